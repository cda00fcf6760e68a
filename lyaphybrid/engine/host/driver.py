"""The host: it calls the compiled loop until a run has reached its end.

Eager, the host calls the compiled `advance` again and again with a budget of attempts that takes about a third
of a second: between two calls there is room for progress, Ctrl-C and checks, and nothing computed is lost.
Traced (under jit, vmap, grad) it is called once.
"""

import functools
import time
import warnings
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compilations, compiled
from ..._jax.tracing import traced
from ...events.compiled_hybrid import by_mode
from ...statuses import RUNNING, STATUS
from .. import beginning, loop, states
from ..binding import evolver_of, settings_of
from ..evolvers.stepping import Stepping
from ..problems import Plan, Problem, mode_of
from ..states import LoopState, Observer
from .checkpoints import Part
from .paces import Pace, Rates, given_up, rates_of
from .reporting import reporter

__all__ = ["Outcome", "drive", "once", "restart", "sealed", "start"]

FOREVER = 2**31 - 1
SECONDS_PER_CALL = 0.3
FIRST, FEWEST, MOST = 2000, 100, 10**8  # attempts in a call …
MOST_FASTER = 64.0  # … and how many times as many the next call may have
SHORT = np.int32(STATUS.max_steps)  # the verdict on a run whose attempts are spent


@compiled(lambda problem, plan, t0, x0, frame, mode, interval: frame.shape[-1], hands_on=True)
def start(problem: Problem, plan: Plan, t0, x0, frame, mode, interval) -> LoopState:
    """The loop's state at its start; x0 (n,), or (m, n) where the plan is batched."""

    def one(x, frame):
        settings = settings_of(problem, plan, t0, x)
        return beginning.begin(settings, t0, x, frame, mode, None, jnp.asarray(interval, x.dtype))

    if not plan.batched:
        return one(x0, frame)
    frames = jnp.broadcast_to(frame, (x0.shape[0], *frame.shape)) if frame.ndim == 2 else frame
    return jax.vmap(one)(x0, frames)


def _loop(problem: Problem, plan: Plan, loop_state: LoopState, ends, last_jumps, budget, reverse: bool = False):
    def one(loop_state):
        settings = settings_of(problem, plan, loop_state.base[0], loop_state.carry.x, reverse)
        return loop.advance(settings, loop_state, ends, last_jumps, budget)

    if not plan.batched:
        return one(loop_state)
    # On a CPU one lane after the other keeps real branches; a vmap of them would compute every case for all.
    if jax.default_backend() == "cpu":
        return jax.lax.map(one, loop_state)
    return jax.vmap(one)(loop_state)


_advance = compiled(
    lambda problem, plan, loop_state, *rest: loop_state.carry.frame.shape[-1],
    functools.partial(_loop, reverse=True),
    hands_on=True,
    in_pieces=True,
)(_loop)


@compiled(hands_on=True)
def restart(loop_state: LoopState, observer: Observer | None = None, batched: bool = False) -> LoopState:
    """`states.restart`, of one loop's state or of several."""
    one = functools.partial(states.restart, observer=observer)
    return jax.vmap(one)(loop_state) if batched else one(loop_state)


class Outcome(NamedTuple):
    """Where a run ended, and its records."""

    loop_state: LoopState
    records: Any  # states.Record with leading axes ([m,] blocks)
    status: Any
    interrupted: bool
    logs: tuple = ()  # of events, to be joined
    why: str = ""  # a run has stalled, in words


