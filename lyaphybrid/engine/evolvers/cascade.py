"""A cascade: all jumps at one instant, their resets in turn, and the perturbations carried through them."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._jax.precision import GUARD_ROUNDING, digits, nonzero
from ..._jax.reverse_mode import checkpointed
from ...events.compiled_hybrid import CompiledHybrid, by_mode
from ...events.roots import arm, to_arm
from ...events.saltations import (
    Sizes,
    event_time_shifts,
    instant,
    pushforward,
    sizes_at,
    sizes_pushed,
    sizes_returned,
    to_reference_time,
)
from ..states import EventLog, Settings, StepState, empty_log, log_event, log_events, most_at_once, select
from .trials import ALONE, LEFT, pending, side, table

__all__ = ["CascadeState", "CascadePerturbations", "in_each_order", "orthonormalises"]


class CascadePerturbations(NamedTuple):
    """Perturbations during a cascade. A neighbour's perturbation at its own event time is columns + direction δτ."""

    columns: Array  # (n, columns)
    direction: Array  # (n,) f⁻ before the first jump; each reset maps it to Dg f⁻ + ∂ₜg
    event_time_shift: Array  # (columns,) δτ of each column
    sizes: Sizes | None  # magnitudes of these three, for `terms` of the frame; None if nothing is orthonormalised


class Meeting(NamedTuple):
    """The guards (slots,) that are zero at the instant of an event."""

    together: Array  # those that may fire
    refused: Array  # those whose `when` is not true: no jump of this instant lets them fire


class CascadeState(NamedTuple):
    """The state of a cascade."""

    x: Array  # (n,)
    moves: CascadePerturbations
    mode: Array
    f: Array  # (n,) vector field of the new mode
    g: Array  # (slots,) guards of the new mode; at first those before the jump
    rate: Array  # (slots,) their time derivatives
    guard_sign: Array  # (slots,)
    guard_tolerance: Array  # (slots,) their rounding
    transition: Array  # the transition that fires next
    which: Array  # its component, for a vector guard
    guard_index: Array  # its guard in the mode; -1: a clock
    count: Array  # pyright: ignore[reportIncompatibleMethodOverride]
    again: Array  # whether the cascade goes on
    terminal: Array  # whether a terminal transition has fired
    stuck: Array  # whether neither a flow nor a jump is possible
    transversality: Array  # |sin| of the angle between flow and first guard
    speed: Array  # largest component of the vector field before the event
    shortest: Array  # the shortest flight from the guard and back that the guard's rounding does not hide
    directed: Array  # whether the first guard fires in one direction only …
    leaves: Array  # … and moves against it: rounding hides the flight at whose end it seems to be
    together: Array  # (slots,) guards that are zero at this instant; in the result: whether their order matters
    settled: Array  # (slots,) guards that have fired at this instant, or may not, and have stayed at zero since
    left: Array  # (slots,) guards that were beyond zero before and have been since: they do not fire anew
    more: Array  # whether another guard fires, or the same one again
    last_first: Array  # whether of several guards that a jump sent beyond zero the last one fires first, not the first
    several: Array  # whether there were several; in the result: whether their order matters
    alone: Array  # whether this is one jump of a cascade without end, after which no time passes
    log: EventLog | None


def orthonormalises(settings: Settings, carry: StepState) -> bool:
    """Whether there are columns and they are ever orthonormalised."""
    return settings.qr_schedule.unit != "never" and carry.frame.shape[1] > 0


