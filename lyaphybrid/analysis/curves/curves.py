"""Bifurcations of periodic orbits followed in two parameters."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..._arguments import Progress, Real, numbers, positive, require, require_values, shape, whole
from ..._jax.precision import require_double
from ..._jax.tracing import as_jax
from ...engine.preparation import grown_columns
from ...errors import NoPeriodicOrbitError
from ...integrators.base import Method
from ...systems.hybrid import Hybrid
from ...systems.kinds import iterates
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from ..continuation.branches import Special
from ..continuation.continuing import (
    at_rest,
    equations_of,
    least_sizes,
    moving,
    orbit_as_result,
    parameters_named,
    range_of,
    require_wider,
)
from ..continuation.equations import BranchEquations, ParameterOf
from ..continuation.following import Arc, BranchProgress, followed
from ..continuation.locating import BORDER
from ..continuation.shrinking import HOPF
from ..continuation.touching import found_touches
from ..orbits.motion.motions import SAMPLES_PER_PIECE, Node
from ..orbits.periodic_orbits import Floquet, floquet
from ..orbits.shooting import OrbitIterate
from .bifurcation_curves import BifurcationCurve, CurveSpecial
from .equations import Condition, CurveEquations, CurvePoint
from .following_curves import follow_curve
from .multiplier_conditions import BranchPointCondition, DoublingCondition, FoldCondition, TorusCondition
from .shrinking_curves import CurveBound
from .touch_conditions import BorderCondition, TouchCondition, placed_around

__all__ = ["bifurcation_curve"]

CONDITIONS: dict[str, Condition] = {
    "fold": FoldCondition(),
    "pitchfork": BranchPointCondition(),
    "transcritical": BranchPointCondition(),
    "period doubling": DoublingCondition(),
    "Neimark–Sacker": TorusCondition(),
}
FROM_BORDER = (
    "for a curve of them give its orbit.x0, and border=(n, x, args) -> number, zero where the rule has its kink."
)
FROM_ELSEWHERE = "there the orbit is an equilibrium. Give a special point of another kind."
FEW_SAMPLES = 24  # recorded points of a piece of motion: enough to tell one orbit from another
# Largest distances, in scaled unknowns, from the given orbit to the first point of the curve.
FROM_SPECIAL, FROM_ORBIT = 0.2, 2.0


def bifurcation_curve(
    system: Flow | Map | Hybrid,
    x0: Any,
    args: Any = None,
    *,
    over: Mapping[str, tuple[float, float]],
    border: Callable | None = None,
    period: Any = None,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    segments: int = 1,
    step: float = 0.03,
    max_points: int = 500,
    conserve: Any = None,
    modulo: Any = None,
    progress: Progress = None,
) -> BifurcationCurve:
    """The curve on which a bifurcation of periodic orbits stays one, as two parameters change.

    It begins at a `Special` that `lh.continuation` found, and is followed to both sides by pseudo-arclength, round its
    own folds and through cusps. Besides the orbit's equations this holds:

    - fold: the Jacobian of the orbit's equations is singular;
    - pitchfork, transcritical: the same, and the parameter does not unfold it, for a symmetry, or an orbit that is
      there anyway, demands it;
    - period doubling: M + I is singular, M the monodromy matrix;
    - Neimark–Sacker: M² − 2 cos θ M + I has two null vectors;
    - grazing: an orbit touches a guard, h = 0 and dh/dt = 0 at one time (an impact with no speed; where sliding begins
      by a touch, or ends or splits inside);
    - edge: an event falls on the zero of another guard, h = 0 and e = 0 (where sliding begins at a crossing; two walls
      at once), or on the tick of a clock (a border collision of a converter);
    - border: a point of a map's orbit lies on a border.

    Which of grazing and edge a `Special` of kind "grazing" is, is found from its orbit. The motion up to a touch does
    not feel the touched guard, so that the curve is smooth, and goes on beyond a cusp, where the touch is from the
    other side and the orbit would hit the guard elsewhere.

    Args:
        system: as for `lh.continuation`.
        x0: a `Special` of an `lh.continuation` with the same system, args and options; with `border` (n,), a point near
            an orbit of which a point lies near the border.
        args: pytree of parameters; the second parameter begins at its value in there.
        over: ``{"rho": (low, high), "sigma": (low, high)}``, two entries of args and their ranges; the first one is the
            parameter of the branch on which the `Special` lies.
        border: of an `lh.Map` (or jumps only), ``(n, x, args) -> number``: zero where the map is not smooth.
        period: as for `lh.continuation`.
        t0: as for `lh.continuation`.
        mode: as for `lh.continuation`.
        method: as for `lh.continuation`.
        segments: number of pieces for multiple shooting; not for curves of touches, which have their own.
        step: the largest step along the curve, relative to the ranges and to the size of the first orbit.
        max_points: largest number of points to each side.
        conserve: as for `lh.continuation`.
        modulo: as for `lh.continuation`.
        progress: as for `lh.continuation`.

    Returns:
        A `BifurcationCurve`. Where Newton's method fails on the way it holds the points until then, and `ends` says so;
        `.resume(…)` goes on at its ends.

    Raises:
        ValueError: on arguments that do not fit; where no touch is found at a `Special` of kind "grazing".
        NoPeriodicOrbitError: where Newton's method does not arrive on the curve.
        RunFailedError: where the motion from x0 itself fails.

    Source:
        W. J. F. Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria (SIAM 2000),
        doi:10.1137/1.9780898719543; Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (Springer 2004), chapter
        10, doi:10.1007/978-1-4757-3978-7; for touches M. di Bernardo, C. Budd, A. Champneys & P. Kowalczyk,
        Piecewise-smooth Dynamical Systems (Springer 2008), doi:10.1007/978-1-84628-708-4.

    Example:
        The fold of x ↦ a + (1 + b) x − x³, which is at a = ±2 (b/3)^(3/2), and its cusp:

        >>> import lyaphybrid as lh
        >>> cubic = lh.Map(lambda n, x, args: args["a"] + (1 + args["b"]) * x - x**3)
        >>> args = {"a": 0.0, "b": 0.75}
        >>> branch = lh.continuation(cubic, [0.9], args, over={"a": (-1.0, 1.0)}, period=1)
        >>> fold = branch.of_kind("fold")[0]
        >>> curve = lh.bifurcation_curve(cubic, fold, args, over={"a": (-1.0, 1.0), "b": (-0.5, 1.0)}, period=1)
        >>> curve.ends
        ('range', 'range')
        >>> cusp = curve.specials[0]
        >>> cusp.kind, bool(abs(cusp.values).max() < 1e-9)
        ('cusp', True)
    """
    kinds = isinstance(system, Flow | Hybrid | Map)
    require(kinds, f"bifurcation_curve needs an lh.Flow, lh.Hybrid or lh.Map; got {system!r}.")
    grown_columns("bifurcation_curve", method)
    special = x0 if isinstance(x0, Special) else None
    start = x0 if special is None else special.x0
    require(
        special is not None or border is not None,
        f"x0 must be a Special of an lh.continuation, such as branch.specials[0], or border be given; got {x0!r}.",
    )
    require(
        special is None or special.kind == "grazing" or special.kind in CONDITIONS,
        f"No curve begins at a {special.kind if special else ''} point: "
        + (FROM_BORDER if special and special.kind == BORDER else FROM_ELSEWHERE),
    )
    require_values("bifurcation_curve", start, args, t0)
    whole("segments", segments, least=1)
    whole("max_points", max_points, least=2)
    positive("step", step)
    names, ranges, args_of, pair = _pair(args, over)
    labels = labels_of(system, shape("x0", start))
    discrete = isinstance(system, Map) or iterates(system)
    require(border is None or discrete, "border is for an lh.Map: a flow's borders are the guards of an lh.Hybrid.")
    require(border is None or callable(border), f"border must be a function (n, x, args) -> number; got {border!r}.")
    given = method
    system, method = moving(system, method)
    require_double("x0", start, "bifurcation_curve")
    options: dict[str, Any] = {"period": period, "t0": t0, "mode": mode, "method": method, "segments": segments}
    options |= {"conserve": conserve, "modulo": modulo}
    if special is not None:
        pair = float(special.parameter), pair[1]
    for name, value, (low, high) in zip(names, pair, ranges, strict=True):
        require(low <= value <= high, f"{name} is {value:.6g}: it must be in over, from {low:.6g} to {high:.6g}.")
    if special is None:
        orbit = floquet(system, as_jax(np.asarray(numbers("x0", x0), float)), args, **dict(options, method=given))
    else:
        orbit = special.orbit
    turns, within = 1 if special is None else special.turns, (ranges[0][0], pair[0], ranges[0][1])
    more = options, least_sizes(x0), given is None
    base = equations_of(system, args_of[0], within, names[0], orbit, turns, *more)._replace(samples=FEW_SAMPLES)
    kind, condition, placed, own = _condition(base, special, border, orbit, pair[0])
    entries = int(args_of[0].entry), int(args_of[1].entry)
    spans = ranges[0][1] - ranges[0][0], ranges[1][1] - ranges[1][0]
    equations = CurveEquations(base, args_of[0], entries, spans, condition)
    first = equations.corrected(*_at_second(equations, placed, pair, own), FROM_SPECIAL if special else FROM_ORBIT)
    if first is None:
        raise NoPeriodicOrbitError(
            f"Newton's method does not arrive on the curve of {kind} from the orbit given: (a) the first name in over "
            "must be the parameter of its branch, and system, args and options the same as there; (b) at a cusp or a "
            "fold of the curve begin at another value of the second parameter; (c) the orbit is not near enough.",
            orbit,
        )
    reports = BranchProgress(progress, first.pair, ranges)
    curve = _Curve(equations, kind, names, orbit, tuple(ranges), step, max_points, float(t0), labels, reports)
    return curve.followed([Arc.begun(first._replace(tangent=side * first.tangent), step) for side in (-1.0, 1.0)])


def _pair(args, over) -> tuple[tuple[str, str], list, tuple[ParameterOf, ParameterOf], tuple[float, float]]:
    """Both names, their ranges, p ↦ args for each, and their values in args."""
    good = isinstance(over, Mapping) and len(over) == 2 and all(isinstance(name, str) for name in over)
    require(good, f"over must name two parameters, {{name: (low, high), name: (low, high)}}; got {over!r}.")
    first, second = over
    (of_first, of_second), (p, q) = parameters_named(args, first, second)
    return (first, second), [range_of(over[first]), range_of(over[second])], (of_first, of_second), (p, q)


def _at_second(
    equations: CurveEquations, orbit: OrbitIterate, pair: tuple[float, float], own: np.ndarray
) -> tuple[np.ndarray, OrbitIterate, np.ndarray, float]:
    """The unknowns of an orbit, the orbit, and the hyperplane on which the second parameter is what it is."""
    z = equations.vector(orbit, pair, own)
    across = np.zeros(len(z))
    across[len(z) - len(own) - 1] = 1.0
    return z, orbit, across, float(across @ z)


def _condition(
    branch: BranchEquations, special: Special | None, border: Callable | None, found: Floquet, p: float
) -> tuple[str, Condition, OrbitIterate, np.ndarray]:
    """The kind of the curve, its condition, the orbit with nodes that fit, and the condition's unknowns."""
    node, period = Node(*found.base), found.period
    if border is not None:
        return "border", BorderCondition(border), branch.orbit_from(node, p, period), np.zeros(0)
    assert special is not None
    if special.kind != "grazing":
        condition = CONDITIONS[special.kind]
        own = np.zeros(condition.unknowns)
        if special.kind == "Neimark–Sacker":
            own[0] = _cosine(np.asarray(special.multipliers))
        return special.kind, condition, branch.orbit_from(node, p, period), own
    seen = branch._replace(samples=SAMPLES_PER_PIECE)
    orbit = seen.orbit_from(node, p, period)
    touches = found_touches(seen, orbit, p)
    require(
        len(touches) > 0,
        "At this special point the sequence of the events changes, but the orbit neither touches a guard nor has an "
        "event on the zero of another or at the tick of a clock: there is no curve to follow.",
    )
    nearest = touches[0]
    orbit, before = placed_around(branch, orbit, p, nearest)
    kind = "grazing" if nearest.touch.tangential else "edge"
    return kind, TouchCondition(nearest.touch), orbit, np.array([before / branch.time])


