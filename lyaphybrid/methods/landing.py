"""Landing: from a trial that ends at an event, through the jumps of that instant, to guards armed anew."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .. import frames
from ..columns import each_column
from ..events import BLUR, Wiring, arm, by_mode, jets, rates, rounding
from ..magnitudes import absolute
from ..precision import digits, nonzero
from ..propagation import Carry, Clock, Events, Settings, added, harvest, log_event, stop
from ..reverse_mode import checkpointed
from ..saltations import Sizes, delays, instant, push, return_along, sizes_at, sizes_pushed, sizes_returned
from ..statuses import STATUS
from .divergences import trace
from .trials import (
    ALONE,
    NEAR,
    PATIENCE,
    Memory,
    Stepper,
    Trial,
    changed,
    firing,
    has_fired,
    is_beyond,
    pending,
    table,
)

__all__ = ["land"]

SAME = 1e-13  # roots nearer than this, relative to the controller's step or the time, are simultaneous
GRAZING = 1e-3  # sine of the angle between flow and guard below which a crossing is called grazing
SHORT = 1e-5  # an interval between events is short below this, relative to the step and the longest interval


LEAST = 1e-140  # an interval over the longest one: squares of shorter ones fall below the smallest double
SHRUNK = 1e-3  # an interval has shrunk below this, relative to the step, where jumps are counted to the longest one
REACH = 10.0  # steps to the next event where events accumulate: so many times as long as the last interval


class Moves(NamedTuple):
    """Perturbations on their way through the jumps of one instant."""

    columns: Array
    direction: Array  # (n,) along which the columns are moved to their own instants …
    delay: Array  # … by δτ (columns,)
    sizes: Sizes | None  # of these three, for the columns of the frame; None where nothing is orthonormalised


class Landing(NamedTuple):
    """The state on its way through the jumps of one instant."""

    x: Array
    moves: Moves
    mode: Array
    f: Array  # of the new mode
    g: Array
    rate: Array
    side: Array
    blur: Array
    transition: Array
    which: Array
    slot: Array
    count: Array
    again: Array
    terminal: Array
    stuck: Array
    transversality: Array
    speed: Array  # of the flow before, its largest component
    shortest: Array  # flight from the guard and back that rounding of the guard does not hide
    together: Array  # slots that the flow brought to zero at this instant; afterwards: does their order matter
    more: Array  # another guard fires, or the same again
    alone: Array  # a jump of a cascade that does not end: time stands still from here on
    log: Events | None


def land(mover, settings: Settings, clock: Clock, c: Carry, tr: Trial) -> Carry:
    """The trial ends at an event: polish, cross, orthonormalise at once, re-arm the guards."""
    own, w = c.own, mover.wiring
    mode = jnp.asarray(0, jnp.int32) if own.mode is None else own.mode
    moved = mover.commit(settings, c, tr.h, tr.x, mover.landed(c, clock, tr))
    ahead = -tr.g / jnp.where(tr.rate == 0, nonzero(1e-300, tr.rate), tr.rate)
    lands, at_once = _at_root(mover, own, tr, ahead), False
    if mover.may_not_flow:  # the next jump where the last one, or the start, has left the state
        at_once = pending(own) > 0
        follows = table(mover, own.mode, w.directed) & (own.side < 0) & ~(has_fired(mover, own) & (own.g == 0))
        moved, lands = _choose(at_once, (c, follows), (moved, lands))
        ahead = jnp.where(at_once, 0.0, ahead)
    c = moved
    ticking = ~jnp.any(lands)
    ahead = jnp.where(lands, ahead, jnp.inf)
    slot = jnp.argmin(ahead).astype(jnp.int32)
    c = _polish(mover, clock, c, slot, ticking | at_once)
    if mover.per_jump:
        c = _within_reach(c, tr.h)
    t = clock.base + c.s
    c = harvest(settings, c, t)[0] if _orthonormalises(mover, settings, c) else c
    # Which transition: the first of those at this instant whose `when` says yes.
    together = lands & (ahead <= ahead[slot] + digits(SAME, t) * (own.h + jnp.abs(t)))
    allowed = together & by_mode(mode, w.whens, t, c.x) if w.shared else together
    blocked = ~ticking & ~jnp.any(allowed)
    slot = jnp.argmax(allowed).astype(jnp.int32)
    transition = table(mover, own.mode, w.transition)[slot]
    which = table(mover, own.mode, w.component)[slot]
    if w.clocks:
        clocks = jnp.asarray(w.clocks, jnp.int32)
        transition = jnp.where(ticking, clocks[tr.tick], transition)
        which = jnp.where(ticking, 0, which)
    event = transition, which, jnp.where(ticking, -1, slot)
    crossed = _cross(mover, settings, clock, c, mode, event, allowed & ~jnp.asarray(at_once), at_once, tr.h)
    crossed = _keep_clocks(mover, clock, crossed, tr, ticking)
    return _choose(blocked, stop(c, STATUS.deadlock), crossed)


def _at_root(mover, own: Stepper, tr: Trial, ahead):
    """The guards whose root is at the end of a trial that lands."""
    ticking = jnp.asarray(False) if tr.tick is None else tr.tick >= 0
    fires = firing(mover, own)
    crossed = fires & is_beyond(own, tr)
    close = fires & (own.side * tr.rate < 0) & (jnp.abs(ahead) <= digits(NEAR, ahead) * own.h)
    return jnp.where(ticking, False, jnp.where(jnp.any(close), close, crossed))


def _orthonormalises(mover, settings: Settings, c: Carry) -> bool:
    return settings.cadence.unit != "never" and c.frame.shape[1] > 0


def _polish(mover, clock: Clock, c: Carry, slot, ticking) -> Carry:
    """Two second-order steps onto the guard; the location of the root was not differentiable, the second of them is.

    Frames move by first order alone: the derivative of a step is right where the step itself is nothing any more.
    """
    w = mover.wiring

    def of_mode(q):
        def polish(t, x, frame, volume):
            def once(i, state):
                t, x, frame, volume, shift = state
                f, second = jax.jvp(w.fields[q], (t, x), (jnp.ones_like(t), w.fields[q](t, x)))
                g, rate = rates(w.guards[q], t, x, f)
                step = -g[slot] / jnp.where(rate[slot] == 0, 1.0, rate[slot])
                step = jnp.where(ticking | (rate[slot] == 0), 0.0, step)
                step = jnp.where(i == 0, jax.lax.stop_gradient(step), step)

                def slope(dx):
                    return jax.jvp(lambda y: w.fields[q](t, y), (x,), (dx,))[1]

                frame = frame + step * each_column(slope, frame)
                volume = None if volume is None else volume + step * trace(w.fields[q], t, x)
                return t + step, x + step * (f + 0.5 * step * second), frame, volume, shift + step

            return jax.lax.fori_loop(0, 2, once, (t, x, frame, volume, jnp.zeros_like(t)))

        return polish

    start = (clock.base + c.s, c.x, c.frame, c.volume)
    _, x, frame, volume, shift = by_mode(c.own.mode, [of_mode(q) for q in range(w.modes)], *start)
    return added(c._replace(x=x, frame=frame, volume=volume), s=shift)


def _within_reach(c: Carry, last_step) -> Carry:
    """Where the next jump comes ever sooner, steps as long as the way there: guards are judged on their scale."""
    flown, before = _flown(c, last_step), Memory(*c.own.memory).interval
    short = (flown > 0) & (flown < before) & (flown < SHRUNK * c.own.h)
    return changed(c, h=jax.lax.stop_gradient(jnp.where(short, REACH * flown, c.own.h)))


def _flown(c: Carry, last_step):
    """The time since the last event: where the time of the block no longer resolves it, the last step alone."""
    return jnp.maximum(c.s - Memory(*c.own.memory).last, last_step)


def _cross(mover, settings, clock: Clock, c: Carry, mode, event, together, at_once, last_step) -> Carry:
    """Through the event and the cascade it sets off; then orthonormalise and arm the guards."""
    slot = event[2]
    t, h, k = clock.base + c.s, c.own.h, c.frame.shape[1]
    columns, was_live = c.frame, jnp.sum(c.frame * c.frame, axis=0) > 0.5
    if settings.sum_rule:  # n more columns, the identity: they come out as the saltation matrix
        columns = jnp.concatenate([columns, jnp.eye(c.x.shape[0], dtype=c.x.dtype)], axis=1)
    landing = _in_each_order(mover, settings, t, h, c, columns, mode, event, together, at_once)
    since = c.since + landing.count.astype(c.since.dtype) if settings.cadence.unit == "jumps" else c.since
    volume = frames.log_abs_det(landing.moves.columns[:, k:]) if settings.sum_rule else None
    project, frame = mover.onto_mode(landing.mode, t, landing.x), landing.moves.columns[:, :k]
    sizes = None if landing.moves.sizes is None else landing.moves.sizes.columns
    if project is not None and k:
        frame = each_column(project, frame)
        sizes = None if sizes is None else each_column(absolute(project), sizes)
    c = c._replace(
        x=landing.x,
        frame=frame,
        since=since,
        jumps=c.jumps + landing.count,
        log=landing.log,
    )
    c = added(c, volume=volume)
    arrival = {"f": landing.f, "g": landing.g, "rate": landing.rate, "side": landing.side, "blur": landing.blur}
    c = changed(c, mode=None if c.own.mode is None else landing.mode, **arrival)
    if c.own.choices is not None:
        c = changed(c, choices=c.own.choices.met(landing.together, jnp.sum(together), t))
    doubtful = jnp.asarray(False)
    if sizes is not None:
        losses, (c, _) = c.losses, harvest(settings, c, t, frames.LOST, frames.LOST, project, was_live, sizes)
        # The direction of the flow shrinks like its speed: so far that the rounding of the columns would hide it?
        speed, terms = jnp.max(jnp.abs(landing.f)), jnp.minimum(jnp.max(sizes), 1.0)  # where they are known
        hidden = digits(frames.DEPENDENT, c.x) * terms * landing.speed
        doubtful = jnp.any(c.losses > losses) & (speed > 0) & (speed < hidden)
    guard = jnp.where(slot < 0, -1, slot + mover.wiring.slots * mode)
    c = _remember(mover, c, landing, clock, guard, doubtful, last_step)
    c = stop(c, STATUS.terminated, landing.terminal)
    c = stop(c, STATUS.deadlock, landing.stuck)
    finite = jnp.all(jnp.isfinite(c.x)) & jnp.all(jnp.isfinite(c.frame))
    c = stop(c, STATUS.nonfinite, ~finite)
    # By its jumps a run goes on through a cascade that does not end, but not through one that does after all.
    ends = landing.alone & ~landing.more if mover.per_jump else landing.count > mover.max_cascade
    return stop(c, STATUS.zeno, ends)


def _start_cascade(mover, settings, t, c, columns, mode, event, together, at_once) -> "Landing":
    """On the guard, before the first jump: the own instant of each column."""
    w, x, (transition, which, slot) = mover.wiring, c.x, event
    f = by_mode(mode, w.fields, t, x)
    gradient, moving, rate = _instant(mover, mode, t, x, f, slot)
    ticking = (slot < 0) | at_once  # the instant of a clock is everybody's, and each has come to its own before
    size = jnp.sqrt(jnp.sum(gradient**2) * jnp.sum(f**2) + nonzero(1e-300, f)) + jnp.abs(moving)
    blur = digits(BLUR, x) * (jnp.sum(jnp.abs(gradient * x)) + jnp.abs(moving * t))
    sizes = None
    if _orthonormalises(mover, settings, c):
        sizes = sizes_at(c.frame, f, gradient, moving, rate)
        sizes = sizes._replace(delay=jnp.where(ticking, 0.0, sizes.delay))
    slots, no = jnp.zeros(w.slots, x.dtype), jnp.asarray(False)
    return Landing(
        x=x,
        moves=Moves(columns, f, jnp.where(ticking, 0.0, delays(gradient @ columns, rate)), sizes),
        mode=mode,
        f=f,
        g=slots,
        rate=slots,
        side=slots,
        blur=slots,
        transition=transition,
        which=which,
        slot=slot,
        count=jnp.asarray(0, jnp.int32),
        again=jnp.asarray(True),
        terminal=no,
        stuck=no,
        speed=jnp.max(jnp.abs(f)),
        transversality=jnp.where(ticking, jnp.inf, jnp.abs(rate) / size),
        shortest=jnp.where(ticking, 0.0, 4 * blur / jnp.where(rate == 0, nonzero(1e-300, rate), jnp.abs(rate))),
        together=together,
        more=no,
        alone=jnp.asarray(at_once) & (pending(c.own) == ALONE),
        log=c.log,
    )


def _cascade(mover, settings: Settings, t, h, landing: "Landing") -> "Landing":
    """The reset of the located event, and of every guard on whose fired side it ends; or the first of them alone."""
    w, resolved = mover.wiring, jnp.zeros_like(t) if mover.timeless else t
    most = jnp.where(landing.alone, 0, mover.max_cascade) if mover.per_jump else mover.max_cascade

    def jump(state: Landing) -> Landing:
        pushers = [_pusher(reset) for reset in w.resets]
        x, moves = jax.lax.switch(state.transition, pushers, t, state.x, state.moves, state.which)
        mode = jax.lax.switch(state.transition, w.targets, state.mode, t, state.x, state.which)
        if w.constrained:  # what a jump leaves undecided is that the new constraints hold
            x, moves = _pushed(functools.partial(mover.onto_constraints, mode), t, x, moves)
        f, g, rate, second, blur = by_mode(mode, [_arrival(w, q) for q in range(w.modes)], t, x)
        fired = (jnp.arange(w.slots, dtype=jnp.int32) == state.slot) & (mode == state.mode)
        side, g, rate, flat = arm(g, rate, second, blur, h, resolved, fired)
        entry = Events(None, t, state.transition, state.which, state.mode, mode, state.x, x)
        terminal = state.terminal | jnp.asarray(mover.terminal)[state.transition]
        # A guard on its fired side fires now; the one that has just fired, and at which the jump ends, does not.
        directed = table(mover, mode if w.modes > 1 else None, w.directed)
        follows = directed & (side < 0) & ~(fired & (g == 0))
        follows = follows & by_mode(mode, w.whens, t, x) if w.shared else follows
        # One that the flow itself brought to zero at this instant, and the jump left there, comes after all that the
        # jump pushed through: had it been later, these would have been first.
        alone = state.together & (g == 0) & (mode == state.mode)
        slot = jnp.argmax(jnp.where(follows, jnp.where(alone, 1, 2), 0)).astype(jnp.int32)
        more = jnp.any(follows) & ~terminal
        again = more & (state.count < most)
        stuck = jnp.any(fired & flat & (side < 0) & directed) & ~again
        if w.borders is not None:  # beyond the border of the flow set, and no jump
            stuck = stuck | (jnp.any(table(mover, mode if w.modes > 1 else None, w.borders) & (side < 0)) & ~more)
        moves = _own_instant(mover, again & alone[slot], mode, t, x, f, slot, moves)
        transition = jnp.where(again, table(mover, mode if w.modes > 1 else None, w.transition)[slot], state.transition)
        which = table(mover, mode if w.modes > 1 else None, w.component)[slot]
        return Landing(
            x,
            moves,
            mode,
            f,
            g,
            rate,
            side,
            blur,
            transition,
            which,
            slot,
            state.count + 1,
            again,
            terminal,
            stuck | state.stuck,
            state.transversality,
            state.speed,
            state.shortest,
            state.together,
            more,
            state.alone,
            log_event(state.log, entry),
        )

    loop = checkpointed if settings.reverse else jax.lax.while_loop
    landing = loop(lambda s: s.again, jump, landing)
    f = jnp.where(landing.alone, 0.0, landing.f) if mover.per_jump else landing.f  # who does not flow on stays there
    return landing._replace(moves=_returned(f, landing.moves))


def _to_its_end(mover, settings: Settings, t, h, start: "Landing") -> "Landing":
    """A cascade; where jumps are counted, and it goes on beyond `max_cascade`, its first jump alone."""
    if not mover.per_jump:
        return _cascade(mover, settings, t, h, start)

    def run(state):
        _, alone, _ = state
        found = _cascade(mover, settings, t, h, start._replace(alone=alone))
        over = ~alone & (found.count > mover.max_cascade)
        return over, alone | over, found

    loop = checkpointed if settings.reverse else jax.lax.while_loop
    return loop(lambda state: state[0], run, (jnp.asarray(True), start.alone, start))[2]


def _instant(mover, mode, t, x, f, slot):
    """∇h, ∂ₜh and ḣ of a slot of the present mode."""

    def of_mode(guards):
        return lambda t, x, f: _gradient(lambda t, x: guards(t, x)[slot], t, x, f)

    return by_mode(mode, [of_mode(g) for g in mover.wiring.guards], t, x, f)


def _own_instant(mover, alone, mode, t, x, f, slot, moves: Moves) -> Moves:
    """Columns whose instant was another guard's, at that of a guard that no jump brought to zero."""
    gradient, moving, rate = _instant(mover, mode, t, x, f, slot)
    back, _, _, sizes = _returned(f, moves)
    if sizes is not None:
        sizes = sizes_at(sizes.columns, f, gradient, moving, rate)
    return _choose(alone, Moves(back, f, delays(gradient @ back, rate), sizes), moves)


