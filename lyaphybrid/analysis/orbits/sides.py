"""On which side of its guards an orbit lies: beyond one that never fires it began there, or never comes back."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compiled
from ..._jax.tracing import as_jax
from ...engine import problems
from ...systems.hybrid import Hybrid
from .motion.motions import Motion, MotionPiece

__all__ = ["BEYOND_GUARD", "guards_passed"]

BEYOND_GUARD = "beyond_guard"  # the note
ROUNDING_OF_GUARD = 1e-9  # of its largest value along the orbit


def guards_passed(flow: Motion, pieces: Sequence[MotionPiece]) -> set[tuple[int, int]]:
    """The directed guards, as transition and entry, on whose fired side these pieces lie somewhere and that never fire.

    Only in modes in which the transition is armed, and where its `when` holds.
    """
    system = flow.problem.system
    if not isinstance(system, Hybrid) or not any(_is_directed(one) for one in system.transitions):
        return set()
    first = pieces[0].start
    t = np.concatenate([[first.t], *(piece.start.t + piece.times for piece in pieces)]).astype(first.x.dtype)
    x = np.concatenate([np.asarray(first.x)[None], *(piece.points for piece in pieces)])
    modes = np.concatenate([[flow.mode(first)], *(piece.modes for piece in pieces)])
    names = np.array(problems.mode_names(system))[modes]
    fired = {
        (int(j), max(int(which), 0))
        for piece in pieces
        for j, which in zip(piece.events.transition, piece.events.which, strict=True)
    }
    passed = set()
    for j, values in enumerate(_beyond(system, as_jax(t), as_jax(x), flow.problem.args)):
        values, source = np.asarray(values), system.transitions[j].source
        armed = np.ones(len(t), bool) if source is None else np.isin(names, source)
        for entry, along in enumerate(values.T):
            if (j, entry) not in fired and np.any(along[armed] > ROUNDING_OF_GUARD * np.max(np.abs(along))):
                passed.add((j, entry))
    return passed


def _is_directed(transition) -> bool:
    return transition.guard is not None and transition.direction != 0


@compiled(hands_on=True)
def _beyond(system, t, x, args):
    """How far states (s, n) are beyond each transition's guard, (s, m); not at all where its `when` does not hold."""

    def at(transition, t, x):
        if not _is_directed(transition):
            return jnp.zeros(0, x.dtype)
        values = transition.direction * jnp.atleast_1d(transition.guard(t, x, args))
        if transition.when is None:
            return values
        return jnp.where(transition.when(t, x, args), values, jnp.minimum(values, -values))

    return [jax.vmap(lambda t, x, one=one: at(one, t, x))(t, x) for one in system.transitions]
