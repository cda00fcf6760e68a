"""The one loop: Tangent -> step -> event? -> cross -> orthonormalise -> collect.

    block     until its end
      span    until something rare is due: an event to locate and land on, an orthonormalisation
        step  look ahead by a trial; keep it and carry the tangent, or try again smaller

The innermost loop is straight-line code with a small state; what is rare stands one loop further out. A *mover* knows
how its kind of system moves: `Stepping` (a field under guards), `Exact` (the next event is known), `Scheduled` (the
same for many bodies), `Iterating` (a map). Everything that needs tangents calls `advance` and says what to collect.
Time is local to the block: the global time only enters where the user's functions ask for it.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array

from . import frames, lost_directions, waiting
from .columns import each_column
from .events import by_mode
from .native import seldom
from .precision import is_short, share
from .reverse_mode import checkpointed
from .statuses import OK, RUNNING, STATUS
from .waiting import Waiting

LONGEST_BLIND = 4.0  # jumps between two orthonormalisations, where each may destroy a direction
STRETCHED = 100.0  # a larger entry of a frame ends the interval there: a grazing jump must not look like a loss
MOST_AT_ONCE = 64  # jumps at one instant that an event log must have room for

__all__ = [
    "Carry", "Cadence", "ErrorWatch", "Events", "Record", "Seen", "Settings", "Watch", "added", "advance", "begin",
    "restart",
]  # fmt: skip


class Cadence(NamedTuple):
    """When an orthonormalisation is due: after so much of a unit since the last one."""

    unit: str  # "steps" | "time" | "jumps" | "never"
    automatic: bool  # lengthen and shorten the interval from the growth that is seen
    each: bool = False  # after each step: where nothing is rare, a span is then one step, and needs no loop


class Seen(NamedTuple):
    """One orthonormalisation."""

    t: Array
    before: Array  # (n, k) the frame before
    frame: Array  # (n, k) after it; zero where lost
    log_r: Array  # (k,) ln R_ii; zero where lost
    lost: Array  # (k,)
    velocity: Callable  # () -> (n,) the flow's, where there is one


class Watch(Protocol):
    """What indicators follow from one orthonormalisation to the next, as a state of arrays."""

    def begin(self, t, frame) -> Any:
        """The state at the start of a run, or of its part that counts."""
        ...

    def update(self, state: Any, seen: Seen) -> Any:
        """The state after an orthonormalisation."""
        ...

    def moved(self, state: Any, source) -> Any:
        """The state after the columns of the frame have changed places: new[i] came from old[source[i]]."""
        ...

    def next_block(self, state: Any) -> Any:
        """The state at the start of the next block."""
        ...


@runtime_checkable
class ErrorWatch(Watch, Protocol):
    """A watch that also looks at the error estimates of the steps."""

    def stepped(self, state: Any, errors: Array) -> Any:
        """The state after a step of the method with these estimates (estimates, n, k) of the frame's errors."""
        ...


class Settings(NamedTuple):
    """What is fixed at compile time."""

    mover: Any
    cadence: Cadence
    kind: str  # of orthonormalisation
    sum_rule: bool  # ∫ tr Df and Σ ln|det S| are collected
    log: int  # room for so many events; 0: none are kept
    count_jumps: bool  # a block may end by its number of jumps
    collect: Callable  # (t, carry) -> what is recorded at the end of a block
    watch: Any = None  # a `Watch`: what follows the orthonormalisations
    reverse: bool = False  # loops keep checkpoints, for a reverse pass


class Events(NamedTuple):
    """The log of events, `count` of which are filled; time is local until the block's end."""

    count: Any
    t: Array
    transition: Array
    which: Any
    mode_before: Array
    mode_after: Array
    x_before: Array
    x_after: Array


class Left(NamedTuple):
    """What rounding left over of the sums of a block: sums of thousands of terms cost float32 its digits."""

    s: Array
    growth: Array
    volume: Any