def drive(
    problem: Problem,
    plan: Plan,
    loop_state: LoopState,
    ends,
    last_jumps,
    max_steps=None,
    progress=None,
    interrupted: bool = False,
    part: Part | None = None,
) -> Outcome:
    """Run all blocks: in one call where traced, else call by call.

    Args:
        problem: what.
        plan: how.
        loop_state: from `start`, or `restart` of an earlier outcome's.
        ends: (blocks,) of the blocks, in time since the run began.
        last_jumps: (blocks,) number of jumps that ends each block; ignored unless plan.count_jumps.
        max_steps: most attempts; None: no limit, but a run that gets nowhere ends as stalled.
        progress: None, True for a bar, or a function of the fraction done.
        interrupted: before it began: nothing is computed.
        part: where it is kept on disk; of a run that has no log of events.
    """
    limit = 0 if interrupted else FOREVER if max_steps is None else max_steps
    leaves = jax.tree.leaves((loop_state, problem, ends, last_jumps))
    if traced(leaves):
        loop_state, records = _advance(problem, plan, loop_state, ends, last_jumps, limit)
        kept = () if loop_state.carry.log is None else (loop_state.carry.log,)
        return Outcome(loop_state, records, _verdict(loop_state, ends, SHORT), False, kept)
    blocks, records, budget, given, done = ends.shape[0], None, FIRST, 0, 0.0
    logs: list[states.Events] = []
    report = reporter(progress)
    if part is not None:
        loop_state, records, given = part.begun(
            loop_state, lambda: eqx.filter_eval_shape(once, problem, plan, loop_state, ends, last_jumps, np.int32(0))[1]
        )
    pace, why = Pace(loop_state, given, ends[-1], last_jumps[-1], plan.count_jumps), ""
    try:
        while records is None or (not _finished(loop_state, blocks) and (limit == FOREVER or given < limit)):
            allowed = budget if limit == FOREVER else min(budget, limit - given)
            clock, compiled = time.perf_counter(), compilations()
            loop_state, fresh = jax.block_until_ready(
                _advance(problem, plan, loop_state, ends, last_jumps, np.int32(allowed))
            )
            records = fresh if records is None else _merge(records, fresh)
            loop_state = _drain(loop_state, logs)
            given += allowed
            if part is not None:
                part.keep(loop_state, records, given)
            before, done = done, float(np.mean(np.asarray(loop_state.block))) / blocks
            if compilations() == compiled:  # the time of a call that compiled says nothing about the loop's speed
                seconds = time.perf_counter() - clock
                budget = int(np.clip(budget * min(SECONDS_PER_CALL / seconds, MOST_FASTER), FEWEST, MOST))
                if done > before:
                    left = (1 - done) / (done - before) * seconds
                    _advance.ahead(left, problem, plan, loop_state, ends, last_jumps, np.int32(allowed))
            if max_steps is None:
                stalled = pace.look(loop_state, given, functools.partial(_rates, problem, loop_state))
                loop_state, said = given_up(loop_state, stalled)
                why = why or said
            report(done)
    except KeyboardInterrupt:
        if records is None:
            raise
        warnings.warn("interrupted: the result holds what was computed until then.", stacklevel=3)
        interrupted = True
    report(None)
    if part is not None:
        part.keep(loop_state, records, given, now=True)
    status = _verdict(loop_state, ends, np.int32(STATUS.interrupted) if interrupted else SHORT)
    return Outcome(loop_state, records, status, interrupted, tuple(logs), why)


def _rates(problem: Problem, loop_state: LoopState, run: int) -> Rates | None:
    """How fast things change where a run stands; None where no field says it."""
    carry, several = loop_state.carry, loop_state.carry.x.ndim == 2
    if problem.method is None:
        return None
    t, x, mode = (
        np.asarray(leaf)[run] if several and np.ndim(leaf) else np.asarray(leaf)
        for leaf in (loop_state.base[..., 0] + carry.s, carry.x, mode_of(carry, np))
    )
    try:
        return Rates(*map(float, _rates_at(problem, t, x, mode)))
    except Exception:  # a callback has no derivative: then nothing is known
        return None


@compiled()
def _rates_at(problem: Problem, t, x, mode):
    evolver = evolver_of(problem, t, x)
    assert isinstance(evolver, Stepping), "what has a method has fields"
    return rates_of(lambda t, x: by_mode(mode, evolver.hybrid.fields, t, x), t, x)


def once(
    problem: Problem, plan: Plan, loop_state: LoopState, ends, last_jumps, budget
) -> tuple[LoopState, states.BlockRecord]:
    """So many attempts: the compiled loop."""
    return _advance(problem, plan, loop_state, ends, last_jumps, budget)


def sealed(outcome: Outcome) -> LoopState:
    """The loop's state of an outcome that did not reach its end stays where it is, with its verdict."""
    loop_state = outcome.loop_state
    return loop_state._replace(carry=loop_state.carry._replace(status=outcome.status))


def _drain(loop_state: LoopState, logs: list) -> LoopState:
    """Take the events out of the log: a run pauses where it is full."""
    log = loop_state.carry.log
    if log is None:
        return loop_state
    # NumPy's, for JAX would compile a slice for every number of events.
    logs.append(jax.tree.map(lambda leaf, upto=int(log.count): np.array(leaf)[:upto], log._replace(count=None)))
    emptied = log._replace(count=jnp.zeros_like(log.count))
    return loop_state._replace(carry=loop_state.carry._replace(log=emptied))


def _finished(loop_state: LoopState, blocks: int) -> bool:
    running = np.asarray(loop_state.carry.status) == 0
    return not bool(np.any(running & (np.asarray(loop_state.block) < blocks)))


@compiled()
def _verdict(loop_state: LoopState, ends, otherwise):
    """The status; where a run goes on still, though blocks are left, that of what has ended it."""
    short = (loop_state.carry.status == RUNNING) & (loop_state.block < ends.shape[0])
    return jnp.where(short, otherwise, loop_state.carry.status)


def _merge(old, new):
    """Records of an earlier call, overwritten where a later call finished a block; on the host: nothing to compile."""
    finished = np.asarray(new.valid)

    def leaf(a, b):
        return np.where(finished.reshape(finished.shape + (1,) * (b.ndim - finished.ndim)), b, a)

    return jax.tree.map(leaf, old, new)
