"""Continuation of periodic orbits in a parameter."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ... import _renamed as renamed
from ..._arguments import Progress, Real, State, numbers, positive, real, require, require_values, shape, whole
from ..._jax.precision import require_double
from ..._jax.tracing import as_jax
from ...engine import preparation
from ...errors import NoPeriodicOrbitError
from ...integrators import HalfExplicit, RungeKutta
from ...integrators.base import Method
from ...statuses import STATUS
from ...systems.daes.semi_linear import Constrained, fields_of
from ...systems.hybrid import Hybrid
from ...systems.kinds import iterates
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from ..orbits.families import family_of, shifts_in_time
from ..orbits.motion.invariants import conserved_of
from ..orbits.motion.motions import Motion, Node, sized, states_of
from ..orbits.motion.sizes import sizes_of
from ..orbits.periodic_orbits import Floquet, floquet, floquet_of, require_period
from ..orbits.points import at_start
from ..orbits.shooting import OrbitIterate
from ..orbits.symmetries import symmetry_of
from ..sensitivity.estimates import parameters_of
from .branches import Continuation, Special
from .equations import ZERO_SINGULAR_VALUE, BranchEquations, BranchPoint, ConstantArgs, ParameterOf, states_over
from .following import ASTRAY, Arc, BranchProgress, follow, followed, point_of_orbit, resumed
from .locating import LocatedPoint
from .shrinking import BOUNDARY_EQUILIBRIUM, HOPF

__all__ = [
    "at_rest",
    "continuation",
    "equations_of",
    "least_sizes",
    "moving",
    "orbit_as_result",
    "parameters_named",
    "range_of",
    "require_wider",
]

CONSERVED_VALUE = "conserved value"  # name of the parameter of a family
FEW_NUMBERS = 100  # of args
OF_START = 1e-3  # of the start: least size of a component, which may be zero on the first orbit
FIRST_STEPS = 0.4 ** np.arange(
    18
)  # fractions of the largest step, tried in turn for the first step onto another branch


def _parameter_of_before(name: str, positional: tuple, given: dict[str, Any]) -> tuple:
    """The parameter's name was an argument of its own, the fourth, and `over` its range."""
    parameter = given.pop("parameter", None)
    positional, rest = positional[:3], positional[3:]
    if rest:
        (parameter,) = rest
    if parameter is not None:
        wanted = f"over must give the range of the parameter: over={{{parameter!r}: (low, high)}}; got none."
        require("over" in given, wanted)
        renamed.warn(f"{name}(…, {parameter!r}, over=(low, high))", f"over={{{parameter!r}: (low, high)}}")
        given["over"] = {parameter: given["over"]}
    return positional


