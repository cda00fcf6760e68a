"""The Lyapunov spectrum of a run with its standard errors, its history and its status."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .. import plots
from .._jax.precision import share
from .._jax.tracing import module_of, traced
from .._text import UNIT, Table, in_full, numbered, with_error, with_unit
from ..statuses import STIFF_REMEDY, status_of, verdicts
from ..systems.labels import Labels
from ..systems.smooth import Map
from .errors import standard_error
from .result import Data, RunResult, exponents_along, states_along
from .resuming import Resumable

__all__ = ["NOTE_TEXTS", "About", "History", "Spectrum", "doubtful", "guard_unreached", "step_too_long", "unresolved"]

NOTE_TEXTS = {
    "rank_lost": "a jump destroys directions: their exponents are -inf",
    "grazing": "an event met its guard nearly tangentially: the saltation matrix is large, or known to few digits",
    "simultaneous": "several events were due at one instant, and their order matters: see lh.solutions",
    "interrupted": "Ctrl-C ended the run",
    "stiff": "steps were as short as an explicit method needs to stay stable, or to resolve a fast decay; an implicit "
    f"one takes long steps here: {STIFF_REMEDY}",
    "guard_unreached": "the system has guards, and the flow reached none of them",
    "beyond_guard": "the start is beyond a guard, on its fired side, where it does not fire, and the motion never came "
    "back: lh.check says which guard",
    "identity_reset": "a jump within a mode changes nothing: is its reset missing?",
    "step_too_long": "steps are too long to carry volumes as the flow does; take a shorter dt, or control='xY'",
    "unresolved": "the smallest exponents, or a loss, may be rounding: a column shrank so much that it may be lost or "
    "only short; orthonormalise more often (every=…); where that does not help, a direction shrank too much between "
    "two losses",
}

UNRESOLVED = 25.0  # ln(R_11/R_kk) per orthonormalisation beyond which R_kk counts as rounding: e^25 ε = 2e-5 of it


def unresolved(spread):
    """Whether an orthonormalisation came so late that the last columns were rounding."""
    return spread > UNRESOLVED * share(spread)


VOLUME_PER_STEP = 1e-3  # the step is too long if the error of its ln|det| is larger …
VOLUME_ROUNDING = 1e-6  # a sum of exponents this near to the mean divergence is right
SMALL_PER_STEP, OF_EXPONENTS = 1e-5, 1e-2  # … or larger than this and not small relative to the exponents


def step_too_long(spectrum: "Spectrum"):
    """Whether steps carry volumes wrongly: the sum of all exponents is not the mean divergence.

    The sum of exponents is a property of the numerical steps, the divergence one of the flow. If k < n, some steps from
    the final state are used (`volumes`), of a fixed step; steps that are not fixed are wrong if they follow the state
    alone (control="x") where perturbations shrink faster.
    """
    if spectrum.residual is None and (spectrum.step is None or spectrum.volume_error is None):
        return False
    xp, length = module_of(spectrum.time), spectrum._run_length
    if spectrum.step is None:
        large = xp.max(spectrum.residual) > OF_EXPONENTS * xp.sum(xp.abs(spectrum.exponents)) + VOLUME_ROUNDING
        return large & xp.all(xp.isfinite(spectrum.exponents)) & ~xp.any(unresolved(spectrum.spread))
    steps = xp.mean(spectrum.time) / spectrum.step / xp.where(length > 0, length, xp.nan)  # in a unit of the clock
    if spectrum.residual is None:
        per_step = spectrum.volume_error
        off = per_step * steps
    else:
        off = xp.max(spectrum.residual)
        per_step = off / xp.where(steps > 0, steps, xp.nan)
    large = off > OF_EXPONENTS * xp.sum(xp.abs(spectrum.exponents))
    found = (per_step > VOLUME_PER_STEP) | ((per_step > SMALL_PER_STEP) & large)
    return found & xp.all(xp.isfinite(spectrum.exponents))


def doubtful(spectrum: "Spectrum"):
    """Whether exponents may be wrong by more than their errors: as step_too_long, unresolved and beyond_guard say."""
    xp = module_of(spectrum.spread)
    return step_too_long(spectrum) | xp.any(unresolved(spectrum.spread)) | xp.any(spectrum.flags[..., -1])


def guard_unreached(spectrum: "Spectrum"):
    """Whether the system has guards, and none of them was reached."""
    xp = module_of(spectrum.min_transversality)
    return spectrum.has_guards & xp.all(xp.isinf(spectrum.min_transversality))


class History(eqx.Module):
    """The convergence of a spectrum by blocks, in the order of its exponents; nan where a block was not reached."""

    time: Array  # (blocks,) in units of the clock, measured from the end of the transient
    exponents: Array  # (blocks, k) running averages; -inf from the first loss on
    growth: Array  # (blocks, k) Σ ln R_ii of each block, without what was lost
    losses: Array | None = None  # (blocks, k) how often a column was lost in each block
    elapsed: Array | None = None  # (blocks,) time since the end of the transient, for every clock
    weights: Array | None = None  # (blocks,) of a unit of the clock in the mean: 1, but for Birkhoff averages


@functools.lru_cache(64)  # to write a method out takes as long as a short run
def _in_words(method: Any) -> str:
    return "" if method is None else " ".join(repr(method).split())


class About:
    """What was run, in words. All instances compare equal, so that they never cause a new compilation.

    Attributes:
        system: its class, and its modes where there are several; method: with its tolerances, "" where there is none.
        stiff: whether the run was seen to be stiff.
    """

    def __init__(self, system: str = "", method: str = "", stiff: bool = False):
        self.system, self.method, self.stiff = system, method, stiff

    def noting(self, stiff: bool) -> "About":
        """The same of a run that was, or was not, seen to be stiff."""
        return About(self.system, self.method, stiff)

    @classmethod
    def of(cls, system: Any, names: tuple[str, ...], method: Any) -> "About":
        """The description of a system with these modes, and of a method or None."""
        modes = f" with the modes {', '.join(names)}" if len(names) > 1 else ""
        try:
            words = _in_words(method)
        except TypeError:  # it holds arrays, which have no hash
            words = _in_words.__wrapped__(method)
        return cls(type(system).__name__ + modes, words)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, About)

    def __hash__(self) -> int:
        return hash(About)


class Spectrum(Resumable, RunResult, eqx.Module):
    """Lyapunov exponents with standard errors, and further results of a run.

    Attributes:
        exponents: (k,) per unit of the clock, descending; -inf where a jump destroyed the direction.
        stderr: (k,) one standard error; `error_kind` says how it is estimated: from "blocks" or "replicates".
        time, jumps: length of the run after the transient (of several runs, the mean).
        upper, lower: (k,) bounds of the running exponents over the second half.
        losses, loss_rate, first_loss: (k,) how often a column was lost (all runs), losses per unit of the clock, and
            the time of the first loss (nan: never). What the mode in which growth begins to count has no room for is
            lost then, too, but not among these.
        finite_exponents: (k,) mean growth without the instants of loss; equal to `exponents` where nothing was lost.
            A lost direction is replaced by one of length 1, the last of the columns: if losses are frequent this, and
            which column has how many of the losses, depends on the coordinates and on k. The -inf do not.
        min_transversality: smallest |sin| of the angle between flow and guard at an event; inf without events.
        history: time, exponents (running), growth (per block).
        x, t, mode, frame: the final state, from which a run can be continued.
        replicates: (m, k) exponents of each run, or None.
        error_kind: "blocks" or "replicates".
        accumulation_time: estimate of the time at which events accumulate; nan where they do not.
        flags: (4,) whether the run met grazing, simultaneous events, an interruption, and whether it was beyond a guard
            all along: what `notes` are made from.
        spread: (k,) how far apart the lengths of columns became between two orthonormalisations, as `notes` need it.
        residual: |Σ λ − (mean divergence + mean ln|det S|)|, whatever was lost; None where k < n,
            and of many components (16; 6 if event-driven).
        step: the step of a method with a fixed one; None.
        volume_error: how much volume such a step loses, where the divergence is not known; None.
        has_guards: whether there are transitions with guards that do not end the run.
        identity_reset: whether a transition within a mode changes nothing.
        about: what was run, in words: `about.system`, `about.method`.
        status: how the run ended, an `lh.STATUS`; of several runs the gravest.
        notes: names of further information; `print` explains them.
        clock: "time", "jumps" or "hybrid": what `exponents` are counted per.
        name: of the problem of the zoo, where it is one.

    Example:
        >>> import lyaphybrid as lh
        >>> found = lh.zoo.henon_map().spectrum(t1=20_000)
        >>> bool(abs(found.exponents[0] - 0.4192) < 5 * found.stderr[0])
        True
        >>> found.status.name, found.error_kind, found.history.growth.shape
        ('ok', 'blocks', (64, 2))
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
    step: Any = None  # step of the method, if fixed
    volume_error: Any = None  # volume error of a fixed step, see `volumes`; None if the sum rule is known
    has_guards: bool = eqx.field(static=True, default=False)  # of transitions that do not end the run
    identity_reset: bool = eqx.field(static=True, default=False)  # whether a transition within a mode changes nothing
    about: About = eqx.field(static=True, default=About())
    state_labels: Labels = eqx.field(static=True, default=Labels())
    name: str = eqx.field(static=True, default="")

    @property
    def notes(self) -> frozenset[str]:
        """Names of observations that come with every status, for example "grazing"."""
        grazing, simultaneous, interrupted, beyond = np.any(np.atleast_2d(self.flags), axis=0)
        found = {
            "rank_lost": bool(np.any(np.isneginf(np.asarray(self.exponents)))),
            "grazing": bool(grazing),
            "simultaneous": bool(simultaneous),
            "interrupted": bool(interrupted),
            "beyond_guard": bool(beyond),
            "guard_unreached": bool(guard_unreached(self)),
            "identity_reset": self.identity_reset,
            "stiff": self.about.stiff,
            "step_too_long": bool(step_too_long(self)),
            "unresolved": bool(np.any(unresolved(np.asarray(self.spread)))),
        }
        return frozenset(name for name, seen in found.items() if seen)

    @property
    def _run_length(self) -> Array:
        """The length of the run in units of its clock; of several runs the mean."""
        xp = module_of(self.time)
        time, jumps = xp.mean(self.time), xp.mean(self.jumps)
        return {"time": time, "jumps": jumps, "hybrid": xp.maximum(time, jumps)}[self.clock]

    @property
    def loss_rate(self) -> Array:
        """(k,) losses per unit of the clock, of all runs together."""
        runs = 1 if self.replicates is None else self.replicates.shape[0]
        return self.losses.astype(self.time.dtype) / (runs * self._run_length)

    @property
    def sum_rule_residual(self) -> Array | None:
        """|Σ λ - (mean divergence + mean ln|det S|)|; None as `residual`, or where something was lost."""
        if self.residual is None:
            return None
        if not traced(self.exponents) and np.any(np.isneginf(np.asarray(self.exponents))):
            return None
        return self.residual

    def kaplan_yorke_dimension(self) -> Array:
        """J + Σ_{i≤j} λ_i / |λ_{j+1}| with the largest j whose sum is not negative (Kaplan & Yorke 1979).

        nan where the largest exponent is.
        """
        xp = module_of(self.exponents)
        sums = xp.cumsum(xp.where(xp.isfinite(self.exponents), self.exponents, -xp.inf))
        j = xp.sum(xp.cumprod(sums >= 0))
        k = self.exponents.shape[0]
        last = xp.where(j > 0, sums[xp.maximum(j - 1, 0)], 0.0)
        following = xp.abs(self.exponents[xp.minimum(j, k - 1)])
        fraction = last / xp.where((j > 0) & (j < k), following, 1.0)
        dimension = xp.where(j >= k, float(k), j.astype(fraction.dtype) + fraction)
        return xp.where(xp.isnan(self.exponents[0]), xp.nan, dimension)

    def kaplan_yorke_stderr(self) -> float:
        """One standard error of it, to first order in the errors of the exponents, which are correlated.

        It is that of Σ g_i λ_i, g the gradient of the dimension: from the same blocks, or runs, as those of the
        exponents. nan where there is none: where no sum is negative the dimension is the number of exponents.
        """
        values = np.asarray(self.exponents)
        sums = np.cumsum(np.where(np.isfinite(values), values, -np.inf))
        j = int(np.sum(np.cumprod(sums >= 0)))
        if not 0 < j < len(values) or not np.isfinite(values[j]):
            return np.nan
        factors = np.zeros(len(values))
        factors[:j], factors[j] = 1 / abs(values[j]), sums[j - 1] / values[j] ** 2
        return self._stderr_of(factors)

    def ks_entropy(self) -> Array:
        """The sum of the positive exponents (Pesin: the Kolmogorov–Sinai entropy of an SRB measure)."""
        xp = module_of(self.exponents)
        return xp.sum(xp.where(self.exponents > 0, self.exponents, 0.0))

    def ks_entropy_stderr(self) -> float:
        """One standard error of it; the errors of the exponents are correlated."""
        return self._stderr_of(np.asarray(self.exponents) > 0)

    def _stderr_of(self, factors) -> float:
        """Of Σ f_i λ_i, f (k,), from the blocks or the runs; f is 0 where an exponent is not finite."""
        factors = np.asarray(factors, float)
        if self.replicates is not None:
            values = _combined(np.asarray(self.replicates), factors)
            return float(np.std(values, ddof=1) / len(values) ** 0.5) if len(values) > 1 else np.nan
        ends = np.asarray(self.history.time)
        reached = np.isfinite(ends)
        if np.sum(reached) < 2:
            return np.nan
        weights = 1.0 if self.history.weights is None else np.asarray(self.history.weights)[reached]
        lengths = weights * np.diff(ends, prepend=0.0)[reached]
        growth = weights * _combined(self.history.growth, factors)[reached]
        whole = np.sum(lengths)
        return float(standard_error(np, growth, lengths, np.sum(growth) / whole, len(lengths), whole))

    def resume(self, t1: Any, *, max_steps: int | None = None, progress: Any = None, throw: bool = True) -> "Spectrum":
        """Go on with the run from its end, to the length t1, with the same settings.

        The blocks that are added are as long as those before. The result is that of one run to t1, up to rounding.

        Args:
            t1: the whole length, beyond what the run has reached, in units of the clock.
            max_steps: most attempts of a step in what is added; None: no limit.
            progress: True for a bar, or a function of the fraction of what is added.
            throw: raise where the run failed.

        Returns:
            A `Spectrum` of the whole run.

        Raises:
            ValueError: on a t1 that is not beyond the end; where the run did not reach its end; where this is not the
                object that `lh.lyapunov_spectrum` has returned (a copy of it, or one that came out of jit or a file).
            RunFailedError: where the run failed and `throw`.

        Example:
            >>> import lyaphybrid as lh
            >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
            >>> short = lh.lyapunov_spectrum(logistic, [0.3], 4.0, t1=1000)
            >>> longer = short.resume(4000)
            >>> float(longer.time), bool(longer.stderr[0] < short.stderr[0])
            (4000.0, True)
        """
        go_on = self._goes_on("lh.lyapunov_spectrum", "A run that is to outlive its process takes checkpoint=….")
        return go_on(self, t1, max_steps, progress, throw)._with_problem_name(self.name)

    def _with_problem_name(self, name: str) -> "Spectrum":
        """The same with the name of a problem."""
        return self if not name else dataclasses.replace(self, name=name)._resumed_by(self._go_on)  # pyright: ignore

    @property
    def unit(self) -> str:
        """What exponents are counted by, in words: of a map its iterations, else what the clock says."""
        if self.about.system == Map.__name__:
            return "iteration"
        return (self.state_labels.time_unit if self.clock == "time" else "") or UNIT[self.clock]

    def per_jump(self) -> Array:
        """(k,) exponents per jump instead of per unit of the clock."""
        return self.exponents * self._run_length / jnp.mean(self.jumps)

    @property
    def plot(self) -> plots.SpectrumPlots:
        """Figures: ``plot()`` of the exponents against their index, ``plot.convergence()`` of their history."""
        return plots.SpectrumPlots(self)

    def _data(self) -> Data:
        per = {"units": f"1/{self.unit}"}
        d = self.x.shape[-1]
        runs, bodies = (("run",) if self.replicates is not None else ()), (("body",) if self.state_labels.rows else ())
        variables: dict[str, Any] = {
            name: ("exponent", getattr(self, name), per)
            for name in ("exponents", "stderr", "finite_exponents", "upper", "lower")
        }
        variables |= {name: ("exponent", getattr(self, name)) for name in ("losses", "first_loss")}
        history = self.history
        variables |= {
            "history": (("block", "exponent"), history.exponents, per),
            "growth": (("block", "exponent"), history.growth),
            "replicates": None if self.replicates is None else (("run", "exponent"), self.replicates, per),
            "x": ((*runs, *bodies, "state"), self.x),
        }
        coordinates = {**exponents_along(len(self.exponents)), **states_along(self.state_labels, d)}
        coordinates["time"] = ("block", np.asarray(history.time), {"units": self.unit})
        attributes = {
            "notes": self.notes,
            "error_kind": self.error_kind,
            "clock": self.clock,
            "time": float(np.mean(self.time)),
            "jumps": float(np.mean(self.jumps)),
            "name": self.name or None,
        }
        return Data(variables, coordinates, attributes)

    def _table(self) -> Table:
        """A spectrum as a physicist writes it: value(error in the last digits)."""
        return jax.tree.map(np.asarray, self)._table_of_host()  # eager operations of JAX are compiled one by one

    def _table_of_host(self) -> Table:
        runs = "" if self.replicates is None else f", {self.replicates.shape[0]} runs"
        time, jumps = in_full(float(np.mean(self.time))), float(np.mean(self.jumps))
        in_unit = with_unit(time, self.state_labels.time_unit)  # with every clock
        length = f"{time} iterations" if self.unit == "iteration" else f"t = {in_unit}, {jumps:.0f} jumps"
        of = f"{self.name}: " if self.name else ""
        title = f"{of}Lyapunov spectrum per {self.unit} ({length}{runs}; errors from {self.error_kind})"
        values, errors = np.asarray(self.exponents), np.asarray(self.stderr)
        cells = [numbered("λ", len(values)), list(map(with_error, values, errors))]
        heads, losses = (), np.asarray(self.losses)
        if np.any(losses > 0):
            heads = ("", "exponent", "losses", "rate", "finite part")
            lost = [losses, self.loss_rate, self.finite_exponents]
            shown = ("{:.0f}", "{:.4g}", "{:.6g}")
            cells += [
                [how.format(value) if losses[i] > 0 else "" for i, value in enumerate(np.asarray(column))]
                for how, column in zip(shown, lost, strict=True)
            ]
        notes = [f"{name}: {NOTE_TEXTS[name]}" for name in sorted(self.notes)]
        return Table(title, list(zip(*cells, strict=True)), [*self._sums(), f"status {_verdict(self)}", *notes], heads)

    def _sums(self) -> list[str]:
        """What follows from the exponents: their sum, entropy and dimension."""
        finite = bool(np.all(np.isfinite(self.exponents)))
        total = float(np.sum(self.exponents))
        lines = [f"sum {with_error(total, self._stderr_of(np.ones(len(self.exponents))) if finite else np.nan)}"]
        if self.sum_rule_residual is not None:
            lines[0] += f", sum rule to {float(np.max(self.sum_rule_residual)):.1e}"
        dimension, error = float(self.kaplan_yorke_dimension()), self.kaplan_yorke_stderr()
        known = with_error(dimension, error) if error > LEAST_ERROR else f"{dimension:.4f}"
        at_least = dimension == len(self.exponents) < self.frame.shape[-2]
        first, doubt = float(np.mean(self.exponents[0])), float(np.mean(self.stderr[0]))
        if dimension == 0 and abs(first) <= ZERO_WITHIN * doubt:
            known = f"{known}; it is 1 if λ1 is 0, as it may be within its error"
        return [*lines, f"Kaplan–Yorke dimension {'at least ' if at_least else ''}{known}"]


ZERO_WITHIN = 2.0  # standard errors within which λ₁ may be 0
LEAST_ERROR = 1e-12  # of a dimension: what is smaller is rounding


def _combined(values, factors: np.ndarray) -> np.ndarray:
    """Σ f_i v_i over the last axis, of those columns whose factor is not 0: others may be infinite."""
    used = factors != 0
    return np.asarray(values)[..., used] @ factors[used]


def _verdict(s: Spectrum) -> str:
    """The status, and how many of several runs ended with which status."""
    different = len(np.unique(s.status_code)) > 1
    return f"{status_of(s.status_code)}" + (f" (of the runs: {verdicts(s.status_code)})" if different else "")
