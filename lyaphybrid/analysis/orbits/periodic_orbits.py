"""Periodic orbits and their Floquet multipliers, through all jumps on the way.

Newton's method for an orbit, in `shooting`, uses the fundamental matrix M = dφ_T/dx. Its eigenvalues are the
multipliers μ, and the exponents are ln|μ|/T.
"""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ... import _renamed as renamed
from ... import plots
from ..._arguments import Real, State, flag, positive, real, require, require_one_start, require_values, whole
from ..._jax.precision import digits
from ..._jax.tracing import as_jax
from ..._keywords import explains_keywords
from ..._text import Table, per_unit, with_unit
from ...engine import preparation, problems
from ...errors import LyaphybridError, NoPeriodicOrbitError
from ...integrators import HalfExplicit, RungeKutta
from ...integrators.base import Method
from ...results.result import Data, RunResult, per_time
from ...statuses import OK, STATUS
from ...systems.daes.semi_linear import Constrained, fields_of
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from .closures import goes_along, repeats, rests
from .families import apart_from_shifts, energy_moved, family_of, shifts_in_time
from .motion.invariants import conserved_of, require_conserved
from .motion.motions import Motion, Node, sized
from .motion.returns import close_return, least_period
from .multipliers import matrices_of, multipliers_of, seen_in_turns, stability_of
from .periods import check_period, depends_on_time
from .points import at_start, nearest
from .shooting import OrbitIterate, newton, placed
from .sides import BEYOND_GUARD, guards_passed
from .symmetries import symmetry_of

__all__ = ["CONVERGED", "Floquet", "floquet", "floquet_of", "in_any_case", "require_period"]

MOST_ITERATES = 1e8  # of a map before the search: they are kept
CONVERGED = 1e-9  # residual, relative to the orbit, that a periodic orbit must reach
LEAPT = (
    "No periodic orbit: Newton's method leapt over the guard of transition {} (entry {}), to x = {}: an orbit on its "
    "fired side, where it never fires, and where the motion from x0 does not come. (a) x0 is too far from a periodic "
    "orbit, give a transient; (b) the orbit is unstable and long, give segments; (c) the motion does not repeat."
)


