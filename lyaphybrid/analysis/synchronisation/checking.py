"""What must hold at the jumps of a motion so that perturbations across it have a linear rule."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._arguments import require
from ...systems.hybrid import Hybrid
from ..trajectories import trajectory
from .skew_products import GuardJump, guard_jumps

__all__ = ["check_jumps", "differ"]

LOOKED_AT = 1 / 16, 1.0  # parts of the run whose jumps are looked at: more where a transition has not fired
EACH = 8  # jumps that are looked at, of each transition out of each mode
SAME = 1e-8  # relative: two values that should be equal
TOGETHER = (
    "At t = {:.6g} several jumps follow each other at one instant. What they do to perturbations across the motion "
    "depends on the field between them, which has no meaning there: let the reset of the first do what all of them do, "
    "so that it is one jump."
)


def check_jumps(system: Any, x0, args, check: Callable[..., None], *, length: float, **how) -> None:
    """Follow the motion alone and call ``check(jump, t, x, new, *which)`` at its first jumps.

    It is followed for a part of its length, and for the whole of it where a transition has not fired by then.

    Args:
        system: of the motion; nothing is done where it is no `lh.Hybrid` with guards.
        x0: start, (n,).
        args: parameters.
        check: raises a ValueError where the jump has no linear rule.
        length: of the run.
        **how: t0, mode and method, as for `lh.trajectory`.
    """
    if not isinstance(system, Hybrid):
        return
    jumping = {i for i, one in enumerate(system.transitions) if not one.is_clock and not one.changes_nothing}
    for part in LOOKED_AT:
        if jumping:
            events = trajectory(system, x0, args, t1=part * length, n=1, throw=False, **how).events
            jumping -= _looked_at(system, args, events, check)


def _looked_at(system: Hybrid, args, events, check) -> set[int]:
    """Check the jumps among the events of a run; the numbers of the transitions that have fired."""
    instants, seen = np.asarray(events.t), Counter[tuple[int, int]]()
    for i, number in enumerate(np.asarray(events.transition)):
        if number >= len(system.transitions):  # the border of a flow set
            continue
        transition, here = system.transitions[number], int(events.mode_before[i])
        if transition.is_clock or transition.changes_nothing:
            continue
        before = i and instants[i] - instants[i - 1] <= 1e-12 * max(1.0, abs(instants[i]))
        require(not before, TOGETHER.format(instants[i]))
        seen[number, here] += 1
        if seen[number, here] <= EACH:
            jump = dict(guard_jumps(system, transition))[system.mode_names[here]]
            check(jump, events.t[i], events.x_before[i], events.x_after[i], *_which(jump, events, i, args))
    return {number for number, _ in seen}


def _which(jump: GuardJump, events, i: int, args) -> tuple:
    """The component of a vector guard; nothing for a scalar one."""
    guard = jump.transition.guard
    assert guard is not None, "clocks are not looked at"
    shape = jax.eval_shape(guard, events.t[i], events.x_before[i], args).shape
    return (events.which[i],) if shape else ()


def differ(one, other) -> Array:
    """Whether two arrays differ by more than rounding and the error of an event's instant."""
    return jnp.any(jnp.abs(one - other) > SAME * (1 + jnp.maximum(jnp.abs(one), jnp.abs(other))))