class Carry(NamedTuple):
    """The state of the innermost loop. What a run does not need is None, and costs nothing."""

    s: Array  # time since the start of the block
    x: Array  # (n,)
    frame: Array  # (n, k)
    since: Array  # steps, time or jumps since the last orthonormalisation
    budget: Array  # attempts left before control returns to the host; 0 also where the run has ended
    status: Array
    jumps: Array
    growth: Array  # (k,) Σ ln R_ii of the block
    volume: Any  # ∫ tr Df + Σ ln|det S| of the block
    losses: Any  # (k,)
    first_loss: Any  # (k,), time of the first loss of each column, nan before
    order: Any  # (k,) where each column stood at the start of the block
    own: Any  # the mover's
    log: Events | None
    watch: Any = None  # the state of a `Watch`
    left: Left | None = None  # None in float64
    waiting: Waiting | None = None  # None where jumps end no block


class Journey(NamedTuple):
    """What changes only from block to block."""

    carry: Carry
    base: Array  # (2,) time at the start of the block: rounded, and what rounding left over
    elapsed: Array  # time since the run began
    block: Array  # number of blocks done
    interval: Array  # between orthonormalisations
    spread: Array  # largest ln(R_11 / R_kk) of one orthonormalisation


class Record(NamedTuple):
    """One block's harvest; `valid` is False where the block was not finished in this call."""

    valid: Array
    duration: Array
    jumps: Array
    growth: Array
    volume: Any
    losses: Any
    order: Any
    collected: Any


class Clock(NamedTuple):
    """What the mover sees of time: the base of the block, its length, and its last jump."""

    base: Array
    rest: Array  # what rounding the base left over
    length: Array
    last_jump: Array
    interval: Any = None  # between orthonormalisations, where these come by time

    def limit(self, carry: Carry):
        """Where a flight ends that meets no event: with the block, or at the next orthonormalisation by time."""
        if self.interval is None:
            return self.length
        return jnp.minimum(self.length, carry.s + jnp.maximum(self.interval - carry.since, 0.0))

    def flown(self, carry: Carry, end):
        """`Carry.since` after such a flight: at an orthonormalisation by time the whole interval, without rounding."""
        return jnp.where(end < self.length, self.interval, carry.since + (end - carry.s))

    def afresh(self, carry: Carry) -> Carry:
        """The carry as it goes on after an orthonormalisation by time, if one is due."""
        return carry._replace(since=jnp.where(carry.since >= self.interval, 0.0, carry.since))


def begin(settings: Settings, t0, x, frame, mode, h, interval) -> Journey:
    """The start of a run at (t0, x) with the given frame.

    Args:
        settings: static.
        t0: time.
        x: (n,) state.
        frame: (n, k); what is not in the tangent space of the mode is taken out of it.
        mode: index; None: the mode to which the state belongs. A negative one is a deadlock.
        h: the mover's first step; None: guessed.
        interval: between orthonormalisations.
    """
    k = frame.shape[1]
    mode = settings.mover.initial_mode(t0, x) if mode is None else jnp.asarray(mode, jnp.int32)
    possible = mode >= 0
    mode = jnp.maximum(mode, 0)
    x, wrong = settings.mover.admitted(t0, x, mode)
    zero, none = jnp.zeros_like(t0), jnp.zeros(k, x.dtype)
    tracks = settings.mover.may_lose_rank and k > 0
    volume = zero if settings.sum_rule else None
    carry = Carry(
        s=zero,
        x=x,
        frame=frame,
        since=zero,
        budget=jnp.asarray(0, jnp.int32),
        status=jnp.asarray(RUNNING, jnp.int32),
        jumps=jnp.asarray(0, jnp.int32),
        growth=none,
        volume=volume,
        losses=jnp.zeros(k, jnp.int32) if tracks else None,
        first_loss=jnp.full(k, jnp.nan, x.dtype) if tracks else None,
        order=jnp.arange(k, dtype=jnp.int32) if tracks else None,
        own=settings.mover.begin(t0, x, mode, h),
        log=_empty_log(settings, t0, x) if settings.log else None,
        left=Left(zero, none, volume) if is_short(x) else None,
        waiting=waiting.begun(x, none, volume) if settings.count_jumps else None,
    )
    carry = stop(_within_mode(settings, carry, t0, mode) if k else carry, STATUS.deadlock, ~possible)
    carry = stop(carry, STATUS.inconsistent_start, wrong)
    if settings.watch is not None:
        carry = carry._replace(watch=settings.watch.begin(t0, carry.frame))
    return Journey(carry, jnp.stack([t0, zero]), zero, jnp.asarray(0, jnp.int32), interval, zero)


