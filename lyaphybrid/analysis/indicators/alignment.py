"""GALI and SALI: the volume that unit deviation vectors span, however small it becomes.

The vectors are W = Q C, Q the orthonormal frame of the loop and C upper triangular: an orthonormalisation
Φ Q = Q' R changes C to C' = R C. The volume of the first k unit vectors is Π C_ii / Π ‖C_i‖, a product of positive
numbers, without subtractions: its logarithm has full relative accuracy even at −10 000.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ... import plots
from ..._arguments import Frame, Progress, Real, State, flag, integers, require, shape
from ..._jax.tracing import as_jax, numpy_for, traced
from ..._keywords import explains_keywords
from ..._text import UNIT, Table
from ...engine.blocks import check_counts
from ...engine.preparation import grown_columns
from ...engine.states import Orthonormalisation, StepState
from ...integrators.base import Method
from ...results.result import Data, RunResult
from ...systems.daes.semi_linear import degrees_of_freedom
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import has_rows, unit_of
from ...systems.smooth import Flow, Map
from .following import follow, samples_of, table_of, times_of, verdict_of
from .verdicts import ATTRACTED, Verdict, grows, of_alignment, of_volumes

__all__ = ["GALIResult", "gali", "sali"]


class Deviations(NamedTuple):
    """The deviation vectors as coefficients in the frame."""

    columns: Array  # (k, k) C, each column of length 1
    logs: Array  # (k,) ln(C_ii / ‖C_i‖); -inf where the direction is lost
    growth: Array  # () ln of how much the first one has grown


@dataclasses.dataclass(frozen=True)
class AlignmentObserver:
    """The `states.Observer` that updates C."""

    def init(self, t, frame) -> Deviations:
        """The deviation vectors are the columns of the frame."""
        del t
        k = frame.shape[1]
        return Deviations(jnp.eye(k, dtype=frame.dtype), jnp.zeros(k, frame.dtype), jnp.zeros((), frame.dtype))

    def update(self, state: Deviations, seen: Orthonormalisation) -> Deviations:
        """C ← R C, its columns made unit vectors again."""
        r = jnp.triu(seen.frame.T @ seen.before)
        columns = r @ state.columns
        square = jnp.sum(columns**2, axis=0)
        length = jnp.sqrt(jnp.where(square > 0, square, 1.0))
        logs = state.logs + jnp.where(seen.lost, -jnp.inf, seen.log_r - jnp.log(length))
        return Deviations(columns / length[None, :], logs, state.growth + jnp.log(length[0]))

    def moved(self, state: Deviations, source) -> Deviations:
        """Reorder the rows of C like the columns of the frame; the deviation vectors stay the same."""
        return state._replace(columns=state.columns[source])

    def next_block(self, state: Deviations) -> Deviations:
        """Unchanged: no sums of single blocks are kept."""
        return state


def _collect(t, carry: StepState):
    del t
    return carry.observer.logs, carry.observer.growth


class GALIResult(RunResult, eqx.Module):
    """GALI_k, or SALI, against time.

    Attributes:
        time: (times,) since the start; nan where not reached.
        orders: the k of each column; () for SALI.
        log_values: (times, orders) natural logarithms; (times,) for SALI; with a leading axis m for m runs. -inf
            where a jump destroyed a direction.
        values: the same without the logarithm.
        status: how the run ended, an `lh.STATUS`.
        unit: of time, "unit of time" or what the system gives, or "iteration".
        log_growth: (times,) natural logarithm of how much the first deviation vector has grown; None: not known.
        verdict: whether the motion is regular or chaotic.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.gali(henon, [0.1, 0.2], 1.4, t1=100, blocks=16)
        >>> found.orders, found.log_values.shape, found.verdict.kind
        ((2,), (16, 1), 'chaotic')
    """

    time: Array
    log_values: Array
    status_code: Array
    orders: tuple[int, ...] = eqx.field(static=True)
    unit: str = eqx.field(static=True, default=UNIT["time"])
    log_growth: Array | None = None

    @property
    def values(self) -> Array:
        """exp(log_values); 0 below 5e-324."""
        return jnp.exp(self.log_values)

    @property
    def verdict(self) -> Verdict:
        """Whether the motion is regular or chaotic, of one run, from GALI_2 or SALI.

        Where the two largest exponents are equal, two deviation vectors never align, and SALI sees nothing. GALI_3 then
        falls exponentially, as it does on a torus that attracts: "undecided", and `lh.fli` tells which. So it is where
        deviation vectors align although none grows: what attracts aligns them, whether it is chaotic or not.
        """
        require(
            not traced(self.log_values) and self.time.ndim == 1,
            "verdict is of one run, outside of jit: start from one x0.",
        )
        time, logs = np.asarray(self.time), np.asarray(self.log_values)
        found = of_volumes(time, logs, self.orders) if self.orders else of_alignment(time, logs)
        if found.kind != "chaotic" or self.log_growth is None:
            return found
        aligned = logs[:, self.orders.index(2)] if self.orders else logs
        return found if grows(time, np.asarray(self.log_growth), aligned) else ATTRACTED

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The values against time, both logarithmic. `style` goes to what it draws."""
        return plots.alignment(self, ax, **style)

    def _table(self) -> Table:
        names = [f"GALI{k}" for k in self.orders] or ["SALI"]
        return table_of(self, names, np.reshape(self.log_values, (*self.time.shape, len(names))), "ln ")

    def _data(self) -> Data:
        by_order = ("order",) if self.orders else ()
        variables = {"log_values": ((*samples_of(self), *by_order), self.log_values)}
        if self.log_growth is not None:
            variables["log_growth"] = (samples_of(self), self.log_growth)
        return Data(variables, {**times_of(self), **({"order": list(self.orders)} if self.orders else {})})


