"""Apply an event: from a trial that ends on a guard, through the cascade, to guards armed again."""

import math

import jax
import jax.numpy as jnp

from ..._jax.columns import each_column
from ..._jax.jaxprs import explicit
from ..._jax.magnitudes import absolute
from ..._jax.precision import GUARD_ROUNDING, digits, nonzero
from ..._linalg import frames
from ...events.bits import as_bits, in_bits
from ...events.compiled_hybrid import by_mode
from ...events.roots import rates, rounding
from ...events.saltations import event_time
from ...integrators.small_steps import flown, moved_on, rates_of_flow
from ...statuses import STATUS
from ..orthonormalising import accumulate, orthonormalise_and_accumulate
from ..states import Clock, Settings, StepState, added, before_events, select, stop
from .cascade import CascadeState, Meeting, in_each_order, orthonormalises
from .grazing import hardly_crosses
from .step_sizes import unresolved
from .trials import (
    ALONE,
    LEFT,
    NEAR,
    PATIENCE,
    Memory,
    SolverState,
    Trial,
    changed,
    firing,
    has_fired,
    is_beyond,
    pending,
    table,
)

__all__ = ["apply_event"]

MOST_EXAMINED = 16  # the terms of the columns' entries are followed where there are no more components
# A column that a jump makes so short, of entries so small beside their terms, may be what errors leave of a lost one.
COLUMN_NOISE = 1e-12
GRAZING = 1e-3  # a crossing grazes if the sine of the angle between flow and guard is smaller, and the guard turns soon
# An interval between events is short below this, relative to the step and to the longest interval.
SHORT_INTERVAL = 1e-5
AT_START = 1e-12  # an event within this part of a step of the start is there up to rounding
SMALLEST_INTERVAL = 1e-140  # smallest interval relative to the longest: squares of smaller numbers underflow in float64
# An interval has shrunk below this, relative to the step; to the longest one where jumps are counted.
SHRUNK_INTERVAL = 1e-3
STEP_PER_INTERVAL = 10.0  # where intervals between jumps shrink, the step is this times the last interval


def apply_event(evolver, settings: Settings, clock: Clock, carry: StepState, trial: Trial) -> StepState:
    """Handle a trial that ends at an event: polish the root, apply the cascade, orthonormalise, arm the guards."""
    solver, hybrid = carry.solver_state, evolver.hybrid
    mode = jnp.asarray(0, jnp.int32) if solver.mode is None else solver.mode
    slow, began = hardly_crosses(evolver, carry, clock, trial), carry.frame
    moved = evolver.commit(settings, carry, trial.h, trial.x, evolver.landed(carry, clock, trial))
    lands, at_once = _at_root(evolver, solver, trial), False
    if evolver.may_not_flow:  # a jump may follow the last one, or the start, without a flow
        at_once = pending(solver) > 0
        follows = (
            table(evolver, solver.mode, hybrid.directed)
            & (solver.guard_sign < 0)
            & (solver.guard_sign != LEFT)
            & ~(has_fired(evolver, solver) & (solver.g == 0))
        )
        if hybrid.recording is not None:  # what changes something goes first
            changing = follows & ~table(evolver, solver.mode, hybrid.recording)
            follows = jnp.where(jnp.any(changing), changing, follows)
        moved, lands = select(at_once, (carry, follows), (moved, lands))
    carry = moved
    ticking = ~jnp.any(lands)
    carry = _polish(evolver, clock, carry, lands, ticking | at_once)
    if evolver.per_jump:
        carry = _within_reach(carry, trial.h)
    t, terms = clock.base + carry.s, jnp.abs(carry.frame)
    if orthonormalises(settings, carry):
        landed = carry.frame
        carry = orthonormalise_and_accumulate(settings, carry, t)[0]
        terms = jnp.abs(carry.frame)
        if max(landed.shape) <= MOST_EXAMINED:
            own = frames.terms_of_columns(carry.frame, landed, jnp.maximum(jnp.abs(landed), jnp.abs(began)))
            terms = jnp.concatenate([terms, own], axis=1)
    # The transition: the first of those at this instant whose `when` is true.
    together = earliest = lands
    if hybrid.slots > 1:
        flown = jnp.maximum(solver.h, carry.s - Memory(*solver.memory).last)
        earliest, together = (
            lands & (at_once | now) for now in _are_now(evolver, mode, t, carry.x, lands, (solver.h, flown))
        )
    whens = by_mode(mode, hybrid.whens, t, carry.x) if hybrid.shared else jnp.asarray(True)
    allowed, earliest = together & whens, earliest & whens
    blocked = ~ticking & ~jnp.any(allowed)
    guard_index = jnp.argmax(jnp.where(jnp.any(earliest), earliest, allowed)).astype(jnp.int32)
    transition = table(evolver, solver.mode, hybrid.transition)[guard_index]
    which = table(evolver, solver.mode, hybrid.component)[guard_index]
    if hybrid.clocks:
        clocks = jnp.asarray(hybrid.clocks, jnp.int32)
        transition = jnp.where(ticking, clocks[trial.tick], transition)
        which = jnp.where(ticking, 0, which)
    event = transition, which, jnp.where(ticking, -1, guard_index)
    meeting = Meeting(*(one & ~jnp.asarray(at_once) for one in (allowed, together & ~whens)))
    crossed = _apply_cascade(evolver, settings, clock, carry, terms, mode, event, meeting, at_once, trial.h, slow)
    crossed = _to_end(evolver, clock, _keep_clocks(evolver, clock, crossed, trial, ticking, mode))
    return select(blocked, stop(before_events(carry, crossed), STATUS.deadlock), crossed)


