"""Whether a root of the equations of an orbit is one: an equilibrium is a root too, and a motion along a group."""

import numpy as np

from ..._jax.precision import digits
from ..._linalg.products import in_units
from ...errors import RunFailedError
from .motion.motions import Motion
from .shooting import OrbitIterate

__all__ = ["goes_along", "repeats", "rests"]

# M f = f must hold to this relative tolerance; it fails by about |f| where there is no orbit ….
FLOW_DIRECTION_KEPT = 1e-6
ROUNDED = 1e-9  # … plus this fraction of |M| |f|, the rounding error of a large derivative


def rests(flow: Motion, orbit: OrbitIterate) -> bool:
    """Whether the motion is only along the group: modulo the group it is an equilibrium without a period."""
    if flow.symmetry is None or not flow.symmetry.freedom:
        return False
    base = orbit.nodes[0]
    velocity, along = flow.velocity(base) / orbit.units, flow.symmetry.image(base.x).by_shift / orbit.units[:, None]
    across = velocity - along @ np.linalg.lstsq(along, velocity)[0]
    return bool(np.linalg.norm(across) <= digits(FLOW_DIRECTION_KEPT, base.x) * np.linalg.norm(velocity))


def repeats(flow: Motion, orbit: OrbitIterate) -> bool:
    """Whether the next period is the image of this one, jumps included; if not, modulo is no symmetry."""
    if flow.symmetry is None or orbit.torn:
        return True
    start, end = orbit.nodes[0], flow.goal(orbit.goal, orbit.shift)
    try:
        again = flow.piece(orbit.goal._replace(t=start.t), orbit.period)
    except RunFailedError:
        return False
    units = np.maximum(orbit.sizes, np.abs(end.x))
    spread = 1 + np.linalg.norm(in_units(again.matrix, units), 2)
    apart = np.linalg.norm((np.asarray(again.x) - np.asarray(end.x)) / units)
    return bool(apart <= digits(FLOW_DIRECTION_KEPT, start.x) * spread)


def goes_along(flow: Motion, orbit: OrbitIterate) -> bool:
    """Whether each piece maps its velocity to that of the next, M_i f(x_i) = f(x_{i+1}): then one multiplier is 1."""
    along, rounded = (digits(part, orbit.nodes[0].x) for part in (FLOW_DIRECTION_KEPT, ROUNDED))
    units = orbit.units
    speeds = [
        (in_units(piece.matrix, units), flow.velocity(piece.start) / units, flow.velocity(node) / units)
        for piece, node in orbit.seams
    ]
    return all(
        np.linalg.norm(matrix @ before - after)
        < along * np.linalg.norm(after) + rounded * np.linalg.norm(matrix, 2) * np.linalg.norm(before)
        for matrix, before, after in speeds
    )
