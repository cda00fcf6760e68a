"""Parameters at which the exponents are what is wanted, by the derivatives of `lyapunov_gradient`."""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from ..._arguments import positive, require, whole
from ..._jax.tracing import traced
from ...engine.blocks import part_of
from ...engine.host.reporting import reporter
from ...statuses import STATUS
from ..spectra import lyapunov_spectrum
from .bounds import Bounds, bounds_of
from .estimates import Case, case_of
from .gradient import Gradient, lyapunov_gradient

__all__ = ["Design", "design"]

EXACT = 1e-12  # difference from the target, relative to 1 + |target|, that is none
NOISE = 1.0  # standard errors of the exponent: a difference below these is none either
HALVINGS = 8  # of a Newton step that does not come nearer
RATE = 0.1  # of the default optimiser, Adam, in the unbounded coordinates
WHOLE = (STATUS.ok, STATUS.terminated)  # a run that has reached its end
KEPT = ("t0", "mode", "clock")  # options that `lyapunov_spectrum` takes too


class Design(eqx.Module):
    """Parameters, and the exponents there.

    Attributes:
        args: the tree of parameters, with those that were free at their best.
        parameters: {name: value} of those.
        exponents: (k,) at args.
        stderr: (k,) their standard errors.
        converged: whether the target was reached, to rounding or to the noise; of an objective, whether its last
            derivatives could be trusted.
        trust: whether the last derivatives passed the checks of their method; of a bisection: whether signs differed.
        reasons: what decided, with numbers.
        history: (steps, p + k) parameters and exponents of every point that was tried.
    """

    args: Any
    parameters: dict[str, float]
    exponents: np.ndarray
    stderr: np.ndarray
    converged: bool = eqx.field(static=True)
    trust: bool = eqx.field(static=True)
    reasons: tuple[str, ...] = eqx.field(static=True)
    history: np.ndarray

    def __str__(self) -> str:
        trust = "trusted" if self.trust else "NOT to be trusted"
        lines = [f"Design: {'converged' if self.converged else 'NOT converged'} in {len(self.history)} points, {trust}"]
        lines += [f"  {name} = {value:.12g}" for name, value in self.parameters.items()]
        pairs = zip(self.exponents, self.stderr, strict=True)
        lines += [f"  λ{i + 1} = {value:.10g} ± {error:.1g}" for i, (value, error) in enumerate(pairs)]
        return "\n".join([*lines, *(f"  {reason}" for reason in self.reasons)])

    __repr__ = __str__


class Point(NamedTuple):
    """What is known at parameters θ."""

    theta: np.ndarray  # (p,)
    value: np.ndarray  # (k,)
    stderr: np.ndarray  # (k,)
    jacobian: np.ndarray | None  # (k, p) dλ/dθ
    trust: bool
    reasons: tuple[str, ...]