def _at_root(evolver, solver: SolverState, trial: Trial):
    """(slots,) the guards whose root is at the end of the trial."""
    ahead = _until_zero(trial.g, trial.rate)
    ticking = jnp.asarray(False) if trial.tick is None else trial.tick >= 0
    fires = firing(evolver, solver)
    crossed = fires & is_beyond(solver, trial)
    close = fires & (solver.guard_sign * trial.rate < 0) & (jnp.abs(ahead) <= digits(NEAR, ahead) * solver.h)
    return jnp.where(ticking, False, jnp.where(jnp.any(close), close, crossed))


def _until_zero(g, rate):
    """The time to the root by one Newton step, for guards close to it."""
    return -g / jnp.where(rate == 0, nonzero(1e-300, rate), rate)


def _are_now(evolver, mode, t, x, lands, spans):
    """(slots,) the guards whose root coincides, up to rounding, with the earliest root among `lands`, for each span.

    The rounding of an instant is that of the guard there, and that of a time of the length `span`: the step, within
    which roots are ordered; and the whole flight, for the state has been rounded at its other places, too.
    """
    hybrid, (t, x, spans) = evolver.hybrid, jax.lax.stop_gradient((t, x, spans))

    def of_mode(q):
        def roots(t, x):
            g, rate = rates(hybrid.guards[q], t, x, hybrid.fields[q](t, x))
            return _until_zero(g, rate), jnp.abs(_until_zero(rounding(hybrid.guards[q], t, x), rate))

        return roots

    ahead, unsure = by_mode(mode, [of_mode(q) for q in range(hybrid.modes)], t, x)
    first = jnp.argmin(jnp.where(lands, ahead, jnp.inf))
    latest = ahead[first] + unsure + unsure[first]
    return [ahead <= latest + digits(GUARD_ROUNDING, span) * span for span in spans]