@renamed.arguments(_parameter_of_before)
def continuation(
    system: Flow | Map | Hybrid,
    x0: State,
    args: Any = None,
    *,
    over: Mapping[str, tuple[float, float]] | tuple[float, float],
    period: Any = None,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    transient: Real = 0.0,
    segments: int = 1,
    step: float = 0.03,
    max_points: int = 500,
    conserve: Any = None,
    modulo: Any = None,
    progress: Progress = None,
) -> Continuation:
    """The branch of periodic orbits through x0, as a parameter changes, and its bifurcations.

    The orbit is a root of φ_T(x; p) − x, found as `lh.floquet` finds it. The branch of roots is followed by
    pseudo-arclength to both sides, round folds, through jumps, stable or not. Where one of these changes sign between
    two points, its root along the branch is located:

        fold                the tangent's component along p
        pitchfork, transcritical    the determinant of the equations with the tangent: another branch crosses
        period doubling     Π (μ_i + 1)
        Neimark–Sacker      Π (μ_i μ_j − 1), where the pair is complex
        grazing             the sequence of the jumps of a period: an impact appears, sliding begins or ends
        border collision    one of these jumps over zero: of a map, where its rule has a kink

    Where the orbits of an autonomous system shrink to an equilibrium the branch ends, at a Hopf point: there a pair of
    eigenvalues of the field's derivative is ±iω. If events remain until the end it is a boundary equilibrium.

    To follow the branch that begins at a pitchfork, transcritical point or doubling, call again with that `Special`
    for x0 and the other arguments as they were.

    Where a quantity is conserved, periodic orbits form families at one value of the parameter. With `conserve` the
    branch keeps the value that the first orbit has; or, where `over` names no parameter, the branch is the family, and
    that value its parameter.

    Args:
        system: an `lh.Flow`, `lh.Map` or `lh.Hybrid` (sliding modes, and jumps only, included).
        x0: (n,) a point near the orbit at the parameter's value in args; or a `Special` of an earlier result.
        args: pytree of parameters.
        over: ``{"rho": (low, high)}``, the entry of args to change ("rho", "spring.rate", "rates[2]"; "args" where args
            is a number) and its range, with its value in args inside; or (low, high) alone, the range of the value that
            is conserved.
        period: as for `lh.floquet`: None where the system is autonomous, else a number or ``args -> number``; of a map
            the number of iterations. After a doubling it stays what it was.
        t0: the time at x0.
        mode: mode at x0, where there are several.
        method: as for `lh.floquet`.
        transient: length of a run before the search for the first orbit.
        segments: number of pieces for multiple shooting; more for orbits that are long and unstable.
        step: the largest step along the branch, relative to the range and to the size of the first orbit.
        max_points: largest number of points to each side.
        conserve: as for `lh.floquet`.
        modulo: as for `lh.floquet`.
        progress: None, True for a bar, or a function of the fraction done: of the way to the ends of `over`, which a
            branch that turns back or ends need not reach.

    Returns:
        A `Continuation`. Where Newton's method fails on the way, it holds the points until then, and `ends` says so;
        `.resume(…)` goes on at its ends.

    Raises:
        ValueError: on arguments that do not fit; where the first orbit is one of a family at the same parameter.
        NoPeriodicOrbitError: where there is none near x0, or Newton's method did not arrive on the other branch.
        RunFailedError: where the motion from x0 itself fails.

    Source:
        R. Seydel, Practical Bifurcation and Stability Analysis (Springer 2010), doi:10.1007/978-1-4419-1740-9;
        E. L. Allgower & K. Georg, Introduction to Numerical Continuation Methods (SIAM 2003),
        doi:10.1137/1.9780898719154; Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (Springer 2004),
        doi:10.1007/978-1-4757-3978-7.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
        >>> fixed = lh.continuation(logistic, [0.6], 2.5, over={"args": (2.0, 3.5)}, period=1)
        >>> fixed.specials
        (period doubling at 3, T = 1,)
        >>> cycle = lh.continuation(logistic, fixed.specials[0], 2.5, over={"args": (2.0, 3.5)}, period=1)
        >>> cycle.specials  # 1 + √6
        (period doubling at 3.44948974278, T = 2,)
    """
    require(
        isinstance(system, Flow | Hybrid | Map), f"continuation needs an lh.Flow, lh.Hybrid or lh.Map; got {system!r}."
    )
    require_values("continuation", x0, args, t0)
    preparation.grown_columns("continuation", method)
    whole("segments", segments, least=1)
    whole("max_points", max_points, least=2)
    positive("step", step)
    parameter, (low, high) = _named_range(over)
    args_of, value = ConstantArgs(args), None
    if parameter is not None:
        (args_of,), (value,) = parameters_named(args, parameter)
    require(
        parameter is not None or conserve not in (None, False),
        "over names no parameter: its range is that of the value which is conserved, give conserve too; or name an "
        "entry of args, over={name: (low, high)}.",
    )
    first = x0.x0 if isinstance(x0, Special) else x0
    size = shape("x0", first)
    require(len(size) == 1, f"x0 must have shape (n,); got {size}.")
    x0 = x0 if isinstance(x0, Special) else jnp.asarray(numbers("x0", x0))
    labels = labels_of(system, size)
    given = method
    system, method = moving(system, method)
    options: dict[str, Any] = {"period": period, "t0": t0, "mode": mode, "method": method, "segments": segments}
    options |= {"conserve": conserve, "modulo": modulo}
    special = x0 if isinstance(x0, Special) else None
    require_double("x0", special.orbit.x0 if special else x0, "continuation")
    if special is not None:
        begins = f"No branch begins at a {special.kind}: give a pitchfork, transcritical point or period doubling."
        require(special.change is not None, begins)
        value = special.parameter
    name, value = _named(system, parameter, value, special, x0, args, options)
    require(low <= value <= high, f"{name} is {value:.6g}: it must be in over, from {low:.6g} to {high:.6g}.")
    if special is None:
        at = args_of(as_jax(np.asarray(value, float)))
        orbit = floquet(system, jnp.asarray(x0, float), at, transient=transient, **dict(options, method=given))
    else:
        orbit = special.orbit
    turns, near = 1 if special is None else special.turns_there, least_sizes(x0)
    equations = equations_of(system, args_of, (low, value, high), name, orbit, turns, options, near, given is None)
    reports = BranchProgress(progress, value, (low, high))
    branch = _Branch(equations, name, orbit, (low, high), step, max_points, float(t0), labels, reports)
    if special is None:
        origin = _origin(equations, orbit, value)
        arcs = [Arc.begun(origin._replace(tangent=side * origin.tangent), step) for side in (-1.0, 1.0)]
    else:
        origin, arcs = _branched(equations, special, (low, high), step)
    return branch.followed(origin, arcs)


