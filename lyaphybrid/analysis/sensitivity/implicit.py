"""Derivatives of a periodic orbit's exponents: first of the orbit (implicit function theorem), then of its multipliers.

The orbit x*(θ), T(θ) is a root of φ_T(x; θ) − x, so that

    (M − I) dx + f dT = −∂φ/∂θ,    f·dx = 0 where the system is autonomous,

and M = ∂φ_T/∂x, computed along the motion through its jumps, depends on θ, x* and T. A group of
multipliers whose invariant subspace V has the dual U (Uᴴ V = I) has Σ ln|μ| = ln|det Uᴴ M V|, and so

    d Σ ln|μ| = Re tr[(Uᴴ M V)⁻¹ Uᴴ dM V].

R. Seydel, Practical Bifurcation and Stability Analysis (Springer 2010), doi:10.1007/978-1-4419-1740-9.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # its submodules load on first use, which takes a tenth of a second

from ..._jax.engines import compiled
from ..._jax.tracing import array, as_jax
from ..._linalg.products import even_units, in_units
from ...engine import preparation, problems
from ...engine.host import driver, reporting
from ...errors import NoPeriodicOrbitError, RunFailedError
from ...integrators import HalfExplicit, RungeKutta
from ...integrators.base import Method
from ...systems.daes.semi_linear import Constrained, fields_of
from ...systems.hybrid import Hybrid
from ...systems.smooth import Map
from ..orbits.motion.motions import velocity
from ..orbits.periodic_orbits import CONVERGED, Floquet, floquet
from ..orbits.periods import depends_on_time
from .estimates import Estimate, ExponentFunction, InapplicableError, UntrustedError

__all__ = ["by_implicit"]

LOOSER = 100.0  # factor of the tolerance for a second run, whose difference estimates the error
EQUAL_MULTIPLIERS = 1e-6  # multipliers nearer than this, relative to their size, form one group
WORST_CONDITION = 1e9  # largest condition numbers of the equations of the orbit and of the multipliers
INFINITE_CONDITION = 1e300  # stands for an infinite one
MOST_ROUNDING = 0.1  # relative error of a derivative by rounding, from which on it is not known
ROUNDING = 4 * float(np.finfo(float).eps)
ZERO_EXPONENT_CHANGE = 1e-6  # largest derivative of the zero exponent, relative to the largest of the others
LONGEST_MAP_PERIOD = 64  # longest period of a map that is searched
RETURNS = 1e-3  # distance of a return that starts Newton's method


class PeriodRun(NamedTuple):
    """The inputs of a run over one period of the orbit."""

    system: Any
    args_of: Callable
    t: Any  # time at the start
    mode: Any
    method: Any

    def end(self, theta, x, length, frame):
        """The point (n,) and the columns (n, k) after a period."""
        problem, x, t, mode = preparation.prepare(self.system, x, self.args_of(theta), self.t, self.method, self.mode)
        plan = problems.RunPlan()
        ends = array(length, x.dtype).reshape(1)
        outcome = driver.drive(problem, plan, driver.start(problem, plan, t, x, frame, mode, 1.0), ends, ends)
        return outcome.loop_state.carry.x, outcome.loop_state.carry.frame


class Derivatives(NamedTuple):
    """Derivatives of the orbit and of its monodromy matrix by the parameters."""

    monodromy: np.ndarray  # (n, n)
    change: np.ndarray  # (p, n, n) dM/dθ
    period: np.ndarray  # (p,) dT/dθ
    condition: float  # condition number of the equations of the orbit


def by_implicit(case: ExponentFunction, *, period: Any = None, progress: Any = None) -> Estimate:
    """Exponents of the periodic orbit near the start, and their derivatives.

    Args:
        case: with the options of `lyapunov_spectrum`; the search starts from the state after the transient.
        period: as for `floquet`; None for a map: it is searched.
        progress: None, True for a bar, or a function of the fraction done.

    Raises:
        UntrustedError: where there is no periodic orbit, or its multipliers cannot be told apart.
        InapplicableError: where the system depends on time and no period is given.
    """
    report = reporting.reporter(progress)
    try:
        orbit, method = _orbit(case, period)
        report(0.6)
        t, mode = np.asarray(orbit.base[0], float), np.int32(orbit.base[2])
        turn = PeriodRun(case.system, case.args_of, t, mode, _of_tolerance(method, 1.0))
        found, unit = derivatives(turn, case, orbit, period), _unit(case, orbit)
        report(0.8)
        looser = _with_looser_tolerance(turn, case, orbit, period, unit)
        report(1.0)
    finally:
        report(None)
    of = of_exponents(found, orbit, case.k, unit)
    reasons, good = _reasons(case, orbit, found, of, autonomous=_autonomous(case, period))
    trust, unstable = good and orbit.stable, good and not orbit.stable
    stderr = np.abs(of.gradient - looser) + (1e-15 * found.condition + of.rounding[:, None]) * np.abs(of.gradient)
    error = orbit.residual
    if _autonomous(case, period):  # the exponent along the flow is zero: its deviation is an error
        error = max(error, float(np.abs(orbit.exponents[_along_the_flow(orbit)])))
    value_stderr = np.full(case.k, error)
    return Estimate(of.value, value_stderr, of.gradient, stderr, trust, tuple(reasons), 1, of_unstable_orbit=unstable)


def _autonomous(case: ExponentFunction, period) -> bool:
    return period is None and not isinstance(case.system, Map)


def _orbit(case: ExponentFunction, period) -> tuple[Floquet, Method | None]:
    options, discrete = case.options, isinstance(case.system, Map)
    args, transient = case.args_of(case.theta), options.get("transient", 0.0)
    x0 = case.start(args)
    method = options.get("method")
    try:
        preparation.grown_columns("implicit", method)
    except ValueError as unfit:
        raise InapplicableError(str(unfit)) from None
    if period is None and not discrete and depends_on_time(case.system, x0, args):
        raise InapplicableError("the system depends on time: give period, that of its forcing or a multiple of it.")
    if method is None and not discrete:
        constrained = any(isinstance(field, Constrained) for field in fields_of(case.system))
        method = HalfExplicit(rtol=1e-12, tableau="dopri8") if constrained else RungeKutta(rtol=1e-12, atol=1e-14)
    if discrete and period is None:
        x0, period, transient = *_returning(case.system, x0, args, int(transient + options.get("t1", 0))), 0.0
    keywords = {name: options[name] for name in ("t0", "mode") if name in options}
    try:
        return floquet(case.system, x0, args, period=period, transient=transient, method=method, **keywords), method
    except (NoPeriodicOrbitError, RunFailedError) as failed:
        why, broken = str(failed).splitlines()[0], isinstance(failed, RunFailedError)
        raise UntrustedError(f"no periodic orbit: {why}", failed=broken) from failed


@np.errstate(invalid="ignore")  # a map that escapes does not come back
def _returning(system: Map, x0, args, transient: int):
    """A point of the motion after the transient, and the first number of iterations that bring it back."""
    start = x = _iterated(system, jnp.asarray(x0), args, np.asarray(transient))
    for count in range(1, LONGEST_MAP_PERIOD + 1):
        x = _iterated(system, x, args, np.asarray(1))
        if np.max(np.abs(np.subtract(x, start))) <= RETURNS * (1 + np.max(np.abs(start))):
            return start, count
    raise UntrustedError(f"no periodic orbit: the map does not come back within {LONGEST_MAP_PERIOD} iterations.")


@compiled()
def _iterated(system: Map, x, args, count):
    return jax.lax.fori_loop(0, count, lambda n, x: system.rule(n, x, args), x)


def derivatives(turn: PeriodRun, case: ExponentFunction, orbit: Floquet, period) -> Derivatives:
    """Derivatives of the orbit and of M, by two passes: first with the point fixed, then with it moving.

    M comes in units in which its rows and columns are of one size, so that no condition number depends on those of x.
    """
    n, p = len(orbit.x0), len(case.theta)
    x, theta = orbit.base[1], as_jax(case.theta)
    autonomous, own, speed = _autonomous(case, period), np.zeros(p), 1.0
    if callable(period):
        own = np.asarray(_slope_of_period(period, case.args_of, theta))
    length, monodromy = np.asarray(orbit.period, float), np.asarray(orbit.monodromy)
    units = even_units(monodromy)
    matrix = in_units(monodromy, units)
    ahead = _derivatives_along(turn, theta, x, length, np.eye(p), np.zeros((p, n)), own)[0].T
    across = matrix
    if _on_a_surface(turn):  # the surface moves with the parameters, and the start with it, which columns of M never do
        along = np.zeros((n, p)), np.eye(n), np.zeros(n)
        across = in_units(_derivatives_along(turn, theta, x, length, *along)[0].T, units)
    system, right = across - np.eye(n), -ahead / units[:, None]
    if autonomous:
        f = np.asarray(velocity(turn.system, turn.t, x, turn.args_of(theta), int(turn.mode))) / units
        speed = float(np.linalg.norm(f))
        f = f / speed
        system = np.block([[system, f[:, None]], [f[None, :], np.zeros((1, 1))]])
        right = np.concatenate([right, np.zeros((1, p))])
    change = np.linalg.lstsq(system, right, rcond=None)[0]
    moves = (change[:n] * units[:, None]).T
    own = change[n] / speed if autonomous else own
    _, moved = _derivatives_along(turn, theta, x, length, np.eye(p), moves, own)
    return Derivatives(matrix, in_units(moved, units), own, min(float(np.linalg.cond(system)), INFINITE_CONDITION))


@compiled()
def _slope_of_period(period: Callable, args_of: Callable, theta):
    """(p,) dT/dθ of a given period(args)."""
    return jax.jacfwd(lambda theta: jnp.asarray(period(args_of(theta)), theta.dtype))(theta)


def _on_a_surface(turn: PeriodRun) -> bool:
    """Whether the orbit begins in a mode in which it is bound to a surface."""
    return isinstance(turn.system, Hybrid) and turn.system.tangent[int(turn.mode)] is not None


@compiled(lambda turn, theta, x, *rest: x.size, hands_on=True)
def _derivatives_along(turn: PeriodRun, theta, x, length, of_theta, of_x, of_length):
    """Derivatives of the end (p, n) and of its columns (p, n, n) along p directions."""
    discrete, frame = isinstance(turn.system, Map), np.eye(len(x), dtype=x.dtype)

    def end(theta, x, length):
        return turn.end(theta, x, length, frame)

    def one(of_theta, of_x, of_length):
        if discrete:
            return jax.jvp(lambda theta, x: end(theta, x, length), (theta, x), (of_theta, of_x))[1]
        return jax.jvp(end, (theta, x, length), (of_theta, of_x, of_length))[1]

    return jax.vmap(one)(of_theta, of_x, of_length)


class Exponents(NamedTuple):
    """The leading exponents of an orbit and their derivatives, nan where they are not known or there are none.

    The derivative of a group is that of its mean.
    """

    value: np.ndarray  # (k,)
    gradient: np.ndarray  # (k, p)
    groups: list[list[int]]  # those of more than one exponent
    condition: np.ndarray  # (k,) condition numbers of the multipliers
    rounding: np.ndarray  # (k,) relative errors of the derivatives by rounding of M


def _unit(case: ExponentFunction, orbit: Floquet) -> int | None:
    """The number of jumps in a period where exponents are per jump, else None."""
    clock = case.options.get("clock", "time")
    if clock == "time" or isinstance(case.system, Map):
        return None
    if clock != "jumps":
        raise InapplicableError(f"exponents of an orbit are per unit of time or per jump; got clock={clock!r}.")
    if orbit.jumps == 0:
        raise InapplicableError("clock='jumps' asks for exponents per jump, and the orbit has none.")
    return orbit.jumps


def of_exponents(found: Derivatives, orbit: Floquet, k: int, jumps: int | None = None) -> Exponents:
    """The exponents, per jump where their number is given, and their derivatives: members of a group may have none."""
    value, multipliers = np.asarray(orbit.exponents), np.asarray(orbit.multipliers)
    length, change = (orbit.period, found.period) if jumps is None else (jumps, np.zeros_like(found.period))
    value = value * (orbit.period / length)
    gradient = np.full((len(value), len(found.period)), np.nan)
    condition, rounding = np.ones(len(value)), np.zeros(len(value))
    groups = _groups(multipliers)
    # M also has eigenvalues 0 across constraints, which are no multipliers of the orbit.
    every = np.pad(multipliers, (0, len(found.monodromy) - len(multipliers)))
    for group in groups:
        if np.all(multipliers[group] != 0):
            rates, condition[group], rounding[group] = _of_group(found, every, group)
            if rounding[group[0]] < MOST_ROUNDING:
                gradient[group] = (rates / len(group) - np.mean(value[group]) * change) / length
    several = [one for one in groups if len(one) > 1 and min(one) < k and np.all(multipliers[one] != 0)]
    return Exponents(value[:k], gradient[:k], several, condition[:k], rounding[:k])


def _groups(multipliers: np.ndarray) -> list[list[int]]:
    """Indices of multipliers that are differentiated together: complex pairs and nearly equal ones."""
    left, groups = list(range(len(multipliers))), []
    while left:
        group = [left.pop(0)]
        for i in group:  # the list grows during this loop
            mu = multipliers[i]
            near = [j for j in left if _same(mu, multipliers[j]) or _same(np.conj(mu), multipliers[j])]
            group += near
            left = [j for j in left if j not in near]
        groups.append(sorted(group))
    return groups


def _same(a, b) -> bool:
    return bool(abs(a - b) <= EQUAL_MULTIPLIERS * max(abs(a), abs(b)))


def _of_group(found: Derivatives, multipliers, group) -> tuple[np.ndarray, float, float]:
    """Derivative (p,) of Σ ln|μ| over the group, its condition number and its relative error by rounding.

    `multipliers` are all (n,) eigenvalues of M.
    """
    try:
        right, left = (_invariant(matrix, multipliers, group) for matrix in (found.monodromy, found.monodromy.T))
        dual = np.linalg.solve(left.conj().T @ right, left.conj().T)
        inside = np.linalg.inv(dual @ found.monodromy @ right)
    except np.linalg.LinAlgError as failed:
        mu = np.mean(multipliers[group]).real
        raise UntrustedError(f"the multiplier {mu:.6g} has no derivative: it cannot be told from another.") from failed
    slopes = np.array([np.trace(inside @ dual @ change @ right).real for change in found.change])
    condition, own = float(np.linalg.norm(dual, 2)), multipliers[group]
    apart = np.append(np.abs(own[:, None] - np.delete(multipliers, group)), np.abs(own))  # from others, and from 0
    rounded = condition * float(np.linalg.norm(found.monodromy, 2)) / float(np.min(apart))
    return slopes, condition, ROUNDING * rounded


def _invariant(matrix, multipliers, group) -> np.ndarray:
    """An orthonormal basis (n, m) of the subspace of the group's multipliers, or of their conjugates."""
    others = np.delete(multipliers, group)

    def belongs(mu) -> bool:
        return bool(np.min(np.abs(multipliers[group] - mu)) < np.min(np.abs(others - mu), initial=np.inf))

    vectors = scipy.linalg.schur(matrix, output="complex", sort=belongs)[1]
    return vectors[:, : len(group)]