def _returned(f, moves: Moves) -> Moves:
    """Back to the instant of the orbit."""
    columns, direction, delay, sizes = moves
    if sizes is not None:
        sizes = sizes._replace(columns=sizes_returned(sizes, f))
    return moves._replace(columns=return_along(columns, direction, f, delay), sizes=sizes)


def _in_each_order(mover, settings: Settings, t, h, c, columns, mode, event, together, at_once) -> "Landing":
    """Where several guards meet at one instant: let another one be the first, too, and compare.

    One other is enough to see that the order matters; where all solutions are asked for, each is the first in turn.
    """

    def start(event):
        return _start_cascade(mover, settings, t, c, columns, mode, event, together, at_once)

    slot, choices = event[2], c.own.choices
    if mover.wiring.slots == 1:
        return _to_its_end(mover, settings, t, h, start(event))._replace(together=jnp.asarray(False))
    count = jnp.sum(together)
    several, turns = (count > 1) & (slot >= 0), 2 if choices is None else count
    pick = None if choices is None else choices.pick()

    def first(turn):
        slot = jnp.argmax(jnp.cumsum(together) == turn + 1).astype(jnp.int32)
        named = (table(mover, c.own.mode, of_slot) for of_slot in (mover.wiring.transition, mover.wiring.component))
        return (*(one[slot] for one in named), slot)

    def run(state):
        turn, kept, chosen, differs = state
        landing = _to_its_end(mover, settings, t, h, start(_choose(turn == 0, event, first(turn))))
        differs = differs | ((turn > 0) & _apart(landing, kept))
        chosen = None if chosen is None else _choose(turn == pick, landing, chosen)
        return turn + 1, _choose(turn == 0, landing, kept), chosen, differs

    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(start, event))
    last = jnp.where(several, turns, 1)
    begin = (jnp.asarray(0), nothing, None if choices is None else nothing, jnp.asarray(False))
    loop = checkpointed if settings.reverse else jax.lax.while_loop
    _, landing, chosen, differs = loop(lambda state: state[0] < last, run, begin)
    if chosen is not None:
        landing = _choose(differs, chosen, landing)
    return landing._replace(together=differs)


