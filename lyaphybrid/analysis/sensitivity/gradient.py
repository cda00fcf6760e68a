"""The derivative of exponents with respect to parameters, by the method that can be trusted with the motion."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import positive, real, require, whole
from ..._jax.tracing import traced
from ...engine import preparation
from ...engine.blocks import check_counts, part_of
from ...integrators.base import Method
from ...systems.daes.semi_linear import degrees_of_freedom
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.smooth import Flow, Map
from ..orbits.periods import check_period
from .birkhoff import by_birkhoff
from .equilibria import by_equilibrium
from .estimates import Case, Estimate, UntrustedError, case_of, tree_of
from .implicit import by_implicit
from .regression import by_regression
from .response.linear_response import by_linear_response

__all__ = ["Gradient", "lyapunov_gradient"]

METHODS = ("auto", "equilibrium", "implicit", "birkhoff", "linear_response", "regression")


class Gradient(eqx.Module):
    """Exponents and their derivatives.

    Attributes:
        value: (k,) exponents, descending.
        value_stderr: (k,) their standard errors.
        gradient: dλ_i/dθ, a tree like args, each leaf (k,) + its shape; None where a leaf is no parameter.
        stderr: the same of standard errors.
        method: which was used.
        trust: whether the result passed all checks of its method.
        reasons: what was checked, with the numbers that decided.
        names: of the parameters, in the order of the rows that `str` shows.
        cost: runs of length t1, or what takes as long.
        time_per_jump: of a regression where the system jumps, the mean time between jumps: a `Gradient` with k = 1.
    """

    value: np.ndarray
    value_stderr: np.ndarray
    gradient: Any
    stderr: Any
    method: str = eqx.field(static=True)
    trust: bool = eqx.field(static=True)
    reasons: tuple[str, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    cost: int = eqx.field(static=True)
    time_per_jump: "Gradient | None" = None

    def __str__(self) -> str:
        k = len(self.value)
        lines = [f"Derivatives of {k} exponents by {self.method}: {self._verdict}"]
        lines += self._rows([f"λ{i + 1}" for i in range(k)])
        if self.time_per_jump is not None:
            lines += [f"  and of the time per jump: {self.time_per_jump._verdict}"]
            lines += self.time_per_jump._rows(["time per jump"])
        return "\n".join(lines)

    __repr__ = __str__

    @property
    def _verdict(self) -> str:
        return "trusted" if self.trust else "NOT to be trusted"

    def _rows(self, of: list[str]) -> list[str]:
        lines = []
        slopes, errors = (np.concatenate([np.reshape(leaf, (len(of), -1)) for leaf in jax.tree.leaves(tree)], axis=1)
                          for tree in (self.gradient, self.stderr))  # fmt: skip
        for i, what in enumerate(of):
            lines.append(f"  {what} = {self.value[i]:.8g} ± {self.value_stderr[i]:.1g}")
            lines += [
                f"    d/d {name} = {slope:.8g} ± {spread:.1g}"
                for name, slope, spread in zip(self.names, slopes[i], errors[i], strict=True)
            ]
        return [*lines, *(f"  {reason}" for reason in self.reasons)]


def lyapunov_gradient(
    system: Flow | Map | Hybrid | EventDriven,
    x0,
    args: Any,
    *,
    t1,
    method: str = "auto",
    period: Any = None,
    key: Any = None,
    free: Sequence[str] | None = None,
    k: int | None = None,
    t0=0.0,
    transient=None,
    mode: str | int | None = None,
    integrator: Method | None = None,
    clock: str = "time",
    window: Any = 0.1,
    points: int | None = None,
    replicates: int = 4,
    degree: int = 3,
    progress: Any = None,
) -> Gradient:
    """Derivatives of the exponents with respect to the floating-point leaves of args.

    "equilibrium": the motion of a flow or `lh.DAE` that does not depend on time comes to rest. The point is found by
    Newton's method, its derivatives by the implicit function theorem, and those of the exponents are eigenvalues'. Of
    exponents that are the same, a complex pair or more, it is that of their mean.

    "implicit": the motion ends on a periodic orbit. It is found by Newton's method, through all jumps, and the
    derivatives of its multipliers follow from the implicit function theorem, to about ten digits; guards and resets may
    depend on the parameters. Of a complex pair, or of exponents that are nearly the same, it is that of their mean.

    "birkhoff": motion that is regular and on no isolated periodic orbit: tori, families of orbits. The derivative is
    taken through one run, forward, or backward where there are many parameters, and averaged with Birkhoff's weights.
    It is trusted where the run and its first half agree.

    "linear_response": chaos of a flow or map that is smooth and has one unstable direction. From 32 runs at the
    parameters themselves, whatever their number. Trusted where the density gradient along the unstable direction has no
    heavy tail, where longer correlations add nothing, where no break of the system was met, and where the zero exponent
    along a flow has no derivative. Unseen go breaks below a thousandth of the system's size, or that fewer than one in
    thirty thousand steps come near to, and what parameters do only where the attractor ends.

    "regression": any motion, chaos with jumps and billiards included. Exponents of an ensemble over a window of
    parameters are fitted by polynomials. The derivative is trusted where χ² agrees with the noise between replicates,
    where two degrees agree, and where zero exponents have none. Of a system that jumps it is found for the mean time
    between jumps too: the mean free time of a billiard.

    "auto": equilibrium or implicit where there is a stable equilibrium or periodic orbit, else birkhoff where that is
    to be trusted, else regression.

    The derivative of a long chaotic trajectory is not that of its exponents: it grows as e^(λt). It is not offered.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (n,) start, or a function of args that returns it (of a system whose energy is a parameter, say).
        args: tree of parameters.
        t1: length of the run, or of each run of a linear response or a regression.
        method: "auto", "equilibrium", "implicit", "birkhoff", "linear_response" or "regression".
        period: of a system that is forced: as for `lh.floquet`. A function of args where it depends on them: else the
            derivative with respect to a frequency is not right.
        key: for the ensemble of a regression, or the runs of a linear response.
        free: names of the leaves of args to differentiate by, "rho" or "spring.rate"; None: all that are floats.
        k: number of exponents; None: all.
        t0: time at the start.
        transient: length of the run before; None: t1/10.
        mode: mode at the start, where there are several.
        integrator: of the flow; None: the default (implicit: with rtol = 1e-12, birkhoff: 1e-11). A linear response
            needs a fixed step, `lh.RungeKutta("rk4", dt=…)`.
        clock: of the exponents, as for `lyapunov_spectrum`.
        window: half width of the window of parameters, relative to each, or an array of absolute ones.
        points: of the window; None: enough for the degree.
        replicates: runs at each point.
        degree: of the polynomial; that with two more is compared.
        progress: None, True for a bar, or a function of the fraction done, of each method that is tried.

    Returns:
        A `Gradient`.

    Raises:
        ValueError: on arguments that do not fit; where "implicit" is asked for and there is no periodic orbit, or
            "equilibrium" and the system has none or depends on time, or "birkhoff" and the motion is chaotic, or
            "linear_response" and the system jumps, has constraints or an energy, or depends on time.

    Source:
        R. Seydel, Practical Bifurcation and Stability Analysis (Springer 2010), doi:10.1007/978-1-4419-1740-9.
        N. Chandramoorthy & Q. Wang, SIAM J. Appl. Dyn. Syst. 21 (2022) 735, doi:10.1137/21M1405599 (linear response).

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
        >>> found = lh.lyapunov_gradient(logistic, [0.3], 2.9, t1=1000)  # λ = ln|2 − r|
        >>> found.method, found.trust, round(float(found.gradient[0]), 6)
        ('implicit', True, 1.111111)
    """
    require(method in METHODS, f"method must be one of {METHODS}; got {method!r}.")
    require(not traced((x0, args, t0)), "lyapunov_gradient decides from values: it cannot be used under jit or vmap.")
    positive("t1, a length,", t1)
    real("t0", t0)
    transient = part_of(system, clock, t1, 0.1) if transient is None else transient
    real("transient, a length,", transient)
    require(float(transient) >= 0, f"transient, a length, must not be negative; got {transient!r}.")
    check_counts(system, clock, t1=t1, transient=transient)
    start = x0 if callable(x0) else jnp.asarray(x0, float)
    most = degrees_of_freedom(system, jnp.asarray(x0(args) if callable(x0) else x0).size)
    if k is not None:
        whole("k", k, least=1)
        require(k <= most, f"k must be at most {most}; got {k}.")
    options = {"t1": t1, "t0": t0, "transient": transient, "mode": mode, "method": integrator, "clock": clock}
    case = case_of(system, start, args, k or most, options, free)
    if period is not None:
        now, own = preparation.as_arrays(args, float), period(args) if callable(period) else period
        positive("period", own)
        check_period(system, own, case.start(now), now, t0)
    name, estimate = _estimate(case, method, period, key, (window, points, replicates, degree, progress))
    return _gradient(case, name, estimate)


def _gradient(case: Case, method: str, found: Estimate) -> Gradient:
    return Gradient(
        value=found.value,
        value_stderr=found.value_stderr,
        gradient=tree_of(case, found.gradient),
        stderr=tree_of(case, found.stderr),
        method=method,
        trust=found.trust,
        reasons=found.reasons,
        names=case.names,
        cost=found.cost,
        time_per_jump=None if found.time_per_jump is None else _gradient(case, method, found.time_per_jump),
    )


def _estimate(case: Case, method: str, period, key, ensemble) -> tuple[str, Estimate]:
    """The method that was used, and what it found: of all that apply, the first that is to be trusted."""
    window, points, replicates, degree, progress = ensemble
    if method == "linear_response":
        require(key is not None, "linear_response needs key=jax.random.key(seed) for its runs.")
        return method, by_linear_response(case, key=key, progress=progress)
    before: list[str] = []
    for name, one in (
        ("equilibrium", lambda: by_equilibrium(case, progress=progress)),
        ("implicit", lambda: _implicit(case, period, progress)),
        ("birkhoff", lambda: by_birkhoff(case, progress=progress)),
    ):
        tried = method == "auto" and (name != "equilibrium" or (isinstance(case.system, Flow) and period is None))
        if method != name and not tried:
            continue
        try:
            found = one()
        except (UntrustedError, ValueError) as error:
            if method == name:
                raise ValueError(str(error)) from error
            before.append(f"{name}: {error}")
            continue
        if method == name or found.trust:
            return name, found._replace(reasons=(*before, *found.reasons))
        before.append(f"{name} was not to be trusted: " + "; ".join(found.reasons))
    require(key is not None, f"regression needs key=jax.random.key(seed) for its ensemble. {' '.join(before)}".strip())
    found = by_regression(
        case, key=key, window=window, points=points, replicates=replicates, degree=degree, progress=progress
    )
    return "regression", found._replace(reasons=(*before, *found.reasons))


def _implicit(case: Case, period, progress) -> Estimate:
    require(not isinstance(case.system, EventDriven), "implicit needs an lh.Flow, lh.Map or lh.Hybrid.")
    return by_implicit(case, period=period, progress=progress)
