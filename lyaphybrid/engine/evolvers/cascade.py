"""The jumps of one instant: the resets one after the other, and perturbations on their way through them."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.precision import BLUR, digits, nonzero
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
from ..states import Events, Settings, StepState, log_event, select
from .trials import ALONE, pending, table

__all__ = ["Landing", "Moves", "in_each_order", "orthonormalises"]


class Moves(NamedTuple):
    """Perturbations on their way through the jumps of one instant."""

    columns: Array
    direction: Array  # (n,) along which the columns are moved to their own instants …
    event_time_shift: Array  # … by δτ (columns,)
    sizes: Sizes | None  # of these three, for the columns of the frame; None where nothing is orthonormalised


class Landing(NamedTuple):
    """The state on its way through the jumps of one instant."""

    x: Array
    moves: Moves
    mode: Array
    f: Array  # of the new mode
    g: Array
    rate: Array
    guard_sign: Array
    guard_tolerance: Array
    transition: Array
    which: Array
    guard_index: Array
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


def orthonormalises(settings: Settings, c: StepState) -> bool:
    """Whether there are columns, and they are orthonormalised at all."""
    return settings.qr_schedule.unit != "never" and c.frame.shape[1] > 0


def _start_cascade(evolver, settings, t, c, columns, mode, event, together, at_once) -> Landing:
    """On the guard, before the first jump: the own instant of each column."""
    w, x, (transition, which, guard_index) = evolver.hybrid, c.x, event
    f = by_mode(mode, w.fields, t, x)
    gradient, moving, rate = _instant(evolver, mode, t, x, f, guard_index)
    ticking = (guard_index < 0) | at_once  # the instant of a clock is everybody's, and each has come to its own before
    size = jnp.sqrt(jnp.sum(gradient**2) * jnp.sum(f**2) + nonzero(1e-300, f)) + jnp.abs(moving)
    guard_tolerance = digits(BLUR, x) * (jnp.sum(jnp.abs(gradient * x)) + jnp.abs(moving * t))
    sizes = None
    if orthonormalises(settings, c):
        sizes = sizes_at(c.frame, f, gradient, moving, rate)
        sizes = sizes._replace(event_time_shift=jnp.where(ticking, 0.0, sizes.event_time_shift))
    slots, no = jnp.zeros(w.slots, x.dtype), jnp.asarray(False)
    return Landing(
        x=x,
        moves=Moves(columns, f, jnp.where(ticking, 0.0, event_time_shifts(gradient @ columns, rate)), sizes),
        mode=mode,
        f=f,
        g=slots,
        rate=slots,
        guard_sign=slots,
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
        together=together,
        more=no,
        alone=jnp.asarray(at_once) & (pending(c.solver_state) == ALONE),
        log=c.log,
    )


def _cascade(evolver, settings: Settings, t, h, landing: Landing) -> Landing:
    """The reset of the located event, and of every guard on whose fired side it ends; or the first of them alone."""
    w, resolved = evolver.hybrid, jnp.zeros_like(t) if evolver.timeless else t
    most = jnp.where(landing.alone, 0, evolver.max_cascade) if evolver.per_jump else evolver.max_cascade

    def jump(state: Landing) -> Landing:
        pushers = [_pusher(reset) for reset in w.resets]
        x, moves = jax.lax.switch(state.transition, pushers, t, state.x, state.moves, state.which)
        mode = jax.lax.switch(state.transition, w.targets, state.mode, t, state.x, state.which)
        if w.constrained:  # what a jump leaves undecided is that the new constraints hold
            x, moves = _pushed(functools.partial(evolver.onto_constraints, mode), t, x, moves)
        f, g, rate, second, guard_tolerance, way = by_mode(mode, [_arrival(w, q) for q in range(w.modes)], t, x, h)
        fired = (jnp.arange(w.slots, dtype=jnp.int32) == state.guard_index) & (mode == state.mode)
        guard_sign, g, rate, flat = arm(g, rate, second, guard_tolerance, way, h, resolved, fired)
        entry = Events(None, t, state.transition, state.which, state.mode, mode, state.x, x)
        terminal = state.terminal | jnp.asarray(evolver.terminal)[state.transition]
        # A guard on its fired side fires now; the one that has just fired, and at which the jump ends, does not.
        directed = table(evolver, mode if w.modes > 1 else None, w.directed)
        follows = directed & (guard_sign < 0) & ~(fired & (g == 0))
        follows = follows & by_mode(mode, w.whens, t, x) if w.shared else follows
        # One that the flow itself brought to zero at this instant, and the jump left there, comes after all that the
        # jump pushed through: had it been later, these would have been first.
        alone = state.together & (g == 0) & (mode == state.mode)
        guard_index = jnp.argmax(jnp.where(follows, jnp.where(alone, 1, 2), 0)).astype(jnp.int32)
        more = jnp.any(follows) & ~terminal
        again = more & (state.count < most)
        stuck = jnp.any(fired & flat & (guard_sign < 0) & directed) & ~again
        if w.borders is not None:  # beyond the border of the flow set, and no jump
            stuck = stuck | (
                jnp.any(table(evolver, mode if w.modes > 1 else None, w.borders) & (guard_sign < 0)) & ~more
            )
        moves = _own_instant(evolver, again & alone[guard_index], mode, t, x, f, guard_index, moves)
        transition = jnp.where(
            again, table(evolver, mode if w.modes > 1 else None, w.transition)[guard_index], state.transition
        )
        which = table(evolver, mode if w.modes > 1 else None, w.component)[guard_index]
        return Landing(
            x,
            moves,
            mode,
            f,
            g,
            rate,
            guard_sign,
            guard_tolerance,
            transition,
            which,
            guard_index,
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
    f = jnp.where(landing.alone, 0.0, landing.f) if evolver.per_jump else landing.f  # who does not flow on stays there
    return landing._replace(moves=_returned(f, landing.moves))


def _to_its_end(evolver, settings: Settings, t, h, start: Landing) -> Landing:
    """A cascade; where jumps are counted, and it goes on beyond `max_cascade`, its first jump alone."""
    if not evolver.per_jump:
        return _cascade(evolver, settings, t, h, start)

    def run(state):
        _, alone, _ = state
        found = _cascade(evolver, settings, t, h, start._replace(alone=alone))
        over = ~alone & (found.count > evolver.max_cascade)
        return over, alone | over, found

    loop = checkpointed if settings.reverse else jax.lax.while_loop
    return loop(lambda state: state[0], run, (jnp.asarray(True), start.alone, start))[2]


def _instant(evolver, mode, t, x, f, guard_index):
    """∇h, ∂ₜh and ḣ of a slot of the present mode."""

    def of_mode(guards):
        return lambda t, x, f: _gradient(lambda t, x: guards(t, x)[guard_index], t, x, f)

    return by_mode(mode, [of_mode(g) for g in evolver.hybrid.guards], t, x, f)


def _own_instant(evolver, alone, mode, t, x, f, guard_index, moves: Moves) -> Moves:
    """Columns whose instant was another guard's, at that of a guard that no jump brought to zero."""
    gradient, moving, rate = _instant(evolver, mode, t, x, f, guard_index)
    back, _, _, sizes = _returned(f, moves)
    if sizes is not None:
        sizes = sizes_at(sizes.columns, f, gradient, moving, rate)
    return select(alone, Moves(back, f, event_time_shifts(gradient @ back, rate), sizes), moves)


