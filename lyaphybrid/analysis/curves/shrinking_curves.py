"""Where the orbits of a bifurcation curve shrink to an equilibrium, and the curve ends.

A curve of folds ends so at a generalised Hopf point (Bautin's). With the extent a of the orbits both parameters change
as polynomials in a², which smaller and smaller orbits give.

Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (Springer 2004), section 8.3, doi:10.1007/978-1-4757-3978-7.
"""

from typing import NamedTuple

import numpy as np
import scipy

from ...errors import RunFailedError
from ..continuation.shrinking import Swing, hopf_point, swing_of
from .equations import CurveEquations, CurvePoint

__all__ = ["CurveBound", "before_the_end"]

SMALLER = (0.7, 0.45, 0.2)  # extents of the orbits in front of an equilibrium, relative to the last one


class CurveBound(NamedTuple):
    """The range of one unknown, counted from the end of z, and what the curve reaches at its ends."""

    place: int
    low: float
    high: float
    ends: tuple[str, str]


def before_the_end(
    equations: CurveEquations, last: CurvePoint, swing: Swing, bounds: list[CurveBound]
) -> CurvePoint | None:
    """A smaller orbit between this one and the Hopf point at which the curve ends; None if there is no such point."""
    branch = equations.along(0, last.pair)
    beside = hopf_point(branch, last.orbit, last.pair[0], swing)
    if beside is None:
        return None
    states = len(last.orbit.nodes) * len(swing.mean)
    outward = np.where(np.arange(len(last.u)) < states, last.u, 0.0)
    outward[:states] -= beside.u[:states]
    distance = float(np.linalg.norm(outward))
    if not distance > 0 or last.tangent @ outward >= 0:
        return None
    across = outward / distance
    # What is no state changes with the square of the distance.
    others = np.where(np.arange(len(last.u)) < states, 0.0, last.tangent) * distance / (2 * (last.tangent @ across))
    points = [last]
    for share in SMALLER:
        guess = last.u - (1 - share) * outward - (1 - share**2) * others
        point = equations.corrected(guess, last.orbit, across, float(across @ guess), reach=distance)
        if point is None or not swing.resembles(swing_of(point.orbit, branch.symmetry), share):
            return None
        points.append(point)
    limit = _limit(equations, points)
    inside = limit is not None and all(bound.low <= limit.u[bound.place] <= bound.high for bound in bounds)
    return points[-1]._replace(tangent=-points[-1].tangent, limit=limit) if inside else None


def _limit(equations: CurveEquations, points: list[CurvePoint]) -> CurvePoint | None:
    """The equilibrium that orbits shrink to, from the polynomials through them in the square of their extent."""
    swings = [swing for point in points if (swing := swing_of(point.orbit, equations.base.symmetry)) is not None]
    nodes = points[-1].orbit.nodes
    rows = [
        np.append(np.tile(swing.mean, len(nodes)), (point.u * _units(equations, point))[len(nodes) * len(swing.mean) :])
        for swing, point in zip(swings, points, strict=True)
    ]
    squares = np.square([swing.extent for swing in swings]) / swings[0].extent ** 2
    values = scipy.interpolate.KroghInterpolator(squares, rows)(0.0)
    z = values / _units(equations, points[-1])
    try:
        there = equations.linearised(z, points[-1].orbit)
    except (RunFailedError, ValueError):
        return None
    return points[-1]._replace(orbit=there.orbit, pair=there.pair, own=there.own, u=z)


def _units(equations: CurveEquations, point: CurvePoint) -> np.ndarray:
    """The scales of all unknowns (N + 2 + e,)."""
    first = equations.along(0, point.pair).scales(point.orbit)
    return np.concatenate([first, [equations.spans[1]], np.ones(len(point.own))])
