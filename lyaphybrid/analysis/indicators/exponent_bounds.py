"""A bound for the error of exponents, from the local errors of the steps and the integral separation of the run.

A step computes Q⁺ R, which differs from Φ Q by the local error: Φ Q = Q⁺ (R + E). The exact product is that of
the matrices R + E, and with unit lower triangular matrices I + W, W = 0 at the start,

    (R + E) (I + W) = (I + W⁺) S,        S upper triangular,

ln S_jj is the exact growth, up to one factor I + W at the end. Elimination with bounds instead of numbers gives, from
|E|, bounds for |W⁺| and for |S_jj − R_jj|. The bound of w_ij, i > j, is multiplied by r_ii / r_jj at each step: it
stays of the size of the local error only where directions are integrally separated. (The theorems of Dieci & Van Vleck
and of Linh, Mehrmann & Van Vleck bound the same by constants of the separation; here the factors R are used.)
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ... import plots
from ..._arguments import Progress, Real, State, flag, positive, require, require_one_start, require_values
from ..._text import Table, numbered, with_unit
from ...engine.blocks import check_counts
from ...engine.preparation import grown_columns
from ...engine.states import Orthonormalisation, StepState
from ...integrators.base import Method
from ...results.result import Data, RunResult, exponents_along
from ...systems.daes.semi_linear import degrees_of_freedom
from ...systems.kinds import iterates, unit_of
from ...systems.smooth import Flow, Map
from .following import follow, start_frame, verdict_of

__all__ = ["ExponentBounds", "exponent_bounds"]

ITERATION_ROUNDING = 8  # rounding error of one iteration of a map, in units of n times that of one operation


class ProductError(NamedTuple):
    """Bounds for the distance of the exact product from the computed one."""

    growth: Array  # (k,) Σ ln R_jj
    bound: Array  # (k,) Σ of the bounds for |ln S_jj − ln R_jj|
    local: Array  # (k,) norm of each column's error since the last orthonormalisation
    tilt: Array  # (k, k) bound for |W|
    widest: Array  # largest entry of `tilt` so far
    largest: Array  # largest local error so far
    steps: Array


@dataclasses.dataclass(frozen=True)
class BoundsObserver:
    """The `states.ErrorObserver` that updates these bounds.

    The error of a column of length 1 after a step is its error estimate plus `local` (√n + its new length).
    """

    local: float

    def init(self, t, frame) -> ProductError:
        """All bounds are zero at the start."""
        del t
        k = frame.shape[1]
        none, zero = jnp.zeros(k, frame.dtype), jnp.zeros((), frame.dtype)
        return ProductError(none, none, none, jnp.zeros((k, k), frame.dtype), zero, zero, jnp.zeros((), jnp.int32))

    def stepped(self, state: ProductError, errors) -> ProductError:
        """Add the error estimates of a step."""
        local = state.local + jnp.sqrt(jnp.sum(errors[0] ** 2, axis=0))
        return state._replace(local=local, largest=jnp.maximum(state.largest, jnp.max(local)), steps=state.steps + 1)

    def update(self, state: ProductError, seen: Orthonormalisation) -> ProductError:
        """The bounds after an orthonormalisation; infinite from then on if a diagonal entry of S may be zero."""
        n, k = seen.before.shape
        r = jnp.abs(jnp.triu(seen.frame.T @ seen.before, 1)) + jnp.diag(jnp.where(seen.lost, 0.0, jnp.exp(seen.log_r)))
        off = state.local + self.local * (n**0.5 + jnp.sqrt(jnp.sum(seen.before**2, axis=0)))
        tilt, share = eliminated(r, jnp.broadcast_to(off[None, :], (k, k)), state.tilt)
        sound = jnp.all(share < 1)
        tilt = jnp.where(sound, tilt, 0.0)
        return state._replace(
            growth=state.growth + seen.log_r,
            bound=state.bound + jnp.where(sound, -jnp.log1p(-jnp.where(sound, share, 0.0)), jnp.inf),
            local=jnp.zeros_like(state.local),
            tilt=tilt,
            widest=jnp.where(sound, jnp.maximum(state.widest, jnp.max(tilt)), jnp.inf),
        )

    def moved(self, state: ProductError, source) -> ProductError:
        """A direction is lost: all bounds are infinite from then on."""
        return state._replace(growth=state.growth[source], bound=jnp.full_like(state.bound, jnp.inf))

    def next_block(self, state: ProductError) -> ProductError:
        """Unchanged: no sums of single blocks are kept."""
        return state


def eliminated(r, off, tilt):
    """One step of the recursion for the bounds.

    Args:
        r: (k, k) |R|.
        off: (k, k) bound for |E|.
        tilt: (k, k) bound for |W|, strictly lower triangular.

    Returns:
        The bound for |W⁺|; and for |S_jj − R_jj| / R_jj (k,), 1 or more where S_jj may be zero.
    """
    k = r.shape[0]
    places = jnp.arange(k)

    def column(j, state):
        left, lower, share = state
        pivot = r[j, j]
        beyond = left[j, j] - pivot
        share = jnp.where(places == j, jnp.where(pivot > 0, beyond / jnp.where(pivot > 0, pivot, 1.0), 1.0), share)
        safe = jnp.where(pivot > beyond, pivot - beyond, 1.0)
        factors = jnp.where(places > j, left[:, j] / safe, 0.0)
        return left + factors[:, None] * left[j][None, :], lower.at[:, j].set(factors), share

    start = (r + off) @ (jnp.eye(k, dtype=r.dtype) + tilt), jnp.zeros_like(r), jnp.zeros(k, r.dtype)
    _, lower, share = jax.lax.fori_loop(0, k, column, start)
    return lower, share


def _collect(t, carry: StepState):
    del t
    return carry.observer


class ExponentBounds(RunResult, eqx.Module):
    """Exponents of a run of finite length, descending, with a bound for the distance of each from its exact value.

    Attributes:
        exponents: (k,) per unit of time.
        bound: (k,) for the distance of each from the exact one of the same time and first frame; inf: none is known.
        tilt: bound for the tangents of the angles between computed and exact directions; it is of the size of the local
            error where directions are integrally separated.
        local_error: the largest estimate of a step, of columns of length 1; steps: how many there were, of a method.
        time: the length of the run.
        status: how the run ended, an `lh.STATUS`.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.exponent_bounds(henon, [0.1, 0.2], 1.4, t1=50)
        >>> found.exponents.shape, bool((found.bound < 1e-12).all())
        ((2,), True)
    """

    exponents: np.ndarray
    bound: np.ndarray
    tilt: float
    local_error: float
    steps: int
    time: float
    status_code: Array
    unit: str = eqx.field(static=True)

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The exponents against their index, with their bounds. `style` goes to what it draws."""
        return plots.bounds(self, ax, **style)

    def _table(self) -> Table:
        cells = ([f"{value:.10g}" for value in self.exponents], [f"{value:.2g}" for value in self.bound])
        what = f"{self.steps} steps of local error {self.local_error:.2g}, directions within {self.tilt:.2g}"
        rows = list(zip(numbered("λ", len(self.exponents)), *cells, strict=True))
        title = f"Exponents per {self.unit} over {with_unit(f'{self.time:g}', self.unit)}"
        return Table(title, rows, [what, f"status {self.status}"], ("", "exponent", "within"))

    def _data(self) -> Data:
        per = {"units": f"1/{self.unit}"}
        variables = {name: ("exponent", getattr(self, name), per) for name in ("exponents", "bound")}
        attributes = {name: getattr(self, name) for name in ("tilt", "local_error", "steps", "time")}
        return Data(variables, exponents_along(len(self.exponents)), attributes)


