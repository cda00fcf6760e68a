"""One lane of a bifurcation diagram: a run at one value of the parameter, with one point for each period."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...engine import beginning, binding, loop, problems
from ...engine.states import BlockRecord
from ...results import averages
from ...statuses import OK, RUNNING, STATUS
from ...systems.hybrid import Hybrid
from . import attractors

__all__ = ["StrobeResults", "StrobeSettings", "StrobeRun", "RunEnd", "at", "placed", "run", "schedule"]

BATCHES = 32  # batches of a run, from which its standard errors come
MOST_BLOCKS = 4096  # about the largest number of blocks of a run; longer runs have several periods in a block


class StrobeRun(NamedTuple):
    """One run: a value of the parameter and where it starts."""

    value: Any
    x: Any  # (n,)
    follows: Any  # whether it starts at the end of the run before


class RunEnd(NamedTuple):
    """The end of a run, from which the next one of a continuation starts."""

    x: Any
    mode: Any
    good: Any


class StrobeSettings(NamedTuple):
    """The static settings of a lane."""

    path: tuple[str, ...]
    angles: tuple[int, ...]
    transient: int  # periods
    ends: tuple[int, ...]  # ends of the blocks, in periods
    samples: int


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


def at(tree, path):
    """The parameter of that name, ("a", "b") for a["b"] or a.b."""
    for word in path:
        tree = tree[word] if isinstance(tree, Mapping) else getattr(tree, word)
    return tree


def placed(args, path, value):
    """The parameters with another value of one of them."""
    return eqx.tree_at(lambda tree: at(tree, path), args, value)


def schedule(name: str, angles, transient: int, t1: int, samples: int) -> StrobeSettings:
    """The settings; blocks are one period long unless there are too many, and always for the kept points."""
    longest = -(-(transient + t1) // MOST_BLOCKS)
    quiet = _divided(0, transient, longest)
    loud = _divided(transient, transient + t1 - samples, longest)
    last = transient + t1 - samples + np.arange(1, samples + 1)
    ends = np.concatenate([quiet, loud, last])
    return StrobeSettings(tuple(name.split(".")), angles, transient, tuple(ends.tolist()), samples)


def _divided(first: int, last: int, longest: int) -> np.ndarray:
    """Ends of blocks of at most `longest` whole periods, from `first` to `last`."""
    pieces = -(-(last - first) // longest)
    return np.round(first + (last - first) * (np.arange(1, pieces + 1) / max(pieces, 1))).astype(int)


def run(shared, state: RunEnd, lane: StrobeRun) -> tuple[RunEnd, StrobeResults]:
    """One run, from its own start or from the end of the run before."""
    problem, plan, how, period, t0, frame, interval, mode, limit = shared
    args = placed(problem.args, how.path, lane.value)
    problem = problem._replace(args=args)
    carries_on = lane.follows & state.good
    x = jnp.where(carries_on, state.x, lane.x)
    settings = binding.settings_of(problem, plan, t0, x)
    if isinstance(problem.system, Hybrid) and problem.system.initial_mode is not None:
        if mode is not None:
            # With another parameter the same state may be in another mode.
            mode = jnp.where(carries_on, settings.evolver.initial_mode(t0, x), mode)
    else:
        mode = jnp.where(carries_on, state.mode, jnp.asarray(mode, jnp.int32))
    loop_state = beginning.initial_loop_state(settings, t0, x, frame, mode, None, interval)
    multiples = np.asarray(how.ends, x.dtype)
    if period is None:
        targets = np.full_like(multiples, np.inf), multiples
    else:
        ends = multiples * (period(args) if callable(period) else period)
        targets = ends, multiples
    loop_state, turns, records, points = _blocks(settings, loop_state, how.angles, targets, limit)
    status = jnp.where(
        (loop_state.carry.status == RUNNING) & ~records.valid[-1], int(STATUS.max_steps), loop_state.carry.status
    )
    failed = (status != OK) & (status != int(STATUS.terminated))
    whole = attractors.turns_of(x.shape[0], how.angles)
    lifetime = attractors.lifetime(jnp, points, np.asarray(how.ends), whole, how.samples)
    settled, empty = jnp.where(status == OK, lifetime, jnp.nan), averages.empty_columns(jnp, loop_state)
    found = _summary(how, records, empty, status, points, settled)
    found = found._replace(
        exponents=jnp.where(failed, jnp.nan, found.exponents), finite=jnp.where(failed, jnp.nan, found.finite)
    )
    end = RunEnd(loop_state.carry.x, problems.mode_of(loop_state.carry), status == OK)
    return end, found


def _blocks(settings, loop_state, angles, targets, limit):
    """All blocks in turn; after each one angles are reduced to (−π, π] and their turns counted."""
    columns = list(angles)

    def block(state, target):
        loop_state, turns, budget = state
        end, last = target
        loop_state = loop_state._replace(block=jnp.zeros_like(loop_state.block))
        loop_state, record = loop.advance(settings, loop_state, end[None], last[None], budget)
        record = jax.tree.map(lambda leaf: leaf[0], record)
        carry = loop_state.carry
        good = record.valid & (carry.status == RUNNING)
        budget = jnp.where(good, carry.budget, 0)
        if columns:
            more = jnp.zeros_like(turns)
            for i in columns:
                more = more.at[i].set(jnp.round(carry.x[i] / (2 * np.pi)))
            turns = turns + more
            loop_state = loop_state._replace(carry=carry._replace(x=carry.x - 2 * np.pi * more))
        point = jnp.where(good, loop_state.carry.x + 2 * np.pi * turns, jnp.nan)
        return (loop_state, turns, budget), (record, point)

    start = (loop_state, jnp.zeros_like(loop_state.carry.x), limit)
    (loop_state, turns, _), (records, points) = jax.lax.scan(block, start, targets)
    return loop_state, turns, records, points


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
    return StrobeResults(exponents[rank], stderr[rank], run["finite"][rank], lost[rank], time, status, last, lifetime)
