"""Trials: what a trial step says about the guards, and where the next one has to end to locate an event."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._jax.precision import BLUR, digits, nonzero
from ...events.roots import cubic, hermite_root, turning_point
from ..states import StepState

REJECT, ADVANCE, LOCATE, LAND, FAIL, NONE = range(6)  # what a trial says; NONE: there is none yet

NEAR = 1e-6  # a trial lands when the root is nearer than this, relative to the controller's step
PROBE = 0.21132486540518713  # (3 - √3)/6 of a step, where the slope of a cubic interpolant errs most
GUARD_RESOLUTION = 0.02  # how well the cubic of a guard must agree with the guard in the middle of a step
TURNED, NEARLY = 1e-3, 10.0  # part of a guard's rate that is left where it turns; tolerances within which it grazes
ALONE, FIRST = 1.0, 2.0  # a jump that no flow leads up to: of a cascade without end; of a start off the flow set
PATIENCE = 30  # relocations of one event before the landing is forced


class Memory(NamedTuple):
    """Numbers that only events need, in one vector of the carry."""

    last: Any  # time of the last event, local to the block
    interval: Any  # between the last two events
    longest: Any  # interval so far
    streak: Any  # short intervals in a row
    transversality: Any  # least so far
    grazing: Any  # seen? 0 or 1, as the next
    simultaneous: Any
    accumulation: Any  # estimated end of an accumulation of events
    guard_index: Any  # whose event was the last, counted over all modes; -1: a clock's
    doubtful: Any  # was a column lost where rounding may have done it? 0 or 1
    pending: Any  # does a jump come next, without a flow? `ALONE`: of a cascade that does not end; `FIRST`; or 0


class Choices(NamedTuple):
    """Instants at which several events meet and their order matters: what is to be done there, and what was met."""

    picks: Any  # (most,) which of the events goes first, at the first such instant, the second, …
    options: Any  # (most,) how many events there were; 0 where a run has not come to so many instants
    times: Any  # (most,)
    count: Any  # of such instants; beyond `most` of them the first event goes first

    def pick(self):
        """Which event goes first at the next such instant."""
        most = self.picks.shape[0]
        return jnp.where(self.count < most, self.picks[jnp.minimum(self.count, most - 1)], 0)

    def met(self, when, options, t) -> "Choices":
        """After an instant with so many events, if their order matters there."""
        here = when & (jnp.arange(self.picks.shape[0], dtype=jnp.int32) == self.count)
        return self._replace(
            options=jnp.where(here, options.astype(jnp.int32), self.options),
            times=jnp.where(here, jax.lax.stop_gradient(t), self.times),
            count=self.count + when.astype(jnp.int32),
        )


class SolverState(NamedTuple):
    """The evolver's part of the carry."""

    f: Any  # the field at the start of the step
    h: Any  # the controller's step
    log_ratio: Any  # of the last accepted step, for the PI controller
    mode: Any
    g: Any  # (slots,) guards at the start of the step, and their rates
    rate: Any
    guard_sign: Any
    guard_tolerance: Any  # (slots,) rounding of the guards
    ticks: Any  # (clocks,) number of the next tick
    memory: Any
    choices: Any = None  # `Choices`, where all solutions are asked for


class Trial(NamedTuple):
    """One trial step of the state, and what it says about the guards."""

    case: Any  # REJECT, ADVANCE, LOCATE, LAND, FAIL or NONE
    h: Array
    x: Array
    f: Array
    ratio: Any  # error over tolerance
    final: Any  # ends the block
    g: Any = None
    rate: Any = None
    miss: Any = None  # (slots,) by how much the cubic of a guard is off
    tick: Any = None  # the clock that ticks at the end of the step; -1: none
    stage_points: tuple[Array, ...] = ()  # the points on the way, where the tangent is to be taken at them


class RootBracket(NamedTuple):
    """What a trial aims at while an event is located."""

    h: Any  # length of the trial
    beyond: Any  # where the guard is known to be beyond its root
    guard_index: Any  # whose root; -1: a turning point, or nothing
    tries: Any


class Signs(NamedTuple):
    """What the guards did during a trial: (slots,) each."""

    crossed: Array
    turn: Array  # turns towards zero inside the step, and may be beyond it there
    theta: Array  # where it turns
    lands: Array  # has its root at the end of the trial
    ahead: Array  # time from there to its root


def miss(tr: Trial):
    """By how much the cubics of the guards are off; unknown, and taken as 0, where steps are fixed."""
    return jnp.zeros_like(tr.g) if tr.miss is None else tr.miss