def moving(system: Flow | Map | Hybrid, method: Method | None) -> tuple[Flow | Map | Hybrid, Method | None]:
    """The system, as a map where nothing flows, and the method that follows its orbits."""
    if isinstance(system, Hybrid) and iterates(system):
        reset = system.transitions[0].reset
        assert reset is not None, "lh.Hybrid wants one where nothing flows"
        system = Map(reset, names=system.names, units=system.units)
    if method is None and not isinstance(system, Map):
        constrained = any(isinstance(field, Constrained) for field in fields_of(system))
        method = HalfExplicit(rtol=1e-12, tableau="dopri8") if constrained else RungeKutta(rtol=1e-12, atol=1e-14)
    return system, method


def _named(system, parameter, value, special, x0, args, options) -> tuple[str, float]:
    """Name and value of the parameter; for a family those of the conserved quantity."""
    if parameter is not None or special is not None:
        return parameter or CONSERVED_VALUE, value
    problem, x, t, mode = preparation.prepare(system, x0, args, options["t0"], options["method"], options["mode"])
    mode = Motion(problem).mode(Node(float(t), x, mode))
    conserved = conserved_of(options["conserve"], system, x, mode, problem.args)
    assert conserved is not None
    require(
        len(conserved.wanted) == 1,
        f"over names no parameter: conserve must then be one number; got {len(conserved.wanted)}.",
    )
    return CONSERVED_VALUE, float(conserved.wanted[0])


def _named_range(over) -> tuple[str | None, tuple[float, float]]:
    """The parameter and its range; None for what is conserved."""
    if not isinstance(over, Mapping):
        return None, range_of(over)
    require(len(over) == 1, f"over must name one parameter, {{name: (low, high)}}; got {over!r}.")
    ((parameter, own),) = over.items()
    return parameter, range_of(own)


def range_of(over) -> tuple[float, float]:
    """The range of a parameter."""
    pair = isinstance(over, tuple | list) or (isinstance(over, np.ndarray) and over.ndim == 1)
    require(pair and len(over) == 2, f"over must be (low, high), or {{name: (low, high)}}, its range; got {over!r}.")
    real("low, of over,", over[0])
    real("high, of over,", over[1])
    require(float(over[0]) < float(over[1]), f"over must be (low, high) with low < high; got {over!r}.")
    return float(over[0]), float(over[1])


def parameters_named(args, *names: str) -> tuple[tuple[ParameterOf, ...], tuple[float, ...]]:
    """P ↦ args for each named entry, and the values of these in args.

    All numbers of args are in the leaf if they are few, so that what is compiled for one parameter serves for another.
    """
    for name in names:
        require(isinstance(name, str), f"the parameter must be the name of an entry of args; got {name!r}.")
    heads = list(dict.fromkeys(name.partition("[")[0] for name in names))
    leaf, args_of, known = parameters_of(args, heads)
    require(len(known) > 0, f"args has no numbers that over could name; got {args!r}.")
    for name in names:
        require(name in known, f"over must name one number, such as {known[0]!r}; got {name!r}.")
    if sum(np.size(one) for one in jax.tree.leaves(args)) <= FEW_NUMBERS:
        leaf, args_of, known = parameters_of(args, None)
    entries = [known.index(name) for name in names]
    leaf = jnp.asarray(leaf, float)
    return tuple(ParameterOf(args_of, leaf, entry) for entry in entries), tuple(float(leaf[i]) for i in entries)


def least_sizes(x0: Any) -> np.ndarray:
    """The least sizes (n,) of the components on a branch, from its start: on it one may leave zero."""
    return np.asarray(x0.sizes) if isinstance(x0, Special) else OF_START * np.abs(np.asarray(x0, float))


