"""The one loop: Tangent -> step -> event? -> cross -> orthonormalise -> collect.

    block     until its end
      span    steps, until an event has to be located or an orthonormalisation is due
        step  propose a step; accept it and propagate the tangent, or reject it and retry with a smaller step

The innermost loop is straight-line code with a small state; rare operations are done one loop further out. An *evolver*
advances one class of systems: `Stepping` (a vector field with guards), `Exact` (closed-form flow, next event known),
`Scheduled` (the same for many bodies), `Iterating` (a map). Every analysis that needs tangents calls `advance` and
passes a function that says what to collect. Time is local to the block; the global time is formed only where the
user's functions need it.
"""

import functools

import jax
import jax.numpy as jnp

from .._jax.reverse_mode import checkpointed
from .._linalg.lost_directions import may_be_rounding
from ..events.compiled_hybrid import by_mode
from ..native import seldom
from ..statuses import OK, RUNNING, STATUS
from . import stalling, waiting
from .orthonormalising import needs_twice_the_digits, orthonormalise, step_with_twice_the_digits
from .states import BlockRecord, Clock, LoopState, Settings, StepState, most_at_once, select, stop

__all__ = ["advance"]


def advance(settings: Settings, loop_state: LoopState, ends, last_jumps, budget) -> tuple[LoopState, BlockRecord]:
    """Run the blocks that are not finished yet, until all are finished or the budget of step attempts is spent.

    Args:
        settings: static.
        loop_state: the present state of the run.
        ends: (blocks,) end of each block, in time since the run began (inf where jumps alone end it).
        last_jumps: (blocks,) number of jumps since the run began at which the block ends as well.
        budget: most step attempts in this call.
    """
    budget = jnp.where(_running(loop_state), jnp.asarray(budget, jnp.int32), 0)
    carry, window = stalling.begun(loop_state.carry, loop_state.elapsed, budget)
    last_jump = jax.lax.stop_gradient(last_jumps[-1]).astype(jnp.int32) if settings.count_jumps else None
    goal = stalling.Goal(ends[-1], last_jump)

    def one(state, block):
        return _block(settings, goal, *state, *block)

    one = jax.checkpoint(one) if settings.reverse else one
    blocks = jnp.arange(ends.shape[0], dtype=jnp.int32), ends, last_jumps
    (loop_state, _), records = jax.lax.scan(one, (loop_state._replace(carry=carry), window), blocks)
    return loop_state, records


def _running(loop_state: LoopState):
    return loop_state.carry.status == RUNNING


def _block(
    settings: Settings, goal: stalling.Goal, loop_state: LoopState, window: stalling.Window, index, end, last_jump
):
    """Run one block; does nothing if the block is finished, the budget is spent or the run has ended."""
    by_time = loop_state.interval if settings.qr_schedule.unit == "time" else None
    clock = Clock(loop_state.base[0], loop_state.base[1], end - loop_state.elapsed, last_jump, by_time)
    todo = (loop_state.block == index) & (loop_state.carry.budget > 0)

    def within(carry, in_span=False):
        inside = _inside(settings, clock, carry)
        if carry.log is not None:  # leave room for one event and its whole cascade
            inside = inside & (carry.log.count <= settings.log - most_at_once(carry.x, carry.log))
        if not in_span:
            return inside & (carry.budget > 0)
        # Where ending a span changes rounding, the budget must not end it: results may not depend on how the host
        # divides the work into calls.
        whole = settings.evolver.by_rows or (settings.evolver.always_regular and settings.qr_schedule.unit != "never")
        return inside & ((carry.status == RUNNING) if whole else (carry.budget > 0))

    def span(state):
        carry, window = state[0], state[-1]
        after, *rest = _end_if_no_jump(settings, clock, carry, _span(settings, clock, within, *state[:-1]))
        if settings.evolver.flies_by_schedule:  # a flight is an attempt, for a run may consist of flights alone
            after = after._replace(budget=jnp.minimum(after.budget, carry.budget - 1))
        after, window = stalling.looked(window, after, loop_state.elapsed, goal)
        return after, *rest, window

    # The block's code always runs; budget 0 keeps a block that is not due from doing anything.
    start = loop_state.carry._replace(budget=jnp.where(todo, loop_state.carry.budget, 0))
    state = (start, settings.evolver.enter(start, clock), loop_state.interval, loop_state.spread, window)
    carry, _, interval, spread, window = _repeated(settings, lambda state: within(state[0]), span, state)
    carry = stop(carry, STATUS.nonfinite, ~jnp.all(jnp.isfinite(carry.x)))
    carry = settings.evolver.inspected(carry, clock)
    done = todo & ((~_inside(settings, clock, carry) & (carry.status == RUNNING)) | (carry.status > OK))
    record = BlockRecord(
        done,
        carry.s,
        carry.jumps,
        carry.growth,
        carry.log_volume,
        carry.losses,
        carry.order,
        settings.collect(clock.base + carry.s, carry),
    )
    carry = carry._replace(budget=jnp.where(todo, carry.budget, loop_state.carry.budget))
    here = LoopState(carry, loop_state.base, loop_state.elapsed, loop_state.block, interval, spread)
    return (select(done, _next_block(settings, here), here), window), record


