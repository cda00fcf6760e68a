"""`lyapunov_spectrum`: exponents of maps, flows and hybrid systems, with standard errors."""

import dataclasses
import functools
import os
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .. import _renamed as renamed
from .._arguments import (
    Frame,
    Key,
    Progress,
    Real,
    State,
    Times,
    attempts,
    flag,
    is_key,
    is_one_of,
    numbers,
    positive,
    random_key,
    require,
    whole,
)
from .._jax.engines import compiled
from .._jax.hashes import hash_of_arrays, hash_of_function
from .._jax.tracing import array, traced
from .._keywords import explains_keywords
from .._linalg import frames
from .._version import __version__
from ..engine import preparation, problems
from ..engine.blocks import check_counts, ends_of_blocks, is_zero, qr_schedule_for, targets_for
from ..engine.host import checkpoints, driver
from ..engine.host.places import Place, account
from ..errors import RunFailedError
from ..integrators.base import Method
from ..results import averages
from ..results.spectrum import About, Spectrum
from ..statuses import STATUS, nan_if_failed
from ..systems.consistency import onto_constraints, tangent_frame
from ..systems.daes.semi_linear import DAE, degrees_of_freedom
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import iterates
from ..systems.labels import Labels, labels_of
from ..systems.smooth import Flow, Map

__all__ = ["initial_frame", "lyapunov_spectrum", "starts"]

CLOCKS = ("time", "jumps", "hybrid")
ENDLESS = "clock='jumps' would never end: an lh.Flow has no jumps. Leave clock='time'."
NOT_KEPT = "checkpoint=… is for runs on the host, not under jit, vmap or grad: there leave it out."
AVERAGES = ("uniform", "birkhoff", "birkhoff-regular")
SUM_RULE_UP_TO = 16  # dimension n; 6 for event-driven systems, whose jumps need a determinant, n³ operations each
SUM_RULE_EXACT = 6
MOST_LENGTHS, MOST_AT_A_TIME = 1e6, 64  # how many times t1 a run with target_stderr goes on, in all and at a time
DECIDES_FROM_VALUES = (
    "target_stderr=… decides from values whether to go on: it cannot be used under jit, vmap or grad, or in a sweep."
)
OUT_OF_REACH = (
    "target_stderr={:.3g} is out of reach: after {} t1 the error is still so large that, as it falls like 1/√t, {:.1e} "
    "t1 would be needed; at most 1e6 are run. Take a longer t1, or a larger target_stderr."
)


