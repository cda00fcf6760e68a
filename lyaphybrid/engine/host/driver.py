"""The host's driver: it calls the compiled loop until a run has reached its end.

Outside of transformations the compiled `advance` is called repeatedly, each time with a budget of step attempts chosen
so that a call takes about SECONDS_PER_CALL. Between calls the host reports progress, handles Ctrl-C and checks the run.
Under a transformation (jit, vmap, grad) the loop is called once.
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
from ..._jax.precision import nonzero
from ..._jax.tracing import array, as_jax, enclosed, numpy_for, traced, transforming
from ...events.compiled_hybrid import by_mode
from ...statuses import RUNNING, STATUS
from .. import beginning, loop, states
from ..binding import evolver_of, settings_of
from ..evolvers.stepping import Stepping
from ..problems import RunPlan, RunProblem, mode_of
from ..stalling import FOREVER
from ..states import LoopState, Observer
from .checkpoints import RunPart
from .paces import Pace, Rates, StiffnessVotes, given_up, rates_of
from .reporting import reporter

__all__ = [
    "Outcome",
    "after_transient",
    "drive",
    "once",
    "rates_at",
    "restart",
    "sealed",
    "start",
    "under_transformation",
]

SECONDS_PER_CALL = 0.3
FIRST_ATTEMPTS = 2000  # in the first call
FEWEST_ATTEMPTS, MOST_ATTEMPTS = 100, 10**8  # in a later call
MOST_FASTER = 64.0  # largest factor from one call's attempts to the next call's
JUST_AHEAD = 1e-9  # of the time in which the state would change by its own size
ATTEMPTS_SPENT = np.int32(STATUS.max_steps)  # status of a run whose attempts are spent


@compiled(lambda problem, plan, t0, x0, frame, mode, interval: frame.shape[-1], hands_on=True)
def start(problem: RunProblem, plan: RunPlan, t0, x0, frame, mode, interval) -> LoopState:
    """The initial state of the loop; x0 (n,), or (m, n) if the plan is batched."""

    def one(x, frame):
        settings = settings_of(problem, plan, t0, x)
        return beginning.initial_loop_state(settings, t0, x, frame, mode, None, jnp.asarray(interval, x.dtype))

    if not plan.batched:
        return one(x0, frame)
    frames = jnp.broadcast_to(frame, (x0.shape[0], *frame.shape)) if frame.ndim == 2 else frame
    return jax.vmap(one)(x0, frames)


def _loop(problem: RunProblem, plan: RunPlan, loop_state: LoopState, ends, last_jumps, budget, reverse: bool = False):
    def one(loop_state):
        settings = settings_of(problem, plan, loop_state.base[0], loop_state.carry.x, reverse)
        return loop.advance(settings, loop_state, ends, last_jumps, budget)

    if not plan.batched:
        return one(loop_state)
    # On a CPU lanes run one after another, so that branches are real; under vmap every lane would compute all branches.
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
    """`states.restart` for the state of one run or of several."""
    one = functools.partial(states.restart, observer=observer)
    return jax.vmap(one)(loop_state) if batched else one(loop_state)


class Outcome(NamedTuple):
    """The final state of a run and its block records."""

    loop_state: LoopState
    records: Any  # states.BlockRecord with leading axes ([m,] blocks)
    status: Any
    interrupted: bool
    logs: tuple = ()  # event logs of successive calls
    why: str = ""  # the reason, in words, if a run has stalled
    stiff: bool = False  # whether an explicit method went at the limit of its stability


def drive(
    problem: RunProblem,
    plan: RunPlan,
    loop_state: LoopState,
    ends,
    last_jumps,
    max_steps=None,
    progress=None,
    interrupted: bool = False,
    part: RunPart | None = None,
) -> Outcome:
    """Run all blocks: in one call under a transformation, otherwise in several calls.

    Args:
        problem: what is computed.
        plan: how.
        loop_state: from `start`, or from `restart` of an earlier outcome's state.
        ends: (blocks,) end of each block, in time since the run began.
        last_jumps: (blocks,) number of jumps that ends each block; ignored unless plan.count_jumps.
        max_steps: most step attempts; None: no limit, but a run without progress ends with the status stalled.
        progress: None, True for a bar, or a function of the fraction done.
        interrupted: whether the run was interrupted before it began; then nothing is computed.
        part: its part of a checkpoint on disk; only for runs without an event log.
    """
    limit = 0 if interrupted else FOREVER if max_steps is None else max_steps
    if under_transformation(problem, loop_state, (ends, last_jumps)):
        loop_state, records = _advance(problem, plan, loop_state, ends, last_jumps, limit)
        kept = () if loop_state.carry.log is None else (loop_state.carry.log,)
        return Outcome(loop_state, records, _verdict(loop_state, ends, ATTEMPTS_SPENT), False, kept)
    blocks, records, budget, given, done = ends.shape[0], None, FIRST_ATTEMPTS, 0, 0.0
    logs: list[states.EventLog] = []
    report = reporter(progress)
    if part is not None:
        loop_state, records, given = part.begun(
            loop_state, lambda: eqx.filter_eval_shape(once, problem, plan, loop_state, ends, last_jumps, np.int32(0))[1]
        )
    pace, why, begun = Pace(loop_state, given, ends[-1], last_jumps[-1], plan.count_jumps), "", time.perf_counter()
    votes = StiffnessVotes(problem.method)
    try:
        while records is None or (not _finished(loop_state, blocks) and (limit == FOREVER or given < limit)):
            allowed = int(min(budget, votes.left(given), np.inf if limit == FOREVER else limit - given))
            clock, compiled = time.perf_counter(), compilations()
            loop_state, fresh = _advance(problem, plan, loop_state, ends, last_jumps, np.int32(allowed))
            records = fresh if records is None else _merge(records, fresh)
            loop_state, spent = _drain(loop_state, logs), _spent(loop_state, allowed)
            given += spent
            if part is not None:
                part.keep(loop_state, records, given)
            before, done = done, float(np.mean(np.asarray(loop_state.block))) / blocks  # waits for the call to end
            if done < 1.0 and compilations() == compiled:  # a call that compiled says nothing about the loop's speed
                seconds = time.perf_counter() - clock
                budget = int(
                    np.clip(spent * min(SECONDS_PER_CALL / seconds, MOST_FASTER), FEWEST_ATTEMPTS, MOST_ATTEMPTS)
                )
                if done > before:
                    left = (1 - done) / (done - before) * seconds
                    _advance.ahead(left, problem, plan, loop_state, ends, last_jumps, np.int32(allowed))
            votes.on_the_way(loop_state, given, functools.partial(_rates, problem, loop_state))
            if max_steps is None:
                stalled = pace.look(loop_state, given, functools.partial(_rates, problem, loop_state))
                undefined = {run for run in stalled if _is_undefined_ahead(problem, loop_state, run)}
                loop_state, said = given_up(loop_state, stalled, undefined)
                why = why or said
            report(done)
        votes.at_the_end(loop_state, given, functools.partial(_rates, problem, loop_state))
    except KeyboardInterrupt:
        if records is None:
            raise
        warnings.warn("interrupted: the result holds what was computed until then.", stacklevel=3)
        interrupted = True
    report(None)
    _advance.ended(time.perf_counter() - begun, problem, plan, loop_state, ends, last_jumps, np.int32(0))
    if part is not None:
        part.keep(loop_state, records, given, now=True)
    status = _verdict(loop_state, ends, np.int32(STATUS.interrupted) if interrupted else ATTEMPTS_SPENT)
    return Outcome(loop_state, records, status, interrupted, tuple(logs), why, votes.stiff)


def under_transformation(problem: RunProblem, loop_state: LoopState, targets) -> bool:
    """Whether a run is part of a traced program, and is computed by one call of the loop."""
    leaves = jax.tree.leaves((loop_state, problem, targets))
    return traced(leaves) or (transforming() and traced(enclosed(problem)))


def after_transient(problem: RunProblem, plan: RunPlan, loop_state: LoopState, quiet, targets, max_steps) -> Outcome:
    """Under a transformation: `drive` for a transient, and for what follows it, whose outcome this is.

    Both are the same loop, taken twice, so that its code is made once. Both have as many blocks: `quiet`, `targets`
    are each the ends and the last jumps of these.
    """
    limit = array(FOREVER if max_steps is None else max_steps, np.int32)
    runs: Any = _two_runs if traced(enclosed(problem)) else _compiled_two_runs
    loop_state, records, status = runs(problem, plan, loop_state, quiet, targets, limit)
    return Outcome(loop_state, records, status, False)


def _two_runs(problem: RunProblem, plan: RunPlan, loop_state: LoopState, quiet, targets, limit) -> tuple:
    def one(loop_state, targets):
        ends, last_jumps = targets
        loop_state, records = _advance(problem, plan, restart(loop_state), ends, last_jumps, limit)
        status = _verdict(loop_state, ends, ATTEMPTS_SPENT)
        return sealed(Outcome(loop_state, records, status, False)), (records, status)

    both = jax.tree.map(lambda *parts: jnp.stack(parts), quiet, targets)
    loop_state, found = jax.lax.scan(one, loop_state, both)
    return loop_state, *jax.tree.map(lambda leaf: leaf[-1], found)


_compiled_two_runs = eqx.filter_jit(_two_runs)  # else XLA compiles the scan in each derivative that is taken eagerly


def _place(loop_state: LoopState, run: int) -> tuple[Any, Any, Any]:
    """Time, state and mode of a run."""
    carry, several = loop_state.carry, loop_state.carry.x.ndim == 2
    t, x, mode = (
        np.asarray(leaf)[run] if several and np.ndim(leaf) else np.asarray(leaf)
        for leaf in (loop_state.base[..., 0] + carry.s, carry.x, mode_of(carry, np))
    )
    return t, x, mode


def _rates(problem: RunProblem, loop_state: LoopState, run: int) -> Rates | None:
    """The `Rates` at the present state of a run; None where they are not known."""
    return rates_at(problem, *_place(loop_state, run))


def _is_undefined_ahead(problem: RunProblem, loop_state: LoopState, run: int) -> bool:
    """Whether the field or a guard is not finite just ahead of a run: its steps shrink towards that point."""
    return problem.method is not None and not bool(_is_finite_ahead(problem, *_place(loop_state, run)))


@compiled()
def _is_finite_ahead(problem: RunProblem, t, x, mode):
    evolver = evolver_of(problem, t, x)
    assert isinstance(evolver, Stepping), "what has a method has fields"
    f = by_mode(mode, evolver.hybrid.fields, t, x)
    ahead = JUST_AHEAD * jnp.max(jnp.abs(x)) / jnp.maximum(jnp.max(jnp.abs(f)), nonzero(1e-300, f))
    t, x = t + ahead, x + ahead * f
    kinds = [evolver.hybrid.fields, *([evolver.hybrid.guards] if evolver.has_events else [])]
    return jnp.all(jnp.isfinite(jnp.concatenate([by_mode(mode, functions, t, x) for functions in kinds])))


def rates_at(problem: RunProblem, t, x, mode) -> Rates | None:
    """The `Rates` at a point; None where there is no vector field, or no derivative of it."""
    if problem.method is None:
        return None
    try:
        return Rates.of(*_rates_at(problem, t, x, mode))
    except Exception:  # for example a callback, which has no derivative
        return None


@compiled()
def _rates_at(problem: RunProblem, t, x, mode):
    evolver = evolver_of(problem, t, x)
    assert isinstance(evolver, Stepping), "what has a method has fields"
    return rates_of(lambda t, x: by_mode(mode, evolver.hybrid.fields, t, x), t, x)


def once(
    problem: RunProblem, plan: RunPlan, loop_state: LoopState, ends, last_jumps, budget
) -> tuple[LoopState, states.BlockRecord]:
    """One call of the compiled loop with a budget of step attempts."""
    return _advance(problem, plan, loop_state, ends, last_jumps, budget)


def sealed(outcome: Outcome) -> LoopState:
    """The loop's state of an outcome with its status stored in it, so that an unfinished run does not go on."""
    loop_state = outcome.loop_state
    return loop_state._replace(carry=loop_state.carry._replace(status=outcome.status))