def equations_of(
    system, args_of, values, parameter: str, orbit: Floquet, turns: int, options, least: np.ndarray, is_default: bool
) -> BranchEquations:
    """The equations of the branch through an orbit, scaled by its sizes and its period."""
    args, period = args_of(jnp.asarray(values[1])), options["period"]
    mode = None if options["mode"] is None else orbit.base[2]  # of the base, which may be another than at x0
    problem, *_ = preparation.prepare(system, orbit.base[1], args, orbit.base[0], options["method"], mode)
    base, scales = Node(*orbit.base), (orbit.period, values[2] - values[0])
    flow = Motion(problem)
    trial = flow.piece(base, orbit.period)
    problem, mixing = sized(flow, trial, is_default, base.x).problem, flow.mixing(base, trial.matrix, trial.length)
    sizes = sizes_of(states_of(trial)[1], mixing, least)
    symmetry = symmetry_of(options["modulo"], system, base.x, problem.args, options["t0"])
    conserved = conserved_of(options["conserve"], system, base.x, flow.mode(base), problem.args)
    along = np.zeros((1, 0)) if symmetry is None else symmetry.image(base.x).by_shift
    lengths = np.linalg.norm(along / sizes[:, None], axis=0)
    closing = symmetry, conserved, tuple(float(1 / length) for length in lengths)
    pieces = options["segments"]
    equations = BranchEquations(problem, args_of, problem.method, period, turns, pieces, sizes, *scales, *closing)
    for p in values:
        own = equations.own_period(p)
        # At the ends of the range a valid period need not exist.
        if p == values[1] or own is None or 0 < np.asarray(own) < np.inf:
            require_period(equations.motion(p), own, base, f" at {parameter} = {p:.6g}")
    return equations


def _origin(equations: BranchEquations, orbit: Floquet, value: float) -> BranchPoint:
    """The point of the branch through an orbit."""
    first = equations.orbit_from(Node(*orbit.base), value, orbit.period)
    timeless = not equations.autonomous and shifts_in_time(equations.motion(value), first)
    require(not timeless, "This system does not depend on time: leave period away; it is found, and may change.")
    jacobian = equations.linearised(first, value)[0]
    singular, null = np.linalg.svd(jacobian)[1:]
    require(
        singular[-1] > ZERO_SINGULAR_VALUE * singular[0],
        "The orbit is one of a family at the same parameter, and there is no single branch through it: (a) something "
        "is conserved, give conserve; (b) a position does not matter, give modulo; (c) the orbit is a bifurcation, "
        "start beside it.",
    )
    start = point_of_orbit(equations, first, value, null[-1] * np.sign(null[-1, -1] or 1.0))
    if start is None:
        raise NoPeriodicOrbitError(
            "Newton's method does not converge at the start of the branch, with nodes away from events: give another "
            "number of segments, or begin at another value of the parameter.",
            orbit,
        )
    return start


def _branched(
    equations: BranchEquations, special: Special, over: tuple[float, float], step: float
) -> tuple[BranchPoint, list[Arc]]:
    """The branch that begins at a special point: to both sides, except at a doubling, whose sides are the same."""
    assert special.change is not None
    period = special.orbit.period * special.turns_there / special.turns
    node = Node(*special.orbit.base)
    orbit, along = resumed(equations, node, special.parameter, period, special.change)
    jacobian = equations.linearised(orbit, special.parameter)[0]
    null = np.linalg.svd(jacobian)[2][-2:]
    along = null.T @ (null @ along)
    along /= np.linalg.norm(along)
    u = equations.vector(orbit, special.parameter)
    origin = BranchPoint(orbit, special.parameter, u, jacobian, along, 0)
    arcs = []
    for side in (-along, along) if special.turns == special.turns_there else (along,):
        tries = (_onto(equations, origin, side, float(share) * step, step, over) for share in FIRST_STEPS)
        first = next((point for point in tries if point is not None), None)
        if first is not None:
            arcs.append(Arc.begun(first, step))
    if not arcs:
        raise NoPeriodicOrbitError(
            f"Newton's method did not arrive on the branch that begins at the {special.kind} at "
            f"{special.parameter:.9g}: (a) it lies outside over; (b) give another step.",
            special,
        )
    return origin, arcs