def _polish(evolver, clock: Clock, carry: StepState, lands, ticking) -> StepState:
    """Two second-order Taylor steps onto the guard; then derivatives, which the location of the root did not have.

    Of several guards the one with the earliest root is taken. The second step identifies it, because it starts so close
    that the roots are known to rounding.
    """

    def of_mode(q):
        field, guards = evolver.hybrid.fields[q], evolver.hybrid.guards[q]

        def polish(t, x, frame, log_volume):
            def once(i, state):
                t, x, frame, log_volume, shift, _ = state
                f, second = rates_of_flow(field, t, x)
                g, rate = rates(guards, t, x, f)
                guard_index = jnp.argmin(jnp.where(lands, _until_zero(g, rate), jnp.inf))
                step = -g[guard_index] / jnp.where(rate[guard_index] == 0, 1.0, rate[guard_index])
                crosses = ~ticking & (rate[guard_index] != 0)
                step = jax.lax.stop_gradient(jnp.where(crosses, step, 0.0))
                state = t + step, *flown(field, step, (f, second), t, x, frame, log_volume)
                return *state, shift + step, jnp.where(crosses, guard_index, -1)

            start = t, x, frame, log_volume, jnp.zeros_like(t), jnp.full_like(jnp.argmin(lands), -1)
            t, x, frame, log_volume, shift, guard_index = jax.lax.fori_loop(0, 2, once, start)
            (field_of, of_field), (guards_of, of_guards) = (explicit(one, t, x) for one in (field, guards))
            operands = of_field, of_guards, t, x, guard_index
            late = event_time(jnp.zeros_like(t), guard_index >= 0, _guard_later(field_of, guards_of), operands)
            return *moved_on(field_of, of_field, late, t, x, frame, log_volume), shift + late

        return polish

    modes, start = range(evolver.hybrid.modes), (clock.base + carry.s, carry.x, carry.frame, carry.log_volume)
    x, frame, log_volume, shift = by_mode(carry.solver_state.mode, [of_mode(q) for q in modes], *start)
    return added(carry._replace(x=x, frame=frame, log_volume=log_volume), s=shift)


def _guard_later(field, guards):
    """A guard after a short time dt, to second order, as a function (dt, (numbers, numbers, t, x, index))."""

    def value(dt, operands):
        of_field, of_guards, t, x, index = operands
        f, second = rates_of_flow(lambda t, x: field(of_field, t, x), t, x)
        return guards(of_guards, t + dt, x + dt * (f + 0.5 * dt * second))[index]

    return value


def _to_end(evolver, clock: Clock, carry: StepState) -> StepState:
    """After an event at the very end of a block: from the time of the event to that of the end, along the new flow.

    The way has no length, up to rounding, but derivatives: the event's time depends on parameters, that of the end does
    not. So the output is the state after the event, as a function of parameters too.
    """
    hybrid = evolver.hybrid

    def move(carry):
        step = clock.length - carry.s

        def of_mode(q):
            field = hybrid.fields[q]

            def along(t, x, frame, log_volume):
                length = jax.lax.stop_gradient(step)
                after = flown(field, length, rates_of_flow(field, t, x), t, x, frame, log_volume)
                field_of, numbers = explicit(field, t, x)
                x, *after = moved_on(field_of, numbers, step - length, t + length, *after)
                return field(t + step, x), x, *after

            return along

        start = clock.base + carry.s, carry.x, carry.frame, carry.log_volume
        f, x, frame, log_volume = by_mode(carry.solver_state.mode, [of_mode(q) for q in range(hybrid.modes)], *start)
        return changed(carry._replace(s=clock.length, x=x, frame=frame, log_volume=log_volume), f=f)

    return jax.lax.cond(clock.over(carry), move, lambda carry: carry, carry)


def _within_reach(carry: StepState, last_step) -> StepState:
    """Where intervals between jumps shrink, limit the step to their scale: guards are armed on the scale of a step."""
    flown, before = _time_since_event(carry, last_step), Memory(*carry.solver_state.memory).interval
    short = (flown > 0) & (flown < before) & (flown < SHRUNK_INTERVAL * carry.solver_state.h)
    return changed(carry, h=jax.lax.stop_gradient(jnp.where(short, STEP_PER_INTERVAL * flown, carry.solver_state.h)))


def _may_be_lost(frame, found, was_live, terms):
    """Whether rounding in `terms`, those of the last step, can have made a column short that should be lost."""
    short = ~found[2] & was_live & (found[1] < math.log(digits(COLUMN_NOISE, frame)))

    def examined(frame, terms):
        return jnp.any(short & frames.is_rounding(frame, terms, COLUMN_NOISE))

    return jax.lax.cond(jnp.any(short), examined, lambda *_: jnp.asarray(False), frame, terms)