def _inside(settings: Settings, clock: Clock, carry: StepState):
    """Whether the end of the block, in time and in jumps, is still ahead."""
    inside = (carry.s < clock.length) | settings.evolver.ticks_now(carry, clock)
    return inside & (carry.jumps.astype(carry.s.dtype) < clock.last_jump) if settings.count_jumps else inside


def _end_if_no_jump(settings: Settings, clock: Clock, before: StepState, state):
    """After a span of a block that only a number of jumps ends: if no jump is expected, end the run at the last one."""
    if before.waiting is None:
        return state
    carry = state[0]
    carry = carry._replace(waiting=waiting.waited(settings, clock, before, carry))
    ends = waiting.hopeless(carry.waiting, clock) & (carry.status == RUNNING)
    kept = carry._replace(growth=carry.waiting.growth, log_volume=carry.waiting.log_volume)
    return (stop(select(ends, kept, carry), STATUS.no_more_jumps, ends), *state[1:])


def _span(settings: Settings, clock: Clock, within, carry: StepState, ahead, interval, spread):
    """One span. If it seems to lose a direction, discard it and do only its first step, in double-double arithmetic."""
    start = carry, ahead, interval, spread
    end = _quick_span(settings, clock, within, *start)
    if not needs_twice_the_digits(settings, clock, carry, ahead):
        return end
    before = jnp.sum(carry.losses)
    # Where directions are lost, an entry that may be rounding may decide later whether another one is: look now.
    may_hide = jax.lax.cond(before > 0, may_be_rounding, lambda _: jnp.asarray(False), end[0].frame)
    loses = jnp.sum(end[0].losses) > before
    once_more = seldom(functools.partial(step_with_twice_the_digits, settings, clock))
    whole = settings.evolver.tells_whole_step(end[0])
    if settings.qr_schedule.automatic:  # as after a loss that is looked at closely
        end = (*end[:2], jnp.where(loses, jnp.ones_like(end[2]), end[2]), end[3])
    return jax.lax.cond((loses | may_hide) & whole, lambda start, _: once_more(*start), lambda _, end: end, start, end)


