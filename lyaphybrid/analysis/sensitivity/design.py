"""Parameters at which exponents have wanted values, by the derivatives of `lyapunov_gradient`."""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ... import _renamed as renamed
from ... import plots
from ..._arguments import Real, State, numbers, positive, random_key, require, require_values, whole, words
from ..._text import Table, numbered, per_unit, with_error
from ...engine.blocks import part_of
from ...engine.host.reporting import reporter
from ...errors import LyaphybridError
from ...integrators.base import Method
from ...results.result import Data, Result, exponents_along, per_time
from ...statuses import STATUS
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.smooth import Flow, Map
from ..spectra import lyapunov_spectrum
from .bounds import ParameterBounds, bounds_of
from .estimates import ExponentFunction, case_of
from .gradient import Gradient, lyapunov_gradient, names_of_before

__all__ = ["Design", "design"]

EXACT = 1e-12  # difference from the target, relative to 1 + |target|, that counts as zero
NOISE = 1.0  # … and the same in standard errors of the exponent
HALVINGS = 8  # trial lengths of a Newton step, each half of the one before
ALL_STEPS = "all steps made"
RATE = 0.1  # learning rate of the default optimiser, Adam: a step changes what has no bounds by a tenth of itself
WHOLE = (STATUS.ok, STATUS.terminated)  # status of a run that reached its end


