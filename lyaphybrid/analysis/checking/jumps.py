"""The jumps of a trial run: what resets and targets do, how guards are met, and which are passed the other way."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...engine.evolvers.landing import GRAZING
from ...systems.hybrid import Hybrid, Transition
from ..trajectories import Trajectory
from .report import Finding, in_short, noted, right, wrong

__all__ = ["check_jumps", "check_targets"]

BEYOND = 1e-9  # a guard is on its fired side after a jump if it is by more than this part of its terms


class _Guard:
    """A guard with `args` bound, positive before it fires; of a vector guard one component."""

    def __init__(self, transition: Transition, args: Any, t, x):
        guard, sign = transition.guard, -1.0 if transition.direction > 0 else 1.0
        assert guard is not None
        shape = jax.eval_shape(guard, t, x, args).shape
        self.width = shape[0] if shape else 1
        self.value = jax.jit(lambda t, x, which: sign * jnp.atleast_1d(guard(t, x, args))[which])
        self.gradient = jax.jit(jax.grad(self.value, argnums=(0, 1)))

    def size(self, t, x, which) -> float:
        """The size of its terms."""
        moving, gradient = self.gradient(t, x, which)
        return float(abs(moving * t) + jnp.sum(jnp.abs(gradient * x)) + jnp.max(jnp.abs(gradient)) * 1e-3)

    def rate(self, t, x, which, f) -> float:
        """Its time derivative along the flow f."""
        moving, gradient = self.gradient(t, x, which)
        return float(moving + gradient @ f)

    def sees_the_same(self, t, before, after, which) -> bool:
        """Whether the components on which the guard depends are the same in two states."""
        _, gradient = self.gradient(t, before, which)
        moved = jnp.abs(after - before) > BEYOND * (jnp.abs(before) + 1e-3 * jnp.max(jnp.abs(before)))
        return not bool(jnp.any(moved & (gradient != 0)))

    def angle(self, t, x, which, f) -> float:
        """The sine of the angle between the flow and the guard; 1 for a guard of the time alone."""
        moving, gradient = self.gradient(t, x, which)
        terms = float(jnp.abs(moving) + jnp.linalg.norm(gradient) * jnp.linalg.norm(f))
        return abs(self.rate(t, x, which, f)) / terms if terms > 0 else 0.0


def check_targets(system: Hybrid, args: Any, run: Trajectory) -> list[Finding]:
    """Targets that are no mode of the system."""
    found = []
    for j, transition in enumerate(system.transitions):
        own = np.flatnonzero(np.asarray(run.events.transition) == j)[:5]
        of = transition.guard
        is_vector = of is not None and bool(jax.eval_shape(of, run.t[0], run.x[0], args).shape)
        found += _of_target(system, j, args, run, own, is_vector)
    return found


def check_jumps(system: Hybrid, args: Any, fields, run: Trajectory) -> list[Finding]:
    """What the jumps of a run show; `fields` are (t, x) -> dx/dt of each mode."""
    found: list[Finding] = []
    counts = np.bincount(np.asarray(run.events.transition), minlength=len(system.transitions))
    for j, transition in enumerate(system.transitions):
        own = np.flatnonzero(np.asarray(run.events.transition) == j)[:5]
        if transition.guard is None:
            continue
        guard = _Guard(transition, args, run.t[0], run.x[0])
        found += _of_landing(system, j, guard, fields, run, own)
        found += _of_contact(j, guard, fields, run, own)
        if not counts[j]:
            found += _passed_unfired(system, j, guard, run)
    total = int(counts.sum())
    said = ", ".join(f"transition {j}: {count}" for j, count in enumerate(counts))
    return found or [right("jumps", f"{total} in the trial run ({said}); resets, targets and contacts are sound")]


def _of_target(system: Hybrid, j: int, args: Any, run: Trajectory, own, is_vector: bool) -> list[Finding]:
    target = system.transitions[j].target
    if not callable(target):
        return []
    for i in own:
        which = (jnp.asarray(run.events.which[i]),) if is_vector else ()
        index = int(target(run.events.t[i], run.events.x_before[i], args, *which))
        if not 0 <= index < len(system.mode_names):
            return [
                wrong("jumps", f"The target of transition {j} is the mode {index} at t = {float(run.events.t[i]):.6g}; "
                      f"there are the modes 0 to {len(system.mode_names) - 1}: {list(system.mode_names)}.")
            ]  # fmt: skip
    return []


def _of_landing(system: Hybrid, j: int, guard: _Guard, fields, run: Trajectory, own) -> list[Finding]:
    """Where a reset leaves the state: off its own guard, and where the field of the next mode is defined."""
    e = run.events
    for i in own:
        t, x, which, mode = e.t[i], e.x_after[i], e.which[i], int(e.mode_after[i])
        f = fields[mode](t, x) if fields else None
        if f is not None and not np.all(np.isfinite(f)):
            return [wrong("jumps", f"After transition {j} at t = {float(t):.6g} the field of mode "
                          f"{system.mode_names[mode]!r} is not finite: {in_short(f)}, x = {in_short(x)}.")]  # fmt: skip
        source = system.transitions[j].source
        armed = source is None or system.mode_names[mode] in source
        stays = np.array_equal(e.x_before[i], x)
        if f is None or not armed or stays or system.transitions[j].direction == 0:
            continue
        value, small = float(guard.value(t, x, which)), BEYOND * guard.size(t, x, which)
        if value < -small:
            return [wrong("jumps", f"The reset of transition {j} ends on the fired side of its own guard (by "
                          f"{-value:.3g}, at t = {float(t):.6g}), so that it fires again at once. It must end on the "
                          "guard or before it.")]  # fmt: skip
        if not guard.sees_the_same(t, e.x_before[i], x, which):  # the reset leads to another place on the guard
            continue
        rate = guard.rate(t, x, which, f)
        if abs(value) <= small and rate < -GRAZING * abs(guard.rate(t, e.x_before[i], which, f)):
            return [wrong("jumps", f"After the reset of transition {j} at t = {float(t):.6g} the state goes on through "
                          f"the guard, to the side on which it had fired: x = {in_short(e.x_before[i])} becomes "
                          f"{in_short(x)}. Is a sign in the reset wrong, or is a target mode missing?")]  # fmt: skip
    return []


def _of_contact(j: int, guard: _Guard, fields, run: Trajectory, own) -> list[Finding]:
    e = run.events
    if not fields:
        return []
    for i in own:
        f = fields[int(e.mode_before[i])](e.t[i], e.x_before[i])
        angle = guard.angle(e.t[i], e.x_before[i], e.which[i], f)
        if angle < GRAZING:
            return [noted("jumps", f"The flow meets the guard of transition {j} nearly tangentially at t = "
                          f"{float(e.t[i]):.6g} (sine of the angle {angle:.1e}): there the saltation matrix is very "
                          "large, and a small change decides whether the event happens.")]  # fmt: skip
    return []


def _passed_unfired(system: Hybrid, j: int, guard: _Guard, run: Trajectory) -> list[Finding]:
    """A guard that never fired, and crossed zero in the direction in which it does not fire."""
    transition = system.transitions[j]
    if transition.direction == 0 or guard.width > 1:
        return []
    t, x, mode, j_done = (np.asarray(one) for one in (run.t, run.x, run.mode, run.j))
    here = np.ones(len(t), bool)
    if transition.source is not None:
        here &= np.isin(mode, [system.mode_names.index(name) for name in transition.source])
    values = np.asarray(jax.vmap(lambda t, x: guard.value(t, x, 0))(t, x))
    same = here[:-1] & here[1:] & (j_done[:-1] == j_done[1:]) & (mode[:-1] == mode[1:])
    count = int(np.sum(same & (values[:-1] < 0) & (values[1:] > 0)))
    if not count:
        return []
    way, other = ("falls", "rose") if transition.direction < 0 else ("rises", "fell")
    return [noted("jumps", f"The guard of transition {j} never fired, but it {other} through zero {count} times in the "
                  f"trial run. It fires where it {way}: is direction={transition.direction} right?")]  # fmt: skip