def design(
    system,
    x0,
    args: Any,
    target: float | Sequence[float] | Callable,
    *,
    t1,
    free: Sequence[str] | str,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    optimiser: Any = None,
    steps: int = 50,
    k: int | None = None,
    progress: Any = None,
    **options,
) -> Design:
    """Parameters at which exponents reach a target, or at which an objective of them is least.

    A number, or a sequence of k of them, is what the leading exponents are to be: Newton's method, of more or fewer
    parameters than exponents Gauss and Newton's, with steps that change a parameter by half of itself at most (a
    distance from a bound by a factor e²) and are halved until they come nearer. It ends where the difference is that of
    rounding, or less than a standard error.

    A function (exponents (k,), args) -> number is made small by gradient descent.

    optimiser="bisection" finds where λ₁ passes one number between two bounds, without derivatives: also where λ₁ is no
    smooth function, as at the edge of chaos.

    Args:
        system: as for `lh.lyapunov_gradient`.
        x0: (n,) start, or a function of args that returns it.
        args: tree of parameters where the search begins.
        target: a number, a sequence of k, or a function to be made small.
        t1: length of the runs.
        free: names of the leaves of args that may change, "rho" or ("rho", "spring.rate").
        bounds: {name: (low, high)}, either of which may be None; they are never reached: the search is one in unbounded
            coordinates, by ln of the distance from one bound, and by ln of the ratio of both distances.
        optimiser: None (Newton's method, or Adam for an objective), an optax optimiser, or "bisection".
        steps: most of them.
        k: exponents that an objective sees; None: all.
        progress: None, True for a bar, or a function of the fraction done: of the points that `steps` allow.
        **options: all others of `lh.lyapunov_gradient`: method, period, key, transient, mode, integrator, window…

    Returns:
        A `Design`. Where the derivatives are not to be trusted at a point it says so, and the search ends there.

    Raises:
        ValueError: on arguments that do not fit.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.design(logistic, [0.3], {"r": 2.8}, -0.5, free="r", t1=1000)  # λ = ln|2 − r|
        >>> found.converged, round(found.parameters["r"], 9)
        (True, 2.60653066)
    """
    require(not traced((x0, args)), "design decides from values: it cannot be used under jit or vmap.")
    positive("t1, a length,", t1)
    whole("steps", steps, least=1)
    names = (free,) if isinstance(free, str) else tuple(free)
    goal = None if callable(target) else np.atleast_1d(np.asarray(target, float))
    if goal is not None:
        good = goal.ndim == 1 and bool(np.all(np.isfinite(goal)))
        require(good, f"target must be a number, a sequence of them, or a function; got {target!r}.")
        require(k is None, "k belongs to a target that is a function: else there are as many exponents as numbers.")
        k = len(goal)
    case = case_of(system, x0, args, k or 0, {}, names)
    limits, first = bounds_of(case, bounds), case.theta
    history: list[np.ndarray] = []
    report = reporter(progress)

    def noted(point: Point) -> Point:
        history.append(np.concatenate([point.theta, point.value]))
        report(min(1.0, len(history) / (steps + 1)))
        return point

    def with_slopes(theta) -> Point:
        found = lyapunov_gradient(system, x0, case.args_of(theta), t1=t1, free=names, k=k, **options)
        return noted(_point(case, theta, found))

    if isinstance(optimiser, str):
        require(optimiser == "bisection", f'optimiser must be None, of optax, or "bisection"; got {optimiser!r}.')
        if goal is None or len(goal) != 1:
            raise ValueError(f"a bisection needs one number as its target; got {target!r}.")
        alone = _alone(case, t1, options)
        search = functools.partial(_bisection, lambda theta: noted(alone(theta)), goal[0], limits, steps)
    elif goal is not None and optimiser is None:
        search = functools.partial(_newton, with_slopes, goal, limits, first, steps)
    else:
        objective = target if callable(target) else lambda exponents, args: jnp.sum((exponents - goal) ** 2)
        optimiser = optax.adam(RATE) if optimiser is None else optimiser
        require(isinstance(optimiser, optax.GradientTransformation), f"optimiser must be of optax; got {optimiser!r}.")
        search = functools.partial(_descent, with_slopes, objective, case, limits, optimiser, steps)
    try:
        end, reached, reasons = search()
        report(1.0)
    finally:
        report(None)
    return Design(
        args=case.args_of(jnp.asarray(end.theta)),
        parameters={name: float(value) for name, value in zip(case.names, end.theta, strict=True)},
        exponents=end.value,
        stderr=end.stderr,
        converged=reached,
        trust=end.trust,
        reasons=(*reasons, *end.reasons),
        history=np.stack(history),
    )


def _point(case: Case, theta, found: Gradient) -> Point:
    count = len(found.value)
    leaves = [np.reshape(leaf, (count, -1)) for leaf in jax.tree.leaves(found.gradient)]
    return Point(theta, found.value, found.value_stderr, np.concatenate(leaves, axis=1), found.trust, found.reasons)


def _alone(case: Case, t1, options: Mapping) -> Callable:
    """Exponents without derivatives, for a bisection."""
    own = {name: options[name] for name in KEPT if name in options}
    if options.get("key") is not None:
        own |= {"key": options["key"], "replicates": options.get("replicates", 4)}
    transient = options.get("transient", part_of(case.system, options.get("clock", "time"), t1, 0.1))
    own |= {"method": options.get("integrator"), "transient": transient, "t1": t1}

    def look(theta) -> Point:
        args = case.args_of(jnp.asarray(theta))
        found = lyapunov_spectrum(case.system, case.start(args), args, throw=False, **own)
        status = STATUS(int(found.status_code))
        value, stderr = np.asarray(found.exponents[:1]), np.asarray(found.stderr[:1])
        return Point(theta, value, stderr, None, status in WHOLE, (f"status: {status.name}",))

    return look