@explains_keywords
@renamed.keywords(until="target_stderr")
def lyapunov_spectrum(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    t0: Real = 0.0,
    transient: Real = 0.0,
    mode: str | int | None = None,
    k: int | None = None,
    frame: Frame = None,
    method: Method | None = None,
    every: Any = None,
    orthonormalise: str = "auto",
    clock: str = "time",
    blocks: int = 64,
    times: Times = None,
    averaging: str = "uniform",
    count_start: bool = False,
    replicates: int | None = None,
    target_stderr: float | None = None,
    max_steps: int | None = None,
    key: Key = None,
    progress: Progress = None,
    throw: bool = True,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
) -> Spectrum:
    """The k leading Lyapunov exponents of a system that flows, jumps, or both.

    λ_i = lim (1/t) Σ ln R_ii, R from the orthonormalisations of k tangent vectors; at events
    the saltation matrix acts on the vectors.

    Args:
        system: an `lh.Flow`, `lh.DAE`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: start, shape (n,); or (m, n) for m runs at once.
        args: pytree of parameters handed to the user's functions.
        t1: length of the run after the transient, in units of the clock (iterations for a map).
        t0: time at the start.
        transient: length of the run before growth is counted; the frame evolves too.
        mode: name or index of the mode at the start; needed where there are several.
        k: number of exponents; None: n, or n_differential of an `lh.DAE`.
        frame: (n, k) initial columns; None: unit vectors, in the paired order where the system is canonical; fewer than
            n columns have generic directions instead, for unit vectors may never leave a subspace, as of the driven
            part of two. A direction that is destroyed, in the transient too, is replaced by a generic one, which need
            not stay in such a part: see `lh.transverse_spectrum`. Of an `lh.DAE` they are projected onto the tangent
            space of the constraints; None: column i changes component i of E₁ x alone.
        method: None: adaptive `lh.RungeKutta`, for an `lh.DAE` `lh.HalfExplicit`; maps and event-driven systems
            have none.
        every: interval of orthonormalisations in iterations (maps), steps (fixed dt), units of time (adaptive) or jumps
            (event-driven); ("time", length): for event-driven systems at fixed times between the events, and after each
            event that may destroy a direction; None: chosen from the growth, so that no exponent is lost
            to rounding.
        orthonormalise: "auto", "mgs" (modified Gram–Schmidt), "lapack", "cholesky".
        clock: "time", "jumps", or "hybrid": max(t, j). By "jumps" and "hybrid" an `lh.Hybrid` also goes on where jumps
            accumulate, as far as double precision can tell them apart, and where a cascade does not end: exponents are
            then those of the product of the jumps, and ∂ₜ of resets plays no part. By "jumps" it ends as no_more_jumps
            where the flow does not reach a guard again: at rest, escaping, or a million steps without a guard.
        blocks: number of equal blocks in which the run is recorded; they give the history and the error, which knows of
            correlations as long as a twentieth of the run.
        times: ends of the blocks instead, increasing, or "log".
        averaging: "uniform"; "birkhoff", smooth weights over the blocks; "birkhoff-regular", the same on the local
            exponent less 1/t, for conservative regular motion.
        count_start: count ln R of the initial frame too.
        replicates: run m times from x0 perturbed by a relative 1e-6 with `key`; the error is sd/√m.
        target_stderr: go on, by multiples of t1, until every finite exponent's standard error is below this. Errors
            fall like 1/√t at best: where that would take more than a million times t1 the run ends as stalled.
        max_steps: most attempts of a step; None: no limit (Ctrl-C returns what is computed), but a run of many tiny
            steps that lead nowhere ends as stalled. Where there is a schedule,
            and in fixed steps, the run ends with the interval between orthonormalisations in which they are spent.
        key: a `jax.random.key` for `replicates`.
        progress: True for a bar, or a function of the fraction done.
        throw: raise where the run failed; False returns the result with its status. Under a transformation, as in a
            sweep, the exponents and errors are nan instead.
        checkpoint: path of a file to which the state of the run is written every few seconds, after Ctrl-C and at the
        end.
        resume: go on from that file, if it is there: the result is bit by bit that of a run that never stopped. A run
            that is finished goes on to a longer t1: this is another run, for steps end where it ended.

    Returns:
        A `Spectrum`. Its `status` is ok, terminated, interrupted, max_steps, zeno, deadlock, nonfinite, stalled,
        step_underflow or no_more_jumps, of a DAE also inconsistent_start, singular_dae or constraint_drift; its `notes`
        may hold rank_lost (an exponent is -inf), grazing, simultaneous, unresolved (the smallest exponents, or a loss,
        may be rounding), step_too_long (the sum of exponents shows it), guard_unreached (there are guards, and none
        was met), beyond_guard (the motion began beyond one, and never came back), identity_reset (a jump within a mode
        that changes nothing), stiff (an explicit method was kept at the limit of its stability, or had to resolve a
        fast decay), interrupted.

    Raises:
        ValueError: on arguments that do not fit, before any computing; where `checkpoint` is the file of another run.
        RunFailedError: where the run failed and `throw`; it carries the result so far.
        OSError: where `checkpoint` cannot be written from the start. Later that is a warning, and the run goes on.

    Source:
        G. Benettin, L. Galgani, A. Giorgilli & J.-M. Strelcyn, Meccanica 15 (1980) 9 and 21,
        doi:10.1007/BF02128236; J. Dinius, Computing Lyapunov Exponents of Hybrid Dynamical Systems (2011).

    Example:
        >>> import lyaphybrid as lh
        >>> s = lh.lyapunov_spectrum(lh.Map(lambda n, x, r: r * x * (1 - x)), [0.3], 4.0, t1=20_000)
        >>> abs(float(s.exponents[0]) - 0.6931) < 0.01
        True
    """
    _check_words(clock, averaging, orthonormalise, blocks, k, target_stderr, replicates, key, max_steps)
    _check_flags(throw=throw, count_start=count_start, resume=resume)
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    preparation.warn_of_small_units(x0, problem.method)
    require(not isinstance(system, Flow) or clock != "jumps", ENDLESS)
    check_counts(system, clock, t1=t1, transient=transient)
    if replicates is not None:
        require(x0.ndim == 1, f"replicates perturbs one start, x0 (n,), or is left out; x0 has shape {x0.shape}.")
        x0 = starts(problem.system, t0, x0, problem.args, replicates, key)
    frame, initial = initial_frame(problem, t0, x0, frame, k)
    qr_schedule, interval = qr_schedule_for(problem, every)
    plan = _plan(system, x0, int(frame.shape[-1]), qr_schedule, orthonormalise, clock)
    in_units = functools.partial(targets_for, clock=clock, discrete=iterates(system), dtype=x0.dtype)
    targets = in_units(ends_of_blocks(t1, blocks, times, "t1"))  # checks the arguments before anything is computed
    loop_state, interrupted = driver.start(problem, plan, t0, x0, frame, mode, array(interval, x0.dtype)), False
    file, stretches = None, [(t1, blocks)]
    if checkpoint is not None:
        words = clock, averaging, target_stderr, count_start
        identity = _identity(problem, plan, loop_state, initial, transient, blocks, times, words)
        file = checkpoints.opened(checkpoint, resume, identity, t1, blocks, times is None and target_stderr is None)
        stretches = file.stretches
    about = About.of(system, problems.mode_names(system), preparation.method_for(system, method))
    how = clock, averaging, initial if count_start else 0.0 * initial, labels_of(system, problem.shape), about
    quieted: list[driver.Outcome] = []  # outcomes of the transient
    if not is_zero(transient):
        quiet = in_units(ends_of_blocks(transient, blocks, None, "transient"))
        if driver.under_transformation(problem, loop_state, (quiet, targets)) and len(targets[0]) == blocks:
            require(target_stderr is None, DECIDES_FROM_VALUES)
            found = driver.after_transient(problem, plan, loop_state, quiet, targets, max_steps)
            return _deliver(_Run(problem, plan, (found,), *how).summarised(t1, blocks), throw, "")
        before = driver.drive(problem, plan, loop_state, *quiet, max_steps, part=file and file.part(0))
        loop_state, interrupted = driver.sealed(before), before.interrupted
        quieted.append(before)
    outcomes, done, more, reached, in_blocks = list[driver.Outcome](), 0, 1, 0.0, 0  # done and more in units of t1
    while True:
        loop_state = driver.restart(loop_state) if quieted or outcomes else loop_state  # a new one has counted nothing
        done, number = done + more, len(outcomes)
        length, count = stretches[number] if number < len(stretches) else (more * t1, blocks)
        targets = in_units(ends_of_blocks(length, count, times, "t1"))
        reached, in_blocks = reached + length, in_blocks + len(targets[0])
        part = None if file is None or interrupted else file.part(number + 1)
        outcomes.append(driver.drive(problem, plan, loop_state, *targets, max_steps, progress, interrupted, part=part))
        loop_state, interrupted = outcomes[-1].loop_state, outcomes[-1].interrupted
        if number + 1 < len(stretches) and not interrupted:
            continue
        spectrum = _Run(problem, plan, tuple(outcomes), *how).summarised(reached, in_blocks)
        spectrum, why, more = _more_lengths(spectrum, (*quieted, *outcomes), target_stderr, done, times)
        if more == 0:
            if file is not None and not interrupted:
                file.close()
            return _deliver(spectrum, throw, why)


