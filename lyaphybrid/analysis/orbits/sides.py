"""On which side of its guards an orbit lies: beyond one that never fires it began there, or never comes back."""

import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compiled
from ..._jax.tracing import array
from ...engine import problems
from ...systems.hybrid import Hybrid
from .motion.motions import Motion
from .shooting import OrbitIterate

__all__ = ["BEYOND_GUARD", "beyond_a_guard"]

BEYOND_GUARD = "beyond_guard"  # the note


def beyond_a_guard(flow: Motion, orbit: OrbitIterate) -> bool:
    """Whether a directed guard is at its fired side at the orbit's first node, and fires nowhere on the orbit."""
    system, node = flow.problem.system, orbit.nodes[0]
    if not isinstance(system, Hybrid):
        return False
    name = problems.mode_names(system)[flow.mode(node)]
    waiting = [
        j
        for j, one in enumerate(system.transitions)
        if one.guard is not None and one.direction and one.when is None and (one.source is None or name in one.source)
    ]
    fired = {
        (int(j), max(int(which), 0))
        for piece in orbit.pieces
        for j, which in zip(piece.events.transition, piece.events.which, strict=True)
    }
    values = _guards(system, array(node.t, node.x.dtype), node.x, flow.problem.args) if waiting else ()
    return any(
        value * system.transitions[j].direction > 0 and (j, entry) not in fired
        for j in waiting
        for entry, value in enumerate(np.asarray(values[j]))
    )


@compiled(hands_on=True)
def _guards(system, t, x, args):
    """The values (m,) of each transition's guard; none of clocks."""
    return [
        jnp.zeros(0, x.dtype) if one.guard is None else jnp.atleast_1d(one.guard(t, x, args))
        for one in system.transitions
    ]
