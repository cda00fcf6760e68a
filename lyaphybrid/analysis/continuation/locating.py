"""Locate the special points between two points of a branch.

A test that changes sign has a root along the branch. Near a branch point the Newton equations are
nearly singular: there the branch and the test are interpolated from points at some distance.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy  # submodules load on first use, because those used here load slowly

from ...errors import RunFailedError
from .bifurcations import TESTS, branching, is_complex, of_doubling
from .equations import BranchEquations, BranchPoint

__all__ = [
    "BORDER",
    "LocatedPoint",
    "LostError",
    "OrbitChange",
    "between",
    "change_of",
    "crossings",
    "is_kink",
    "root",
]

INTERPOLATION_OFFSETS = 0.1 * np.array([-3, -2, -1, 1, 2, 3])  # of a step: offsets of the interpolation points
SAME_POINT = 1e-3  # of a step: a fold nearer to a branch point than this is that branch point
BORDER = "border collision"
DIVERGES = 1e3  # size of scaled derivatives from which on they seem to diverge, as those of √x at 0
OTHER_PIECE = 0.01  # relative change of the equations' derivative across a kink, at least
ON_CIRCLE = 1e-9  # |μ_i μ_j − 1| of pairs that stay on the unit circle, as conservative ones do: its sign is rounding
ROOT = 1e-2  # of the test's values at both ends: a larger value at the root means a jump, not a root


class OrbitChange(NamedTuple):
    """A direction of change of an orbit, at its first node."""

    x: np.ndarray  # (n,)
    period: float
    parameter: float
    shift: np.ndarray  # (q,) change of the shift of a group


class LocatedPoint(NamedTuple):
    """A special point that was located on a branch."""

    kind: str
    point: BranchPoint
    change: OrbitChange | None  # direction to another branch
    turns: int  # turns of this orbit in one period on that branch


def crossings(equations: BranchEquations, before: BranchPoint, after: BranchPoint) -> list[LocatedPoint] | None:
    """The special points between two points, in order; None if Newton's method fails there."""
    total = float(before.tangent @ (after.u - before.u))
    places: list[tuple[float, LocatedPoint]] = []
    for kind, test in TESTS.items():
        ends = test(equations, before), test(equations, after)
        on_circle = kind == "Neimark–Sacker" and min(np.abs(ends)) < ON_CIRCLE
        if ends[0] * ends[1] >= 0 or on_circle:
            continue
        try:
            place, point = _located(equations, before, after, kind)
            jump = abs(test(equations, point)) > ROOT * max(np.abs(ends))
            found = _at_a_kink(equations, before, after, place) if jump else _from_sign_change(equations, kind, point)
        except (LostError, RunFailedError):
            return None
        if found is not None and not _is_known(place / total, found, [(at / total, one) for at, one in places]):
            places.append((place, found))
    return [found for _, found in sorted(places, key=lambda pair: pair[0])]


def _is_known(place: float, found: LocatedPoint, places: list[tuple[float, LocatedPoint]]) -> bool:
    """Whether what was found is another point that a second test shows, too; places in parts of a step."""
    near = [one.kind for other, one in places if abs(place - other) < SAME_POINT]
    return bool(near) if found.kind == "fold" else found.kind == BORDER and BORDER in near


class LostError(Exception):
    """Newton's method found no point of the branch."""


def between(equations: Any, before: Any, after: Any) -> tuple[float, Callable[[float], Any]]:
    """The length between two points along the first tangent, and the points in between, each computed once.

    Raises:
        LostError: by the function, where Newton's method finds no point.
    """
    total = float(before.tangent @ (after.u - before.u))
    slopes = before.tangent, after.tangent / (before.tangent @ after.tangent)
    path = scipy.interpolate.CubicHermiteSpline([0.0, total], [before.u, after.u], slopes)
    known = {0.0: before, total: after}

    def at(place: float) -> Any:
        if place not in known:
            level = float(before.tangent @ before.u + place)
            point = equations.corrected(path(place), before.orbit, before.tangent, level, reach=total)
            if point is None:
                raise LostError
            known[place] = point
        return known[place]

    return total, at