def exponent_bounds(
    system: Flow | Map,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    t0: Any = 0.0,
    transient: Any = 0.0,
    method: Method | None = None,
    local_error: float | None = None,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> ExponentBounds:
    """All exponents, with a bound for the error that local errors have caused.

    Assumptions: (a) the linear equation is that along the computed motion: for nonlinear systems what that motion's
    error does to the equation comes on top; (b) no step is off by more than its error estimate (and `local_error`), for
    each column of the frame; (c) what lies between the time that is computed and infinity is not part of the bound.
    Signs of errors are not known, so they are added up as if all were the same, and estimates are those of the lower
    order of a pair: the truth is usually a hundred times nearer, and more.

    Args:
        system: an `lh.Flow`, `lh.DAE` or `lh.Map`.
        x0: (n,) start.
        args: pytree of parameters.
        t1: length of the run (iterations for a map).
        t0: time at the start.
        transient: length of a run before, after which directions are ordered, and the bound is better.
        method: as for `lh.lyapunov_spectrum`, but for `lh.ContinuousQR`.
        local_error: e, what a step does to a column c of length 1 is Φ c within e (√n + |Φ c|), on top of the method's
            estimate, if there is one. None: e is rounding.
        max_steps: most attempts of a step.
        progress: True for a bar, or a function of the fraction done.
        throw: raise where the run failed.

    Returns:
        `ExponentBounds` with `.exponents` (k,), `.bound` (k,), `.tilt`, `.steps` and `.status`.

    Raises:
        ValueError: on arguments that do not fit; on systems that jump; on a fixed step without local_error.
        RunFailedError: where the run failed and `throw`.

    Source:
        V. H. Linh, V. Mehrmann & E. S. Van Vleck, Adv. Comput. Math. 35 (2011) 281, doi:10.1007/s10444-010-9156-1;
        L. Dieci & E. S. Van Vleck, Numer. Math. 101 (2005) 619, doi:10.1007/s00211-005-0644-z.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> linear = lh.Flow(lambda t, x, args: jnp.array([[1.0, 4.0], [0.0, -2.0]]) @ x)
        >>> method = lh.RungeKutta("dopri5", rtol=1e-6)
        >>> found = lh.exponent_bounds(linear, [0.0, 0.0], t1=100.0, transient=20.0, method=method)
        >>> bool(abs(found.exponents[0] - 1.0) < found.bound[0] < 1e-4)
        True
    """
    flag("throw", throw)
    require(isinstance(system, Flow | Map), f"exponent_bounds needs an lh.Flow, lh.DAE or lh.Map; got {system!r}.")
    require_one_start("exponent_bounds", x0)
    require_values("exponent_bounds", x0, args, t1, t0, transient, local_error, method)
    check_counts(system, t1=t1, transient=transient)
    n = np.shape(x0)[0]
    local = _local(system, n, method, local_error)
    k = degrees_of_freedom(system, n)
    found = follow(
        BoundsObserver(local), _collect, system, x0, args, k=k, t1=t1, t0=t0, transient=transient, times=None, blocks=2,
        mode=None, frame=start_frame(system, t0, x0, args, k), method=grown_columns("exponent_bounds", method),
        max_steps=max_steps, progress=progress, each_step=True,
    )  # fmt: skip
    return verdict_of(found, _result(found, unit_of(system)), throw)


def _local(system, n: int, method, local_error) -> float:
    """What there is beside error estimates: what the user gave, or rounding."""
    if local_error is not None:
        positive("local_error", local_error)
        return float(local_error)
    require(
        iterates(system) or method is None or method.adaptive,
        "A fixed step has no error estimate: take a method that controls its step, or give local_error.",
    )
    return ITERATION_ROUNDING * n * float(np.finfo(float).eps)


def _result(found, unit: str) -> ExponentBounds:
    reached = np.flatnonzero(np.isfinite(np.asarray(found.time)))
    state: ProductError = jax.tree.map(lambda leaf: np.asarray(leaf)[reached[-1:]], found.collected)
    if len(reached) == 0:
        nothing = np.full(state.growth.shape[1], np.nan)
        return ExponentBounds(nothing, nothing, np.nan, np.nan, 0, 0.0, jnp.asarray(found.status), unit)
    growth, bound, _, tilt, widest, largest, steps = (part[0] for part in state)
    # The QR factor of I + W: its leading minors are between 1 and the product of the lengths of the columns.
    ends = np.cumsum(0.5 * np.log1p(np.sum(tilt**2, axis=0)))
    time = float(np.asarray(found.time)[reached[-1]])
    order = np.argsort(-growth, kind="stable")
    exponents, off = np.asarray(growth)[order] / time, np.asarray(bound + ends)[order] / time
    return ExponentBounds(
        exponents, off, float(widest), float(largest), int(steps), time, jnp.asarray(found.status), unit
    )
