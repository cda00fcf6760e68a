"""The SVD method: exponents from the singular values of the fundamental matrix, directions from its singular vectors.

Frames are propagated as for any spectrum, Φ Q_0 = Q P with P = R_N … R_1. P itself overflows; its rows divided by
their diagonal entries e^(s_i) do not:

    P = diag(e^s) B,   B ← B + (r_ij e^(s_j − s_i) / r_ii)_{i<j} B,   s ← s + ln r_ii

The first columns of the frame grow fastest, so e^(s_j − s_i) decays for i < j and B converges. The singular values
of Φ on the span of Q_0 then follow to full relative accuracy, however far apart they are (`graded`).
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ... import plots
from ..._arguments import Progress, Real, State, Times, flag, require_one_start, require_values, whole
from ..._linalg.frames import LOST, orthonormalise
from ..._text import Table, numbered
from ...engine.blocks import check_counts
from ...engine.preparation import grown_columns
from ...engine.states import Orthonormalisation, StepState
from ...integrators.base import Method
from ...results.result import Data, RunResult, exponents_along, in_time
from ...systems.daes.semi_linear import degrees_of_freedom
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import has_rows, unit_of
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from .following import follow, start_frame, verdict_of
from .graded import log_singular_values

__all__ = ["SVDSpectrum", "svd_spectrum"]


class GradedProduct(NamedTuple):
    """The fundamental matrix on the span of the first frame."""

    start: Array  # (n, k) Q_0
    rows: Array  # (k, k) B; zeros where a direction is lost
    logs: Array  # (k,) s; -inf where lost


@dataclasses.dataclass(frozen=True)
class ProductObserver:
    """The `states.Observer` that updates P."""

    def init(self, t, frame) -> GradedProduct:
        """Orthonormalise the first frame, frame = Q_0 R; then P = R⁻¹ at the start, where R has an inverse.

        In a mode of fewer dimensions the projection onto its tangent space may have made columns dependent.
        """
        del t
        unit = jnp.eye(frame.shape[1], dtype=frame.dtype)
        start, logs, lost = orthonormalise(frame, relative=LOST)
        r = jnp.where(lost[None, :], unit, jnp.triu(start.T @ frame))
        inverse = jnp.where(lost[:, None], 0.0, jax.scipy.linalg.solve_triangular(r, unit))
        return GradedProduct(start, inverse * jnp.exp(logs)[:, None], jnp.where(lost, -jnp.inf, -logs))

    def update(self, state: GradedProduct, seen: Orthonormalisation) -> GradedProduct:
        """P ← R P, by rows."""
        r, (start, rows, logs) = jnp.triu(seen.frame.T @ seen.before, 1), state
        gone = seen.lost | jnp.isneginf(logs)
        scale = jnp.where(gone, 0.0, logs + seen.log_r)  # a direction that is lost now still adds to the rows above it
        ratio = logs[None, :] - scale[:, None]
        rows = jnp.where(gone[:, None], 0.0, rows + jnp.where(r == 0, 0.0, r * jnp.exp(ratio)) @ rows)
        return GradedProduct(start, rows, jnp.where(gone, -jnp.inf, logs + seen.log_r))

    def moved(self, state: GradedProduct, source) -> GradedProduct:
        """Reorder the rows like the columns of the frame: columns that are not lost come first."""
        return GradedProduct(state.start, state.rows[source], state.logs[source])

    def next_block(self, state: GradedProduct) -> GradedProduct:
        """Unchanged: no sums of single blocks are kept."""
        return state


def _collect(t, carry: StepState):
    del t
    return carry.observer


class SVDSpectrum(RunResult, eqx.Module):
    """Exponents from singular values, descending.

    Attributes:
        time: (times,) since the end of the transient.
        log_values: (times, k) ln σ_i of the fundamental matrix from there; -inf where a direction was destroyed.
        directions: (times, n, k) its right singular vectors, the perturbations at the start that grow by σ_i; at late
            times eigenvectors of Λ = lim (ΦᵀΦ)^(1/2t), the Lyapunov directions. Up to their signs; zero where σ_i = 0.
        exponents: (k,) per unit of time, or iteration; `running`: (times, k).
        error: (k,) how far they may be from their limits; `turned`: (k,) by which angle directions turned at last.
        status: how the run ended, an `lh.STATUS`.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.svd_spectrum(henon, [0.1, 0.2], 1.4, t1=200, blocks=16)
        >>> found.directions.shape, round(float(sum(found.exponents)), 6), round(float(jnp.log(0.3)), 6)
        ((16, 2, 2), -1.203973, -1.203973)
    """

    time: np.ndarray
    log_values: np.ndarray
    directions: np.ndarray
    status_code: Array
    unit: str = eqx.field(static=True)
    state_labels: Labels = eqx.field(static=True, default=Labels())

    @property
    def running(self) -> np.ndarray:
        """(times, k) ln σ_i / t."""
        return self.log_values / self.time[:, None]

    @property
    def exponents(self) -> np.ndarray:
        """(k,) ln σ_i / t at the last time; nan where the run reached none."""
        return self.running[-1] if len(self.time) else np.full(self.log_values.shape[1], np.nan)

    @property
    def error(self) -> np.ndarray:
        """(k,) estimated distance of the exponents from their limits.

        The largest difference from (ln σ_i(T) − ln σ_i(t)) / (T − t), T/4 ≤ t ≤ 3T/4. Where ln σ_i = λ_i t + c_i it is
        the error |c_i| / T itself; where growth varies it is of the size of the statistical error.
        """
        if not len(self.time):
            return self.exponents
        inside = (self.time >= 0.25 * self.time[-1]) & (self.time <= 0.75 * self.time[-1])
        with np.errstate(invalid="ignore"):
            later = (self.log_values[-1] - self.log_values[inside]) / (self.time[-1] - self.time[inside])[:, None]
            distance = np.abs(self.exponents - later)
        distance = np.where(np.isneginf(self.exponents), 0.0, distance)
        return np.max(distance, axis=0) if len(later) else np.full(len(self.exponents), np.nan)

    @property
    def turned(self) -> np.ndarray:
        """(k,) angles in [0, π/2] between the directions at the end and at half of the time.

        Directions converge exponentially, at rates given by the gaps between exponents: the error at the end is much
        smaller than this angle.
        """
        if not len(self.time):
            return self.exponents
        half = np.searchsorted(self.time, 0.5 * self.time[-1], side="right") - 1
        before, now = self.directions[max(half, 0)], self.directions[-1]
        along = np.sum(before * now, axis=0)
        return np.arctan2(np.linalg.norm(now - along * before, axis=0), np.abs(along))

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The running exponents against time. `style` goes to what it draws."""
        return plots.running(self.time, self.running, self.exponents, self.error, self.unit, ax, **style)

    def _table(self) -> Table:
        columns = (self.exponents, self.error, self.turned)
        how = ("{:.6g}", "{:.2g}", "{:.2g}")
        cells = [[how.format(value) for value in column] for how, column in zip(how, columns, strict=True)]
        rows = list(zip(numbered("λ", len(self.exponents)), *cells, strict=True))
        heads = ("", "exponent", "within", "direction turned by")
        return Table(f"Exponents by the SVD method, per {self.unit}", rows, [f"status {self.status}"], heads)

    def _data(self) -> Data:
        n, k = self.directions.shape[1:]
        per = {"units": f"1/{self.unit}"}
        variables = {
            "exponents": ("exponent", self.exponents, per),
            "error": ("exponent", self.error, per),
            "turned": ("exponent", self.turned, {"units": "rad"}),
            "log_values": (("sample", "exponent"), self.log_values),
            "directions": (("sample", "state", "exponent"), self.directions),
        }
        names = {"state": [self.state_labels.name(i) for i in range(n)]}
        time = ("sample", np.asarray(self.time), in_time(self.unit))
        return Data(variables, {"time": time, **exponents_along(k), **names})