@explains_keywords
def gali(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    orders: Sequence[int] | None = None,
    times: Any = "log",
    t0: Any = 0.0,
    transient: Any = 0.0,
    mode: str | int | None = None,
    frame: Frame = None,
    method: Method | None = None,
    every: Any = None,
    blocks: int = 64,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> GALIResult:
    """The generalised alignment indices GALI_k: the volume of k unit deviation vectors.

    Chaos: GALI_k ∝ exp(−t Σ_{j≤k} (λ₁ − λ_j)). So it is on any attractor with different exponents, chaotic or not: the
    verdict looks at the growth of a deviation vector, too. Regular motion on an s-dimensional torus of a Hamiltonian
    system with N degrees of freedom: constant for k ≤ s, t^{−(k−s)} for s < k ≤ 2N − s, t^{−2(k−N)} beyond.

    Args:
        system: an `lh.Flow`, `lh.Hamiltonian`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: start, shape (n,); or (m, n) for m runs at once.
        args: pytree of parameters.
        t1: length of the run (iterations for a map).
        orders: the k that are wanted, 2 ≤ k ≤ n; None: 2 … min(n, 4).
        times: where they are recorded: "log", an increasing array that ends at t1, or None for equal intervals.
        t0: time at the start.
        transient: length of the run before the deviation vectors count.
        mode: mode at the start, where there are several.
        frame: (n, max k) deviation vectors; None: fixed orthonormal vectors in generic directions.
        method: as for `lh.lyapunov_spectrum`, except `lh.ContinuousQR`.
        every: interval of orthonormalisations, as for `lh.lyapunov_spectrum`; None: chosen from the growth.
        blocks: number of times, where `times` is "log" or None.
        max_steps: most attempts of a step.
        progress: True for a bar, or a function of the fraction done.
        throw: raise where the run failed.

    Returns:
        A `GALIResult` with `.time`, `.orders`, `.values` (times, orders), `.log_values`, `.status` and `.verdict`.

    Raises:
        ValueError: on arguments that do not fit.
        RunFailedError: where the run failed and `throw`.

    Source:
        Ch. Skokos, T. Bountis & Ch. Antonopoulos, Physica D 231 (2007) 30, doi:10.1016/j.physd.2007.04.004.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> cat = lh.Map(lambda n, x, args: jnp.stack([2 * x[0] + x[1], x[0] + x[1]]) % 1.0)
        >>> g = lh.gali(cat, [0.1, 0.2], t1=1000)
        >>> round(float(g.log_values[-1, 0]) / 1000, 2)  # −2 ln((3 + √5)/2), far below what a float can hold
        -1.92
    """
    flag("throw", throw)
    check_counts(system, t1=t1, transient=transient)
    axes = 2 if has_rows(system) else 1
    n = degrees_of_freedom(system, math.prod((shape("x0", x0) or (1,))[-axes:]))
    orders = tuple(range(2, min(n, 4) + 1)) if orders is None else integers("orders", orders, 2, n)
    require(
        len(orders) > 0, f"orders must be numbers k with 2 ≤ k ≤ n, of a state x0 of n = {n} components; got {orders}."
    )
    found = follow(
        AlignmentObserver(), _collect, system, x0, args, k=max(orders), t1=t1, t0=t0, transient=transient, times=times,
        blocks=blocks, mode=mode, frame=frame, method=grown_columns("gali", method), every=every, max_steps=max_steps,
        progress=progress,
    )  # fmt: skip
    xp = numpy_for(found.time, found.collected, found.status)
    time, status = xp.asarray(found.time), xp.asarray(found.status)
    logs, growth = found.collected
    volumes = xp.cumsum(xp.asarray(logs), axis=-1)[..., np.asarray(orders) - 1]
    volumes = xp.where(xp.isnan(time)[..., None], xp.nan, volumes)
    growth = xp.where(xp.isnan(time), xp.nan, xp.asarray(growth))
    result = GALIResult(time, volumes, status, orders, unit_of(system), growth)
    return verdict_of(found, as_jax(result), throw)


@explains_keywords
def sali(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    times: Any = "log",
    t0: Any = 0.0,
    transient: Any = 0.0,
    mode: str | int | None = None,
    frame: Frame = None,
    method: Method | None = None,
    every: Any = None,
    blocks: int = 64,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> GALIResult:
    """The smaller alignment index, min(‖w₁ + w₂‖, ‖w₁ − w₂‖) of two unit deviation vectors.

    With GALI_2 = sin θ it is √(2(1 − |cos θ|)): between GALI_2 and √2 GALI_2.

    Args:
        system: as for `gali`.
        x0: start, shape (n,), n ≥ 2; or (m, n).
        args: pytree of parameters.
        t1: length of the run (iterations for a map).
        times: as for `lh.gali`.
        t0: as for `lh.gali`.
        transient: as for `lh.gali`.
        mode: as for `lh.gali`.
        frame: (n, 2) the deviation vectors; None: orthonormal ones of no special direction.
        method: as for `lh.gali`.
        every: as for `lh.gali`.
        blocks: as for `lh.gali`.
        max_steps: as for `lh.gali`.
        progress: as for `lh.gali`.
        throw: as for `lh.gali`.

    Returns:
        A `GALIResult` with `.time`, `.values` (times,), `.log_values`, `.status` and `.verdict`.

    Raises:
        ValueError: on arguments that do not fit.
        RunFailedError: where the run failed and `throw`.

    Source:
        Ch. Skokos, J. Phys. A 34 (2001) 10029, doi:10.1088/0305-4470/34/47/309.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> cat = lh.Map(lambda n, x, args: jnp.stack([2 * x[0] + x[1], x[0] + x[1]]) % 1.0)
        >>> lh.sali(cat, [0.1, 0.2], t1=100).verdict.kind
        'chaotic'
    """
    flag("throw", throw)
    found = gali(
        system, x0, args, t1=t1, orders=(2,), times=times, t0=t0, transient=transient, mode=mode, frame=frame,
        method=method, every=every, blocks=blocks, max_steps=max_steps, progress=progress, throw=throw,
    )  # fmt: skip
    xp = numpy_for(found.log_values)
    log_sine = xp.asarray(found.log_values)[..., 0]
    square = xp.exp(2 * xp.minimum(log_sine, 0.0))
    cosine = xp.sqrt(xp.maximum(1 - square, 0.0))
    values = as_jax(log_sine + 0.5 * xp.log(2 / (1 + cosine)))
    return GALIResult(found.time, values, found.status_code, (), found.unit, found.log_growth)