def _within_mode(settings: Settings, carry: Carry, t, mode) -> Carry:
    """A frame of the tangent space of the mode: what is lost of it here is no loss of the motion."""
    project = settings.mover.onto_mode(mode, t, carry.x)
    if project is None:
        return carry
    carry = carry._replace(frame=each_column(project, carry.frame))
    if settings.cadence.unit == "never":
        return carry
    kept = carry.growth, carry.order, carry.left
    unwatched = settings._replace(watch=None)
    least = 0.0 if carry.losses is None else frames.LOST
    carry, _ = harvest(unwatched, carry, t, least, least, project, was_live=False)
    return carry._replace(growth=kept[0], order=kept[1], left=kept[2])


def _empty_log(settings: Settings, t, x) -> Events:
    room = settings.log
    integers = jnp.zeros(room, jnp.int32)
    which = jax.tree.map(lambda leaf: jnp.zeros(room, leaf.dtype), settings.mover.which_shape(t, x))
    points = jnp.zeros((room, *x.shape), x.dtype)
    times = jnp.zeros(room, x.dtype)
    return Events(jnp.asarray(0, jnp.int32), times, integers, which, integers, integers, points, points)


def advance(settings: Settings, journey: Journey, ends, last_jumps, budget) -> tuple[Journey, Record]:
    """Go on with the blocks that are not done, until they are, or the budget of attempts is spent.

    Args:
        settings: static.
        journey: where the run stands.
        ends: (blocks,) end of each block, in time since the run began (inf where jumps alone end it).
        last_jumps: (blocks,) number of jumps, counted from the start, that ends the block too.
        budget: attempts.
    """
    budget = jnp.where(_running(journey), budget, 0)
    journey = journey._replace(carry=journey.carry._replace(budget=budget))

    def one(journey, block):
        return _block(settings, journey, *block)

    one = jax.checkpoint(one) if settings.reverse else one
    return jax.lax.scan(one, journey, (jnp.arange(ends.shape[0], dtype=jnp.int32), ends, last_jumps))


def _running(journey: Journey):
    return journey.carry.status == RUNNING


def _block(settings: Settings, journey: Journey, index, end, last_jump):
    """One block; or nothing where it was done before, the budget is spent or the run is over."""
    by_time = journey.interval if settings.cadence.unit == "time" else None
    clock = Clock(journey.base[0], journey.base[1], end - journey.elapsed, last_jump, by_time)
    todo = (journey.block == index) & (journey.carry.budget > 0)

    def within(carry, in_span=False):
        inside = carry.s < clock.length
        if settings.count_jumps:
            inside = inside & (carry.jumps.astype(carry.s.dtype) < clock.last_jump)
        if carry.log is not None:  # one event, with its cascade, must find room
            inside = inside & (carry.log.count <= settings.log - MOST_AT_ONCE)
        if not in_span:
            return inside & (carry.budget > 0)
        # Where the end of a span changes rounding, how the host divides the work must not decide where spans end.
        whole = settings.mover.by_rows or (settings.mover.always_common and settings.cadence.unit != "never")
        return inside & ((carry.status == RUNNING) if whole else (carry.budget > 0))

    # A block always runs once through: what is not to be done is stopped by the budget.
    start = journey.carry._replace(budget=jnp.where(todo, journey.carry.budget, 0))
    state = (start, settings.mover.enter(start, clock), journey.interval, journey.spread)
    carry, _, interval, spread = _repeated(
        settings,
        lambda state: within(state[0]),
        lambda state: _waited(settings, clock, state[0], _span(settings, clock, within, *state)),
        state,
    )
    carry = stop(carry, STATUS.nonfinite, ~jnp.all(jnp.isfinite(carry.x)))
    carry = settings.mover.inspected(carry, clock)
    over = carry.s >= clock.length
    if settings.count_jumps:
        over = over | (carry.jumps.astype(carry.s.dtype) >= clock.last_jump)
    done = todo & ((over & (carry.status == RUNNING)) | (carry.status > OK))
    record = Record(
        done,
        carry.s,
        carry.jumps,
        carry.growth,
        carry.volume,
        carry.losses,
        carry.order,
        settings.collect(clock.base + carry.s, carry),
    )
    carry = carry._replace(budget=jnp.where(todo, carry.budget, journey.carry.budget))
    here = Journey(carry, journey.base, journey.elapsed, journey.block, interval, spread)
    return _select(done, _next_block(settings, here), here), record