def no_bracket(h) -> RootBracket:
    """Aim at nothing."""
    infinity = jnp.full_like(h, jnp.inf)
    return RootBracket(infinity, infinity, jnp.asarray(-1, jnp.int32), jnp.asarray(0, jnp.int32))


def changed(c: StepState, **changes) -> StepState:
    """The carry with changes in the evolver's part."""
    return c._replace(solver_state=c.solver_state._replace(**changes))


def resolve(evolver, solver: SolverState, tr: Trial, slope) -> Trial:
    """How well the cubic of each guard follows the guard: it must, for events to be seen."""
    if slope is None:
        return tr
    # The cubic errs like θ²(1-θ)²; its slope errs most at the probe, 3.08 times its error in the middle.
    d0, d1 = tr.h * solver.rate, tr.h * tr.rate
    miss = jnp.abs(tr.h * slope - cubic(PROBE, solver.g, d0, tr.g, d1)[1]) / 3.0792
    size = jnp.abs(solver.g) + jnp.abs(tr.g) + 0.25 * (jnp.abs(d0) + jnp.abs(d1))
    # A guard that is nothing but rounding all along the step has no structure to be seen.
    hidden = jnp.where(size <= solver.guard_tolerance, solver.guard_tolerance, 0.0)
    allowed = GUARD_RESOLUTION * size + 1e3 * evolver.method.atol + hidden
    return tr._replace(miss=miss, ratio=jnp.maximum(tr.ratio, jax.lax.stop_gradient(jnp.max(miss / allowed))))


def firing(evolver, solver: SolverState):
    """The slots that a change of sign would fire."""
    directed = table(evolver, solver.mode, evolver.hybrid.directed)
    return (solver.guard_sign > 0) | (~directed & (solver.guard_sign != 0))


def is_beyond(solver: SolverState, tr: Trial):
    """The guards on or beyond zero at the end of a trial; one that starts at zero may have left it by rounding only."""
    after = solver.guard_sign * tr.g
    return jnp.where(solver.g == 0, after < -solver.guard_tolerance, after <= 0)


def stays(evolver, solver: SolverState, tr: Trial) -> tuple[Any, Any]:
    """Sides and guards after a step without an event: what seems to have fired there is at zero up to rounding."""
    guard_sign = jnp.where(
        firing(evolver, solver), solver.guard_sign, jnp.where(tr.g == 0, solver.guard_sign, jnp.sign(tr.g))
    )
    return guard_sign, jnp.where(guard_sign * tr.g < 0, 0.0, tr.g)


def suspects(evolver, solver: SolverState, tr: Trial):
    """Whether a guard may have been crossed: cheap, and never wrong in saying no."""
    before, after = solver.guard_sign * solver.g, solver.guard_sign * tr.g
    crossed = firing(evolver, solver) & (after <= 0)
    turns = (solver.guard_sign * solver.rate < 0) & (solver.guard_sign * tr.rate > 0) & (after > 0)
    reach = tr.h * jnp.abs(tr.rate - solver.rate) + 4.0 * miss(tr)
    return jnp.any(crossed | (turns & ((before <= reach) | (after <= reach))))


def finds(evolver, solver: SolverState, tr: Trial, bracket: RootBracket):
    """Whether there is an event to be located still, and whether the trial ends at one."""
    signs, given_up = read_signs(evolver, solver, tr, bracket), bracket.tries > PATIENCE
    found = jnp.any(signs.crossed | signs.turn)
    event = (found | (bracket.guard_index >= 0)) & ~(given_up & ~jnp.any(signs.crossed))
    far = jnp.any((signs.crossed & ~signs.lands) | signs.turn)
    return event, jnp.any(signs.lands) & (~far | given_up)


