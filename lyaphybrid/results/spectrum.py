"""Results: the Lyapunov spectrum with its error bars, its history and the verdict on the run."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .. import plots
from .._jax.precision import share
from .._jax.tracing import traced
from .._text import UNIT, with_error
from ..statuses import STATUS, status_of, verdicts

__all__ = ["History", "Spectrum", "guard_unreached", "step_too_long", "unresolved"]

UNRESOLVED = 25.0  # ln(R_11/R_kk) per orthonormalisation beyond which R_kk is rounding (facts: e^25 of 1/ε)


def unresolved(spread):
    """Whether an orthonormalisation was so late that the last columns were rounding."""
    return spread > UNRESOLVED * share(spread)


VOLUME_PER_STEP = 1e-3  # of ln|det| of a step: an error that is larger says that the step is far too long …
SMALL_PER_STEP, OF_EXPONENTS = 1e-5, 1e-2  # … a smaller one too, if it is not small beside the exponents


def step_too_long(spectrum: "Spectrum"):
    """Whether a fixed step carries volumes wrongly: the sum of all exponents is not the mean divergence.

    The sum belongs to the numerical steps, the divergence to the flow. False where the step is not fixed. Where k < n
    some steps at the end of the run are asked (`volumes`).
    """
    if spectrum.step is None or (spectrum.residual is None and spectrum.volume_error is None):
        return False
    time = jnp.mean(spectrum.time)
    steps = time / spectrum.step / jnp.where(spectrum._length > 0, spectrum._length, jnp.nan)  # in a unit of the clock
    if spectrum.residual is None:
        per_step = spectrum.volume_error
        off = per_step * steps
    else:
        off = jnp.max(spectrum.residual)
        per_step = off / jnp.where(steps > 0, steps, jnp.nan)
    large = off > OF_EXPONENTS * jnp.sum(jnp.abs(spectrum.exponents))
    found = (per_step > VOLUME_PER_STEP) | ((per_step > SMALL_PER_STEP) & large)
    return found & jnp.all(jnp.isfinite(spectrum.exponents))


def guard_unreached(spectrum: "Spectrum"):
    """Whether the system has guards, and none of them was reached."""
    return spectrum.has_guards & jnp.all(jnp.isinf(spectrum.min_transversality))


class History(eqx.Module):
    """How a spectrum converged, block by block, in the order of its exponents; nan where a block was not reached."""

    time: Array  # (blocks,) in units of the clock, counted from the end of the transient
    exponents: Array  # (blocks, k) running
    growth: Array  # (blocks, k) Σ ln R_ii of each block
    losses: Array | None = None  # (blocks, k) how often a column was lost in each block
    elapsed: Array | None = None  # (blocks,) time, whatever the clock, since the end of the transient


class Spectrum(eqx.Module):
    """Lyapunov exponents, their errors, and what else a run has to say.

    Attributes:
        exponents: (k,) per unit of the clock, descending; -inf where a jump destroyed the direction.
        stderr: (k,) one standard error; `error_kind` says from what: "blocks" or "replicates".
        time, jumps: length of the run after the transient (of several runs, the mean).
        upper, lower: (k,) bounds of the running exponents over the second half.
        losses, loss_rate, first_loss: (k,) how often a column was lost (all runs), per time, and first (nan: never).
        finite_exponents: (k,) the growth without the moments of loss; equal to `exponents` where nothing was lost.
            A lost direction starts anew with length 1: where losses are frequent this depends on the coordinates.
        min_transversality: least |sin| of the angle between flow and guard at an event; inf without events.
        history: time, exponents (running), growth (per block).
        x, t, mode, frame: the state at the end: a run goes on from there.
        replicates: (m, k) exponents of each run, or None.
    """

    exponents: Array
    stderr: Array
    finite_exponents: Array
    time: Array
    jumps: Array
    upper: Array
    lower: Array
    losses: Array
    first_loss: Array
    history: History
    x: Array
    t: Array
    mode: Array
    frame: Array
    replicates: Array | None
    min_transversality: Array
    accumulation_time: Array
    status_code: Array
    flags: Array  # (3,) grazing, simultaneous, interrupted
    spread: Array
    residual: Array | None
    error_kind: str = eqx.field(static=True)
    clock: str = eqx.field(static=True)
    mode_names: tuple[str, ...] = eqx.field(static=True)
    step: Any = None  # of the method, where it is fixed
    volume_error: Any = None  # of such a step, see `volumes`; None where the sum rule says more
    has_guards: bool = eqx.field(static=True, default=False)  # … that jump, and do not end the run
    identity_reset: bool = eqx.field(static=True, default=False)  # of a jump within a mode

    @property
    def status(self) -> STATUS | Array:
        """The verdict; of several runs the gravest. Under a transformation the bare code."""
        return status_of(self.status_code)

    @property
    def notes(self) -> frozenset[str]:
        """Information that comes with any verdict."""
        grazing, simultaneous, interrupted = np.any(np.atleast_2d(self.flags), axis=0)
        found = {
            "rank_lost": bool(np.any(np.isneginf(np.asarray(self.exponents)))),
            "grazing": bool(grazing),
            "simultaneous": bool(simultaneous),
            "interrupted": bool(interrupted),
            "guard_unreached": bool(guard_unreached(self)),
            "identity_reset": self.identity_reset,
            "step_too_long": bool(step_too_long(self)),
            "unresolved": bool(np.any(unresolved(np.asarray(self.spread)))),
        }
        return frozenset(name for name, seen in found.items() if seen)

    @property
    def _length(self) -> Array:
        """The length of the run by its own clock, the mean of several."""
        time, jumps = jnp.mean(self.time), jnp.mean(self.jumps)
        return {"time": time, "jumps": jumps, "hybrid": jnp.maximum(time, jumps)}[self.clock]

    @property
    def loss_rate(self) -> Array:
        """(k,) losses per unit of the clock, of all runs together."""
        runs = 1 if self.replicates is None else self.replicates.shape[0]
        return self.losses.astype(self.time.dtype) / (runs * self._length)

    @property
    def sum_rule_residual(self) -> Array | None:
        """|Σ λ - (mean divergence + mean ln|det S|)|; None where k < n or something was lost."""
        if self.residual is None:
            return None
        if not traced(self.exponents) and np.any(np.isneginf(np.asarray(self.exponents))):
            return None
        return self.residual

    def kaplan_yorke_dimension(self) -> Array:
        """J + Σ_{i≤j} λ_i / |λ_{j+1}| with the largest j whose sum is not negative (Kaplan & Yorke 1979)."""
        sums = jnp.cumsum(jnp.where(jnp.isfinite(self.exponents), self.exponents, -jnp.inf))
        j = jnp.sum(jnp.cumprod(sums >= 0))
        k = self.exponents.shape[0]
        last = jnp.where(j > 0, sums[jnp.maximum(j - 1, 0)], 0.0)
        following = jnp.abs(self.exponents[jnp.minimum(j, k - 1)])
        fraction = jnp.where(j > 0, last / following, 0.0)
        return jnp.where(j >= k, float(k), j.astype(fraction.dtype) + fraction)

    def ks_entropy(self) -> Array:
        """The sum of the positive exponents (Pesin: the Kolmogorov–Sinai entropy of an SRB measure)."""
        return jnp.sum(jnp.where(self.exponents > 0, self.exponents, 0.0))

    def per_jump(self) -> Array:
        """(k,) exponents per jump instead of per unit of the clock."""
        return self.exponents * self._length / jnp.mean(self.jumps)

    def plot(self, ax=None, kind: str = "spectrum"):
        """The spectrum against its index, or (kind="convergence") its history in time."""
        kinds = {"spectrum": plots.spectrum, "convergence": plots.convergence}
        if kind not in kinds:
            raise ValueError(f"kind must be one of {tuple(kinds)}; got {kind!r}.")
        return kinds[kind](self, ax)

    def to_xarray(self):
        """The spectrum as an `xarray.Dataset` (extra "sweep")."""
        try:
            import xarray
        except ImportError as error:
            raise ImportError("Spectrum.to_xarray needs xarray: pip install 'lyaphybrid[sweep]'.") from error
        index = np.arange(1, self.exponents.shape[0] + 1)
        variables: dict[str, Any] = {
            name: ("exponent", np.asarray(getattr(self, name)))
            for name in ("exponents", "stderr", "finite_exponents", "upper", "lower", "losses", "first_loss")
        }
        variables["history"] = (("block", "exponent"), np.asarray(self.history.exponents))
        coordinates = {"exponent": index, "time": ("block", np.asarray(self.history.time))}
        attributes = {
            "status": str(self.status),
            "notes": sorted(self.notes),
            "error_kind": self.error_kind,
            "clock": self.clock,
            "time": float(jnp.mean(self.time)),
            "jumps": float(jnp.mean(self.jumps)),
        }
        return xarray.Dataset(variables, coordinates, attributes)

    def __str__(self) -> str:
        if traced(self):
            return "Spectrum(under a transformation)"
        return _table(self)

    __repr__ = __str__


def _table(s: Spectrum) -> str:
    """A spectrum as a physicist writes it: value(error in the last digits)."""
    runs = "" if s.replicates is None else f", {s.replicates.shape[0]} runs"
    length = f"t = {float(jnp.mean(s.time)):.6g}, {float(jnp.mean(s.jumps)):.6g} jumps{runs}"
    lines = [f"Lyapunov spectrum per {UNIT[s.clock]} ({length}; errors from {s.error_kind})"]
    values, errors, losses = (np.asarray(a) for a in (s.exponents, s.stderr, s.losses))
    for i, (value, error) in enumerate(zip(values, errors, strict=True)):
        line = f"  λ{i + 1:<3d} {with_error(value, error):>18s}"
        if losses[i] > 0:
            rate, finite = np.asarray(s.loss_rate)[i], np.asarray(s.finite_exponents)[i]
            line += f"   lost {losses[i]:.0f} times, {rate:.4g} per unit; finite part {finite:.6g}"
        lines.append(line)
    total = f"  sum {float(jnp.sum(s.exponents)):.6g}"
    if s.sum_rule_residual is not None:
        total += f", sum rule to {float(jnp.max(s.sum_rule_residual)):.1e}"
    lines.append(f"{total}; Kaplan–Yorke dimension {float(s.kaplan_yorke_dimension()):.4f}")
    lines.append(f"  status {_verdict(s)}" + (f"; notes: {', '.join(sorted(s.notes))}" if s.notes else ""))
    return "\n".join(lines)


def _verdict(s: Spectrum) -> str:
    """What ended the run, or how many of several ended how."""
    different = len(np.unique(s.status_code)) > 1
    return f"{status_of(s.status_code)}" + (f" (of the runs: {verdicts(s.status_code)})" if different else "")
