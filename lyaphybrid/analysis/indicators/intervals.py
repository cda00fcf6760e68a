"""Spectral intervals: the ranges of averages of growth, and the integral separation of directions.

Lyapunov exponents may be lim sup and lim inf that differ, and averages over windows that start late may differ from
those that start at 0: the intervals of Lyapunov and of Sacker and Sell (Bohl) contain all of them. Exponents depend
continuously on the system where neighbouring directions are integrally separated: their difference, averaged over
windows (Steklov), stays above 0.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array

from ... import _renamed as renamed
from ... import plots
from ..._arguments import Frame, Progress, Real, State, flag, positive, real, require, require_one_start
from ..._keywords import explains_keywords
from ..._text import Table, numbered, with_unit
from ...integrators.base import Method
from ...results.result import Data, RunResult, exponents_along, in_time
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import has_rows, iterates, unit_of
from ...systems.smooth import Flow, Map
from ..spectra import lyapunov_spectrum

__all__ = ["SpectralIntervals", "spectral_intervals"]

MOST_PIECES = 1e8  # into which a run may be cut: their growth is kept
STARTS_PER_WINDOW = 64  # extremes are off by about its inverse square of the change within a window


class SpectralIntervals(RunResult, eqx.Module):
    """Intervals of exponents, descending by the averages over the whole run.

    Attributes:
        lyapunov: (k, 2) least and greatest of the averages over [0, t], tau ≤ t ≤ t1; per unit of time.
        sacker_sell: (k, 2) of the averages over all windows.
        steklov: (k − 1,) least difference of neighbours, averaged over a window.
        time: (times,) where running averages end, t ≥ tau; running: (times, k) those averages.
        start: (windows,) where windows begin; windows: (windows, k) averages over them.
        window: their length.
        separated: whether all neighbours are integrally separated, as far as these windows show.
        status: how the run ended, an `lh.STATUS`.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.spectral_intervals(henon, [0.1, 0.2], 1.4, t1=200, window=20, tau=20)
        >>> found.sacker_sell.shape, found.running.shape, bool(found.separated)
        ((2, 2), (181, 2), True)
    """

    lyapunov: np.ndarray
    sacker_sell: np.ndarray
    steklov: np.ndarray
    time: np.ndarray
    running: np.ndarray
    start: np.ndarray
    windows: np.ndarray
    status_code: Array
    window: float = eqx.field(static=True)
    unit: str = eqx.field(static=True)

    @property
    def separated(self) -> bool:
        """Whether all neighbours are integrally separated, as far as these windows show."""
        return bool(np.all(np.asarray(self.steklov) > 0))

    @renamed.keywords(axes="ax")
    def plot(self, ax: Sequence[plots.Axes] | None = None, **style: Any) -> Sequence[plots.Axes]:
        """Running averages, and averages over windows, with their intervals, on two axes.

        `style` goes to what it draws.
        """
        return plots.intervals(self, ax, **style)

    def _table(self) -> Table:
        names = numbered("λ", len(self.lyapunov))
        rows = [
            (name, _interval(bounds), _interval(wider))
            for name, bounds, wider in zip(names, np.asarray(self.lyapunov), np.asarray(self.sacker_sell), strict=True)
        ]
        notes = [f"status {self.status}"]
        if len(self.steklov):
            least = ", ".join(f"{value:.5g}" for value in np.asarray(self.steklov))
            notes = [f"{'' if self.separated else 'not '}integrally separated: Steklov differences ≥ {least}", *notes]
        title = f"Spectral intervals per {self.unit}, windows of {with_unit(f'{self.window:g}', self.unit)}"
        return Table(title, rows, notes, ("", "Lyapunov", "Sacker–Sell"))

    def _data(self) -> Data:
        per = {"units": f"1/{self.unit}"}
        k = len(self.lyapunov)
        variables = {
            "lyapunov": (("exponent", "bound"), self.lyapunov, per),
            "sacker_sell": (("exponent", "bound"), self.sacker_sell, per),
            "steklov": ("pair", self.steklov, per),
            "running": (("sample", "exponent"), self.running, per),
            "windows": (("start", "exponent"), self.windows, per),
        }
        coordinates = {
            **exponents_along(k),
            "bound": ["least", "greatest"],
            "pair": [f"{i + 1},{i + 2}" for i in range(k - 1)],
            "time": ("sample", np.asarray(self.time), in_time(self.unit)),
            "start": ("start", np.asarray(self.start), in_time(self.unit)),
        }
        return Data(variables, coordinates, {"window": self.window, "separated": self.separated})


def _interval(bounds) -> str:
    return f"[{bounds[0]:.5g}, {bounds[1]:.5g}]"


@explains_keywords
def spectral_intervals(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    window: Real,
    tau: Real,
    t0: Any = 0.0,
    transient: Any = 0.0,
    mode: str | int | None = None,
    k: int | None = None,
    frame: Frame = None,
    method: Method | None = None,
    every: Any = None,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> SpectralIntervals:
    """Intervals of Lyapunov and of Sacker and Sell, and the integral separation of neighbouring directions.

    All are of a run of finite length: the true intervals are reached from inside, as t1 and the window grow.

    Args:
        system: an `lh.Flow`, `lh.Hamiltonian`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (n,) start; (N, d) where the state has a row for each body.
        args: pytree of parameters.
        t1: length of the run (iterations for a map).
        window: length of the windows over which growth is averaged, 0 < window ≤ t1.
        tau: running averages count from there on, 0 ≤ tau < t1.
        t0: as for `lh.lyapunov_spectrum`.
        transient: as for `lh.lyapunov_spectrum`.
        mode: as for `lh.lyapunov_spectrum`.
        k: as for `lh.lyapunov_spectrum`.
        frame: as for `lh.lyapunov_spectrum`.
        method: as for `lh.lyapunov_spectrum`.
        every: as for `lh.lyapunov_spectrum`.
        max_steps: as for `lh.lyapunov_spectrum`.
        progress: as for `lh.lyapunov_spectrum`.
        throw: as for `lh.lyapunov_spectrum`.

    Returns:
        A `SpectralIntervals` with `.lyapunov` (k, 2), `.sacker_sell` (k, 2), `.steklov` (k − 1,), `.separated`,
        `.status` and `.plot()`; bounds are -inf where a jump destroyed a direction.

    Raises:
        ValueError: on arguments that do not fit.
        RunFailedError: where the run failed and `throw`.

    Source:
        L. Dieci & E. S. Van Vleck, SIAM J. Numer. Anal. 40 (2002) 516, doi:10.1137/S0036142901392304, and J. Dyn.
        Differ. Equ. 19 (2007) 265, doi:10.1007/s10884-006-9030-5.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> swing = lh.Flow(lambda t, x, args: x * (jnp.cos(jnp.log(t + 1)) + jnp.array([0.0, -3.0])))
        >>> found = lh.spectral_intervals(swing, [0.0, 0.0], t1=2000.0, window=50.0, tau=100.0)
        >>> found.separated, round(float(found.steklov[0]), 6)
        (True, 3.0)
    """
    flag("throw", throw)
    require_one_start("spectral_intervals", x0, has_rows(system))
    positive("t1, a length,", t1)
    positive("window", window)
    real("tau", tau)
    pieces = STARTS_PER_WINDOW * float(t1) / float(window)
    require(pieces <= MOST_PIECES, f"window must be at least {STARTS_PER_WINDOW / MOST_PIECES:.2g} t1; got {window!r}.")
    length, window, tau = float(t1), float(window), float(tau)
    require(window <= length, f"window must be at most t1 = {length:g}; got {window:g}.")
    require(0 <= tau < length, f"tau must be in [0, t1) = [0, {length:g}); got {tau:g}.")
    step = max(1.0, round(window / STARTS_PER_WINDOW)) if iterates(system) else window / STARTS_PER_WINDOW
    s = lyapunov_spectrum(
        system, x0, args, t1=length, times=_ends(length, step), t0=t0, transient=transient, mode=mode, k=k, frame=frame,
        method=method, every=every, max_steps=max_steps, progress=progress, throw=throw,
    )  # fmt: skip
    ends, growth, losses = (np.asarray(a) for a in (s.history.time, s.history.growth, s.history.losses))
    reached, unit = np.isfinite(ends), unit_of(system)
    # A direction that was lost before counts as lost in all windows, or until another one grows in its place.
    before = np.isneginf(np.asarray(s.exponents)) & ~np.any(losses > 0, axis=0)
    grows = np.nan_to_num(growth) != 0
    until = np.where(np.any(grows, axis=0), np.arange(len(grows))[:, None] == np.argmax(grows, axis=0), True)
    losses = losses + (before & until)
    return _from_growth(
        ends[reached], growth[reached], losses[reached], round(window / step), step, tau, s.status_code, unit
    )


def _ends(length: float, step: float) -> np.ndarray:
    """All multiples of the step below the length, and the length itself."""
    inside = step * np.arange(1, int(np.ceil(length / step - 1e-9)))
    return np.append(inside, length)


def _from_growth(ends, growth, losses, across: int, step: float, tau: float, status, unit: str) -> SpectralIntervals:
    """The intervals from the growth (times, k) of the pieces; a window is `across` pieces."""
    start = np.concatenate([[0.0], ends])
    total, gone = (np.vstack([np.zeros(growth.shape[1]), np.cumsum(a, axis=0)]) for a in (growth, losses))
    late = ends >= tau
    running = np.where(gone[1:] > 0, -np.inf, total[1:])[late] / ends[late, None]
    # The last piece may be shorter: only windows of full length are used.
    count = max(0, len(start) - across - (len(ends) > 0 and ends[-1] - start[-2] < 0.999 * step))
    first, last = slice(0, count), slice(across, across + count)
    windows = (total[last] - total[first]) / (start[last] - start[first])[:, None]
    windows = np.where(gone[last] > gone[first], -np.inf, windows)
    with np.errstate(invalid="ignore"):
        differences = windows[:, :-1] - windows[:, 1:]
    return SpectralIntervals(
        _bounds(running), _bounds(windows), _least(differences), ends[late], running, start[first], windows,
        status, across * step, unit,
    )  # fmt: skip


def _bounds(values: np.ndarray) -> np.ndarray:
    """(k, 2) least and greatest of (times, k); nan where the run did not reach any."""
    if len(values) == 0:
        return np.full((values.shape[1], 2), np.nan)
    return np.stack([values.min(axis=0), values.max(axis=0)], axis=1)


def _least(differences: np.ndarray) -> np.ndarray:
    return _bounds(differences)[:, 0]