def _near(point: Point, goal) -> bool:
    """Whether a point is at the target: to rounding, or to the noise."""
    return bool(np.all(np.abs(point.value - goal) <= np.maximum(EXACT * (1 + np.abs(goal)), NOISE * point.stderr)))


def _newton(look: Callable, goal, limits: Bounds, first, steps: int):
    """Steps of least length that would reach the target if the exponents were linear in the unbounded coordinates."""
    here, u = look(first), limits.unbounded(first)
    for _ in range(steps):
        if _near(here, goal):
            return here, True, ("the target is reached",)
        if not here.trust:
            return here, False, ("the derivatives are not to be trusted here",)
        assert here.jacobian is not None
        whole_step = np.linalg.lstsq(here.jacobian * limits.slope(u), goal - here.value, rcond=None)[0]
        whole_step = whole_step * min(1.0, float(np.min(limits.longest(u) / np.maximum(np.abs(whole_step), 1e-300))))
        distance, failure = np.linalg.norm(here.value - goal), ""
        for halving in range(HALVINGS):
            ahead = u + 0.5**halving * whole_step
            try:
                there = look(limits.bounded(ahead))
            except ValueError as failed:  # there is no such motion so far away
                failure = f"; a step failed: {str(failed).splitlines()[0]}"
                continue
            if np.linalg.norm(there.value - goal) < distance or _near(there, goal):
                break
        else:
            return here, False, (f"no step comes nearer than {distance:.3g}: λ may have an extremum here{failure}",)
        here, u = there, ahead
    return here, _near(here, goal), (f"{steps} steps",)


def _descent(look: Callable, objective: Callable, case: Case, limits: Bounds, optimiser, steps: int):
    """Steps of an optimiser; the best point is kept."""

    def of_all(value, theta):
        return objective(value, case.args_of(theta))

    u = jnp.asarray(limits.unbounded(case.theta))
    state, best, least = optimiser.init(u), None, np.inf
    here, slope = None, np.zeros(0)
    for _ in range(steps):
        here = look(limits.bounded(np.asarray(u)))
        size, (by_value, by_theta) = jax.value_and_grad(of_all, argnums=(0, 1))(
            jnp.asarray(here.value), jnp.asarray(here.theta)
        )
        if best is None or size < least:
            best, least = here, float(size)
        slope = (by_value @ here.jacobian + by_theta) * limits.slope(np.asarray(u))
        if not here.trust or not np.any(slope):
            break
        with jax.numpy_dtype_promotion("standard"):  # optax mixes integers and floats
            changes, state = optimiser.update(slope, state, u)
        u = optax.apply_updates(u, changes)
    assert best is not None
    assert here is not None
    ended = "the derivatives are not to be trusted where the steps ended"
    reason = ended if not here.trust else "the objective is stationary" if not np.any(slope) else f"{steps} steps"
    return best, here.trust, (f"{reason}; the objective is {least:.6g}",)


def _bisection(look: Callable, goal: float, limits: Bounds, steps: int):
    """Halve the bounds; the side on which λ₁ is below the target stays below."""
    left, right = (look(theta) for theta in limits.both())
    falls = left.value[0] > right.value[0]
    if (left.value[0] < goal) == (right.value[0] < goal):
        values = f"λ₁ is {left.value[0]:.6g} and {right.value[0]:.6g} at the bounds: on one side of {goal}"
        return left._replace(trust=False), False, (values,)
    for _ in range(steps):
        narrow = np.abs(right.theta - left.theta) <= EXACT * (1 + np.abs(left.theta))
        if narrow or (_near(left, goal) and _near(right, goal)):
            break
        here = look(0.5 * (left.theta + right.theta))
        if (here.value[0] < goal) == falls:
            right = here
        else:
            left = here
    nearer = min(left, right, key=lambda point: abs(point.value[0] - goal))
    sides = f"λ₁ is {left.value[0]:.6g} at {left.theta[0]:.12g} and {right.value[0]:.6g} at {right.theta[0]:.12g}"
    return nearer, True, (sides,)