def _time_since_event(carry: StepState, last_step):
    """The time since the last event; the length of the last step, where the block's time does not resolve it."""
    return jnp.maximum(carry.s - Memory(*carry.solver_state.memory).last, last_step)


def _apply_cascade(
    evolver,
    settings,
    clock: Clock,
    carry: StepState,
    terms,
    mode,
    event,
    meeting: Meeting,
    at_once,
    last_step,
    slow,
) -> StepState:
    """Apply the cascade that the event starts; then orthonormalise and store the armed guards."""
    guard_index, arrived = event[2], carry
    t, h, k = clock.base + carry.s, carry.solver_state.h, carry.frame.shape[1]
    columns, was_live = carry.frame, jnp.sum(carry.frame * carry.frame, axis=0) > 0.5
    if settings.sum_rule:  # append the identity (n, n): its image is the saltation matrix
        columns = jnp.concatenate([columns, jnp.eye(carry.x.shape[0], dtype=carry.x.dtype)], axis=1)
    landing = in_each_order(evolver, settings, t, h, carry, columns, terms, mode, event, meeting, at_once)
    since = (
        carry.since + landing.count.astype(carry.since.dtype) if settings.qr_schedule.unit == "jumps" else carry.since
    )
    log_volume = frames.log_abs_det(landing.moves.columns[:, k:]) if settings.sum_rule else None
    project, frame = evolver.onto_mode(landing.mode, t, landing.x), landing.moves.columns[:, :k]
    sizes = None if landing.moves.sizes is None else landing.moves.sizes.columns
    if project is not None and k:
        frame = _within(project, frame, landing.terminal if settings.moving_end else None)
        sizes = None if sizes is None else each_column(absolute(project), sizes)
    carry = carry._replace(
        x=landing.x,
        frame=frame,
        since=since,
        jumps=carry.jumps + landing.count,
        log=landing.log,
    )
    carry = added(carry, log_volume=log_volume)
    arrival = {
        "f": landing.f,
        "g": landing.g,
        "rate": landing.rate,
        "guard_sign": jnp.where(_stays_left(landing), LEFT, landing.guard_sign),
        "guard_tolerance": landing.guard_tolerance,
    }
    carry = changed(carry, mode=None if carry.solver_state.mode is None else landing.mode, **arrival)
    if carry.solver_state.choices is not None:
        met = carry.solver_state.choices.met(landing.together, jnp.sum(meeting.together), t)
        carry = changed(carry, choices=met._replace(others=met.others | landing.several))
    doubtful = jnp.asarray(False)
    if sizes is not None:
        sizes = sizes[:, :k], sizes[:, -k:]
        carry, doubtful = _orthonormalised(settings, carry, t, landing, project, sizes, was_live)
    guard = jnp.where(guard_index < 0, -1, guard_index + evolver.hybrid.slots * mode)
    unsure, turns = (own[guard_index] & (guard_index >= 0) for own in slow)  # an angle hangs on units
    grazing = ((landing.transversality < GRAZING) & turns) | (unsure & _bends(landing))
    seen = grazing, doubtful, _still_waiting(arrived, landing, guard_index)
    carry = _store_event(evolver, carry, landing, clock, guard, seen, last_step)
    carry = stop(carry, STATUS.terminated, landing.terminal)
    carry = stop(carry, STATUS.deadlock, landing.stuck)
    finite = jnp.all(jnp.isfinite(carry.x)) & jnp.all(jnp.isfinite(carry.frame))
    carry = stop(carry, STATUS.nonfinite, ~finite)
    # Where jumps are counted the run goes on through an endless cascade, and stops if the cascade ends after all.
    ends = landing.alone & ~landing.more if evolver.per_jump else landing.count > evolver.max_cascade
    # A reset would turn a state that leaves the guard to the side beyond it.
    arrived = before_events(arrived, carry)
    return select(landing.leaves, stop(arrived, STATUS.zeno), stop(carry, STATUS.zeno, ends))