def _plan(system, x0, k: int, qr_schedule, orthonormalise: str, clock: str) -> problems.RunPlan:
    limit = SUM_RULE_EXACT if isinstance(system, EventDriven) else SUM_RULE_UP_TO
    return problems.RunPlan(
        qr_schedule=qr_schedule,
        kind=frames.kind_for(k) if orthonormalise == "auto" else orthonormalise,
        sum_rule=k == x0.shape[-1] <= limit,
        count_jumps=clock != "time",
        batched=x0.ndim == 2,
        collect=problems.first_losses,
    )


class _Run(NamedTuple):
    """A run, its transient left out, from which its spectrum follows, and with which it can go on."""

    problem: problems.RunProblem
    plan: problems.RunPlan
    outcomes: tuple[driver.Outcome, ...]
    clock: str
    averaging: str
    initial: Any  # (k,) growth at the start that is counted
    labels: Labels
    about: About

    def summarised(self, length, blocks: int) -> Spectrum:
        """The spectrum of a run of this length, in so many blocks."""
        about = self.about.noting(any(outcome.stiff for outcome in self.outcomes))
        how = self.clock, self.initial, self.averaging, self.labels, about
        spectrum = averages.summarise(self.outcomes, self.problem, *how)
        return spectrum if traced(spectrum) else spectrum._resumed_by(functools.partial(_go_on, self, length, blocks))