def _keep_clocks(mover, clock: Clock, c: Carry, tr: Trial, ticking) -> Carry:
    """The clock that has ticked goes on; clocks that were not listened to catch up."""
    if not mover.wiring.clocks:
        return c
    t = clock.base + c.s
    ticked = ticking & (jnp.arange(len(mover.clock_times), dtype=jnp.int32) == tr.tick)
    number = c.own.ticks + ticked.astype(c.own.ticks.dtype)
    now = jnp.stack([jnp.floor((t - phase) / period + digits(1e-9, t)) for period, phase in mover.clock_times])
    number = jnp.where(number < now - 1e-3, now + 1, number)
    return changed(c, ticks=number)


def _remember(mover, c: Carry, landing: "Landing", clock: Clock, guard, doubtful, last_step) -> Carry:
    """Intervals between events, for Zeno; transversality and notes. `guard` counts slots over all modes."""
    m, first = Memory(*c.own.memory), guard.astype(c.x.dtype)
    interval = _flown(c, last_step) if mover.per_jump else c.s - m.last
    longest = jnp.maximum(m.longest, interval)
    short = interval < digits(SHORT, interval) * jnp.minimum(c.own.h, longest)
    streak = jnp.where(short, m.streak + 1, 0.0)
    shrink = jnp.clip(interval / jnp.where(m.interval > 0, m.interval, 1.0), 0.0, 1 - digits(1e-9, interval))
    ahead = clock.base + c.s + interval * shrink / (1 - shrink)
    # Bounces may shrink below what can be told from rest, or from rounding, before there are so many of them.
    if mover.per_jump:  # they are what is counted: as many as double precision can tell
        small = interval < SHRUNK * longest
        hidden = small & (interval < LEAST * longest) & ~landing.alone
        few, patience = small, jnp.inf
    else:
        small, few, patience = interval < SHRUNK * c.own.h, m.streak > 0, PATIENCE
        hidden = False
    shrunk = (m.interval > 0) & small
    hidden = hidden | (few & (m.slot == first) & (interval < landing.shortest))
    zeno = (streak > patience) | (landing.stuck & shrunk) | hidden
    memory = Memory(
        c.s,
        interval,
        longest,
        streak,
        jnp.minimum(m.transversality, landing.transversality),
        jnp.maximum(m.grazing, (landing.transversality < GRAZING).astype(c.x.dtype)),
        jnp.maximum(m.simultaneous, landing.together.astype(c.x.dtype)),
        jnp.where(zeno, ahead, m.accumulation),
        first,
        jnp.maximum(m.doubtful, doubtful.astype(c.x.dtype)),
        jnp.where(landing.more & landing.alone, ALONE, 0.0),
    )
    memory = jax.lax.stop_gradient(jnp.stack([jnp.asarray(v, c.x.dtype) for v in memory]))
    return stop(changed(c, memory=memory), STATUS.zeno, zeno)


