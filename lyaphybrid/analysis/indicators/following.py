"""One run with an `Observer`, as all indicators need it."""

import warnings
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..._arguments import attempts, numbers, require, whole
from ..._jax.tracing import array, numpy_for, traced
from ..._keywords import user_level
from ..._linalg import frames
from ..._text import Table, in_brackets
from ...engine import preparation, problems
from ...engine.blocks import each_step_of, ends_of_blocks, is_zero, qr_schedule_for, targets_for
from ...engine.host import driver
from ...engine.host.places import Place, account, place_of
from ...engine.states import BlockRecord, Observer
from ...errors import RunFailedError
from ...results.result import in_time
from ...results.spectrum import NOTE_TEXTS, unresolved
from ...statuses import STATUS, gravest
from ...systems.consistency import onto_constraints
from ...systems.daes.semi_linear import DAE, degrees_of_freedom
from ...systems.kinds import iterates

__all__ = [
    "IndicatorRun",
    "follow",
    "samples_of",
    "start_frame",
    "table_of",
    "times_of",
    "unit_columns",
    "verdict_of",
]

TIMES_SHOWN = 8  # times in a table


class IndicatorRun(NamedTuple):
    """The results of a run; the leading axes are ([m,] blocks)."""

    time: Any  # at the ends of the blocks, since the start of the part that counts; nan where not reached
    collected: Any
    status: Any
    interrupted: bool
    loop_state: Any
    system: Any
    why: str
    quiet: BlockRecord | None = None  # of the two blocks of the transient; None without one

    @property
    def place(self) -> Place:
        """Time, state and mode at the end."""
        return place_of(self.loop_state, self.system)


def follow(
    observer: Observer | None,
    collect,
    system,
    x0,
    args,
    *,
    k: int,
    t1,
    t0,
    transient,
    times,
    blocks,
    mode,
    frame,
    method,
    max_steps,
    progress,
    every=None,
    each_step: bool = False,
) -> IndicatorRun:
    """Run a system with k deviation vectors, and call `observer` at every orthonormalisation (k = 0: there are none).

    `collect` says what is recorded at the ends of the blocks; `frame` None: orthonormal vectors in generic
    directions; `each_step`: orthonormalise after each step, or each flight between events. All else as for
    `lyapunov_spectrum`.
    """
    whole("blocks", blocks, least=2, each=1)
    attempts(max_steps)
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    preparation.warn_of_small_units(x0, problem.method)
    n = x0.shape[-1]
    most = degrees_of_freedom(system, n)
    require(k <= most, f"{k} deviation vectors were asked for, in a space of {most} dimensions: at most {most}.")
    frame = frames.generic_frame(n, k, x0.dtype) if frame is None else unit_columns(frame, n, k, x0.dtype)
    qr_schedule, interval = each_step_of(problem) if each_step else qr_schedule_for(problem, every)
    qr_schedule = qr_schedule if k else problems.NO_ORTHONORMALISATION
    plan = problems.RunPlan(
        qr_schedule=qr_schedule, kind=frames.kind_for(k), batched=x0.ndim == 2, collect=collect, observer=observer
    )
    limits = ends_of_blocks(t1, blocks, times, "t1")
    discrete, interrupted, why, quiet_records = iterates(problem.system), False, "", None
    loop_state = driver.start(problem, plan, t0, x0, frame, mode, array(interval, x0.dtype))
    if not is_zero(transient):
        quiet = targets_for(ends_of_blocks(transient, 2, None, "transient"), "time", discrete, x0.dtype)
        before = driver.drive(problem, plan, loop_state, *quiet, max_steps)
        why, quiet_records = before.why, before.records
        loop_state, interrupted = driver.restart(driver.sealed(before), observer, plan.batched), before.interrupted
    outcome = driver.drive(
        problem, plan, loop_state, *targets_for(limits, "time", discrete, x0.dtype), max_steps, progress, interrupted
    )
    valid, durations = outcome.records.valid, outcome.records.duration
    xp = numpy_for(durations)
    time = xp.where(valid, xp.cumsum(xp.where(valid, durations, 0.0), axis=-1), xp.nan)
    collected, why = outcome.records.collected, why or outcome.why
    return IndicatorRun(
        time, collected, outcome.status, outcome.interrupted, outcome.loop_state, problem.system, why, quiet_records
    )


def start_frame(system, t0, x0, args, k: int):
    """The generic frame at x0, (n,) or (N, d); for a DAE an orthonormal one of its tangent space."""
    x = jnp.asarray(x0, float).ravel()
    frame = frames.generic_frame(x.shape[0], k, x.dtype)
    if not isinstance(system, DAE):
        return frame
    return np.linalg.qr(np.asarray(onto_constraints(system, jnp.asarray(t0, x.dtype), x, args, jnp.asarray(frame))))[0]


def unit_columns(frame, n, k, dtype):
    """The user's vectors, normalised: indicators are defined for unit vectors."""
    frame = jnp.asarray(numbers("frame", frame, dtype))
    require(frame.shape == (n, k), f"frame must have shape (n, k) = ({n}, {k}); got {frame.shape}.")
    return frame / jnp.linalg.norm(frame, axis=0, keepdims=True)


def verdict_of(followed: IndicatorRun, result, throw: bool):
    """Return the result, or raise if the run failed, its values are known and `throw` is set.

    It warns where columns became rounding on the way, as the note of a spectrum says.
    """
    spread = followed.loop_state.spread
    if traced((followed.status, spread)):
        return result
    status = STATUS(int(gravest(np.asarray(followed.status))))
    if status.failed and throw:
        raise RunFailedError(status, account(followed.status, followed.place, why=followed.why), result)
    if not status.failed and np.any(unresolved(np.asarray(spread))):
        warnings.warn(f"unresolved: {NOTE_TEXTS['unresolved']}", stacklevel=user_level())
    return result


def samples_of(result) -> tuple[str, ...]:
    """The dimensions of an indicator's time, of one run or of several."""
    return ("run", "sample") if result.time.ndim == 2 else ("sample",)


def times_of(result) -> dict[str, Any]:
    """The coordinate of its times."""
    return {"time": (samples_of(result), np.asarray(result.time), in_time(result.unit))}


def table_of(result, names: list[str], columns, before: str = "") -> Table:
    """An indicator in print: columns (…, times, values) at some of its times; of several runs at their ends."""
    time, columns = np.asarray(result.time), np.asarray(columns)
    head = in_brackets("time", result.unit)
    if time.ndim == 2:
        rows = [
            (f"run {i}", f"{t[-1]:.6g}", *_written(own[-1]))
            for i, (t, own) in enumerate(zip(time, columns, strict=True))
        ]
        heads = ("", head, *(before + name for name in names))
        return Table(f"{', '.join(names)} of {len(time)} runs", rows, [f"status {result.status}"], heads)
    chosen = np.unique(np.linspace(0, len(time) - 1, TIMES_SHOWN).astype(int))
    rows = [(f"{time[i]:.6g}", *_written(columns[i])) for i in chosen]
    notes = [str(result.verdict), f"status {result.status}"]
    return Table(f"{', '.join(names)} at {len(time)} times", rows, notes, (head, *(before + name for name in names)))


def _written(values) -> list[str]:
    return [f"{value:.6g}" for value in values]
