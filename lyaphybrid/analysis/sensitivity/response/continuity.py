"""Detect discontinuities of a rule or a field: jumps and kinks, which its derivatives do not show.

Between two points of the attractor, PAIR_DISTANCE apart along the unstable direction, a smooth function changes by the
mean of the slopes at both, and its slope by the mean of the second derivatives, up to about the cube of PAIR_DISTANCE
of third and fourth ones. A jump of a map alone may be a change of charts, as φ mod 2π is: it is one if the point found
and the point predicted from the slopes have the same image.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

__all__ = ["PAIR_DISTANCE", "breaks"]

PAIR_DISTANCE = 1e-3  # distance of the two points, relative to the size of the attractor
SEEN = 1e-3  # least relative size of a jump that is detected


def breaks(function: Callable, x, direction, size, charts: bool) -> Any:
    """Whether a function has a jump or kink between x and x + PAIR_DISTANCE size direction.

    Args:
        function: x (n,) -> (n,).
        x: (n,) point.
        direction: (n,) unit vector.
        size: of the attractor.
        charts: a jump may be a change of charts: the function is a map, and its values are points.
    """

    def values(x, direction):
        return jax.jvp(function, (x,), (direction,))

    def ahead(s):
        return jax.jvp(lambda s: values(x + s * direction, direction), (s,), (jnp.ones_like(s),))

    reach = PAIR_DISTANCE * size
    ((here, slope), (_, bend)), ((there, slope_there), (_, bend_there)) = ahead(0.0 * reach), ahead(reach)
    foreseen = here + reach * (slope + slope_there) / 2
    kink = _apart(slope_there, slope + reach * (bend + bend_there) / 2, size * _norm(bend))
    jump = _apart(there, foreseen, size * _norm(slope))
    if not charts:
        return kink | jump
    onwards = slope_there / _norm(slope_there)
    found, expected = values(there, onwards), values(foreseen, onwards)
    alike = ~_apart(found[0], expected[0], size * _norm(found[1])) & ~_apart(found[1], expected[1], 0.0)
    return kink | (jump & ~alike)


def _apart(one, other, scale):
    return _norm(one - other) > SEEN * (_norm(one) + _norm(other) + scale)


def _norm(vector):
    return jnp.sqrt(jnp.sum(vector**2))