def _waited(settings: Settings, clock: Clock, before: Carry, state):
    """After a span, where jumps alone end a block: if there will be none any more, the run ends with the last one."""
    if before.waiting is None:
        return state
    carry = state[0]
    carry = carry._replace(waiting=waiting.waited(settings.mover, clock, before, carry))
    ends = waiting.hopeless(carry.waiting, clock) & (carry.status == RUNNING)
    kept = carry._replace(growth=carry.waiting.growth, volume=carry.waiting.volume)
    return (stop(_select(ends, kept, carry), STATUS.no_more_jumps, ends), *state[1:])


def _select(condition, yes, no):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _span(settings: Settings, clock: Clock, within, carry: Carry, ahead, interval, spread):
    """Steps, until something rare is due; then that. Where it seems to lose a direction, its first step with care."""
    start = carry, ahead, interval, spread
    end = _quick_span(settings, clock, within, *start)
    if not _takes_care(settings, clock, carry, ahead):
        return end
    loses = jnp.sum(end[0].losses) > jnp.sum(carry.losses)
    once_more = seldom(functools.partial(_with_care, settings, clock))
    return jax.lax.cond(loses, lambda start, _: once_more(*start), lambda _, end: end, start, end)


def _takes_care(settings: Settings, clock: Clock, carry: Carry, ahead) -> bool:
    """Whether columns are judged by their lengths alone, behind jumps that may do anything; and could be otherwise."""
    mover = settings.mover
    if settings.cadence.unit == "never" or carry.frame.shape[1] == 0 or settings.reverse:
        return False
    if not (mover.jumps_uncontrolled and mover.may_lose_rank):
        return False
    return lost_directions.is_precise(mover.tangent(clock, carry, ahead), carry.x)


def _with_care(settings: Settings, clock: Clock, carry: Carry, ahead, interval, spread):
    """One step in twice the digits, and what it loses."""
    mover, t = settings.mover, clock.base + carry.s

    def orthonormal(carry, spread):  # the span goes on with a frame that the last one has left as it was
        carry, gained = harvest(settings, carry, t, -jnp.inf, frames.DEPENDENT)
        return carry, jnp.maximum(spread, jnp.max(gained) - jnp.min(gained))

    carry, spread = jax.lax.cond(carry.since > 0, orthonormal, lambda *same: same, carry, spread)
    before, tangent = carry, mover.tangent(clock, carry, ahead)
    carry = mover.once(settings, clock, carry._replace(budget=carry.budget - 1), ahead)
    if carry.volume is not None:
        left = carry.left and before.left and carry.left._replace(volume=before.left.volume)
        carry = carry._replace(volume=before.volume, left=left)
        carry = added(carry, volume=lost_directions.volume(tangent, len(carry.x), carry.x.dtype))
    *found, sure = lost_directions.orthonormalised(tangent, before.frame)
    sane = jnp.all(jnp.isfinite(found[1]))
    found[1] = jnp.where(sane, found[1], 0.0)
    carry = stop(_harvested(settings, carry, clock.base + carry.s, found), STATUS.nonfinite, ~sane)
    interval = jnp.ones_like(interval) if settings.cadence.automatic else interval
    spread = jnp.where(sure, spread, jnp.inf)
    return carry._replace(since=jnp.zeros_like(carry.since)), mover.look(carry, clock), interval, spread