def _returned(f, moves: Moves) -> Moves:
    """Back to the instant of the orbit."""
    columns, direction, event_time_shift, sizes = moves
    if sizes is not None:
        sizes = sizes._replace(columns=sizes_returned(sizes, f))
    return moves._replace(columns=to_reference_time(columns, direction, f, event_time_shift), sizes=sizes)


def in_each_order(evolver, settings: Settings, t, h, c, columns, mode, event, together, at_once) -> Landing:
    """Where several guards meet at one instant: let another one be the first, too, and compare.

    One other is enough to see that the order matters; where all solutions are asked for, each is the first in turn.
    """

    def start(event):
        return _start_cascade(evolver, settings, t, c, columns, mode, event, together, at_once)

    guard_index, choices = event[2], c.solver_state.choices
    if evolver.hybrid.slots == 1:
        return _to_its_end(evolver, settings, t, h, start(event))._replace(together=jnp.asarray(False))
    count = jnp.sum(together)
    several, turns = (count > 1) & (guard_index >= 0), 2 if choices is None else count
    pick = None if choices is None else choices.pick()

    def first(turn):
        guard_index = jnp.argmax(jnp.cumsum(together) == turn + 1).astype(jnp.int32)
        named = (
            table(evolver, c.solver_state.mode, of_slot)
            for of_slot in (evolver.hybrid.transition, evolver.hybrid.component)
        )
        return (*(one[guard_index] for one in named), guard_index)

    def run(state):
        turn, kept, chosen, differs = state
        landing = _to_its_end(evolver, settings, t, h, start(select(turn == 0, event, first(turn))))
        differs = differs | ((turn > 0) & _apart(landing, kept))
        chosen = None if chosen is None else select(turn == pick, landing, chosen)
        return turn + 1, select(turn == 0, landing, kept), chosen, differs

    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(start, event))
    last = jnp.where(several, turns, 1)
    begin = (jnp.asarray(0), nothing, None if choices is None else nothing, jnp.asarray(False))
    loop = checkpointed if settings.reverse else jax.lax.while_loop
    _, landing, chosen, differs = loop(lambda state: state[0] < last, run, begin)
    if chosen is not None:
        landing = select(differs, chosen, landing)
    return landing._replace(together=differs)


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
    columns, direction, event_time_shift, sizes = moves
    new, columns, direction = pushforward(reset, t, x, columns, direction)
    if sizes is not None:
        sizes = sizes_pushed(reset, t, x, sizes, direction)
    return new, Moves(columns, direction, event_time_shift, sizes)


def _arrival(w: CompiledHybrid, q: int):
    guards, field = w.guards[q], w.fields[q]
    return lambda t, x, h: (field(t, x), *to_arm(guards, field, t, x, h))
