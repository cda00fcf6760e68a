"""One lane of a bifurcation diagram: a run at one value of the parameter, with one point for each period."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._entries import ArgsEntry
from ...engine import beginning, binding, loop, problems
from ...engine.host.driver import FOREVER
from ...engine.states import BlockRecord
from ...results import averages
from ...statuses import OK, RUNNING, STATUS
from ...systems.hybrid import Hybrid
from . import attractors
from .moved import moved_over

__all__ = ["StrobeResults", "StrobeSettings", "StrobeRun", "RunEnd", "run", "schedule"]

BATCHES = 32  # batches of a run, from which its standard errors come
MOST_BLOCKS = 4096  # about the largest number of blocks of a run; longer runs have several periods in a block


class StrobeRun(NamedTuple):
    """One run: a value of the parameter and where it starts."""

    value: Any
    x: Any  # (n,)
    follows: Any  # whether it starts at the end of the run before


class RunEnd(NamedTuple):
    """The end of a run, from which the next one of a continuation starts."""

    value: Any  # of the parameter
    x: Any
    mode: Any
    good: Any


class StrobeSettings(NamedTuple):
    """The static settings of a lane."""

    entry: ArgsEntry
    angles: tuple[int, ...]
    transient: int  # periods
    ends: tuple[int, ...]  # ends of the blocks, in periods
    samples: int
    most: int | None = None  # attempts until a section is crossed; None: any number


class StrobeResults(NamedTuple):
    """The results of a lane."""

    exponents: Any
    stderr: Any
    finite: Any
    losses: Any
    time: Any
    status: Any
    points: Any
    lifetime: Any
    beyond: Any  # whether it was beyond a guard all along


def schedule(entry: ArgsEntry, angles, transient: int, t1: int, samples: int) -> StrobeSettings:
    """The settings; blocks are one period long unless there are too many, and always for the kept points."""
    longest = -(-(transient + t1) // MOST_BLOCKS)
    quiet = _divided(0, transient, longest)
    loud = _divided(transient, transient + t1 - samples, longest)
    last = transient + t1 - samples + np.arange(1, samples + 1)
    ends = np.concatenate([quiet, loud, last])
    return StrobeSettings(entry, angles, transient, tuple(ends.tolist()), samples)


def _divided(first: int, last: int, longest: int) -> np.ndarray:
    """Ends of blocks of at most `longest` whole periods, from `first` to `last`."""
    pieces = -(-(last - first) // longest)
    return np.round(first + (last - first) * (np.arange(1, pieces + 1) / max(pieces, 1))).astype(int)


def run(shared, state: RunEnd, lane: StrobeRun) -> tuple[RunEnd, StrobeResults]:
    """One run, from its own start or from the end of the run before, unless a surface has moved over that."""
    problem, plan, how, period, t0, frame, interval, mode, limit = shared
    before, args = (how.entry.placed(problem.args, value) for value in (state.value, lane.value))
    problem = problem._replace(args=args)
    carries_on = lane.follows & state.good & ~moved_over(problem.system, t0, state.x, state.mode, before, args)
    x = jnp.where(carries_on, state.x, lane.x)
    settings = binding.settings_of(problem, plan, t0, x)
    if isinstance(problem.system, Hybrid) and problem.system.initial_mode is not None:
        if mode is not None:
            # With another parameter the same state may be in another mode.
            mode = jnp.where(carries_on, settings.evolver.initial_mode(t0, x), mode)
    else:
        mode = jnp.where(carries_on, state.mode, jnp.asarray(mode, jnp.int32))
    loop_state = beginning.initial_loop_state(settings, t0, x, frame, mode, None, interval)
    multiples, wanted = np.asarray(how.ends, x.dtype), np.diff(how.ends, prepend=0)
    most = np.minimum(FOREVER, np.full(len(wanted), FOREVER) if how.most is None else how.most * wanted)
    if period is None:  # crossings: the jumps of a flow, see `_crossed` for systems with others
        targets = np.full_like(multiples, np.inf), multiples
    else:
        ends = multiples * (period(args) if callable(period) else period)
        targets = ends, multiples
    targets = *targets, wanted.astype(np.int32), most.astype(np.int32)
    loop_state, turns, records, points = _blocks(settings, loop_state, how.angles, targets, limit)
    ended = int(STATUS.max_steps if how.most is None else STATUS.no_more_jumps)
    status = jnp.where((loop_state.carry.status == RUNNING) & ~records.valid[-1], ended, loop_state.carry.status)
    failed = (status != OK) & (status != int(STATUS.terminated))
    whole = attractors.turns_of(x.shape[0], how.angles)
    lifetime = attractors.lifetime(jnp, points, np.asarray(how.ends), whole, how.samples)
    settled, empty = jnp.where(status == OK, lifetime, jnp.nan), averages.empty_columns(jnp, loop_state)
    found = _summary(how, records, empty, status, points, settled)
    found = found._replace(
        exponents=jnp.where(failed, jnp.nan, found.exponents),
        finite=jnp.where(failed, jnp.nan, found.finite),
        beyond=problems.beyond_guard(loop_state) > 0,
    )
    good = (status == OK) & ~found.beyond
    end = RunEnd(lane.value, loop_state.carry.x, problems.mode_of(loop_state.carry), good)
    return end, found


def _blocks(settings, loop_state, angles, targets, limit):
    """All blocks in turn; after each one angles are reduced to (−π, π] and their turns counted."""
    columns = list(angles)

    def block(state, target):
        loop_state, turns, budget = state
        end, last, wanted, most = target
        given = jnp.minimum(budget, most)
        if settings.log:
            loop_state, record, x = _crossed(settings, loop_state, wanted, given)
        else:
            loop_state, record = _advanced(settings, loop_state, end, last, given)
            x = loop_state.carry.x
        carry = loop_state.carry
        good = record.valid & (carry.status == RUNNING)
        budget, whole = jnp.where(good, budget - given + carry.budget, 0), turns
        if columns:
            more = jnp.zeros_like(turns)
            for i in columns:
                more = more.at[i].set(jnp.round(carry.x[i] / (2 * np.pi)))
            turns = turns + more
            loop_state = loop_state._replace(carry=carry._replace(x=carry.x - 2 * np.pi * more))
        point = jnp.where(good, x + 2 * np.pi * whole, jnp.nan)
        return (loop_state, turns, budget), (record, point)

    start = (loop_state, jnp.zeros_like(loop_state.carry.x), limit)
    (loop_state, turns, _), (records, points) = jax.lax.scan(block, start, targets)
    return loop_state, turns, records, points


def _advanced(settings, loop_state, end, last, budget) -> tuple[Any, BlockRecord]:
    """One block, until a time or a number of jumps."""
    loop_state = loop_state._replace(block=jnp.zeros_like(loop_state.block))
    loop_state, record = loop.advance(settings, loop_state, end[None], last[None], budget)
    return loop_state, jax.tree.map(lambda leaf: leaf[0], record)


def _crossed(settings, loop_state, wanted, budget) -> tuple[Any, BlockRecord, Any]:
    """Jump after jump, until the section was crossed so often: one block; and the state of the last crossing.

    The section is the first transition. It has been crossed by the flow if it fires before other guards that are zero
    at the same instant; the state is that before their jumps, as in `lh.poincare_section`.
    """
    x, never = loop_state.carry.x, jnp.asarray(np.inf, loop_state.carry.x.dtype)

    @jax.jit  # traced once, for shapes and loop
    def jump(loop_state, budget):
        log = loop_state.carry.log
        carry = loop_state.carry._replace(log=log._replace(count=jnp.zeros_like(log.count)))
        last = (carry.jumps + 1).astype(x.dtype)
        return _advanced(settings, loop_state._replace(carry=carry), never, last, budget)

    def once(state):
        loop_state, before, x, count, budget = state
        first = loop_state.carry.jumps == 0
        loop_state, record = jump(loop_state, budget)
        log, flowed = loop_state.carry.log, first | (record.duration > 0)
        crossed = record.valid & flowed & (log.count > 0) & (log.transition[0] == 0)
        record = record._replace(duration=record.duration + before.duration, growth=record.growth + before.growth)
        count, x = count + crossed.astype(count.dtype), jnp.where(crossed, log.x_before[0], x)
        return loop_state, record, x, count, jnp.where(record.valid, loop_state.carry.budget, 0)

    def goes_on(state):
        _, record, _, count, _ = state
        return record.valid & (count < wanted)

    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(jump, loop_state, budget)[1])
    start = loop_state, nothing._replace(valid=jnp.asarray(True)), x, jnp.zeros_like(wanted), budget
    loop_state, record, x, _, _ = jax.lax.while_loop(goes_on, once, start)
    return loop_state, record, x


def _summary(how: StrobeSettings, records: BlockRecord, empty, status, points, lifetime) -> StrobeResults:
    """Exponents and errors from batches of the blocks after the motion has converged; and the last points."""
    ends = np.asarray(how.ends, points.dtype)
    begins = np.concatenate([np.zeros(1, ends.dtype), ends[:-1]])
    start = jnp.maximum(jnp.where(jnp.isnan(lifetime), 0.0, lifetime), float(how.transient))
    counts = begins >= start
    growth, losses = records.growth, records.losses
    lost = jnp.zeros(growth.shape[1], growth.dtype)
    if records.order is not None:
        places = averages.places(jnp, records.order, records.valid)
        growth = jnp.take_along_axis(growth, places, axis=1)
        counted = jnp.take_along_axis(losses, places, axis=1)
        lost = (counted[-1] - counted[jnp.sum(~counts) - 1]).astype(growth.dtype)
    middle = (0.5 * (begins + ends) - start) / jnp.maximum(ends[-1] - start, 1.0)
    most = min(BATCHES, len(ends))
    batches = jnp.where(counts & records.valid, (middle * most).astype(jnp.int32), most)

    def in_batches(values):
        return jax.ops.segment_sum(values, batches, most + 1)[:most]

    duration, gained = in_batches(records.duration), in_batches(growth)
    grouped = BlockRecord(duration > 0, duration, jnp.zeros_like(duration), gained, None, None, None, None)
    run = averages.one_run(jnp, grouped, empty, "time", jnp.zeros(growth.shape[1], growth.dtype), "uniform")
    exponents = jnp.where(lost > 0, -jnp.inf, run["exponents"])
    stderr = jnp.where(lost > 0, jnp.nan, run["stderr"])
    rank = jnp.argsort(-jnp.where(jnp.isfinite(exponents), exponents, -jnp.inf), stable=True)
    last = points[-how.samples :]
    time = run["time"]
    found = exponents[rank], stderr[rank], run["finite"][rank], lost[rank], time, status, last, lifetime
    return StrobeResults(*found, beyond=None)
