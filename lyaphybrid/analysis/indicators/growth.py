"""FLI, OFLI and MEGNO: the growth of one deviation vector, read at every step."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ... import plots
from ..._arguments import Frame, Progress, Real, State, flag, require
from ..._jax.precision import nonzero
from ..._jax.tracing import traced
from ..._keywords import explains_keywords
from ..._text import UNIT, Table
from ...engine.blocks import check_counts
from ...engine.preparation import grown_columns
from ...engine.states import Orthonormalisation, StepState
from ...integrators.base import Method
from ...results.result import Data, RunResult
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import iterates, unit_of
from ...systems.smooth import Flow, Map
from .following import follow, samples_of, table_of, times_of, verdict_of
from .verdicts import Verdict, of_fli, of_megno

__all__ = ["IndicatorResult", "fli", "megno", "ofli"]


class LogLength(NamedTuple):
    """ln ‖w‖ and its averages."""

    t0: Array
    t: Array
    log: Array  # ln ‖w(t)‖
    area: Array  # ∫ ln ‖w‖ dt
    value: Array  # Y(t)
    value_area: Array  # ∫ Y dt
    highest: Array  # the largest ln ‖w‖ so far
    highest_across: Array  # the largest ln of the norm of its part across the flow


@dataclasses.dataclass(frozen=True)
class LengthObserver:
    """The `states.Observer` of the length of the first column."""

    across: bool = False  # also follow the part across the flow

    def init(self, t, frame) -> LogLength:
        """The vector has length 1."""
        zero = jnp.zeros((), frame.dtype)
        return LogLength(t, t, zero, zero, zero, zero, zero, zero - jnp.inf if self.across else zero)

    def update(self, state: LogLength, seen: Orthonormalisation) -> LogLength:
        """Y = (2/t) ∫ s d(ln ‖w‖) = 2 (ln ‖w(t)‖ − (1/t) ∫ ln ‖w‖ ds), integrals by the trapezoidal rule."""
        log = state.log + jnp.where(seen.lost[0], -jnp.inf, seen.log_r[0])
        dt, elapsed = seen.t - state.t, seen.t - state.t0
        area = state.area + 0.5 * dt * (state.log + log)
        value = jnp.where(elapsed > 0, 2 * (log - area / jnp.where(elapsed > 0, elapsed, 1.0)), 0.0)
        value_area = state.value_area + 0.5 * dt * (state.value + value)
        across = state.highest_across
        if self.across:
            across = jnp.maximum(across, log + _log_across(seen.frame[:, 0], seen.velocity()))
        return LogLength(state.t0, seen.t, log, area, value, value_area, jnp.maximum(state.highest, log), across)

    def moved(self, state: LogLength, source) -> LogLength:
        """Unchanged: there is only one column."""
        del source
        return state

    def next_block(self, state: LogLength) -> LogLength:
        """Unchanged: no sums of single blocks are kept."""
        return state


def _log_across(w, f):
    """Ln of the length of the part of a unit vector w that is orthogonal to f."""
    square = jnp.sum(f**2)
    rest = w - f * (jnp.sum(w * f) / jnp.where(square > 0, square, 1.0))
    left = jnp.sum(rest**2)
    return 0.5 * jnp.log(jnp.maximum(left, nonzero(1e-300, left)))


def _collect(t, carry: StepState):
    del t
    return carry.observer


class IndicatorResult(RunResult, eqx.Module):
    """An indicator against time.

    Attributes:
        time: (times,) since the start; nan where not reached.
        values: (times,); with a leading axis m for m runs.
        mean: (times,) of MEGNO, its mean over [0, t]; None for the others.
        name: "MEGNO", "FLI", "OFLI" or "OFLI2".
        status: how the run ended, an `lh.STATUS`.
        unit: of time, "unit of time" or what the system gives, or "iteration".
        verdict: whether the motion is regular or chaotic.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.megno(henon, [0.1, 0.2], 1.4, t1=100, blocks=16)
        >>> found.name, found.mean.shape, found.verdict.kind
        ('MEGNO', (16,), 'chaotic')
    """

    time: Array
    values: Array
    mean: Array | None
    status_code: Array
    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default=UNIT["time"])

    @property
    def verdict(self) -> Verdict:
        """Whether the motion is regular or chaotic, of one run."""
        require(
            not traced(self.values) and self.time.ndim == 1, "verdict is of one run, outside of jit: start from one x0."
        )
        time = np.asarray(self.time)
        return of_fli(time, np.asarray(self.values)) if self.mean is None else of_megno(time, np.asarray(self.mean))

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The values against time. `style` goes to what it draws."""
        return plots.growth(self, ax, **style)

    def _table(self) -> Table:
        columns = [self.values] if self.mean is None else [self.values, self.mean]
        return table_of(self, [self.name, f"mean {self.name}"][: len(columns)], np.stack(columns, axis=-1))

    def _data(self) -> Data:
        mean = None if self.mean is None else (samples_of(self), self.mean)
        return Data({"values": (samples_of(self), self.values), "mean": mean}, times_of(self), {"name": self.name})