def _with_looser_tolerance(turn: PeriodRun, case: ExponentFunction, orbit: Floquet, period, unit) -> np.ndarray:
    """The derivatives (k, p) along the same orbit with a looser tolerance."""
    turn = turn._replace(method=_of_tolerance(turn.method, LOOSER))
    return of_exponents(derivatives(turn, case, orbit, period), orbit, case.k, unit).gradient


def _of_tolerance(method: Method | None, factor: float) -> Method | None:
    """The method with its tolerances times a factor, as arrays: runs that differ in them only are one program."""
    names = [name for name in ("rtol", "atol") if name in getattr(method, "__dataclass_fields__", ())]
    values = [as_jax(np.asarray(factor * getattr(method, name), float)) for name in names]
    return eqx.tree_at(lambda m: [getattr(m, name) for name in names], method, values) if names else method


def _along_the_flow(orbit: Floquet) -> int:
    return int(np.argmin(np.abs(np.asarray(orbit.multipliers) - 1)))


def _reasons(case: ExponentFunction, orbit: Floquet, found: Derivatives, of: Exponents, autonomous: bool):
    """Reasons why the derivatives can be trusted or not; and whether they can, if motion stays with the orbit."""
    good = orbit.residual <= CONVERGED
    reasons = [f"Newton's method ended at a residual of {orbit.residual:.1e} after {orbit.period:.6g}"]
    reasons.append(f"the orbit is {'stable' if orbit.stable else 'not stable: motion does not stay with it'}")
    reasons.append(f"condition number {found.condition:.1e} of the equations of the orbit")
    worst = float(np.max(of.condition))
    if worst > WORST_CONDITION:
        reasons.append(f"condition number {worst:.1e} of a multiplier: it cannot be told from another")
    for group in of.groups:
        names = ", ".join(f"λ{i + 1}" for i in group)
        reasons.append(f"{names}: a complex pair or nearly the same, the derivative is that of their mean")
    if np.any(np.isneginf(of.value)):
        reasons.append("an exponent that is −∞ has no derivative")
    if hidden := [f"λ{i + 1}" for i in np.flatnonzero(np.isnan(of.gradient[:, :1]).ravel() & np.isfinite(of.value))]:
        reasons.append(f"{', '.join(hidden)}: the multiplier is less than rounding beside the others: no derivative")
        good = False
    good = good and max(found.condition, worst) <= WORST_CONDITION
    if autonomous:
        at = _along_the_flow(orbit)
        if at < case.k:
            slope = float(np.max(np.abs(of.gradient[at])))
            reasons.append(f"the zero exponent along the flow has a derivative of {slope:.1e}")
            good = good and slope <= ZERO_EXPONENT_CHANGE * max(1.0, float(np.nanmax(np.abs(of.gradient))))
    return reasons, bool(good)