class Floquet(RunResult, eqx.Module):
    """A periodic orbit and its multipliers.

    Attributes:
        x0: (n,) the point of the orbit at t0 (of an autonomous system: the one nearest to the start that was given).
        period: T.
        multipliers: complex (n,), the largest first; exactly 0 where a direction is destroyed on the way, and of a
            complex pair so small that only its size is known, by its exponent. Of an `lh.DAE` there are n_differential.
        exponents: (n,) ln|μ|/T, descending, also of a μ too small for a number; -inf where a direction is destroyed.
        stability: from all multipliers except those that are 1 by necessity, along the flow of an autonomous system,
            along a family and along a group: "stable" (all are inside the unit circle), "unstable" (one is outside),
            "elliptic" (those on it are complex), "neutral" (one on it is real; or a family has no others), "unknown"
            where no orbit was found.
        residual: largest |φ_T(x) − x| over the nodes, relative to the size of the orbit; inf where it is no orbit: the
            mode after T differs, or an autonomous system does not map its velocity to itself.
        monodromy: (n, n), dx(T)/dx(0) at a point of the orbit that may be another than x0, away from events.
        base: that point, as its time, state and mode.
        mode: index of the mode at x0.
        jumps: number of jumps in a period.
        shift: (q,) s after a period, for an orbit modulo a group g(x, s): the length of a runner's step.
        family: number of parameters of the family of orbits around this one, whatever `conserve` is: 0 for an isolated
            orbit, 1 where an energy is conserved.
        notes: frozenset of names: "family", "moved" (the energy of this orbit is not that of the start), "beyond_guard"
            (the orbit lies on the fired side of a directed guard, and never fires it: as a start there does),
            "unresolved" (a direction contracts so much that it cannot be told from one that is destroyed: its exponent
            may be wrong, or is nan).
        status: an `lh.STATUS`: ok; no_orbit where Newton's method did not arrive at an orbit; where the motion from the
            start failed, how it ended.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.floquet(henon, [0.6, 0.2], 1.4, period=1)
        >>> found.x0.round(6).tolist(), found.stability
        ([0.631354, 0.189406], 'unstable')
        >>> bool(abs(found.multipliers.prod() + 0.3) < 1e-9)  # the determinant
        True
    """

    x0: Array
    period: float
    multipliers: Array
    exponents: Array
    stability: str = eqx.field(static=True)
    residual: float
    monodromy: Array
    base: tuple[float, Array, int]
    mode: int = eqx.field(static=True)
    jumps: int = eqx.field(static=True)
    shift: Array
    family: int = eqx.field(static=True)
    notes: frozenset[str] = eqx.field(static=True)
    status_code: int = eqx.field(static=True, default=OK)
    state_labels: Labels = eqx.field(static=True, default=Labels())

    events = renamed.attribute("events", "jumps")

    @property
    def stable(self) -> bool:
        """Whether `stability` is "stable": the orbit attracts; in a family, at fixed conserved values."""
        return self.stability == "stable"

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The multipliers in the complex plane, with the unit circle. `style` goes to what it draws."""
        return plots.multipliers(self, ax, **style)

    def _table(self) -> Table:
        rows = []
        for mu, rate in zip(np.asarray(self.multipliers), np.asarray(self.exponents), strict=True):
            imaginary = f"{'-' if mu.imag < 0 else '+'} {abs(mu.imag):.9g}i" if mu.imag else ""
            rows.append((f"{mu.real:.9g}", imaginary, f"{rate:.12g}"))
        lines = ["stable" if self.stable else f"{self.stability}: not asymptotically stable"]
        if self.shift.size:
            lines.append(f"modulo a shift of {', '.join(f'{s:.12g}' for s in np.asarray(self.shift))} in each period")
        if self.family:
            parameters = "one parameter" if self.family == 1 else f"{self.family} parameters"
            lines.append(f"one of a family of orbits with {parameters}, along which multipliers are 1")
        if "moved" in self.notes:
            lines.append("its energy is not that of the start: conserve=True keeps it")
        if BEYOND_GUARD in self.notes:
            lines.append(
                "it lies beyond a guard that it never fires, on the fired side, as the motion from the start does"
            )
        if "unresolved" in self.notes:
            lines.append("unresolved: a direction contracts so much that it may be destroyed or only be short")
        lines.append(f"status {self.status}")
        what = "No periodic orbit" if self.status.failed else "Periodic orbit"
        unit = self.state_labels.time_unit
        period = with_unit(f"{self.period:.12g}", unit)
        title = f"{what}, T = {period}, {self.jumps} jumps, residual {self.residual:.1e}"
        return Table(title, rows, lines, ("multiplier", "", "exponent" + per_unit(unit)))

    def _data(self) -> Data:
        names = self.state_labels.columns(len(self.x0))
        variables = {
            "x0": ("state", self.x0),
            "multipliers": ("exponent", self.multipliers),
            "exponents": ("exponent", self.exponents, per_time(self.state_labels.time_unit)),
            "monodromy": (("state", "start"), self.monodromy),
            "shift": ("parameter", self.shift) if self.shift.size else None,
            "mode": ((), self.mode),
        }
        words = ("period", "stability", "residual", "jumps", "family", "notes")
        attributes = {word: getattr(self, word) for word in words}
        coordinates = {"state": names, "start": names, "exponent": np.arange(1, len(self.exponents) + 1)}
        return Data(variables, coordinates, attributes)


@explains_keywords
def floquet(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    period: Any = None,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    transient: Real = 0.0,
    segments: int = 1,
    max_iterations: int = 30,
    throw: bool = True,
    conserve: Any = None,
    modulo: Any = None,
) -> Floquet:
    """The periodic orbit near x0, and its Floquet multipliers.

    After T state and mode are the same; for an autonomous system one multiplier is 1, as its velocity is mapped to
    itself. Where Newton's method reaches a point whose motion ends in another mode, it starts again from the state
    after one more period.

    Where a quantity is conserved, orbits form families, and Newton's method finds one of those near x0; `family` says
    so. `conserve` selects one. Multipliers along a family are exactly 1.

    Args:
        system: an `lh.Flow`, `lh.Hybrid` (sliding modes included), `lh.Map` or `lh.EventDriven` (without a schedule).
        x0: (n,) a point near the orbit; far from it give a transient, where the orbit attracts.
        args: pytree of parameters.
        period: of a system that depends on time: a multiple of its own period, a number or ``args -> number`` (of a map
            the number of iterations). None: unknown, for autonomous systems; it is taken from the first close return.
        t0: the time at x0.
        mode: mode at x0, where there are several.
        method: one that is right for the system, and no `lh.ContinuousQR`; None: the default with rtol = 1e-12; closed
            forms have none.
        transient: run for so long before, in whole periods where the period is given.
        segments: number of pieces for multiple shooting; more for orbits that are long and unstable, or to find small
            multipliers, which the rounding of the largest one hides in the derivative of one piece.
        max_iterations: largest number of Newton iterations.
        throw: raise where it does not converge; False returns what there is, with its status and residual.
        conserve: quantities to keep at their values at x0: a function ``(x, args) -> number``, or ``-> (c,)`` for
            several, that the motion conserves; ``{"mode": function, …}`` where it differs from mode to mode; True: the
            energy of an `lh.Hamiltonian` or `lh.canonical_flow`.
        modulo: a symmetry after which the orbit closes, x(T) = g(x0): ``g(x) -> x``, a step or a rotation that is
            known; ``g(x, s) -> x`` with g(x, 0) = x, a group whose s is found; the index of a component that grows, or
            several. Multipliers are those of Dg⁻¹ dx(T)/dx(0); along a group they are 1.

    Returns:
        A `Floquet`.

    Raises:
        ValueError: on arguments that do not fit; on a system that depends on time, without a period or with one after
            which fields, guards, resets or clocks do not repeat (the message gives their period); where the motion does
            not conserve the wanted quantity, or does not have the symmetry.
        NoPeriodicOrbitError: where Newton's method does not converge, or to what is no orbit (an equilibrium; what
            closes in another mode), and `throw`; where no close return was found.
        RunFailedError: where the motion from x0 itself fails, and `throw`.

    Source:
        R. Seydel, Practical Bifurcation and Stability Analysis (Springer 2010), chapter 7,
        doi:10.1007/978-1-4419-1740-9; for jumps R. I. Leine & H. Nijmeijer, Dynamics and Bifurcations of Non-Smooth
        Mechanical Systems (Springer 2004), doi:10.1007/978-3-540-44398-8.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def van_der_pol(t, x, mu):
        ...     return jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]])
        >>> orbit = lh.floquet(lh.Flow(van_der_pol), [2.0, 0.0], 1.0)
        >>> round(orbit.period, 6), orbit.stable
        (6.663287, True)

        A pendulum that swings up to 90°, and one that goes round; each has its energy.

        >>> pendulum = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))
        >>> swing = lh.floquet(pendulum, [jnp.pi / 2, 0.0], conserve=True)
        >>> round(swing.period, 6), swing.family, swing.stability
        (7.416299, 1, 'neutral')
        >>> turn = jnp.array([2 * jnp.pi, 0.0])
        >>> round(lh.floquet(pendulum, [0.0, 3.0], conserve=True, modulo=lambda x: x + turn).period, 6)
        2.41289
    """
    flag("throw", throw)
    kinds = Flow | Hybrid | Map | EventDriven
    require(
        isinstance(system, kinds), f"floquet needs an lh.Flow, lh.Hybrid, lh.Map or lh.EventDriven; got {system!r}."
    )
    require(
        not isinstance(system, EventDriven) or system.schedule is None,
        "floquet needs an lh.EventDriven with next_event, and this one has a schedule: write it without one, or take "
        "lh.tangent_map(…, t1=period) at a point of the orbit, whose eigenvalues are the multipliers.",
    )
    whole("segments", segments, least=1)
    whole("max_iterations", max_iterations, least=1)
    require_values("floquet", x0, args, t0)
    preparation.grown_columns("floquet", method)
    discrete = isinstance(system, Map)
    is_default = method is None
    if is_default and not discrete and not isinstance(system, EventDriven):
        constrained = any(isinstance(field, Constrained) for field in fields_of(system))
        method = HalfExplicit(rtol=1e-12, tableau="dopri8") if constrained else RungeKutta(rtol=1e-12, atol=1e-14)
    problem, start, time, index = preparation.prepare(system, x0, args, t0, method, mode)
    require_one_start("floquet", start)
    symmetry = symmetry_of(modulo, system, start, problem.args, time)
    flow = Motion(problem, symmetry)
    point = Node(float(time), start, index)
    flow = flow._replace(conserved=conserved_of(conserve, system, start, flow.mode(point), problem.args))
    period = period(args) if callable(period) else period
    require_period(flow, period, point)
    real("transient, a length,", transient)
    few = not discrete or transient <= MOST_ITERATES
    require(few, f"transient must be at most {MOST_ITERATES:g} iterations; got {transient!r}.")
    try:
        found = _orbit_near(flow, point, period, transient, segments, max_iterations, throw, conserve, is_default)
        return dataclasses.replace(found, state_labels=labels_of(system, problem.shape))
    except LyaphybridError as failed:
        if failed.result is None:
            failed.result = _no_orbit(flow, point, getattr(failed, "status", STATUS.no_orbit))
        if throw:
            raise
        return failed.result


def _orbit_near(
    flow: Motion, point: Node, period, transient, segments: int, max_iterations: int, throw: bool, conserve, is_default
) -> Floquet:
    """The orbit near a point."""
    start = point.x
    if transient > 0:
        turn = None if period is None else float(np.asarray(period))
        run = flow.piece(point, float(transient if turn is None else np.ceil(transient / turn) * turn))
        point = Node(point.t, run.x, run.mode)
    autonomous = period is None
    given = point
    point, guess = close_return(flow, point) if period is None else (point, float(np.asarray(period)))
    trial = flow.piece(point, guess)
    if flow.conserved is not None:
        require_conserved(flow, trial)
    flow = sized(flow, trial, is_default, start)
    orbit = newton(flow, placed(flow, point, guess, segments), guess, autonomous, max_iterations)
    if autonomous and flow.symmetry is None:
        least = least_period(flow, orbit.pieces, orbit.period, orbit.extents)
        if least < orbit.period:
            orbit = newton(flow, placed(flow, orbit.nodes[0], least, segments), least, autonomous, max_iterations)
    base = orbit.nodes[0]
    if autonomous:
        end = nearest(flow, base, orbit.period, start, orbit.extents)
    else:
        end = at_start(flow, orbit, given, guess)
    every = family_of(flow, orbit, autonomous)
    family = every if autonomous else apart_from_shifts(flow, orbit, every)
    result = floquet_of(flow, orbit, end, autonomous or family.shape != every.shape, family)
    leapt = guards_passed(flow, orbit.pieces) - guards_passed(flow, [trial]) if BEYOND_GUARD in result.notes else set()
    if leapt:
        result = dataclasses.replace(result, residual=np.inf, stability="unknown", status_code=STATUS.no_orbit)
        if throw:
            raise NoPeriodicOrbitError(LEAPT.format(*sorted(leapt)[0], orbit.nodes[0].x), result)
    if result.family and conserve is None and energy_moved(flow, given, end, orbit.sizes):
        result = dataclasses.replace(result, notes=result.notes | {"moved"})
    if throw and result.status.failed:
        raise NoPeriodicOrbitError(_failure(flow, orbit, result, period is not None), result)
    return result


def _no_orbit(flow: Motion, point: Node, status: STATUS) -> Floquet:
    """The result where the motion from the start fails or does not return, so that no orbit was found."""
    none = jnp.full(flow.degrees_of_freedom(point), jnp.nan)
    n, mode = len(point.x), flow.mode(point)
    return Floquet(
        x0=point.x, period=np.nan, multipliers=none + 0j, exponents=none, stability="unknown", residual=np.inf,
        monodromy=jnp.full((n, n), jnp.nan), base=(point.t, point.x, mode), mode=mode, jumps=0, shift=jnp.zeros(0),
        family=0, notes=frozenset(), status_code=status,
    )  # fmt: skip


def _failure(flow: Motion, orbit: OrbitIterate, result: Floquet, given: bool) -> str:
    """The error message: what Newton's method found instead of an orbit."""
    if orbit.torn:
        wanted, found = (problems.mode_names(flow.problem.system)[mode] for mode in orbit.torn[0])
        return (
            f"No periodic orbit: after {orbit.period:.6g}, {orbit.iterations} iterations of Newton's method, the state "
            f"is back to {orbit.gap:.1e} of its size, but in mode {found!r} where it should be in {wanted!r}: (a) x0 "
            "is too far from a periodic orbit, give a transient or another mode; (b) there is none, the motion leaves "
            "this cycle of events; (c) the period is not one of this motion."
        )
    converged = orbit.residual <= digits(CONVERGED, orbit.nodes[0].x)
    if converged and rests(flow, orbit):
        return (
            f"No periodic orbit: at x = {orbit.nodes[0].x} the motion moves along the group alone, modulo that it is "
            "an equilibrium, and any time is a period: give one element of the group, g(x), such as the turn after "
            "which it is to close."
        )
    if converged and not repeats(flow, orbit):
        return (
            f"No periodic orbit: the state after {orbit.period:.6g} is the image of that at the start, but the period "
            "is not repeated from there. modulo must be a symmetry of guards, resets and switches too."
        )
    if converged:
        values = ", ".join(f"{mu:.6g}" for mu in np.asarray(result.multipliers))
        return (
            f"No periodic orbit: the state is back after {orbit.period:.6g}, but one multiplier of an autonomous "
            f"system's orbit is 1, and those here are {values}: (a) it is an equilibrium, its speed is "
            f"{np.linalg.norm(flow.velocity(orbit.nodes[0])):.1e}; (b) the method is too coarse, tighten its "
            "tolerances; (c) the derivative of a reset, guard or field is not that of its values."
        )
    any_period = given and shifts_in_time(flow, orbit)
    return (
        f"Newton's method stands at a residual of {orbit.gap:.1e} after {orbit.iterations} iterations, "
        f"period {orbit.period:.6g}: (a) x0 is too far from a periodic orbit, give a transient; (b) the orbit is "
        "unstable and long, give segments; (c) the period is not one of this motion"
        + (": this system does not depend on time, leave period away, and it is found." if any_period else ".")
    )