class Design(Result, eqx.Module):
    """Parameters, and the exponents there.

    Attributes:
        args: the tree of parameters, with the free ones at their best values.
        parameters: {name: value} of the free ones.
        exponents: (k,) at args.
        stderr: (k,) their standard errors.
        converged: whether the target was reached, up to rounding or noise; for an objective whether its last
            derivatives could be trusted (also where all steps were made: the objective may fall further with more).
        trust: whether the last derivatives passed the checks of their method; for a bisection whether signs differed.
        reasons: why the search ended and whether it is trusted, with numbers.
        history: (steps, p + k) parameters and exponents of every point that was tried.
        time_unit: that exponents are per; "" where the system has none, and where jumps are counted.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.design(logistic, [0.3], {"r": 2.8}, -0.5, over="r", t1=500)
        >>> round(found.parameters["r"], 4), found.converged
        (2.6065, True)
    """

    args: Any
    parameters: dict[str, float]
    exponents: np.ndarray
    stderr: np.ndarray
    converged: bool = eqx.field(static=True)
    trust: bool = eqx.field(static=True)
    reasons: tuple[str, ...] = eqx.field(static=True)
    history: np.ndarray
    time_unit: str = eqx.field(static=True, default="")

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The exponents of the points that were tried, in their order, with what was reached.

        `style` goes to what it draws.
        """
        return plots.design(self, ax, **style)

    def _table(self) -> Table:
        trust = "trusted" if self.trust else "NOT to be trusted"
        ended = "converged" if self.converged else "NOT converged"
        if self.converged and self.reasons[0].startswith(ALL_STEPS):
            ended = ALL_STEPS
        per = f", exponents{per_unit(self.time_unit)}" if self.time_unit else ""
        title = f"Design: {ended} in {len(self.history)} points, {trust}{per}"
        rows = [(name, f"{value:.12g}") for name, value in self.parameters.items()]
        found = map(with_error, self.exponents, self.stderr)
        return Table(title, [*rows, *zip(numbered("λ", len(self.exponents)), found, strict=True)], self.reasons)

    def _data(self) -> Data:
        p, per = len(self.parameters), per_time(self.time_unit)
        variables = {
            "parameters": ("parameter", list(self.parameters.values())),
            "exponents": ("exponent", self.exponents, per),
            "stderr": ("exponent", self.stderr, per),
            "tried_parameters": (("point", "parameter"), self.history[:, :p]),
            "tried_exponents": (("point", "exponent"), self.history[:, p:], per),
        }
        attributes = {name: getattr(self, name) for name in ("converged", "trust", "reasons")}
        return Data(variables, {**exponents_along(len(self.exponents)), "parameter": list(self.parameters)}, attributes)


class DesignPoint(NamedTuple):
    """Exponents and derivatives at parameters θ."""

    theta: np.ndarray  # (p,)
    value: np.ndarray  # (k,)
    stderr: np.ndarray  # (k,)
    jacobian: np.ndarray | None  # (k, p) dλ/dθ
    trust: bool
    reasons: tuple[str, ...]
    usable: bool = True  # whether a step from here leads anywhere


def _over_of_before(name: str, positional: tuple, given: dict[str, Any]) -> tuple:
    """The parameters were named by `free`, and their bounds apart."""
    if "free" in given:
        renamed.warn(f"{name}(…, free=…, bounds=…)", "over={name: (low, high)}")
        names, bounds = given.pop("free"), given.pop("bounds", None) or {}
        over = dict.fromkeys((names,) if isinstance(names, str) else names)
        unknown = [name for name in bounds if name not in over]
        require(not unknown, f"bounds must name free parameters, {', '.join(over)}; got {unknown}.")
        given["over"] = over | bounds
    return positional


@renamed.arguments(_over_of_before)
@renamed.arguments(names_of_before)
def design(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any,
    target: float | Sequence[float] | Callable,
    *,
    t1: Real,
    over: Mapping[str, tuple[float | None, float | None] | None] | Sequence[str] | str,
    optimiser: Any = None,
    steps: int = 50,
    k: int | None = None,
    algorithm: str = "auto",
    period: Any = None,
    key: Any = None,
    t0: Real = 0.0,
    transient: Real | None = None,
    mode: str | int | None = None,
    method: Method | None = None,
    clock: str = "time",
    window: Any = 0.1,
    points: int | None = None,
    replicates: int = 4,
    degree: int = 3,
    progress: Any = None,
) -> Design:
    """Parameters at which exponents reach a target, or at which an objective of them is least.

    A number, or a sequence of k of them, is the target of the leading exponents. The method is Newton's, or
    Gauss–Newton if there are more or fewer parameters than exponents. A step changes a parameter by at most half of
    itself (a distance from a bound by at most a factor e²) and is halved until the difference decreases. The search
    ends when the difference is of the size of rounding, or below a standard error.

    A function (exponents (k,), args) -> number is minimised by gradient descent: by default with steps of a tenth of
    a parameter, or in its coordinate between bounds.

    optimiser="bisection" finds where λ₁ passes one number between two bounds, without derivatives: also where λ₁ is not
    smooth, as at the edge of chaos.

    Args:
        system: as for `lh.lyapunov_gradient`.
        x0: (n,) start, or a function of args that returns it.
        args: tree of parameters where the search begins.
        target: a number, a sequence of k numbers, or a function to be minimised.
        t1: length of the runs.
        over: the parameters that may change, names of leaves of args: "rho" or ("rho", "spring.rate"); or with bounds,
            {name: (low, high)}, either of which may be None. These are never reached: the search is one in unbounded
            coordinates, by ln of the distance from one bound, and by ln of the ratio of both distances.
        optimiser: None (Newton's method, or Adam for an objective), an optax optimiser, or "bisection".
        steps: most of them.
        k: exponents that an objective sees; None: all.
        algorithm: as for `lh.lyapunov_gradient`; "implicit" follows the orbit of the given period, also where it is
            unstable, as that of a converter which the search is to make stable; a bisection has none.
        period: as for `lh.lyapunov_gradient`; a bisection has none.
        key: as for `lh.lyapunov_gradient`.
        t0: as for `lh.lyapunov_gradient`.
        transient: as for `lh.lyapunov_gradient`.
        mode: as for `lh.lyapunov_gradient`.
        method: as for `lh.lyapunov_gradient`.
        clock: as for `lh.lyapunov_gradient`.
        window: as for `lh.lyapunov_gradient`; a bisection has none.
        points: as for `lh.lyapunov_gradient`; a bisection has none.
        replicates: as for `lh.lyapunov_gradient`.
        degree: as for `lh.lyapunov_gradient`; a bisection has none.
        progress: None, True for a bar, or a function of the fraction done: of the points that `steps` allow.

    Returns:
        A `Design`. Where the derivatives at a point cannot be trusted, the search ends there and `reasons` says so.

    Raises:
        ValueError: on arguments that do not fit.
        NoDerivativeError: where the motion fails at the first point. Later the search ends there; `reasons` says why.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.design(logistic, [0.3], {"r": 2.8}, -0.5, over="r", t1=1000)  # λ = ln|2 − r|
        >>> found.converged, round(found.parameters["r"], 9)
        (True, 2.60653066)
    """
    require_values("design", x0, args)
    positive("t1, a length,", t1)
    whole("steps", steps, least=1)
    random_key("key", key)
    over = over if isinstance(over, Mapping) else dict.fromkeys(words("over", over))
    names, x0 = tuple(over), x0 if callable(x0) else jnp.asarray(numbers("x0", x0, float))
    goal = None if callable(target) else np.atleast_1d(numbers("target", target, float))
    if goal is not None:
        good = goal.ndim == 1 and goal.size > 0 and bool(np.all(np.isfinite(goal)))
        require(good, f"target must be a number, a sequence of them, or a function; got {target!r}.")
        require(k is None, f"k is for a target that is a function; there are as many exponents as numbers; got k={k}.")
        k = len(goal)
    case = case_of(system, x0, args, k or 0, {}, names)
    limits, first = bounds_of(case, over), case.theta
    alone = {"t0": t0, "mode": mode, "clock": clock, "method": method}
    history, report = list[np.ndarray](), reporter(progress)

    def noted(point: DesignPoint) -> DesignPoint:
        history.append(np.concatenate([point.theta, point.value]))
        report(min(1.0, len(history) / (steps + 1)))
        return point

    def with_slopes(theta) -> DesignPoint:
        found = lyapunov_gradient(
            system, x0, case.args_of(theta), t1=t1, over=names, k=k, algorithm=algorithm, period=period, key=key,
            transient=transient, window=window, points=points, replicates=replicates, degree=degree, **alone,
        )  # fmt: skip
        return noted(_point(case, theta, found))

    if isinstance(optimiser, str):
        require(optimiser == "bisection", f'optimiser must be None, of optax, or "bisection"; got {optimiser!r}.')
        if goal is None or len(goal) != 1:
            raise ValueError(f"a bisection needs one number as its target; got {target!r}.")
        alone |= {} if key is None else {"key": key, "replicates": replicates}
        transient = part_of(system, clock, t1, 0.1) if transient is None else transient
        look = _without_slopes(case, {"t1": t1, "transient": transient, **alone})
        search = functools.partial(_bisection, lambda theta: noted(look(theta)), goal[0], limits, steps)
    elif goal is not None and optimiser is None:
        search = functools.partial(_newton, with_slopes, goal, limits, first, steps)
    else:
        import optax  # here, because the import is slow, and few need it

        objective = target if callable(target) else lambda exponents, args: jnp.sum((exponents - goal) ** 2)
        units = limits.sizes(case.theta) if optimiser is None else np.ones(len(case.theta))
        optimiser = optax.adam(RATE) if optimiser is None else optimiser
        good = isinstance(optimiser, optax.GradientTransformation)
        require(good, f'optimiser must be of optax, as optax.adam(0.01), "bisection" or None; got {optimiser!r}.')
        search = functools.partial(_descent, with_slopes, objective, case, limits, optimiser, units, steps)
    try:
        end, reached, reasons = search()
        report(1.0)
    finally:
        report(None)
    return Design(
        args=case.args_of(jnp.asarray(end.theta)),
        parameters={name: float(value) for name, value in zip(case.names, end.theta, strict=True)},
        exponents=end.value, stderr=end.stderr, converged=reached, trust=end.trust,
        reasons=(*reasons, *end.reasons), history=np.stack(history),
        time_unit=case.time_unit if clock == "time" else "",
    )  # fmt: skip


def _point(case: ExponentFunction, theta, found: Gradient) -> DesignPoint:
    count = len(found.value)
    leaves = [np.reshape(leaf, (count, -1)) for leaf in jax.tree.leaves(found.gradient)]
    return DesignPoint(
        theta, found.value, found.value_stderr, np.concatenate(leaves, axis=1), found.trust, found.reasons,
        usable=found.trust or found.of_unstable_orbit,
    )  # fmt: skip


def _without_slopes(case: ExponentFunction, how: Mapping[str, Any]) -> Callable:
    """Exponents without derivatives, for a bisection."""

    def look(theta) -> DesignPoint:
        args = case.args_of(jnp.asarray(theta))
        found = lyapunov_spectrum(case.system, case.start(args), args, throw=False, **how)
        value, stderr = np.asarray(found.exponents[:1]), np.asarray(found.stderr[:1])
        return DesignPoint(theta, value, stderr, None, found.status in WHOLE, (f"status: {found.status.name}",))

    return look


def _near(point: DesignPoint, goal) -> bool:
    """Whether a point is at the target, up to rounding or noise."""
    return bool(np.all(np.abs(point.value - goal) <= np.maximum(EXACT * (1 + np.abs(goal)), NOISE * point.stderr)))


def _newton(look: Callable, goal, limits: ParameterBounds, first, steps: int):
    """Newton (or Gauss–Newton) steps of least norm in the unbounded coordinates."""
    here, u = look(first), limits.unbounded(first)
    for _ in range(steps):
        if _near(here, goal):
            return here, True, ("the target is reached",)
        if not here.usable:
            return here, False, ("the derivatives are not to be trusted here",)
        assert here.jacobian is not None
        whole_step = np.linalg.lstsq(here.jacobian * limits.slope(u), goal - here.value, rcond=None)[0]
        whole_step = whole_step * min(1.0, float(np.min(limits.longest(u) / np.maximum(np.abs(whole_step), 1e-300))))
        distance, failure = np.linalg.norm(here.value - goal), ""
        for halving in range(HALVINGS):
            ahead = u + 0.5**halving * whole_step
            try:
                there = look(limits.bounded(ahead))
            except (ValueError, LyaphybridError) as failed:  # so far away: no orbit, wrong input, singular equations
                failure = f"; a step failed: {str(failed).splitlines()[0]}"
                continue
            if np.linalg.norm(there.value - goal) < distance or _near(there, goal):
                break
        else:
            few = f"{len(goal)} targets, {len(u)} parameters: the least squares of what is missed"
            why = few if len(goal) > len(u) else "λ may have an extremum here"
            return here, False, (f"no step comes nearer than {distance:.3g}: {why}{failure}",)
        here, u = there, ahead
    return here, _near(here, goal), (f"{steps} steps",)


def _descent(
    look: Callable, objective: Callable, case: ExponentFunction, limits: ParameterBounds, optimiser, units, steps: int
):
    """Steps of an optimiser, which sees the unbounded coordinates in these units (p,); returns the best point."""

    def of_all(value, theta):
        return objective(value, case.args_of(theta))

    u = jnp.asarray(limits.unbounded(case.theta) / units)
    state, best, least = optimiser.init(u), None, np.inf
    here, slope = None, np.zeros(0)
    for _ in range(steps):
        try:
            here = look(limits.bounded(units * np.asarray(u)))
        except LyaphybridError as failed:
            if best is None:
                raise
            why = f"a step failed: {str(failed).splitlines()[0]}; the objective is {least:.6g}"
            return best, False, (why,)
        size, (by_value, by_theta) = jax.value_and_grad(of_all, argnums=(0, 1))(
            jnp.asarray(here.value), jnp.asarray(here.theta)
        )
        if best is None or size < least:
            best, least = here, float(size)
        used = np.asarray(by_value) != 0  # an exponent that is -inf has no derivatives, and need have none
        slope = (by_value[used] @ np.asarray(here.jacobian)[used] + by_theta) * units
        slope = slope * limits.slope(units * np.asarray(u))
        if not here.usable or not np.any(slope):
            break
        with jax.numpy_dtype_promotion("standard"):  # optax mixes integers and floats
            changes, state = optimiser.update(slope, state, u)
        u = u + changes
    assert best is not None
    assert here is not None
    reason = f"{ALL_STEPS}, {steps}: more may come nearer"
    if not here.usable:
        reason = "the derivatives are not to be trusted where the steps ended"
    elif not np.any(slope):
        reason = "the objective is stationary"
    return best, here.usable, (f"{reason}; the objective is {least:.6g}",)


def _bisection(look: Callable, goal: float, limits: ParameterBounds, steps: int):
    """Bisection between the bounds; one end stays below the target, the other above."""
    left, right = (look(theta) for theta in limits.both())
    for end in (left, right):
        if not np.isfinite(end.value[0]):
            return end._replace(trust=False), False, ("λ₁ is not known at a bound: the run failed",)
    falls = left.value[0] > right.value[0]
    if (left.value[0] < goal) == (right.value[0] < goal):
        values = f"λ₁ is {left.value[0]:.6g} and {right.value[0]:.6g} at the bounds: on one side of {goal}"
        return left._replace(trust=False), False, (values,)
    for _ in range(steps):
        narrow = np.abs(right.theta - left.theta) <= EXACT * (1 + np.abs(left.theta))
        if narrow or (_near(left, goal) and _near(right, goal)):
            break
        here = look(0.5 * (left.theta + right.theta))
        if not np.isfinite(here.value[0]):
            why = f"λ₁ is not known at {here.theta[0]:.12g}, {here.reasons[0]}"
            nearer = min(left, right, key=lambda point: abs(point.value[0] - goal))
            return nearer._replace(trust=False), False, (why,)
        if (here.value[0] < goal) == falls:
            right = here
        else:
            left = here
    nearer = min(left, right, key=lambda point: abs(point.value[0] - goal))
    sides = f"λ₁ is {left.value[0]:.6g} at {left.theta[0]:.12g} and {right.value[0]:.6g} at {right.theta[0]:.12g}"
    return nearer, True, (sides,)
