"""Special points of a curve: where one more condition holds. Tests change sign there."""

from collections.abc import Callable

import numpy as np

from ..continuation.bifurcations import across_flow
from ..continuation.locating import between, root
from .equations import CurveEquations, CurvePoint

__all__ = ["special_points"]

VANISHES = 1e-5  # the tangent's part along both parameters at a cusp, relative to that at both ends
WITH_CUSPS = ("fold", "grazing", "edge")
ANGLES = {"1:3 resonance": -0.5, "1:4 resonance": 0.0}  # cos θ


def _characteristic(equations: CurveEquations, point: CurvePoint, at: float, derivative: int = 0) -> float:
    """The characteristic polynomial of the monodromy matrix across the flow, or its derivative."""
    matrix = across_flow(equations.along(0, point.pair), point.orbit, point.pair[0])
    polynomial = np.poly(matrix) if len(matrix) else np.ones(1)
    return float(np.polyval(np.polyder(polynomial, derivative), at).real)


def _another(at: float, derivative: int) -> Callable[[CurveEquations, CurvePoint], float]:
    return lambda equations, point: _characteristic(equations, point, at, derivative)


def _angle(kappa: float) -> Callable[[CurveEquations, CurvePoint], float]:
    return lambda equations, point: float(point.own[0]) - kappa


# One multiplier is 1 or −1 along the curve; the test asks for another one.
TESTS_OF_CURVES: dict[str, dict[str, Callable[[CurveEquations, CurvePoint], float]]] = {
    "fold": {"fold–flip": _another(-1.0, 0), "1:1 resonance": _another(1.0, 1)},
    "period doubling": {"fold–flip": _another(1.0, 0), "1:2 resonance": _another(-1.0, 1)},
    "Neimark–Sacker": {name: _angle(kappa) for name, kappa in ANGLES.items()},
}


def special_points(
    equations: CurveEquations, kind: str, before: CurvePoint, after: CurvePoint
) -> list[tuple[str, CurvePoint]]:
    """The special points between two points, in order.

    Raises:
        LostError: where Newton's method fails on the way; a shorter step is needed.
    """
    free = equations.base.symmetry is None and equations.base.conserved is None
    tests = dict(TESTS_OF_CURVES.get(kind, {})) if free or kind == "Neimark–Sacker" else {}
    heading, unknowns = before.parameters_along(equations.condition.unknowns), equations.condition.unknowns
    if kind in WITH_CUSPS:
        tests["cusp"] = lambda equations, point: float(heading @ point.parameters_along(unknowns))
    total, at = between(equations, before, after)
    found = []
    for name, test in tests.items():
        ends = test(equations, before), test(equations, after)
        if ends[0] * ends[1] >= 0:
            continue
        place = root(lambda place, test=test: test(equations, at(place)), 0.0, total)
        point = at(place)
        size = max(np.linalg.norm(end.parameters_along(unknowns)) for end in (before, after))
        if name == "cusp" and np.linalg.norm(point.parameters_along(unknowns)) > VANISHES * size:
            continue  # the curve turns by more than a right angle, without a cusp
        found.append((place, name, point))
    return [(name, point) for _, name, point in sorted(found, key=lambda one: one[0])]