@explains_keywords
def megno(
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
    blocks: int = 64,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> IndicatorResult:
    """The mean exponential growth factor of nearby orbits, Y = (2/t) ∫ s d(ln ‖w‖).

    It tends to 2 for quasiperiodic motion, to 0 where ‖w‖ stays bounded, and grows like λ₁ t in chaos; its mean over
    time like λ₁ t / 2. The integral is a sum over the steps of the method, or the flights of an event-driven system, by
    the trapezoidal rule; of a map Y = (2/n) Σ_j (j − ½) ln(‖w_j‖/‖w_{j−1}‖).

    Args:
        system: an `lh.Flow`, `lh.Hamiltonian`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: start, shape (n,); or (m, n) for m runs at once.
        args: pytree of parameters.
        t1: length of the run (iterations for a map).
        times: when it is recorded, as for `lh.gali`: "log", an increasing array that ends at t1, or None.
        t0: time at the start.
        transient: length of the run before the deviation vector counts.
        mode: mode at the start, where there are several.
        frame: (n, 1) the deviation vector; None: one of no special direction, always the same.
        method: as for `lh.lyapunov_spectrum`, except `lh.ContinuousQR`.
        blocks: number of times, where `times` is "log" or None.
        max_steps: most attempts of a step.
        progress: True for a bar, or a function of the fraction done.
        throw: raise where the run failed.

    Returns:
        An `IndicatorResult` with `.time`, `.values` (times,), `.mean` (times,), `.status` and `.verdict`.

    Raises:
        ValueError: on arguments that do not fit.
        RunFailedError: where the run failed and `throw`.

    Source:
        P. M. Cincotta & C. Simó, Astron. Astrophys. Suppl. 147 (2000) 205, doi:10.1051/aas:2000108.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> pendulum = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))
        >>> found = lh.megno(pendulum, [0.5, 0.0], t1=20_000.0, method=lh.Symplectic("ABA864", dt=0.2))
        >>> found.verdict.kind, round(float(found.mean[-1]), 1)
        ('regular', 2.0)
    """
    flag("throw", throw)
    return _grown(
        "MEGNO", False, system, x0, args, throw, t1=t1, times=times, t0=t0, transient=transient, mode=mode,
        frame=frame, method=method, blocks=blocks, max_steps=max_steps, progress=progress,
    )  # fmt: skip


@explains_keywords
def fli(
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
    blocks: int = 64,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> IndicatorResult:
    """The fast Lyapunov indicator, sup ln ‖w(s)‖ over s ≤ t.

    It grows like ln t for regular motion, and like λ₁ t in chaos.

    Args:
        system: an `lh.Flow`, `lh.Hamiltonian`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: start, shape (n,); or (m, n) for m runs at once.
        args: pytree of parameters.
        t1: length of the run (iterations for a map).
        times: as for `lh.megno`.
        t0: as for `lh.megno`.
        transient: as for `lh.megno`.
        mode: as for `lh.megno`.
        frame: as for `lh.megno`.
        method: as for `lh.megno`.
        blocks: as for `lh.megno`.
        max_steps: as for `lh.megno`.
        progress: as for `lh.megno`.
        throw: as for `lh.megno`.

    Returns:
        An `IndicatorResult` with `.time`, `.values` (times,), `.status` and `.verdict`.

    Raises:
        ValueError: on arguments that do not fit.
        RunFailedError: where the run failed and `throw`.

    Source:
        C. Froeschlé, E. Lega & R. Gonczi, Celest. Mech. Dyn. Astron. 67 (1997) 41, doi:10.1023/A:1008276418601.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> cat = lh.Map(lambda n, x, args: jnp.stack([2 * x[0] + x[1], x[0] + x[1]]) % 1.0)
        >>> lh.fli(cat, [0.1, 0.2], t1=1000).verdict.kind
        'chaotic'
    """
    flag("throw", throw)
    return _grown(
        "FLI", False, system, x0, args, throw, t1=t1, times=times, t0=t0, transient=transient, mode=mode,
        frame=frame, method=method, blocks=blocks, max_steps=max_steps, progress=progress,
    )  # fmt: skip


@explains_keywords
def ofli(
    system: Flow | Hybrid,
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
    blocks: int = 64,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> IndicatorResult:
    """The orthogonal fast Lyapunov indicator: the FLI of the part of w orthogonal to the flow.

    It stays bounded on periodic orbits, grows like ln t on tori and like λ₁ t in chaos.

    Args:
        system: an `lh.Flow`, `lh.Hamiltonian` or `lh.Hybrid`: there must be a flow.
        x0: start, shape (n,); or (m, n) for m runs at once.
        args: pytree of parameters.
        t1: length of the run.
        times: as for `lh.megno`.
        t0: as for `lh.megno`.
        transient: as for `lh.megno`.
        mode: as for `lh.megno`.
        frame: as for `lh.megno`.
        method: as for `lh.megno`.
        blocks: as for `lh.megno`.
        max_steps: as for `lh.megno`.
        progress: as for `lh.megno`.
        throw: as for `lh.megno`.

    Returns:
        An `IndicatorResult` with `.time`, `.values` (times,), `.status` and `.verdict`.

    Raises:
        ValueError: on arguments that do not fit; on a system without a field.
        RunFailedError: where the run failed and `throw`.

    Source:
        M. Fouchard, E. Lega, Ch. Froeschlé & Cl. Froeschlé, Celest. Mech. Dyn. Astron. 83 (2002) 205,
        doi:10.1023/A:1020199201070.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> pendulum = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))
        >>> lh.ofli(pendulum, [0.5, 0.0], t1=2000.0, method=lh.Symplectic("ABA864", dt=0.2)).verdict.kind
        'regular'
    """
    flag("throw", throw)
    flows = isinstance(system, Flow) or (isinstance(system, Hybrid) and not iterates(system))
    require(flows, f"ofli looks across the flow: it needs an lh.Flow or an lh.Hybrid with fields; got {system!r}.")
    return _grown(
        "OFLI", True, system, x0, args, throw, t1=t1, times=times, t0=t0, transient=transient, mode=mode,
        frame=frame, method=method, blocks=blocks, max_steps=max_steps, progress=progress,
    )  # fmt: skip


def _grown(name: str, across: bool, system, x0, args, throw: bool, **how: Any) -> IndicatorResult:
    grown_columns(name.lower(), how["method"])
    check_counts(system, t1=how["t1"], transient=how["transient"])
    found = follow(LengthObserver(across), _collect, system, x0, args, k=1, each_step=True, **how)
    state, time = found.collected, jnp.asarray(found.time)
    values = {"MEGNO": state.value, "FLI": state.highest, "OFLI": state.highest_across}[name]
    values = jnp.where(jnp.isnan(time), jnp.nan, values)
    mean = jnp.where(jnp.isnan(values), jnp.nan, state.value_area) / time if name == "MEGNO" else None
    result = IndicatorResult(time, values, mean, jnp.asarray(found.status), name, unit_of(system))
    return verdict_of(found, result, throw)
