"""What is met between two points of a branch, and where.

A test that changes sign has a root along the branch. Next to a branch point Newton's method is led astray by rounding,
and the nearer the more: there the branch and the test are interpolated from points a little aside.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy  # its parts load when they are first used; those used here take long

from ...errors import RunFailedError
from .bifurcations import TESTS, branching, is_complex, of_doubling
from .equations import Equations, Point

__all__ = ["Change", "Found", "change_of", "crossings"]

ASIDE = 0.1 * np.array([-3, -2, -1, 1, 2, 3])  # of a step: where a branch point is seen from
SAME = 1e-3  # of a step: a fold this near to a branch point is that point
ROOT = 1e-2  # of a test's values around: what is left at a root; more is a jump


class Change(NamedTuple):
    """A direction from an orbit, at its first node."""

    x: np.ndarray  # (n,)
    period: float
    parameter: float
    shift: np.ndarray  # (q,) of a group


class Found(NamedTuple):
    """A point of a branch at which something happens."""

    kind: str
    point: Point
    change: Change | None  # towards another branch
    turns: int  # of this orbit in one of that branch


def crossings(equations: Equations, before: Point, after: Point) -> list[Found] | None:
    """Where the tests change sign between two points, in their order; None where Newton's method fails there."""
    total = float(before.tangent @ (after.u - before.u))
    places: list[tuple[float, Found]] = []
    for kind, test in TESTS.items():
        ends = test(equations, before), test(equations, after)
        if ends[0] * ends[1] >= 0:
            continue
        try:
            place, point = _located(equations, before, after, total, kind)
            jump = abs(test(equations, point)) > ROOT * max(np.abs(ends))
            found = None if jump else _found(equations, kind, point)
        except (_LostError, RunFailedError):
            return None
        double = kind == "fold" and any(abs(place - other) < SAME * total for other, _ in places)
        if found is not None and not double:
            places.append((place, found))
    return [found for _, found in sorted(places, key=lambda pair: pair[0])]


class _LostError(Exception):
    """Newton's method found no point of the branch."""


def _located(equations: Equations, before: Point, after: Point, total: float, kind: str) -> tuple[float, Point]:
    """The point between two others where a test vanishes, by its place along the first tangent."""
    slopes = before.tangent, after.tangent / (before.tangent @ after.tangent)
    path = scipy.interpolate.CubicHermiteSpline([0.0, total], [before.u, after.u], slopes)
    known = {0.0: before, total: after}

    def at(place: float) -> Point:
        if place not in known:
            level = float(before.tangent @ before.u + place)
            point = equations.corrected(path(place), before.orbit, before.tangent, level, reach=total)
            if point is None:
                raise _LostError
            known[place] = point
        return known[place]

    def value(place: float) -> float:
        return TESTS[kind](equations, at(place))

    if kind == "branch point":
        roughly = _root(value, 0.0, total, 0.05 * total)
        return _from_aside(equations, roughly + ASIDE * total, at, value)
    place = _root(value, 0.0, total, 1e-14)
    return place, at(place)


def _root(function: Callable[[float], float], low: float, high: float, within: float) -> float:
    return float(scipy.optimize.brentq(function, low, high, xtol=within, rtol=8.9e-16))  # pyright: ignore[reportArgumentType]


def _from_aside(equations: Equations, places: np.ndarray, at: Callable, value: Callable) -> tuple[float, Point]:
    """A branch point, by the polynomials through points around it."""
    rows = [np.append(value(place), at(place).u) for place in map(float, places)]
    through = scipy.interpolate.KroghInterpolator(places, rows)
    if rows[2][0] * rows[3][0] >= 0:
        raise _LostError
    place = _root(lambda place: float(through(place)[0]), float(places[2]), float(places[3]), 1e-14)
    u, along = through(place)[1:], through.derivative(place)[1:]
    orbit, p = equations.shoot(u, at(float(places[2])).orbit)
    return place, Point(orbit, p, u, equations.linearised(orbit, p)[0], along / np.linalg.norm(along), 0)


def _found(equations: Equations, kind: str, point: Point) -> Found | None:
    """What a change of sign means, and where it leads."""
    if kind == "branch point":
        other = branching(equations, point)
        return Found(other.kind, point, change_of(equations, point, other.direction), 1)
    if kind == "period doubling":
        return Found(
            kind,
            point,
            Change(of_doubling(equations, point) * equations.size, 0.0, 0.0, np.zeros(len(equations.shifts))),
            2,
        )
    if kind == "Neimark–Sacker" and not is_complex(equations, point):
        return None
    return Found(kind, point, None, 1)


def change_of(equations: Equations, point: Point, direction: np.ndarray) -> Change:
    """A direction of the unknowns, as it is seen at the first node."""
    values = direction * equations.scales(point.orbit)
    n, states = len(point.orbit.nodes[0].x), len(point.orbit.nodes) * len(point.orbit.nodes[0].x)
    shift = values[states + equations.autonomous :][: len(equations.shifts)]
    return Change(values[:n], float(values[states]) if equations.autonomous else 0.0, float(values[-1]), shift)