def _quick_span(settings: Settings, clock: Clock, within, carry: Carry, ahead, interval, spread):
    """Steps, until something rare is due; then that."""
    mover, frequent = settings.mover, settings.cadence.unit != "never" and carry.frame.shape[1] > 0

    def is_due(carry):
        enough = carry.since >= interval
        if settings.cadence.automatic and mover.jumps_uncontrolled:
            enough = enough | mover.stretched(carry)
        return enough

    def goes_on(state):
        carry, ahead, _ = state
        return within(carry, in_span=True) & mover.common(ahead) & (~is_due(carry) if frequent else True)

    def stepping(mover):
        def step(state):
            carry, ahead, spread = state
            if at_once:  # the trial and its tangent side by side
                ahead = mover.look(carry, clock)
            carry = mover.step(settings, clock, carry._replace(budget=carry.budget - 1), ahead)
            if at_once:
                # A step that failed has left the frame orthonormal: nothing is gained or lost by doing it again.
                carry, _, _, spread = _tidy(settings, clock, carry, ahead, interval, spread)
            return carry, ahead if at_once else mover.look(carry, clock), spread

        return step

    k, at_once = carry.frame.shape[1], frequent and _at_once(settings)
    carry = carry._replace(frame=frames.staggered(carry.frame) if mover.by_rows else carry.frame)
    if _step_by_step(settings):
        carry, ahead, spread = stepping(mover)((carry, ahead, spread))
    elif settings.reverse:  # the loop over spans is the one that keeps checkpoints
        state = carry, ahead, spread
        carry, ahead, spread = jax.lax.cond(goes_on(state), stepping(mover), lambda state: state, state)
    else:
        steps = [stepping(one) for one in mover.in_each_mode()]
        loops = [lambda state, step=step: jax.lax.while_loop(goes_on, step, state) for step in steps]
        carry, ahead, spread = by_mode(getattr(carry.own, "mode", None), loops, (carry, ahead, spread))
    carry = carry._replace(frame=carry.frame[:, :k])
    due = frequent and mover.by_rows and is_due(carry)  # to settle such a span is to forget what it did to the frame
    carry, ahead = mover.settle(settings, clock, functools.partial(within, in_span=True), carry, ahead)
    if not frequent:
        return carry, ahead, interval, spread
    due = due | is_due(carry) | (carry.s >= clock.length)
    if settings.count_jumps:
        due = due | (carry.jumps.astype(carry.s.dtype) >= clock.last_jump) | (carry.status == STATUS.no_more_jumps)
    if mover.always_common and not settings.count_jumps:  # then nothing but this ends a span
        return _tidy(settings, clock, carry, ahead, interval, spread)
    tidied = jax.lax.cond(
        due,
        lambda *state: _tidy(settings, clock, *state),
        lambda *state: state,
        carry,
        ahead,
        interval,
        spread,
    )
    return tidied


def _step_by_step(settings: Settings) -> bool:
    """Whether each span is one step."""
    return settings.mover.always_common and settings.cadence.each


def _at_once(settings: Settings) -> bool:
    """Whether a step and its orthonormalisation are one: a span for each is half as much again."""
    mover = settings.mover
    alone = settings.watch is None and not mover.may_lose_rank and not mover.by_rows
    return alone and settings.cadence.each and not mover.always_common


def _repeated(settings: Settings, goes_on, step, state):
    """A loop."""
    return (checkpointed if settings.reverse else jax.lax.while_loop)(goes_on, step, state)