def _start_cascade(evolver, settings, t, carry, columns, terms, mode, event, meeting: Meeting, at_once) -> CascadeState:
    """On the guard, before the first jump: compute the event-time shift of each column."""
    hybrid, x, (transition, which, guard_index) = evolver.hybrid, carry.x, event
    f = by_mode(mode, hybrid.fields, t, x)
    gradient, moving, rate = _guard_derivatives(evolver, mode, t, x, f, guard_index)
    ticking = (guard_index < 0) | at_once  # a clock's event time does not depend on the state; at_once: no new flow
    size = jnp.sqrt(jnp.sum(gradient**2) * jnp.sum(f**2) + nonzero(1e-300, f)) + jnp.abs(moving)
    guard_tolerance = digits(GUARD_ROUNDING, x) * (jnp.sum(jnp.abs(gradient * x)) + jnp.abs(moving * t))
    sizes = None
    if orthonormalises(settings, carry):
        sizes = sizes_at(terms, f, gradient, moving, rate)
        sizes = sizes._replace(event_time_shift=jnp.where(ticking, 0.0, sizes.event_time_shift))
    slots, no = jnp.zeros(hybrid.slots, x.dtype), jnp.asarray(False)
    g = jax.lax.stop_gradient(by_mode(mode, hybrid.guards, t, x))
    guard_sign = side(evolver, carry.solver_state, g)
    guard_sign = jnp.where(meeting.refused, -guard_sign, guard_sign) if hybrid.shared else guard_sign
    directed = ~ticking & table(evolver, carry.solver_state.mode, hybrid.directed)[guard_index]
    return CascadeState(
        x=x,
        moves=CascadePerturbations(
            columns, f, jnp.where(ticking, 0.0, event_time_shifts(gradient @ columns, rate)), sizes
        ),
        mode=mode,
        f=f,
        g=g,
        rate=slots,
        guard_sign=guard_sign,
        guard_tolerance=slots,
        transition=transition,
        which=which,
        guard_index=guard_index,
        count=jnp.asarray(0, jnp.int32),
        again=jnp.asarray(True),
        terminal=no,
        stuck=no,
        speed=jnp.max(jnp.abs(f)),
        transversality=jnp.where(ticking, jnp.inf, jnp.abs(rate) / size),
        shortest=jnp.where(
            ticking, 0.0, 4 * guard_tolerance / jnp.where(rate == 0, nonzero(1e-300, rate), jnp.abs(rate))
        ),
        directed=directed,
        leaves=directed & (guard_sign[guard_index] * rate > 0),
        together=meeting.together,
        settled=meeting.refused,
        left=_may_be_left(evolver, carry.solver_state.mode)
        & jnp.where(at_once, carry.solver_state.guard_sign == LEFT, guard_sign < 0),
        more=no,
        last_first=no,
        several=no,
        alone=jnp.asarray(at_once) & (pending(carry.solver_state) == ALONE),
        log=carry.log,
    )