def _go_on(run: _Run, length, blocks: int, spectrum: Spectrum, t1, max_steps, progress, throw: bool) -> Spectrum:
    """The same run to t1: the blocks that are added are as long as those before."""
    system, before, last = run.problem.system, float(length), run.outcomes[-1]
    positive("t1, a length,", t1)
    check_counts(system, run.clock, t1=t1)
    attempts(max_steps)
    require(t1 > before, f"t1 must be beyond the {before:.15g} that the run has reached; got {t1!r}.")
    require(
        spectrum.status == STATUS.ok and not last.interrupted,
        f"resume goes on from the end of a run, and this one did not come to its end: {spectrum.status}. After Ctrl-C "
        "checkpoint=… and resume=True of lh.lyapunov_spectrum go on.",
    )
    more = max(2, round((t1 - before) * blocks / before))
    dtype = last.loop_state.carry.x.dtype
    targets = targets_for(ends_of_blocks(t1 - before, more, None, "t1"), run.clock, iterates(system), dtype)
    again = driver.drive(run.problem, run.plan, driver.restart(last.loop_state), *targets, max_steps, progress)
    found = run._replace(outcomes=(*run.outcomes, again)).summarised(t1, blocks + more)
    return _deliver(found, throw, again.why)


def _identity(problem, plan, loop_state, initial, transient, blocks, times, words) -> dict[str, str]:
    """Hashes of what must be the same when a run is resumed from a checkpoint."""
    require(not traced((loop_state, problem)), NOT_KEPT)
    one = np.ones(1, loop_state.base.dtype)

    def advance(loop_state):
        return driver.once(problem, plan, loop_state, one, one, np.int32(0))

    start = {str(i): np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves((loop_state, initial)))}
    ends = np.array([blocks]) if times is None else np.array([repr(times)] if isinstance(times, str) else times)
    how = {"transient": np.asarray(transient, float), "ends": ends, "words": np.array(repr(words))}
    return {
        "system, args or method": hash_of_function(advance, loop_state),
        "start": hash_of_arrays(start),
        "length or averaging": hash_of_arrays(how),
        "version": f"lyaphybrid {__version__}, jax {jax.__version__}",
    }


def _check_words(clock, averaging, orthonormalise, blocks, k, target_stderr, replicates, key, max_steps) -> None:
    require(is_one_of(clock, CLOCKS), f"clock must be one of {CLOCKS}; got {clock!r}.")
    require(is_one_of(averaging, AVERAGES), f"averaging must be one of {AVERAGES}; got {averaging!r}.")
    kinds = ("auto", *frames.QR_ALGORITHMS)
    require(is_one_of(orthonormalise, kinds), f"orthonormalise must be one of {kinds}; got {orthonormalise!r}.")
    whole("blocks", blocks, least=2, each=1)
    if k is not None:
        whole("k", k, least=1)
    if target_stderr is not None:
        positive("target_stderr, a standard error,", target_stderr)
    attempts(max_steps)
    random_key("key", key)
    if replicates is not None:
        whole("replicates", replicates, least=2, each=1)
        require(is_key(key), f"replicates needs key=jax.random.key(seed), to perturb the starts; got {key!r}.")


def _check_flags(**flags) -> None:
    for name, value in flags.items():
        flag(name, value)


def starts(system, t0, x0, args, replicates: int, key):
    """The starts of the replicates: x0 perturbed by a relative 1e-6; chaos makes them independent."""
    noise = jax.random.normal(key, (replicates, *x0.shape), x0.dtype)
    noise = 1e-6 * jnp.maximum(1.0, jnp.abs(x0))[None, :] * noise
    if isinstance(system, DAE):
        noise = onto_constraints(system, t0, x0, args, noise.T).T
    return x0[None, :] + noise