def _spent(loop_state: LoopState, allowed: int) -> int:
    """The attempts of a call by the run that made most: fewer than allowed if the end, or a full log, was reached."""
    left = np.asarray(loop_state.carry.budget)[np.asarray(loop_state.carry.status) == RUNNING]
    return allowed - int(np.min(left, initial=allowed)) if left.size else allowed


def _drain(loop_state: LoopState, logs: list) -> LoopState:
    """Copy the events out of the log and empty it; the loop pauses when the log is full."""
    log = loop_state.carry.log
    if log is None:
        return loop_state
    # With NumPy, because JAX would compile a slice for every number of events.
    logs.append(jax.tree.map(lambda leaf, upto=int(log.count): np.array(leaf)[:upto], log._replace(count=None)))
    emptied = log._replace(count=as_jax(np.zeros_like(np.asarray(log.count))))
    return loop_state._replace(carry=loop_state.carry._replace(log=emptied))


def _finished(loop_state: LoopState, blocks: int) -> bool:
    running = np.asarray(loop_state.carry.status) == 0
    return not bool(np.any(running & (np.asarray(loop_state.block) < blocks)))


def _verdict(loop_state: LoopState, ends, otherwise):
    """The status of a run; `otherwise` if it is still running and blocks are left."""
    xp = numpy_for(loop_state.carry.status)
    status, block = xp.asarray(loop_state.carry.status), xp.asarray(loop_state.block)
    return xp.where((status == RUNNING) & (block < ends.shape[0]), otherwise, status)


def _merge(old, new):
    """Records of an earlier call, overwritten for blocks finished by the later call; in NumPy, without compiling."""
    finished = np.asarray(new.valid)

    def leaf(a, b):
        return np.where(finished.reshape(finished.shape + (1,) * (b.ndim - finished.ndim)), b, a)

    return jax.tree.map(leaf, old, new)