def read_signs(evolver, solver: SolverState, tr: Trial, bracket: RootBracket) -> Signs:
    """Which guards crossed zero during a trial, turned towards it, or have their root at its end."""
    fires = firing(evolver, solver)
    crossed = fires & is_beyond(solver, tr)
    # A guard that turns back inside the step: the step is cut there if it may have been beyond zero.
    d0, d1 = tr.h * solver.rate, tr.h * tr.rate
    turns = (d0 * d1 < 0) & (solver.guard_sign * d0 < 0) & (solver.guard_sign * tr.g > 0)
    theta = turning_point(solver.g, d0, tr.g, d1)
    extreme, _ = cubic(theta, solver.g, d0, tr.g, d1)
    drop = jnp.minimum(jnp.abs(solver.g - extreme), jnp.abs(tr.g - extreme))
    none = digits(1e-9, theta)
    doubt = 0.2 * drop + 64.0 * (theta * (1 - theta)) ** 2 * miss(tr)
    turn = turns & (solver.guard_sign * extreme <= doubt) & (theta > none) & (theta < 1 - none)
    ahead = -tr.g / jnp.where(tr.rate == 0, nonzero(1e-300, tr.rate), tr.rate)
    close = fires & (solver.guard_sign * tr.rate < 0) & (jnp.abs(ahead) <= digits(NEAR, ahead) * solver.h)
    aimed = jnp.arange(evolver.hybrid.slots, dtype=jnp.int32) == bracket.guard_index
    lands = close & ((bracket.guard_index >= 0) | jnp.any(crossed))
    lands = lands | ((bracket.tries > PATIENCE) & (crossed | aimed))
    return Signs(crossed, turn, theta, lands, ahead)


def grazes(evolver, solver: SolverState, tr: Trial, bracket: RootBracket):
    """Whether a guard turned back at the end of a trial that was cut there, off zero by less than the tolerance."""
    bend = (tr.rate - solver.rate) / tr.h
    least = solver.guard_sign * (tr.g - 0.5 * tr.rate**2 / jnp.where(bend == 0, nonzero(1e-300, bend), bend))
    turned = (solver.guard_sign * solver.rate < 0) & (jnp.abs(tr.rate) <= TURNED * jnp.abs(solver.rate))
    tolerance = NEARLY * (
        evolver.method.atol + evolver.method.rtol * (solver.guard_tolerance / digits(BLUR, solver.guard_tolerance))
    )
    close = firing(evolver, solver) & turned & (jnp.abs(least) <= tolerance)
    return (tr.case == ADVANCE) & (bracket.tries > 0) & (bracket.guard_index < 0) & jnp.any(close)


def pending(solver: SolverState):
    """Whether a jump comes next, and which: 0, `ALONE` or `FIRST`."""
    return solver.memory[Memory._fields.index("pending")]


def has_fired(evolver, solver: SolverState):
    """The slot (slots,) whose event was the last, where the motion is still in its mode."""
    slots = evolver.hybrid.slots
    first = 0 if solver.mode is None else slots * solver.mode
    last = solver.memory[Memory._fields.index("guard_index")]
    return (jnp.arange(slots, dtype=jnp.int32) + first).astype(last.dtype) == last


def table(evolver, mode, table: np.ndarray):
    """The row of a table for the present mode."""
    return jnp.asarray(table[0]) if len(table) == 1 else jnp.asarray(table)[mode]


def next_bracket(evolver, solver: SolverState, tr: Trial, bracket: RootBracket) -> RootBracket:
    """A guard was crossed, or may have been: aim at the earliest root or turning point.

    A first trial was only suspected: where a close look finds nothing the aim is the same step again.
    """
    signs, h = read_signs(evolver, solver, tr, bracket), tr.h
    d0, d1 = h * solver.rate, h * tr.rate
    # A guard that starts at zero first leaves it: its root lies beyond the extremum between.
    lo = jnp.where((solver.g == 0) & (d0 * d1 < 0), turning_point(solver.g, d0, tr.g, d1), 0.0)
    roots = jnp.where(signs.crossed, h * hermite_root(lo, solver.g, d0, tr.g, d1), jnp.inf)
    guard_index = jnp.argmin(roots).astype(jnp.int32)
    cut = jnp.min(jnp.where(signs.turn, h * signs.theta, jnp.inf))
    # An undershoot of the slot aimed at: one Newton step, kept below where the guard is known to be beyond.
    aimed = jnp.maximum(bracket.guard_index, 0)
    newton = h + signs.ahead[aimed]
    newton = jnp.where((newton > h) & (newton < bracket.beyond), newton, 0.5 * (h + bracket.beyond))
    undershot = (bracket.guard_index >= 0) & ~jnp.any(signs.crossed)
    root = jnp.where(undershot, newton, roots[guard_index])
    guard_index = jnp.where(undershot, aimed, jnp.where(jnp.any(signs.crossed), guard_index, -1))
    # The cubic's root may stagnate at one end where it is very flat: then bisect.
    root = jnp.where((bracket.tries > 10) & ~undershot, 0.5 * root, root)
    target = jax.lax.stop_gradient(jnp.minimum(root, cut))
    beyond = jax.lax.stop_gradient(jnp.where(undershot, bracket.beyond, h))
    return RootBracket(target, beyond, jnp.where(root <= cut, guard_index, -1).astype(jnp.int32), bracket.tries + 1)