def _tidy(settings: Settings, clock: Clock, carry: Carry, ahead, interval, spread):
    """Orthonormalise: where it is due, and at the end of a block so that the sum rule closes."""
    before, carry = (carry.growth, carry.left), settings.mover.kept_to_constraints(carry, clock)
    if settings.mover.jumps_uncontrolled and settings.mover.may_lose_rank:
        # By time each jump that may destroy a direction is orthonormalised by itself.
        jumps = 1.0 if settings.cadence.unit == "time" else carry.since
        absolute = settings.mover.least_length(carry, jumps)
        carry, gained = harvest(settings, carry, clock.base + carry.s, absolute, frames.DEPENDENT)
    else:
        carry, gained = harvest(settings, carry, clock.base + carry.s)
    seen = jnp.maximum(jnp.max(gained), 0.0) - jnp.minimum(jnp.min(gained), 0.0)
    sane = jnp.isfinite(seen)
    growth, left = _select(sane, (carry.growth, carry.left), before)
    carry = stop(carry._replace(growth=growth, left=left), STATUS.nonfinite, ~sane)
    spread = jnp.maximum(spread, jnp.where(sane, seen, 0.0))
    if settings.cadence.automatic:
        # Growth varies, so an interval is never long: that of a map or a jump may do anything, that of a step is
        # bounded by its error control. Only where there are many bodies a jump does little to the whole.
        longest, aim = settings.mover.longest_interval, settings.mover.spread_wanted
        full = carry.since >= interval
        wanted = jnp.clip(aim * interval / jnp.maximum(seen, 1e-3), 0.5 * interval, 2 * interval)
        wanted = jax.lax.stop_gradient(wanted)
        interval = jnp.where(full | (wanted < interval), jnp.clip(jnp.floor(wanted), 1.0, longest), interval)
    return carry._replace(since=jnp.zeros_like(carry.since)), ahead, interval, spread


def stretched(carry: Carry):
    """Whether jumps have stretched a column so much that it must be orthonormalised at once."""
    return jnp.max(jnp.abs(carry.frame)) > STRETCHED ** share(carry.frame)


def harvest(
    settings: Settings,
    carry: Carry,
    t,
    absolute: Any = 0.0,
    relative=0.0,
    project=None,
    was_live: Any = True,
    sizes=None,
) -> tuple[Carry, Array]:
    """Orthonormalise the frame and add ln R_ii to the growth; also returns ln R_ii of the columns as they stood.

    Where a tolerance is given columns may be lost: they are counted, and replaced.

    Args:
        settings: static.
        carry: with the frame.
        t: the time, for the record.
        absolute: tolerance of `frames.orthonormalise`.
        relative: the same.
        project: onto the tangent space of the mode; None: there is no constraint.
        was_live: (k,), columns that were not empty before.
        sizes: of `frames.orthonormalise`.
    """
    found = frames.orthonormalise(carry.frame, settings.kind, absolute, relative, sizes)
    return _harvested(settings, carry, t, found, frames.tracked(relative), project, was_live), found[1]


def _harvested(settings: Settings, carry: Carry, t, found, tracked=True, project=None, was_live: Any = True) -> Carry:
    """What an orthonormalisation of the frame has found: columns, ln R_ii, and which are lost."""
    frame, log_r, lost = found
    if settings.watch is not None:
        seen = Seen(t, carry.frame, frame, log_r, lost, lambda: settings.mover.velocity(t, carry.x, carry.own))
        carry = carry._replace(watch=settings.watch.update(carry.watch, seen))
    carry = added(carry._replace(frame=frame), growth=log_r)
    if not tracked:
        return carry
    live, lost = ~lost, lost & was_live

    def replace(carry, lost, live):
        frame, source = frames.refill(carry.frame, project or (lambda dx: dx), live)
        count = jnp.sum(live)
        places = jnp.arange(live.shape[0])
        now = (places >= count) & (places < count + jnp.sum(lost))
        first = carry.first_loss[source]
        first = jnp.where(jnp.isnan(first) & now, t, first)
        return carry._replace(
            frame=frame,
            growth=carry.growth[source],
            left=carry.left and carry.left._replace(growth=carry.left.growth[source]),
            losses=carry.losses[source] + now.astype(jnp.int32),
            first_loss=first,
            order=carry.order[source],
            watch=None if settings.watch is None else settings.watch.moved(carry.watch, source),
        )

    return jax.lax.cond(jnp.all(live), lambda c, *_: c, replace, carry, lost, live)