def _cascade(evolver, settings: Settings, t, h, landing: CascadeState) -> CascadeState:
    """The reset of the located event, then of every guard that is beyond zero afterwards; or the first reset only."""
    # Long: the resets of one instant share too many values to be taken apart.
    hybrid, resolved = evolver.hybrid, jnp.zeros_like(t) if evolver.timeless else t
    most = jnp.where(landing.alone, 0, evolver.max_cascade) if evolver.per_jump else evolver.max_cascade

    def jump(state: CascadeState) -> CascadeState:
        pushers = [_pusher(reset) for reset in hybrid.resets]
        x, moves = jax.lax.switch(state.transition, pushers, t, state.x, state.moves, state.which)
        mode = jax.lax.switch(state.transition, hybrid.targets, state.mode, t, state.x, state.which)
        if hybrid.constrained:  # the reset need not satisfy the constraints of the new mode
            x, moves = _pushed(functools.partial(evolver.onto_constraints, mode), t, x, moves)
        arrivals = [_arrival(hybrid, q) for q in range(hybrid.modes)]
        f, g, rate, second, guard_tolerance, step_rounding = by_mode(mode, arrivals, t, x, h)
        before = _in_new_mode(hybrid, state, mode)
        fired, settled = before.fired, before.fired | before.settled
        touching = _touching(hybrid, state, before, mode, t, g, guard_tolerance + step_rounding)
        guard_sign, g, rate, flat = arm(g, rate, second, guard_tolerance, step_rounding, h, resolved, settled)
        turned = before.settled & ~fired & (before.guard_sign * guard_sign < 0)  # back to zero, by another's reset
        settled, left = settled & (g == 0) & ~turned, before.left & (guard_sign < 0)
        entry = EventLog(None, t, state.transition, state.which, state.mode, mode, state.x, x)
        terminal = state.terminal | jnp.asarray(evolver.terminal)[state.transition]
        row = mode if hybrid.modes > 1 else None
        directed = table(evolver, row, hybrid.directed)
        by_flow = ~directed if hybrid.recording is None else ~directed | table(evolver, row, hybrid.recording)
        brought = _brought(by_flow, before, g, guard_sign, guard_tolerance + step_rounding)
        follows = _following(evolver, row, directed, brought, (guard_sign < 0) & ~left) & ~settled
        follows = follows & by_mode(mode, hybrid.whens, t, x) if hybrid.shared else follows
        # A guard that the flow brought to zero and the reset left at zero fires after those that the reset pushed
        # beyond zero: the order would be the same if its event were slightly later.
        rank = jnp.where(follows, jnp.where(brought, 1, 2), 0)
        equal = rank == jnp.max(rank)
        last = hybrid.slots - 1 - jnp.argmax(equal[::-1])
        guard_index = jnp.where(state.last_first, last, jnp.argmax(equal)).astype(jnp.int32)
        more = jnp.any(follows) if evolver.whole_instant else jnp.any(follows) & ~terminal
        nowhere = (mode < 0) | (mode >= hybrid.modes)  # a target that is no mode's index
        again = more & (state.count < most) & ~nowhere
        stuck = nowhere | (jnp.any(fired & flat & (guard_sign < 0) & directed) & ~again)
        if hybrid.borders is not None:  # outside the flow set, and no jump is possible
            stuck = stuck | (jnp.any(table(evolver, row, hybrid.borders) & (guard_sign < 0)) & ~more)
        by_a_flow = (brought | touching)[guard_index]  # so that it comes to a neighbour in its own time
        moves = _own_instant(evolver, again & by_a_flow, mode, t, x, f, guard_index, moves)
        transition = jnp.where(again, table(evolver, row, hybrid.transition)[guard_index], state.transition)
        which = table(evolver, row, hybrid.component)[guard_index]
        return state._replace(
            x=x,
            moves=moves,
            mode=mode,
            f=f,
            g=g,
            rate=rate,
            guard_sign=guard_sign,
            guard_tolerance=guard_tolerance,
            transition=transition,
            which=which,
            guard_index=guard_index,
            count=state.count + 1,
            again=again,
            terminal=terminal,
            stuck=stuck | state.stuck,
            together=before.together,
            settled=settled,
            left=left,
            more=more,
            several=state.several | (again & (jnp.sum(equal) > 1)),
            log=log_event(state.log, entry),
        )

    loop = checkpointed if settings.reverse else jax.lax.while_loop
    landing = loop(lambda s: s.again, jump, landing)
    f = jnp.where(landing.alone, 0.0, landing.f) if evolver.per_jump else landing.f  # no flow follows
    f = jnp.where(landing.terminal, 0.0, f) if settings.moving_end else f
    return landing._replace(moves=_returned(f, landing.moves))


class _Before(NamedTuple):
    """What was true of the guards (slots,) before a jump, in the order of the new mode; 0 or False for new ones."""

    known: Array  # whether it is a guard of the mode before, too
    g: Array
    guard_sign: Array
    fired: Array  # the guard whose jump it is
    together: Array
    settled: Array
    left: Array


def _in_new_mode(hybrid: CompiledHybrid, state: CascadeState, mode) -> _Before:
    """What is known of the guards, for the mode after the jump: a transition from several modes has one guard."""
    fired = jnp.arange(hybrid.slots, dtype=jnp.int32) == state.guard_index
    left = state.left | (state.settled & (state.guard_sign < 0))
    every = jnp.ones(hybrid.slots, bool)
    known = _Before(every, state.g, state.guard_sign, fired, state.together, state.settled, left & ~fired)
    if hybrid.modes == 1:
        return known
    same = (hybrid.transition[:, None, :, None] == hybrid.transition[None, :, None, :]) & (
        hybrid.component[:, None, :, None] == hybrid.component[None, :, None, :]
    )
    where, found = np.argmax(same, axis=3).astype(np.int32), np.any(same, axis=3)  # (new mode, old mode, slots)
    where, found = (jnp.asarray(one)[mode, state.mode] for one in (where, found))
    return jax.tree.map(lambda old: jnp.where(found, old[where], jnp.zeros((), old.dtype)), known)


def _brought(by_flow, before: _Before, g, guard_sign, rounding):
    """(slots,) the guards at zero that the flow has brought there.

    Of those that no jump fires, `by_flow`, also those that are there within rounding and will be beyond it soon: they
    seem to start beyond zero, and the next step would not see them.
    """
    passes = (jnp.abs(before.g) <= rounding) & (before.guard_sign * guard_sign < 0)
    return (g == 0) & (before.together | (by_flow & passes))