def _located(
    equations: BranchEquations, before: BranchPoint, after: BranchPoint, kind: str
) -> tuple[float, BranchPoint]:
    """The root of a test between two points: its place along the first tangent, and the point."""
    total, at = between(equations, before, after)

    def value(place: float) -> float:
        return TESTS[kind](equations, at(place))

    if kind == "branch point":
        roughly = root(value, 0.0, total, 0.05 * total)
        return _from_aside(equations, roughly + INTERPOLATION_OFFSETS * total, at, value)
    place = root(value, 0.0, total)
    return place, at(place)


def root(function: Callable[[float], float], low: float, high: float, within: float = 1e-14) -> float:
    """A root between two places where the signs differ."""
    return float(scipy.optimize.brentq(function, low, high, xtol=within, rtol=8.9e-16))  # pyright: ignore[reportArgumentType]


def _from_aside(
    equations: BranchEquations, places: np.ndarray, at: Callable, value: Callable
) -> tuple[float, BranchPoint]:
    """A branch point, from the polynomials through points around it."""
    rows = [np.append(value(place), at(place).u) for place in map(float, places)]
    through = scipy.interpolate.KroghInterpolator(places, rows)
    if rows[2][0] * rows[3][0] >= 0:
        raise LostError
    place = root(lambda place: float(through(place)[0]), float(places[2]), float(places[3]))
    u, along = through(place)[1:], through.derivative(place)[1:]
    orbit, p = equations.shoot(u, at(float(places[2])).orbit)
    return place, BranchPoint(orbit, p, u, equations.linearised(orbit, p)[0], along / np.linalg.norm(along), 0)


def _at_a_kink(
    equations: BranchEquations, before: BranchPoint, after: BranchPoint, place: float
) -> LocatedPoint | None:
    """Where a test jumps over zero, if a map has other derivatives on both sides: the border of two of its pieces."""
    if not equations.discrete:
        return None
    total, at = between(equations, before, after)
    sides = [float(np.clip(place + shift * total, 0.0, total)) for shift in (-SAME_POINT, SAME_POINT)]
    try:
        one, other = (at(side).jacobian for side in sides)
    except LostError:  # as beside a branch point
        return None
    return LocatedPoint(BORDER, at(place), None, 1) if is_kink(one, other) else None


def is_kink(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether the equations of a map have other derivatives here and a tiny step on, and none that diverges."""
    size = max(1.0, np.linalg.norm(one), np.linalg.norm(other))
    return bool(size < DIVERGES and np.linalg.norm(one - other) > OTHER_PIECE * size)


def _from_sign_change(equations: BranchEquations, kind: str, point: BranchPoint) -> LocatedPoint | None:
    """The special point of a change of sign, with the direction to the other branch."""
    if kind == "branch point":
        other = branching(equations, point)
        return LocatedPoint(other.kind, point, change_of(equations, point, other.direction), 1)
    if kind == "period doubling":
        return LocatedPoint(
            kind,
            point,
            OrbitChange(of_doubling(equations, point), 0.0, 0.0, np.zeros(len(equations.shifts))),
            2,
        )
    if kind == "Neimark–Sacker" and not is_complex(equations, point):
        return None
    return LocatedPoint(kind, point, None, 1)


def change_of(equations: BranchEquations, point: BranchPoint, direction: np.ndarray) -> OrbitChange:
    """A direction of the scaled unknowns, as a `OrbitChange` at the first node."""
    values = direction * equations.scales(point.orbit)
    n, states = len(point.orbit.nodes[0].x), len(point.orbit.nodes) * len(point.orbit.nodes[0].x)
    shift = values[states + equations.autonomous :][: len(equations.shifts)]
    return OrbitChange(values[:n], float(values[states]) if equations.autonomous else 0.0, float(values[-1]), shift)