def _cosine(multipliers: np.ndarray) -> float:
    """The cosine of the angle of the complex pair that is nearest to the unit circle."""
    pairs = multipliers[np.imag(multipliers) > 0]
    nearest = pairs[np.argmin(np.abs(np.abs(pairs) - 1))]
    return float(np.cos(np.angle(nearest)))


def _angle(point: CurvePoint) -> float:
    """θ from its cosine."""
    return float(np.arccos(np.clip(point.own[0], -1, 1)))


class _Curve(NamedTuple):
    """A curve, whose arcs can be followed on."""

    equations: CurveEquations
    kind: str
    names: tuple[str, str]
    orbit: Floquet
    ranges: tuple[tuple[float, float], ...]
    step: float
    most: int
    t0: float
    labels: Labels
    progress: BranchProgress

    def followed(self, arcs: list[Arc]) -> BifurcationCurve:
        """The curve with both arcs followed on."""
        bounds, how = self._bounds(), (self.step, self.most, self.progress)
        arcs = followed(arcs, lambda arc: follow_curve(self.equations, self.kind, arc, bounds, *how), self.progress)
        return self._as_result(arcs)._resumed_by(functools.partial(self._again, arcs))

    def _again(self, arcs: list[Arc], most: int | None, over) -> BifurcationCurve:
        ranges = self.ranges
        if over is not None:
            good = isinstance(over, Mapping) and set(over) == set(self.names)
            require(good, f"over must give ranges of {' and '.join(self.names)}; got {over!r}.")
            ranges = tuple(range_of(over[name]) for name in self.names)
        for name, wider, before in zip(self.names, ranges, self.ranges, strict=True):
            require_wider(name, wider, before)
        silent = BranchProgress(None, [low for low, _ in ranges], ranges)
        return self._replace(ranges=ranges, most=most or self.most, progress=silent).followed(arcs)

    def _bounds(self) -> list[CurveBound]:
        own = self.equations.condition.unknowns
        bounds = [
            CurveBound(place - own, low / span, high / span, ("range", "range"))
            for place, (low, high), span in zip((-2, -1), self.ranges, self.equations.spans, strict=True)
        ]
        if self.kind == "Neimark–Sacker":
            bounds.append(CurveBound(-1, -1.0, 1.0, ("1:2 resonance", "1:1 resonance")))
        return bounds

    def _as_result(self, arcs: list[Arc]) -> BifurcationCurve:
        """Both arcs as one curve, the first one reversed."""
        start, after = Node(self.t0, self.orbit.x0, self.orbit.mode), arcs[-1]
        before = arcs[0] if len(arcs) == 2 else Arc(after.points[:1], [], "closed", 0.0)
        points = [*reversed(before.points[1:]), *after.points]

        def orbit_of(point: CurvePoint) -> Floquet:
            along = self.equations.along(0, point.pair)
            return orbit_as_result(along, point.orbit, point.pair[0], start, self.labels)

        def special_of(name: str, point: CurvePoint) -> CurveSpecial:
            orbit = orbit_of(point)
            orbit = at_rest(orbit, point.orbit) if name == HOPF else orbit
            return CurveSpecial(name, self.names, np.array(point.pair), orbit)

        return BifurcationCurve(
            kind=self.kind,
            parameters=self.names,
            values=np.array([point.pair for point in points]),
            orbits=tuple(orbit_of(point) for point in points),
            specials=tuple(special_of(name, one) for name, one in [*reversed(before.found), *after.found]),
            ends=(before.end, after.end),
            angles=np.array([_angle(one) if self.kind == "Neimark–Sacker" else np.nan for one in points]),
            state_labels=self.labels,
        )