def initial_frame(problem, t0, x0, frame, k):
    """The orthonormal initial columns, and ln R_ii of the user's columns; for a DAE without any, of those of Ē⁻¹."""
    system, n, dtype = problem.system, x0.shape[-1], x0.dtype
    most = degrees_of_freedom(system, n)
    if k is not None:
        whole("k", k, least=1)
    require(k is None or k <= most, f"k must be at most {'n' if most == n else 'n_differential'} = {most}; got {k}.")
    k = k or (most if frame is None else None)
    if frame is None:
        assert k is not None
        if not isinstance(system, DAE):
            canonical, no_growth = getattr(system, "canonical", False), np.zeros(k, dtype)
            if k == n:
                return frames.unit_vectors(n, n, dtype, paired=canonical), no_growth
            return frames.generic_frame(n, k, dtype), no_growth
        frame = tangent_frame(system, t0, x0 if x0.ndim == 1 else x0[0], problem.args)
        frame = frame if k == most else frame @ frames.generic_frame(most, k, dtype)
    frame = array(numbers("frame", frame), dtype)
    fits = frame.ndim == 2 and frame.shape[0] == n and 1 <= frame.shape[1] <= most
    fits = fits and k in (None, frame.shape[1])
    require(fits, f"frame must have shape (n, k) = ({n}, {k or 'k'}) with 1 ≤ k ≤ {most}; got {frame.shape}.")
    if isinstance(system, DAE) and x0.ndim == 1:
        frame = onto_constraints(system, t0, x0, problem.args, frame)
    columns, log_r, lost = _orthonormal(frame)
    require(traced(lost) or not bool(np.any(np.asarray(lost))), "frame must have linearly independent columns.")
    return columns, log_r


@compiled(hands_on=True)
def _orthonormal(frame):
    return frames.orthonormalise(frame, "mgs", frames.LOST, frames.LOST)


def _good_enough(spectrum: Spectrum, target_stderr: float) -> bool:
    require(not traced(spectrum.stderr), DECIDES_FROM_VALUES)
    finite = np.isfinite(np.asarray(spectrum.exponents))
    reached = bool(np.all(np.asarray(spectrum.stderr)[finite] <= target_stderr))
    return reached or bool(spectrum.status != STATUS.ok) or "interrupted" in spectrum.notes


def _more_lengths(
    spectrum: Spectrum, outcomes: tuple[driver.Outcome, ...], target_stderr: float | None, done: int, times: Times
) -> tuple[Spectrum, str, int]:
    """The spectrum, why it ends, and how many more times t1 to run if errors fall like 1/√t: 0 at the end."""
    why = next((one.why for one in outcomes if one.why), "")
    if target_stderr is None or _good_enough(spectrum, target_stderr):
        return spectrum, why, 0
    worst = np.max(np.where(np.isfinite(np.asarray(spectrum.exponents)), np.asarray(spectrum.stderr), 0.0))
    with np.errstate(over="ignore"):
        needed = done * (worst / np.float64(target_stderr)) ** 2
    if needed <= MOST_LENGTHS:
        return spectrum, why, int(np.clip(np.ceil(needed - done), 1, MOST_AT_A_TIME if times is None else 1))
    stalled = np.full_like(spectrum.status_code, STATUS.stalled)
    return dataclasses.replace(spectrum, status_code=stalled), OUT_OF_REACH.format(target_stderr, done, needed), 0


def _deliver(spectrum: Spectrum, throw: bool, why: str) -> Spectrum:
    """Raise on the host where the run failed and the values are concrete; where they are not, they become nan."""
    status = spectrum.status
    if throw and traced(spectrum.status_code):
        return nan_if_failed(spectrum.status_code, spectrum, "exponents", "stderr", "finite_exponents")
    if not throw or not isinstance(status, STATUS) or not status.failed:
        return spectrum
    place = Place.of(spectrum.t, spectrum.x, spectrum.mode, spectrum.mode_names)
    raise RunFailedError(status, account(spectrum.status_code, place, spectrum.accumulation_time, why), spectrum)