def _touching(hybrid: CompiledHybrid, state: CascadeState, before: _Before, mode, t, g, rounding):
    """(slots,) the guards that are at zero before and after a jump, as those of bodies that touch.

    Where each combination of the modes of two bodies is a mode of its own, the guard of one of them is another
    transition's after each jump of the other one. So a guard that the mode before does not have is asked at the state
    before, if in that mode some guard was at zero besides the one that fired.
    """
    g_before = before.g
    if hybrid.modes > 1:
        fired = jnp.arange(hybrid.slots, dtype=jnp.int32) == state.guard_index
        others = jnp.min(jnp.where(fired, jnp.inf, jnp.abs(state.g))) <= rounding
        asked = by_mode(mode, hybrid.guards, t, state.x)
        g_before = jnp.where(before.known, g_before, jnp.where(others, asked, jnp.inf))
    return (jnp.abs(g) <= rounding) & (jnp.abs(g_before) <= rounding)


def _following(evolver, row, directed, brought, beyond):
    """(slots,) the guards that fire after a jump: those beyond zero, and those that the flow brought to zero before it.

    The latter where they have no direction; and where their transition changes nothing only such, for it records what
    the flow does. Those that have fired here already and are still exactly at zero are for the caller to leave out, as
    are those that were beyond zero before this instant and have not come back.
    """
    hybrid = evolver.hybrid
    follows = jnp.where(directed, beyond, brought)
    return follows if hybrid.recording is None else follows & (brought | ~table(evolver, row, hybrid.recording))


def _may_be_left(evolver, mode):
    """(slots,) the guards that may stay beyond zero: those of one direction that are no border of a flow set."""
    directed, borders = table(evolver, mode, evolver.hybrid.directed), evolver.hybrid.borders
    return directed if borders is None else directed & ~table(evolver, mode, borders)


def _to_its_end(evolver, settings: Settings, t, h, start: CascadeState) -> CascadeState:
    """The whole cascade; where jumps are counted and it exceeds `max_cascade`, only its first jump."""
    if not evolver.per_jump:
        return _cascade(evolver, settings, t, h, start)

    def run(state):
        _, alone, _ = state
        found = _cascade(evolver, settings, t, h, start._replace(alone=alone))
        over = ~alone & (found.count > evolver.max_cascade)
        return over, alone | over, found

    loop = checkpointed if settings.reverse else jax.lax.while_loop
    return loop(lambda state: state[0], run, (jnp.asarray(True), start.alone, start))[2]


def _guard_derivatives(evolver, mode, t, x, f, guard_index):
    """∇h (n,), ∂ₜh and ḣ of one guard of the present mode."""

    def of_mode(guards):
        return lambda t, x, f: _gradient(lambda t, x: guards(t, x)[guard_index], t, x, f)

    return by_mode(mode, [of_mode(g) for g in evolver.hybrid.guards], t, x, f)


def _own_instant(evolver, alone, mode, t, x, f, guard_index, moves: CascadePerturbations) -> CascadePerturbations:
    """If `alone`, change from the event times of the last guard to those of a guard that the flow brought to zero."""
    gradient, moving, rate = _guard_derivatives(evolver, mode, t, x, f, guard_index)
    back, _, _, sizes = _returned(f, moves)
    if sizes is not None:
        sizes = sizes_at(sizes.columns, f, gradient, moving, rate)
    return select(alone, CascadePerturbations(back, f, event_time_shifts(gradient @ back, rate), sizes), moves)


def _returned(f, moves: CascadePerturbations) -> CascadePerturbations:
    """Bring the columns back to the event time of the reference orbit."""
    columns, direction, event_time_shift, sizes = moves
    if sizes is not None:
        sizes = sizes._replace(columns=sizes_returned(sizes, f))
    return moves._replace(columns=to_reference_time(columns, direction, f, event_time_shift), sizes=sizes)