def _quick_span(settings: Settings, clock: Clock, within, carry: StepState, ahead, interval, spread):
    """Steps until an event or an orthonormalisation is due; then handle that."""
    evolver, frequent = settings.evolver, settings.qr_schedule.unit != "never" and carry.frame.shape[1] > 0

    def is_due(carry):
        enough = carry.since >= interval
        if settings.qr_schedule.automatic and evolver.jumps_uncontrolled:
            enough = enough | evolver.stretched(carry)
        return enough

    def goes_on(state):
        carry, ahead, _ = state
        return within(carry, in_span=True) & evolver.is_regular(ahead) & (~is_due(carry) if frequent else True)

    def stepping(evolver):
        def step(state):
            carry, ahead, spread = state
            if at_once:  # compute the trial and its tangent together
                ahead = evolver.propose_step(carry, clock)
            carry = evolver.step(settings, clock, carry._replace(budget=carry.budget - 1), ahead)
            if at_once:
                # After a rejected step the frame is still orthonormal: orthonormalising it again adds ln 1 = 0.
                carry, _, _, spread = orthonormalise(settings, clock, carry, ahead, interval, spread)
            return carry, ahead if at_once else evolver.propose_step(carry, clock), spread

        return step

    at_once = frequent and _at_once(settings)
    if _step_by_step(settings):
        carry, ahead, spread = stepping(evolver)((carry, ahead, spread))
    elif settings.reverse:  # the loop over spans keeps the checkpoints; a span is then at most one step
        state = carry, ahead, spread
        carry, ahead, spread = jax.lax.cond(goes_on(state), stepping(evolver), lambda state: state, state)
    else:
        steps = [stepping(one) for one in evolver.in_each_mode()]
        loops = [lambda state, step=step: jax.lax.while_loop(goes_on, step, state) for step in steps]
        carry, ahead, spread = by_mode(getattr(carry.solver_state, "mode", None), loops, (carry, ahead, spread))
    due = frequent and evolver.by_rows and is_due(carry)  # before `locate_events`, which resets `stretch`
    carry, ahead = evolver.locate_events(settings, clock, functools.partial(within, in_span=True), carry, ahead)
    if not frequent:
        return carry, ahead, interval, spread
    due = due | is_due(carry) | (carry.s >= clock.length)
    if settings.count_jumps:
        due = due | (carry.jumps.astype(carry.s.dtype) >= clock.last_jump) | (carry.status == STATUS.no_more_jumps)
    # An event or a flight that is next comes first, also if the host's call ends in between: rounding would differ.
    # But a flight may end at this very orthonormalisation: what is next is then another one.
    if clock.interval is None or not evolver.flies_by_schedule:
        due = due & (evolver.is_regular(ahead) | (carry.status != RUNNING) | ~_inside(settings, clock, carry))
    if evolver.always_regular and not settings.count_jumps:  # then only an orthonormalisation ends a span
        return orthonormalise(settings, clock, carry, ahead, interval, spread)
    return jax.lax.cond(
        due,
        lambda *state: orthonormalise(settings, clock, *state),
        lambda *state: state,
        carry,
        ahead,
        interval,
        spread,
    )


def _step_by_step(settings: Settings) -> bool:
    """Whether each span is one step."""
    return settings.evolver.always_regular and settings.qr_schedule.each


def _at_once(settings: Settings) -> bool:
    """Whether each step of the innermost loop also orthonormalises, which is cheaper than a span of its own."""
    evolver = settings.evolver
    alone = settings.observer is None and not evolver.may_lose_rank and not evolver.by_rows
    return alone and settings.qr_schedule.each and not evolver.always_regular


def _repeated(settings: Settings, goes_on, step, state):
    """A while loop; with checkpoints where a reverse pass follows."""
    return (checkpointed if settings.reverse else jax.lax.while_loop)(goes_on, step, state)


def _next_block(settings: Settings, loop_state: LoopState) -> LoopState:
    """Move the time base to the end of the block (exact sums) and set the block's sums to zero."""
    carry, (high, low) = loop_state.carry, (loop_state.base[0], loop_state.base[1])
    total = high + carry.s
    back = total - high
    low = low + ((high - (total - back)) + (carry.s - back))
    # Fields are given the rounded base alone: the remainder must not grow from block to block.
    rounded = total + low
    low = low - (rounded - total)

    def cleared(sums):
        return jax.tree.map(jnp.zeros_like, sums)

    carry = carry._replace(
        s=jnp.zeros_like(carry.s),
        growth=cleared(carry.growth),
        log_volume=cleared(carry.log_volume),
        left=cleared(carry.left),
        order=None if carry.order is None else jnp.arange(carry.order.shape[0], dtype=jnp.int32),
        solver_state=settings.evolver.rebase(carry.solver_state, carry.s),
        waiting=waiting.next_block(carry.waiting, cleared(carry.growth), cleared(carry.log_volume)),
        observer=None if settings.observer is None else settings.observer.next_block(carry.observer),
    )
    base, elapsed = jnp.stack([rounded, low]), loop_state.elapsed + loop_state.carry.s
    return LoopState(carry, base, elapsed, loop_state.block + 1, loop_state.interval, loop_state.spread)