def _orthonormalised(settings, carry: StepState, t, landing: CascadeState, project, sizes, was_live):
    """The carry with an orthonormal frame and what is lost, by the terms `sizes`; and whether a loss is doubtful."""
    losses = carry.losses
    least = frames.LOST + _left_of_velocities(landing)[: carry.frame.shape[1]]
    found, doubtful = frames.orthonormalise_after_jump(carry.frame, settings.kind, least, sizes[0])
    if max(carry.frame.shape) <= MOST_EXAMINED:
        doubtful |= _may_be_lost(carry.frame, found, was_live, sizes[1])
    carry = accumulate(settings, carry, t, found, True, project, was_live)
    # The direction of the flow shrinks by the ratio of speeds: a loss is doubtful if rounding could hide it, unless
    # the new mode has no room for what is lost.
    forced = jnp.maximum(jnp.sum(was_live, dtype=jnp.int32) - _room(project, carry.x), 0)
    lost = jnp.sum(carry.losses - losses, dtype=jnp.int32) > forced
    speed, size = jnp.max(jnp.abs(landing.f)), jnp.minimum(jnp.max(sizes[0]), 1.0)  # unknown magnitudes are huge
    hidden = digits(frames.DEPENDENT, carry.x) * size * landing.speed
    return carry, doubtful | (lost & (speed > 0) & (speed < hidden))


def _within(project, frame, ended):
    """The frame projected onto the tangent space of the mode; not where a surface that moves met the neighbours."""
    within = each_column(project, frame)
    return within if ended is None else jnp.where(ended, frame, within)


def _left_of_velocities(landing: CascadeState):
    """(k,) what rounding leaves of a column where the velocities before and after should cancel, see `saltations`.

    At a slow crossing the shift of the event time makes this long: a body that is put to rest on a moving wall forgets
    its past, though the wall's velocity and the derivative of its position differ by rounding.
    """
    speeds = jnp.max(jnp.abs(landing.moves.direction)) + jnp.max(jnp.abs(landing.f))
    return jax.lax.stop_gradient(digits(frames.DEPENDENT, speeds) * speeds * jnp.abs(landing.moves.event_time_shift))


def _room(project, x):
    """The dimension of the tangent space of a mode: the trace of the projection onto it."""
    n = x.shape[0]
    if project is None:
        return n
    return jnp.round(jnp.trace(each_column(project, jnp.eye(n, dtype=x.dtype)))).astype(jnp.int32)


def _stays_left(landing: CascadeState):
    """(slots,) the guards beyond zero that must not fire in the next jump of a cascade without end, see `LEFT`."""
    done = landing.left | (landing.settled & (landing.guard_sign < 0))
    return done & landing.alone & landing.more


def _bends(landing: CascadeState):
    """Whether the flow afterwards differs from the one before, seen through the reset: else S is Dg at any rate."""
    through = landing.moves.direction
    size = jnp.maximum(jnp.max(jnp.abs(through)), jnp.max(jnp.abs(landing.f)))
    return jnp.max(jnp.abs(through - landing.f)) > digits(1e-9, size) * size


def _keep_clocks(evolver, clock: Clock, carry: StepState, trial: Trial, ticking, mode) -> StepState:
    """Advance to their next tick the clock that has ticked, its equals in other modes, and any that was not armed."""
    if not evolver.hybrid.clocks:
        return carry
    t, times = clock.base + carry.s, jnp.asarray(evolver.clock_times, carry.x.dtype)
    ticked = ticking & (jnp.arange(len(times), dtype=jnp.int32) == trial.tick)
    # Of equal clocks one ticks at a time: with one in each of two modes these take turns.
    equal = jnp.all(times == times[trial.tick][None, :], axis=1) & ~table(evolver, mode, evolver.hybrid.armed)
    number = carry.solver_state.ticks + (ticked | (ticking & equal)).astype(carry.solver_state.ticks.dtype)
    rounding_of_time = unresolved(carry, clock)
    number = [
        _tick_to_come(t, number[i], period, phase, rounding_of_time)
        for i, (period, phase) in enumerate(evolver.clock_times)
    ]
    return changed(carry, ticks=jnp.stack(number))


