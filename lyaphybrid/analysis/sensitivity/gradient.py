"""The derivative of exponents with respect to parameters, by a method that suits the motion."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ... import _renamed as renamed
from ... import plots
from ..._arguments import (
    Real,
    State,
    is_one_of,
    numbers,
    parameters,
    positive,
    random_key,
    real,
    require,
    require_values,
    whole,
    words,
)
from ..._jax.tracing import as_arrays
from ..._text import Table, in_brackets, numbered, per_unit, with_error
from ...engine.blocks import check_counts, part_of
from ...errors import NoDerivativeError
from ...integrators.base import Method
from ...results.result import Data, Result, exponents_along, per_time
from ...systems.daes.semi_linear import degrees_of_freedom
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.smooth import Flow, Map
from ...systems.validation import check_functions
from ..orbits.periods import check_period
from ..spectra import CLOCKS, ENDLESS
from .birkhoff import by_birkhoff
from .equilibria import by_equilibrium
from .estimates import (
    Estimate,
    ExponentFunction,
    InapplicableError,
    UntrustedError,
    case_of,
    start_of,
    tree_of,
    unknown,
)
from .implicit import by_implicit
from .regression import by_regression
from .response.linear_response import by_linear_response

__all__ = ["Gradient", "lyapunov_gradient"]

NEIGHBOUR = 1e-3  # relative change of parameters at which a period must still be one
ALGORITHMS = ("auto", "equilibrium", "implicit", "birkhoff", "linear_response", "regression")


class Gradient(Result, eqx.Module):
    """Exponents and their derivatives.

    Attributes:
        value: (k,) exponents, descending.
        value_stderr: (k,) their standard errors.
        gradient: dλ_i/dθ, a tree like args, each leaf (k,) + its shape; None where a leaf is no parameter.
        stderr: their standard errors, a tree like `gradient`.
        algorithm: name of the algorithm that was used.
        trust: whether the result passed all checks of its method.
        reasons: what was checked, with the numbers that decided.
        names: of the parameters, in the order of the rows that `str` shows.
        cost: in runs of length t1.
        time_per_jump: the mean time between jumps as a `Gradient` with k = 1, from a regression of a system that jumps.
        time_unit: that exponents are per; "" where the system has none, and where jumps are counted.
        of_unstable_orbit: whether nothing speaks against `trust` but that motion does not stay with the orbit: all
            values are those of this orbit, as algorithm="implicit" asks for.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.lyapunov_gradient(logistic, [0.3], {"r": 2.9}, t1=500)
        >>> found.gradient["r"].round(6).tolist(), found.trust  # ln|2 − r|: 1/(r − 2)
        ([1.111111], True)
    """

    value: np.ndarray
    value_stderr: np.ndarray
    gradient: Any
    stderr: Any
    algorithm: str = eqx.field(static=True)
    trust: bool = eqx.field(static=True)
    reasons: tuple[str, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    cost: int = eqx.field(static=True)
    time_per_jump: "Gradient | None" = None
    time_unit: str = eqx.field(static=True, default="")
    of_unstable_orbit: bool = eqx.field(static=True, default=False)

    @property
    def method(self) -> str:
        """The algorithm, under the name that it had before `method` came to mean the integrator everywhere."""
        return self.algorithm

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The derivatives of each exponent by each parameter, with error bars of one standard error.

        `style` goes to what it draws.
        """
        return plots.gradient(self, ax, **style)

    def by_parameter(self) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives, and their standard errors, as matrices (k, p), p the parameters in the order of `names`."""
        k = len(self.value)
        slopes, errors = (
            np.concatenate([np.reshape(leaf, (k, -1)) for leaf in jax.tree.leaves(tree)], axis=1)
            for tree in (self.gradient, self.stderr)
        )
        return slopes, errors

    @property
    def _verdict(self) -> str:
        return "trusted" if self.trust else "NOT to be trusted"

    def _table(self) -> Table:
        k, more = len(self.value), self.time_per_jump
        rows, notes = self._rows(numbered("λ", k)), list(self.reasons)
        if more is not None:
            rows += more._rows([in_brackets("time per jump", self.time_unit)])
            notes += [f"time per jump: {more._verdict}", *more.reasons]
        title = f"Derivatives of {k} exponents{per_unit(self.time_unit)} by {self.algorithm}: {self._verdict}"
        return Table(title, rows, notes, ("", "value", *(f"d/d {name}" for name in self.names)))

    def _rows(self, of: list[str]) -> list[tuple[str, ...]]:
        slopes, errors = self.by_parameter()
        values = map(with_error, self.value, self.value_stderr)
        return [
            (what, value, *map(with_error, own, off))
            for what, value, own, off in zip(of, values, slopes, errors, strict=True)
        ]

    def _data(self) -> Data:
        slopes, errors = self.by_parameter()
        variables = {
            "value": ("exponent", self.value, per_time(self.time_unit)),
            "value_stderr": ("exponent", self.value_stderr, per_time(self.time_unit)),
            "gradient": (("exponent", "parameter"), slopes),
            "stderr": (("exponent", "parameter"), errors),
        }
        attributes = {name: getattr(self, name) for name in ("algorithm", "trust", "reasons", "cost")}
        return Data(variables, {**exponents_along(len(self.value)), "parameter": list(self.names)}, attributes)


def names_of_before(name: str, positional: tuple, given: dict[str, Any]) -> tuple:
    """`method` was the algorithm, and `integrator` what `method` is everywhere else."""
    if is_one_of(given.get("method"), ALGORITHMS):
        renamed.warn(f"{name}(…, method={given['method']!r})", "algorithm=")
        given["algorithm"] = given.pop("method")
    if "integrator" in given:
        renamed.warn(f"{name}(…, integrator=…)", "method=")
        given["method"] = given.pop("integrator")
    return positional


@renamed.keywords(free="over")
@renamed.arguments(names_of_before)
def lyapunov_gradient(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any,
    *,
    t1: Real,
    over: Sequence[str] | str | None = None,
    algorithm: str = "auto",
    period: Any = None,
    key: Any = None,
    k: int | None = None,
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
) -> Gradient:
    """Derivatives of the exponents with respect to the floating-point leaves of args.

    "equilibrium": the motion of a flow or `lh.DAE` that does not depend on time comes to rest. The point is found by
    Newton's method, its derivatives by the implicit function theorem; those of the exponents are derivatives of
    eigenvalues. For equal exponents (a complex pair or more) it is the derivative of their mean.

    "implicit": the motion ends on a periodic orbit. It is found by Newton's method, through all jumps, and the
    derivatives of its multipliers follow from the implicit function theorem, to about ten digits; guards and resets may
    depend on the parameters. For a complex pair, or nearly equal exponents, it is the derivative of their mean. Where a
    multiplier is less than rounding beside the others its derivative is nan, and the result is not trusted.

    "birkhoff": regular motion without an isolated periodic orbit: tori, families of orbits. The derivative is taken
    along one run, in forward mode, or in reverse mode for many parameters, and averaged with smooth (Birkhoff) weights.
    It is trusted where the run and its first half agree.

    "linear_response": chaos of a flow or map that is smooth and has one unstable direction. It takes 32 runs at
    the given parameters, for any number of them. It is trusted where the density gradient along the unstable direction
    has no heavy tail, longer correlations add nothing, no discontinuity was met, and the zero exponent along a flow has
    no derivative. It cannot detect discontinuities below a thousandth of the system's size, or near fewer than one in
    thirty thousand steps, nor effects of parameters only at the edge of the attractor.

    "regression": any motion, chaos with jumps and billiards included. Exponents of an ensemble over a window of
    parameters are fitted by polynomials. The derivative is trusted where χ² agrees with the noise between replicates,
    where two degrees agree, and where zero exponents have none. For a system that jumps it also gives that of the mean
    time between jumps, such as the mean free time of a billiard.

    "auto": equilibrium or implicit where there is a stable equilibrium or periodic orbit, else birkhoff if that can
    be trusted, else regression.

    The derivative of a long chaotic trajectory is not offered: it grows as e^(λt) and is not that of its exponents.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (n,) start, or a function of args that returns it (for example if the energy is a parameter).
        args: tree of parameters.
        t1: length of the run, or of each run of a linear response or a regression.
        over: the parameters to differentiate by, names of leaves of args: "rho" or ("rho", "spring.rate"); None: all
            that are floats.
        algorithm: "auto", "equilibrium", "implicit", "birkhoff", "linear_response" or "regression".
        period: of a forced system, as for `lh.floquet`. Where it depends on args it must be a function of them, or the
            derivative with respect to a frequency would be wrong.
        key: for the ensemble of a regression, or the runs of a linear response.
        k: number of exponents; None: all.
        t0: time at the start.
        transient: length of the run before; None: t1/10.
        mode: mode at the start, where there are several.
        method: the integrator of the flow; None: the default (implicit: with rtol = 1e-12, birkhoff: 1e-11). A linear
            response needs a fixed step, `lh.RungeKutta("rk4", dt=…)`.
        clock: of the exponents, as for `lyapunov_spectrum`. Those of an orbit are per unit of time, or with "jumps" per
            jump: where it jumps once a period they are the ln|μ| of its multipliers.
        window: half width of the window of parameters, relative to each, or an array of absolute ones.
        points: number of points in the window; None: enough for the degree.
        replicates: runs at each point.
        degree: of the polynomial; it is compared with that of two degrees more.
        progress: None, True for a bar, or a function of the fraction done, of each method that is tried.

    Returns:
        A `Gradient`.

    Raises:
        ValueError: on arguments that do not fit; where "equilibrium" is asked for and the system jumps or depends on
            time, or "linear_response" and it jumps, has constraints or an energy, or depends on time.
        NoDerivativeError: where the motion fails; where "implicit" is asked for and there is no periodic orbit, or
            "equilibrium" and Newton's method finds none, or "birkhoff" and the motion is chaotic.

    Source:
        R. Seydel, Practical Bifurcation and Stability Analysis (Springer 2010), doi:10.1007/978-1-4419-1740-9.
        N. Chandramoorthy & Q. Wang, SIAM J. Appl. Dyn. Syst. 21 (2022) 735, doi:10.1137/21M1405599 (linear response).

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
        >>> found = lh.lyapunov_gradient(logistic, [0.3], 2.9, t1=1000)  # λ = ln|2 − r|
        >>> found.algorithm, found.trust, round(float(found.gradient[0]), 6)
        ('implicit', True, 1.111111)
    """
    require(is_one_of(algorithm, ALGORITHMS), f"algorithm must be one of {ALGORITHMS}; got {algorithm!r}.")
    over = None if over is None else words("over", over)
    random_key("key", key)
    require_values("lyapunov_gradient", x0, args, t0)
    positive("t1, a length,", t1)
    real("t0", t0)
    require(is_one_of(clock, CLOCKS), f"clock must be one of {CLOCKS}; got {clock!r}.")
    require(clock != "jumps" or not isinstance(system, Flow), ENDLESS)
    transient = part_of(system, clock, t1, 0.1) if transient is None else transient
    real("transient, a length,", transient)
    require(float(np.asarray(transient)) >= 0, f"transient, a length, must not be negative; got {transient!r}.")
    check_counts(system, clock, t1=t1, transient=transient)
    args = jax.tree.map(lambda leaf: parameters("args", leaf), args)
    start = x0 if callable(x0) else jnp.asarray(numbers("x0", x0, float))
    most = degrees_of_freedom(system, start_of(x0, args).size)
    if k is not None:
        whole("k", k, least=1)
        require(k <= most, f"k must be at most {most}; got {k}.")
    options = {"t1": t1, "t0": t0, "transient": transient, "mode": mode, "method": method, "clock": clock}
    case = case_of(system, start, args, k or most, options, over)
    if not callable(start) and isinstance(system, Flow | Map | Hybrid | EventDriven) and start.ndim == 1:
        check_functions(system, jax.ShapeDtypeStruct(start.shape, start.dtype), as_arrays(args, start.dtype))
    if period is not None:
        now, own = as_arrays(args, float), period(args) if callable(period) else period
        positive("period", own)
        check_period(system, own, case.start(now), now, t0)
        if not callable(period):
            _require_fixed(case, own)
    try:
        name, estimate = _estimate(case, algorithm, period, key, (window, points, replicates, degree, progress))
    except UntrustedError as failed:
        raise NoDerivativeError(str(failed), _gradient(case, algorithm, unknown(case, str(failed)))) from failed
    return _gradient(case, name, estimate)


def _gradient(case: ExponentFunction, algorithm: str, found: Estimate) -> Gradient:
    return Gradient(
        value=found.value,
        value_stderr=found.value_stderr,
        gradient=tree_of(case, found.gradient),
        stderr=tree_of(case, found.stderr),
        algorithm=algorithm,
        trust=found.trust,
        reasons=found.reasons,
        names=case.names,
        cost=found.cost,
        time_per_jump=None if found.time_per_jump is None else _gradient(case, algorithm, found.time_per_jump),
        time_unit=case.time_unit if case.options["clock"] == "time" else "",
        of_unstable_orbit=found.of_unstable_orbit,
    )


def _require_fixed(case: ExponentFunction, period) -> None:
    """Require that a period that is given as a number is one for neighbouring parameters, too."""
    theta = np.asarray(case.theta, float)
    steps = np.linspace(
        NEIGHBOUR, 2 * NEIGHBOUR, len(theta)
    )  # different ones: equal factors may leave a ratio as it is
    args = as_arrays(case.args_of(jnp.asarray(np.where(theta == 0, steps, theta * (1 + steps)))), float)
    try:
        check_period(case.system, period, case.start(args), args, case.options["t0"])
    except ValueError as error:
        raise ValueError(
            f"period is given as the number {float(period):.9g}, but it changes with the parameters by which "
            f"derivatives are taken ({', '.join(case.names[:5])}): give a function, period=lambda args: …, or over= "
            "those that leave it as it is."
        ) from error


def _estimate(case: ExponentFunction, algorithm: str, period, key, ensemble) -> tuple[str, Estimate]:
    """The name of the algorithm that was used, and its estimate: the first applicable one that can be trusted."""
    window, points, replicates, degree, progress = ensemble
    if algorithm == "linear_response":
        require(key is not None, "linear_response needs key=jax.random.key(seed) for its runs.")
        return algorithm, by_linear_response(case, key=key, progress=progress)
    before: list[str] = []
    failed = False
    for name, one in (
        ("equilibrium", lambda: by_equilibrium(case, progress=progress)),
        ("implicit", lambda: _implicit(case, period, progress)),
        ("birkhoff", lambda: by_birkhoff(case, progress=progress)),
    ):
        tried = algorithm == "auto" and (name != "equilibrium" or (isinstance(case.system, Flow) and period is None))
        if algorithm != name and not tried:
            continue
        try:
            found = one()
        except (UntrustedError, InapplicableError) as error:
            if algorithm == name:
                raise
            before.append(f"{name}: {error}".removesuffix("."))
            failed = failed or getattr(error, "failed", False)
            continue
        if algorithm == name or found.trust:
            return name, found._replace(reasons=(*before, *found.reasons))
        before.append(f"{name} was not to be trusted: " + "; ".join(found.reasons))
        if found.of_unstable_orbit:
            before[-1] += "; for the exponents of this orbit give algorithm='implicit'"
    if key is None and failed:
        raise UntrustedError(f"The motion fails: {'; '.join(before)}", failed=True)
    needed = "regression needs key=jax.random.key(seed) for its ensemble."
    require(key is not None, f"{'. '.join(before)}. What is left, {needed}" if before else needed)
    how = {"window": window, "points": points, "replicates": replicates, "degree": degree}
    try:
        found = by_regression(case, key=key, progress=progress, **how)
    except ValueError as error:
        raise ValueError(f"{'. '.join(before)}. What is left, regression: {error}" if before else str(error)) from error
    return "regression", found._replace(reasons=(*before, *found.reasons))


def _implicit(case: ExponentFunction, period, progress) -> Estimate:
    if isinstance(case.system, EventDriven):
        raise InapplicableError(
            f"implicit needs an lh.Flow, lh.Map or lh.Hybrid; got an lh.{type(case.system).__name__}."
        )
    return by_implicit(case, period=period, progress=progress)