def svd_spectrum(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    k: int | None = None,
    t0: Any = 0.0,
    transient: Any = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    blocks: int = 64,
    times: Times = None,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> SVDSpectrum:
    """Lyapunov exponents by the SVD method, λ_i = lim ln σ_i(Φ(t)) / t, and the Lyapunov directions.

    Singular values do not depend on the first frame, unlike the results of QR methods at finite times: ln σ_1 is the
    growth of the perturbation that has grown most. Both methods have the same limits where the equations are regular.

    Args:
        system: an `lh.Flow`, `lh.DAE`, `lh.Hamiltonian`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (n,) start; (N, d) where the state has a row for each body, with n = N d.
        args: pytree of parameters.
        t1: length of the run (iterations for a map).
        k: number of exponents; None: all. With fewer than all, Φ is restricted to k directions: those after the
            transient or, without a transient, generic ones.
        t0: time at the start.
        transient: length of a run before; Φ begins at its end.
        mode: mode at the start, where there are several.
        method: as for `lh.lyapunov_spectrum`, except `lh.ContinuousQR`, which gives no factors R.
        blocks: number of equal intervals of time, at whose ends singular values are computed.
        times: an array or "log" in place of these.
        max_steps: most attempts of a step.
        progress: True for a bar, or a function of the fraction done.
        throw: raise where the run failed.

    Returns:
        An `SVDSpectrum` with `.exponents` (k,), `.error` (k,), `.directions` (times, n, k), `.turned` (k,),
        `.time`, `.log_values` (times, k) and `.status`.

    Raises:
        ValueError: on arguments that do not fit; under jit, where values are not known.
        RunFailedError: where the run failed and `throw`.

    Source:
        L. Dieci & C. Elia, J. Differ. Equ. 230 (2006) 502; V. H. Linh & V. Mehrmann,
        SIAM J. Numer. Anal. 49 (2011) 1810, doi:10.1137/100806059.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> shear = lh.Map(lambda n, x, args: jnp.array([[2.0, 100.0], [0.0, 0.5]]) @ x)
        >>> found = lh.svd_spectrum(shear, [0.0, 0.0], t1=1000)
        >>> [round(float(value), 3) for value in found.exponents]
        [0.697, -0.697]
        >>> [round(float(value), 3) for value in found.exponents - found.error * jnp.array([1, -1])]
        [0.693, -0.693]
    """
    flag("throw", throw)
    require_one_start("svd_spectrum", x0, has_rows(system))
    require_values("svd_spectrum", x0, args, t1, t0, transient)
    check_counts(system, t1=t1, transient=transient)
    n = np.size(x0)
    number = degrees_of_freedom(system, n) if k is None else k
    whole("k", number, least=1)
    found = follow(
        ProductObserver(), _collect, system, x0, args, k=number, t1=t1, t0=t0, transient=transient, times=times,
        blocks=blocks, mode=mode, frame=start_frame(system, t0, x0, args, number),
        method=grown_columns("svd_spectrum", method), max_steps=max_steps, progress=progress,
    )  # fmt: skip
    reached = np.isfinite(found.time)
    start, rows, logs = (np.asarray(part)[reached] for part in found.collected)
    logs, vectors = log_singular_values(rows, logs)
    unit = unit_of(system)
    status, labels = jnp.asarray(found.status), labels_of(system, np.shape(x0))
    result = SVDSpectrum(np.asarray(found.time)[reached], logs, start @ vectors, status, unit, labels)
    return verdict_of(found, result, throw)