def _next_block(settings: Settings, journey: Journey) -> Journey:
    """Rebase time to the end of the block (two-sum: no digit is lost) and start new sums."""
    carry, (high, low) = journey.carry, (journey.base[0], journey.base[1])
    total = high + carry.s
    back = total - high
    low = low + ((high - (total - back)) + (carry.s - back))

    def cleared(sums):
        return jax.tree.map(jnp.zeros_like, sums)

    carry = carry._replace(
        s=jnp.zeros_like(carry.s),
        growth=cleared(carry.growth),
        volume=cleared(carry.volume),
        left=cleared(carry.left),
        order=None if carry.order is None else jnp.arange(carry.order.shape[0], dtype=jnp.int32),
        own=settings.mover.rebase(carry.own, carry.s),
        waiting=waiting.next_block(carry.waiting, cleared(carry.growth), cleared(carry.volume)),
        watch=None if settings.watch is None else settings.watch.next_block(carry.watch),
    )
    base, elapsed = jnp.stack([total, low]), journey.elapsed + journey.carry.s
    return Journey(carry, base, elapsed, journey.block + 1, journey.interval, journey.spread)


def restart(journey: Journey, watch: Watch | None = None) -> Journey:
    """Forget what was counted so far (time, jumps, losses): a new run begins where this one stands.

    The status stays: what has ended stays ended.
    """
    carry = journey.carry._replace(jumps=jnp.zeros_like(journey.carry.jumps))
    if carry.losses is not None:
        carry = carry._replace(losses=jnp.zeros_like(carry.losses), first_loss=jnp.full_like(carry.first_loss, jnp.nan))
    if watch is not None:
        carry = carry._replace(watch=watch.begin(journey.base[0] + journey.base[1], carry.frame))
    nothing = jnp.zeros_like(journey.elapsed)
    return Journey(carry, journey.base, nothing, jnp.zeros_like(journey.block), journey.interval, nothing)


def log_event(log: Events | None, entry: Events, real: Any = True) -> Events | None:
    """Append one event (its `count` is ignored), if it is real; there is room for it."""
    if log is None:
        return None

    def put(buffer, value):
        return buffer.at[log.count].set(value)

    filled = jax.tree.map(put, log._replace(count=None), entry._replace(count=None))
    return filled._replace(count=log.count + jnp.asarray(real, jnp.int32))


def added(carry: Carry, **terms) -> Carry:
    """The carry with terms added to its sums `s`, `growth` and `volume`; what is None has no sum."""
    terms = {name: term for name, term in terms.items() if term is not None and getattr(carry, name) is not None}
    if carry.left is None:
        return carry._replace(**{name: getattr(carry, name) + term for name, term in terms.items()})
    terms = {name: term + getattr(carry.left, name) for name, term in terms.items()}
    sums = {name: getattr(carry, name) + term for name, term in terms.items()}
    # Kahan's: the sum takes in less, or more, than the term.
    left = {name: term - (sums[name] - getattr(carry, name)) for name, term in terms.items()}
    return carry._replace(**sums, left=carry.left._replace(**left))


def stop(carry: Carry, status, when: Any = True) -> Carry:
    """End the run with a status where `when` holds."""
    ends = jnp.asarray(when) & (carry.status == RUNNING)
    return carry._replace(
        status=jnp.where(ends, jnp.asarray(status, jnp.int32), carry.status),
        budget=jnp.where(ends, 0, carry.budget),
    )