def _choose(condition, yes, no):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _gradient(guard, t, x, f):
    gradient, rate = instant(guard, t, x, f)[::2]
    return gradient, rate - jnp.sum(gradient * f), rate


def _apart(a: Landing, b: Landing):
    """Whether two orders of the same events end differently, in the state or in the tangent."""
    alike = digits(1e-9, b.x)
    size = 1.0 + jnp.max(jnp.abs(b.moves.columns), initial=0.0)
    columns = jnp.max(jnp.abs(a.moves.columns - b.moves.columns), initial=0.0) > alike * size
    states = jnp.max(jnp.abs(a.x - b.x)) > alike * (1.0 + jnp.max(jnp.abs(b.x)))
    return columns | states | (a.mode != b.mode)


def _pusher(reset):
    return lambda t, x, moves, which: _pushed(lambda t, x: reset(t, x, which), t, x, moves)


def _pushed(reset, t, x, moves: Moves) -> tuple[Array, Moves]:
    """Through a reset."""
    columns, direction, delay, sizes = moves
    new, columns, direction = push(reset, t, x, columns, direction)
    if sizes is not None:
        sizes = sizes_pushed(reset, t, x, sizes, direction)
    return new, Moves(columns, direction, delay, sizes)


def _arrival(w: Wiring, q: int):
    guards, field = w.guards[q], w.fields[q]
    return lambda t, x: (field(t, x), *jets(guards, field, t, x), rounding(guards, t, x))