def _onto(equations: BranchEquations, origin: BranchPoint, side, length: float, step: float, over):
    """A first point of a branch, as far from its origin as `length` across the parameter; None if it is not there.

    The branch leaves along `side`, in which the parameter does not change, and then bends: how much, and so where the
    point is along the parameter, depends on the range. It is looked for on the plane across `side` alone.
    """
    guess, longest = origin.u + length * side, step / 4
    after = equations.corrected(guess, origin.orbit, side, float(side @ guess), reach=length + longest)
    if after is None or not over[0] <= after.parameter <= over[1]:
        return None
    off = np.abs(after.u - guess)
    return after if np.linalg.norm(off[:-1]) <= ASTRAY * length and off[-1] <= longest else None


class _Branch(NamedTuple):
    """A branch, whose arcs can be followed on."""

    equations: BranchEquations
    name: str
    orbit: Floquet
    over: tuple[float, float]
    step: float
    most: int
    t0: float
    labels: Labels
    progress: BranchProgress

    def followed(self, origin: BranchPoint, arcs: list[Arc]) -> Continuation:
        """The branch with both arcs followed on."""
        how = self.over, self.step, self.most, self.progress
        arcs = followed(arcs, lambda arc: follow(self.equations, arc, *how), self.progress)
        return self._as_result(origin, arcs)._resumed_by(functools.partial(self._again, origin, arcs))

    def _again(self, origin: BranchPoint, arcs: list[Arc], most: int | None, over) -> Continuation:
        name, wider = (self.name, self.over) if over is None else _named_range(over)
        require((name or CONSERVED_VALUE) == self.name, f"over must be the range of {self.name}; got {over!r}.")
        require_wider(self.name, wider, self.over)
        silent = BranchProgress(None, wider[0], wider)
        return self._replace(over=wider, most=most or self.most, progress=silent).followed(origin, arcs)

    def _as_result(self, origin: BranchPoint, arcs: list[Arc]) -> Continuation:
        """Both arcs as one branch, the first one reversed; the origin is the first point of each, or before it."""
        after = arcs[-1]
        before = arcs[0] if len(arcs) == 2 else Arc([], [], "closed" if after.end == "closed" else "start", 0.0)
        own = [[point for point in arc.points if point.orbit is not origin.orbit] for arc in (before, after)]
        points = [*reversed(own[0]), origin, *own[1]]
        equations, start = self.equations, Node(self.t0, self.orbit.x0, self.orbit.mode)
        states = [states_over(point) for point in points]
        return Continuation(
            parameter=self.name,
            values=np.array([point.parameter for point in points]),
            orbits=tuple(
                orbit_as_result(equations, point.orbit, point.parameter, start, self.labels) for point in points
            ),
            specials=tuple(
                _special_as_result(equations, one, start, self.labels) for one in (*before.found[::-1], *after.found)
            ),
            ends=(before.end, after.end),
            largest=np.array([np.max(x, axis=0) for x in states]),
            smallest=np.array([np.min(x, axis=0) for x in states]),
            state_labels=self.labels,
        )


def require_wider(name: str, over: tuple[float, float], before: tuple[float, float]) -> None:
    """Raise a ValueError unless a range holds that before."""
    wider = over[0] <= before[0] and before[1] <= over[1]
    require(wider, f"The range of {name} must hold that before, from {before[0]:.6g} to {before[1]:.6g}; got {over}.")


def orbit_as_result(equations: BranchEquations, orbit: OrbitIterate, p: float, start: Node, labels: Labels) -> Floquet:
    """The orbit with its multipliers; for a forced system shown at t0."""
    flow, base = equations.motion(p), orbit.nodes[0]
    shown = base if equations.autonomous else at_start(flow, orbit, start, orbit.period)
    family = family_of(flow, orbit, equations.autonomous, equations.fixed)
    return dataclasses.replace(floquet_of(flow, orbit, shown, equations.autonomous, family), state_labels=labels)


def at_rest(found: Floquet, orbit: OrbitIterate) -> Floquet:
    """An orbit that has shrunk to an equilibrium: it closes, but has no velocity that says so."""
    return dataclasses.replace(found, residual=orbit.residual, status_code=STATUS.ok)


def _special_as_result(equations: BranchEquations, found: LocatedPoint, start: Node, labels: Labels) -> Special:
    orbit = orbit_as_result(equations, found.point.orbit, found.point.parameter, start, labels)
    orbit = at_rest(orbit, found.point.orbit) if found.kind in (HOPF, BOUNDARY_EQUILIBRIUM) else orbit
    rest, turns = (found.change, np.max(states_over(found.point), axis=0), equations.sizes), equations.turns
    return Special(found.kind, found.point.parameter, orbit, turns, turns * found.turns, *rest)