def require_period(flow: Motion, period, point: Node, where: str = "") -> None:
    """Require a period where the system depends on time, and check it from the point on."""
    system, args = flow.problem.system, flow.problem.args
    if isinstance(system, Map):
        whole("period, of a map its number of iterations,", period, least=1)
    elif period is not None:
        positive("period", period)
    if period is not None:
        return check_period(system, period, point.x, args, point.t, where=where)
    return require(
        not depends_on_time(system, point.x, args),
        "This system depends on time: give period, that of its forcing or a multiple of it.",
    )


def in_any_case(flow: Motion, orbit: OrbitIterate, autonomous: bool, family: np.ndarray) -> np.ndarray:
    """The directions (n, d) at the first node with the multiplier 1; empty if the flow is the only one."""
    base, known = orbit.nodes[0], family
    if flow.symmetry is not None:
        known = np.column_stack([flow.symmetry.image(base.x).by_shift, family])
    return np.column_stack([flow.velocity(base), known]) if autonomous and known.shape[1] else known


def floquet_of(
    flow: Motion, orbit: OrbitIterate, point: Node, autonomous: bool, family: np.ndarray | None = None
) -> Floquet:
    """The multipliers of an orbit that Newton's method found.

    `point` is the point of the orbit to report; `family` holds the directions (n, f) to other orbits.
    """
    base = orbit.nodes[0]
    family = np.zeros((len(point.x), 0)) if family is None else family
    matrices = matrices_of(flow, orbit)
    if flow.symmetry is not None:
        matrices[-1] = np.linalg.solve(flow.symmetry.image(base.x, orbit.shift).by_state, matrices[-1])
    known = in_any_case(flow, orbit, autonomous, family)
    # Constraints leave fewer than n directions; the others do not count as destroyed by the orbit.
    found = multipliers_of(matrices, known, flow.degrees_of_freedom(point), autonomous)
    found = seen_in_turns(flow, orbit, found)
    good = not autonomous or (goes_along(flow, orbit) and not rests(flow, orbit))
    good = good and repeats(flow, orbit)
    residual = orbit.residual if good else np.inf
    return Floquet(
        x0=as_jax(point.x),
        period=orbit.period,
        multipliers=as_jax(found.values),
        exponents=as_jax(found.logs / orbit.period),
        stability=stability_of(found.deciding, base.x, isolated=not known.shape[1]),
        residual=residual,
        monodromy=as_jax(functools.reduce(lambda product, matrix: matrix @ product, matrices)),
        base=(base.t, as_jax(base.x), flow.mode(base)),
        mode=flow.mode(point),
        jumps=sum(piece.jumps for piece in orbit.pieces),
        shift=as_jax(np.asarray(orbit.shift)),
        family=family.shape[1],
        notes=frozenset({"family"} if family.shape[1] else ())
        | ({BEYOND_GUARD} if guards_passed(flow, orbit.pieces) else set())
        | ({"unresolved"} if found.unsure else set()),
        status_code=STATUS.ok if residual <= digits(CONVERGED, base.x) else STATUS.no_orbit,
    )