def in_each_order(
    evolver, settings: Settings, t, h, carry, columns, terms, mode, event, meeting: Meeting, at_once
) -> CascadeState:
    """The cascade; where several guards may be next at one instant, run it again with another one and compare.

    `terms`: magnitudes of the frame's columns, one or several (n, k) side by side. One other order shows whether the
    order matters; where all solutions are asked for, each guard that the flow brings to zero is first in turn. Where a
    jump sends several guards beyond zero at once, it is run once more, with the last of them first.
    """
    log = carry.log
    if evolver.hybrid.slots > 1:  # each order has a short log of its own; the long one would be copied for each
        carry = carry._replace(log=empty_log(log, most_at_once(carry.x, log)))

    @jax.jit  # traced once, for shapes and loop
    def start(event, last_first):
        begun = _start_cascade(evolver, settings, t, carry, columns, terms, mode, event, meeting, at_once)
        return begun._replace(last_first=last_first)

    guard_index, choices, no, together = event[2], carry.solver_state.choices, jnp.asarray(False), meeting.together
    if evolver.hybrid.slots == 1:
        return _to_its_end(evolver, settings, t, h, start(event, no))._replace(together=no)
    count = jnp.sum(together)
    several, turns = (count > 1) & (guard_index >= 0), 2 if choices is None else count
    pick = None if choices is None else choices.pick()

    others = together & (jnp.arange(evolver.hybrid.slots, dtype=jnp.int32) != guard_index)

    def first(turn):
        other = jnp.argmax(jnp.cumsum(others) == turn).astype(jnp.int32)
        named = (
            table(evolver, carry.solver_state.mode, of_slot)
            for of_slot in (evolver.hybrid.transition, evolver.hybrid.component)
        )
        return (*(one[other] for one in named), other)

    last = jnp.where(several, turns, 1)

    def run(state):
        turn, kept, chosen, differs, later = state
        once_more = turn == last
        own = select((turn == 0) | once_more, event, first(turn))
        landing = _to_its_end(evolver, settings, t, h, start(own, once_more))
        differ = (turn > 0) & _orders_differ(landing, kept)
        chosen = None if chosen is None else select(turn == pick, landing, chosen)
        return turn + 1, select(turn == 0, landing, kept), chosen, differs | (differ & ~once_more), differ & once_more

    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(start, event, no))
    begin = (jnp.asarray(0), nothing, None if choices is None else nothing, no, no)
    loop = checkpointed if settings.reverse else jax.lax.while_loop
    _, landing, chosen, differs, later = loop(
        lambda state: (state[0] < last) | ((state[0] == last) & state[1].several), run, begin
    )
    if chosen is not None:
        landing = select(differs, chosen, landing)
    return landing._replace(together=differs, several=later, log=log_events(log, landing.log))


def _gradient(guard, t, x, f):
    gradient, rate = instant(guard, t, x, f)[::2]
    return gradient, rate - jnp.sum(gradient * f), rate


def _orders_differ(a: CascadeState, b: CascadeState):
    """Whether two orders of the same events give different states or tangents.

    Components may be in very different units: each is compared with itself, and with the rounding of the largest.
    """
    alike, sizes = digits(1e-9, b.x), jnp.abs(a.x) + jnp.abs(b.x)
    size = 1.0 + jnp.max(jnp.abs(b.moves.columns), initial=0.0)
    columns = jnp.max(jnp.abs(a.moves.columns - b.moves.columns), initial=0.0) > alike * size
    states = jnp.any(jnp.abs(a.x - b.x) > alike * sizes + digits(GUARD_ROUNDING, b.x) * jnp.max(sizes))
    return columns | states | (a.mode != b.mode)


def _pusher(reset):
    return lambda t, x, moves, which: _pushed(lambda t, x: reset(t, x, which), t, x, moves)


def _pushed(reset, t, x, moves: CascadePerturbations) -> tuple[Array, CascadePerturbations]:
    """Carry the state and the perturbations through one reset."""
    columns, direction, event_time_shift, sizes = moves
    new, columns, direction = pushforward(reset, t, x, columns, direction)
    if sizes is not None:
        sizes = sizes_pushed(reset, t, x, sizes, direction)
    return new, CascadePerturbations(columns, direction, event_time_shift, sizes)


def _arrival(hybrid: CompiledHybrid, q: int):
    guards, field = hybrid.guards[q], hybrid.fields[q]
    return lambda t, x, h: (field(t, x), *to_arm(guards, field, t, x, h))