def _tick_to_come(t, number, period, phase, rounding_of_time):
    """The number of a clock's next tick: what passed while it was not armed is over, what rounding made late comes."""
    slack = digits(1e-9, t)
    late = t - phase - period * number > slack * period + rounding_of_time
    return jnp.where(late, jnp.ceil((t - phase) / period - slack), number)


def _still_waiting(arrived: StepState, landing: CascadeState, guard_index):
    """The guards that were beyond zero at the start and have been since, as bits; none in another mode."""
    solver, slots = arrived.solver_state, landing.guard_sign.shape[0]
    waiting = Memory(*solver.memory).waiting
    kept = in_bits(waiting, slots) & (landing.guard_sign < 0) & (jnp.arange(slots, dtype=jnp.int32) != guard_index)
    stays = True if solver.mode is None else solver.mode == landing.mode
    return jnp.where(stays, as_bits(kept).astype(waiting.dtype), 0.0)


def _store_event(evolver, carry: StepState, landing: CascadeState, clock: Clock, guard, seen, last_step) -> StepState:
    """Update `Memory`: intervals between events (Zeno), transversality, notes.

    `seen`: whether the event was grazing or doubtful, and the guards that wait.

    `guard` counts over all modes.
    """
    grazing, doubtful, waiting = seen
    m, first = Memory(*carry.solver_state.memory), guard.astype(carry.x.dtype)
    interval = _time_since_event(carry, last_step) if evolver.per_jump else carry.s - m.last
    # An event that the run begins with, up to rounding, comes after no interval.
    begins = (m.longest == 0) & (interval <= digits(AT_START, interval) * carry.solver_state.h)
    longest = jnp.maximum(m.longest, jnp.where(begins, 0.0, interval))
    # A flight from a guard and back to it that is lower than the guard's rounding.
    unresolved = (m.guard_index == first) & (interval < landing.shortest)
    short = interval < digits(SHORT_INTERVAL, interval) * jnp.minimum(carry.solver_state.h, longest)
    short = short | (unresolved & landing.directed)
    streak = jnp.where(short, m.streak + 1, 0.0)
    shrink = jnp.clip(interval / jnp.where(m.interval > 0, m.interval, 1.0), 0.0, 1 - digits(1e-9, interval))
    ahead = clock.base + carry.s + interval * shrink / (1 - shrink)
    # Intervals may shrink below the resolution of the state, or below rounding, before MOST_SHORT_INTERVALS is reached.
    if evolver.per_jump:  # jumps are counted: go on as long as float64 separates them
        small = interval < SHRUNK_INTERVAL * longest
        hidden = small & (interval < SMALLEST_INTERVAL * longest) & ~landing.alone
        few, patience = small, jnp.inf
    else:
        small, few, patience = interval < SHRUNK_INTERVAL * carry.solver_state.h, m.streak > 0, PATIENCE
        hidden = False
    shrunk = (m.interval > 0) & small
    hidden = hidden | (few & unresolved)
    zeno = (streak > patience) | (landing.stuck & shrunk) | hidden
    memory = Memory(
        carry.s,
        interval,
        longest,
        streak,
        jnp.minimum(m.transversality, landing.transversality),
        jnp.maximum(m.grazing, grazing.astype(carry.x.dtype)),
        jnp.maximum(m.simultaneous, (landing.together | landing.several).astype(carry.x.dtype)),
        jnp.where(zeno, ahead, m.accumulation),
        first,
        jnp.maximum(m.doubtful, doubtful.astype(carry.x.dtype)),
        jnp.where(landing.more & landing.alone, ALONE, 0.0),
        waiting,
    )
    memory = jax.lax.stop_gradient(jnp.stack([jnp.asarray(v, carry.x.dtype) for v in memory]))
    return stop(changed(carry, memory=memory), STATUS.zeno, zeno)
