"""Trials: what a trial step shows about the guards, and where the next trial must end to locate an event."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._jax.precision import GUARD_ROUNDING, digits, is_short, nonzero
from ...events.bits import as_bits
from ...events.compiled_hybrid import by_mode
from ...events.roots import cubic, hermite_root, rates, rounding, turning_point
from ...events.turns import clear, hidden
from ..states import StepState

REJECT, ADVANCE, LOCATE, LAND, FAIL, NONE = range(6)  # cases of a trial; NONE: no trial yet

NEAR = 1e-6  # a trial lands if the root is closer than this, relative to the controller's step
GUARD_RESOLUTION = 0.02  # largest relative error of a guard's cubic interpolant in the middle of a step
ALONE, FIRST = 1.0, 2.0  # jumps without a flow before: in a cascade without end; from a start outside the flow set
LEFT = -0.5  # the `guard_sign` of a guard that was left beyond zero before a cascade without end: it does not follow
STRAIGHT = 0.01  # a guard that bends by less than this part of its tolerance counts as straight
PATIENCE = 30  # trials to locate one event before landing is forced


class Memory(NamedTuple):
    """Quantities that only events need, stored as one vector in the solver state."""

    last: Any  # time of the last event, local to the block
    interval: Any  # between the last two events
    longest: Any  # longest interval so far
    streak: Any  # number of short intervals in a row
    transversality: Any  # smallest so far
    grazing: Any  # 1 if an event was grazing, else 0
    simultaneous: Any  # 1 if guards met at one instant and their order matters, else 0
    accumulation: Any  # estimated time at which events accumulate (Zeno)
    guard_index: Any  # guard of the last event, counted over all modes; -1: a clock
    doubtful: Any  # 1 if a column was lost where rounding may be the cause, else 0
    pending: Any  # `ALONE` or `FIRST` if a jump comes next without a flow before it, else 0
    waiting: Any  # the guards of the first mode that were beyond zero at the start and have been since, see `as_bits`

    @classmethod
    def at_start(cls, like, waiting) -> "Memory":
        """Before the first event; of the type of a number."""
        zero, one = jnp.zeros_like(like), jnp.ones_like(like)
        return cls(zero, zero, zero, zero, one * jnp.inf, zero, zero, one * jnp.nan, -one, zero, zero, waiting)


class Choices(NamedTuple):
    """Instants at which several events coincide and their order matters: the choices to make, and what was found."""

    picks: Any  # (most,) index of the event to apply first, at the first such instant, the second, …
    options: Any  # (most,) number of coinciding events; 0 for instants that were not reached
    times: Any  # (most,) times of the instants
    count: Any  # number of such instants so far; beyond `most` the first event is applied first
    others: Any  # whether the order of later jumps of a cascade matters too, which no pick changes

    def pick(self):
        """The index of the event to apply first at the next such instant."""
        most = self.picks.shape[0]
        return jnp.where(self.count < most, self.picks[jnp.minimum(self.count, most - 1)], 0)

    def met(self, when, options, t) -> "Choices":
        """Record an instant with `options` coinciding events, if their order matters (`when`)."""
        here = when & (jnp.arange(self.picks.shape[0], dtype=jnp.int32) == self.count)
        return self._replace(
            options=jnp.where(here, options.astype(jnp.int32), self.options),
            times=jnp.where(here, jax.lax.stop_gradient(t), self.times),
            count=self.count + when.astype(jnp.int32),
        )


class SolverState(NamedTuple):
    """The evolver's state within the loop's state."""

    f: Any  # (n,) the vector field at the start of the step
    h: Any  # the controller's step
    log_ratio: Any  # ln(error / tolerance) of the last accepted step, for the PI controller
    mode: Any  # its index; None where there is one mode
    g: Any  # (slots,) guards at the start of the step
    rate: Any  # (slots,) their time derivatives along the flow
    guard_sign: Any  # (slots,) the side of zero on which each guard is, see `roots.arm`
    guard_tolerance: Any  # (slots,) rounding of the guards
    ticks: Any  # (clocks,) number of the next tick
    memory: Any  # `Memory` as a vector
    choices: Any = None  # `Choices`, where all solutions are asked for


class Trial(NamedTuple):
    """One trial step of the state, and what it shows about the guards."""

    case: Any  # REJECT, ADVANCE, LOCATE, LAND, FAIL or NONE
    h: Array
    x: Array
    f: Array
    ratio: Any  # error over tolerance
    final: Any  # whether it ends the block
    g: Any = None  # (slots,) guards at the end
    rate: Any = None  # (slots,) their time derivatives
    miss: Any = None  # (slots,) error of each guard's cubic interpolant
    tick: Any = None  # the clock that ticks at the end of the step; -1: none
    stage_points: tuple[Array, ...] = ()  # the stages' points, if the tangent reuses them
    hidden: Any = None  # (slots,) whether the guard may have zeros inside that its ends do not show


class RootBracket(NamedTuple):
    """The target of the next trial while an event is being located; times count from the start of the step."""

    h: Any  # length of the trial
    beyond: Any  # a time at which the guard is known to be beyond its root
    guard_index: Any  # the guard whose root is the target; -1: a turning point, or no target
    tries: Any  # number of trials for this event


class Signs(NamedTuple):
    """What the guards did during a trial: (slots,) each."""

    crossed: Array  # is beyond zero at the end
    turn: Array  # has an extremum inside the step that may be beyond zero
    theta: Array  # the extremum, as a fraction of the step
    lands: Array  # has its root at the end of the trial
    ahead: Array  # time from the end to the root


def miss(trial: Trial):
    """(slots,) errors of the guards' cubic interpolants; not estimated, and taken as 0, for fixed steps."""
    return jnp.zeros_like(trial.g) if trial.miss is None else trial.miss


def no_bracket(h) -> RootBracket:
    """No target: the next trial has the controller's step."""
    infinity = jnp.full_like(h, jnp.inf)
    return RootBracket(infinity, infinity, jnp.asarray(-1, jnp.int32), jnp.asarray(0, jnp.int32))


def waiting_at_start(evolver, mode, g, guard_sign):
    """The guards that the start is beyond, so that they do not fire, as bits; not those that only record."""
    beyond = table(evolver, mode, evolver.hybrid.directed) & (guard_sign < 0) & (g != 0)
    if evolver.hybrid.recording is not None:
        beyond &= ~table(evolver, mode, evolver.hybrid.recording)
    return as_bits(beyond).astype(g.dtype)


def changed(carry: StepState, **changes) -> StepState:
    """The carry with changed fields of the solver state."""
    return carry._replace(solver_state=carry.solver_state._replace(**changes))


def trial_in(evolver, q: int):
    """Of mode q: (t, x, f, h) -> step, error over tolerance, guards, their rates at the end and inside."""
    hybrid, method = evolver.hybrid, evolver.method

    def of_mode(t, x, f, h):
        step = evolver.alike(method.step(hybrid.fields[q], t, x, f, h), x)
        ratio = jax.lax.stop_gradient(method.state_ratio(step, x)) if evolver.rejects else None
        if not evolver.has_events:
            return step._replace(stage_slopes=()), ratio, None, None, ()
        at = hybrid.calls.once(functools.partial(rates, hybrid.guards[q]), "rates", hybrid.guards[q])
        g, rate = at(t + h, step.x, step.f)
        inside = [at(*sample)[1] for sample in method.samples(hybrid.fields[q], t, h, step)]
        return step._replace(stage_slopes=()), ratio, g, rate, inside

    return hybrid.calls.once(of_mode, "trial", method, hybrid.fields[q], hybrid.guards[q] if hybrid.guards else None)


def resolve(evolver, solver: SolverState, trial: Trial, inside) -> Trial:
    """Add the error of each guard's cubic interpolant to the step's error ratio: it must be small to detect events."""
    if not evolver.rejects:
        return trial
    miss = interpolation_errors(evolver, solver, trial.g, trial.rate, trial.h, inside)
    size = jnp.abs(solver.g) + jnp.abs(trial.g) + 0.25 * trial.h * (jnp.abs(solver.rate) + jnp.abs(trial.rate))
    # A guard that is within rounding of zero during the whole step cannot be resolved.
    hidden = jnp.where(size <= solver.guard_tolerance, solver.guard_tolerance, 0.0)
    allowed = GUARD_RESOLUTION * size + 1e3 * evolver.method.atol + hidden
    return trial._replace(miss=miss, ratio=jnp.maximum(trial.ratio, jax.lax.stop_gradient(jnp.max(miss / allowed))))


def interpolation_errors(evolver, solver: SolverState, g, rate, h, inside):
    """(slots,) errors of the guards' cubic interpolants in the middle of a step of length h, from a slope inside."""
    # The error of the cubic is proportional to θ²(1-θ)², that of its slope to the derivative of this, which is largest
    # at (3 ± √3)/6 of the step.
    shares = [abs(32 * theta * (1 - theta) * (1 - 2 * theta)) for theta in evolver.method.sample_fractions]
    best = max(range(len(shares)), key=lambda i: (round(shares[i], 9), i))  # of two the later stage: it is more exact
    slope = cubic(evolver.method.sample_fractions[best], solver.g, h * solver.rate, g, h * rate)[1]
    return jnp.abs(h * inside[best] - slope) / shares[best]


def firing(evolver, solver: SolverState):
    """(slots,) the guards that fire if their sign changes."""
    directed = table(evolver, solver.mode, evolver.hybrid.directed)
    return (solver.guard_sign > 0) | (~directed & (solver.guard_sign != 0))


def is_beyond(solver: SolverState, trial: Trial):
    """(slots,) guards at or beyond zero at the end; one that starts at zero must be beyond it by more than rounding.

    Or have risen and fallen by more: a flight that hardly rises above the guard's rounding.
    """
    after, least = solver.guard_sign * trial.g, solver.guard_tolerance
    rises, falls = (solver.guard_sign * trial.h * rate for rate in (solver.rate, trial.rate))
    returns = (after <= 0) & (rises > least) & (falls < -least)
    return jnp.where(solver.g == 0, (after < -least) | returns, after <= 0)


def stays(evolver, solver: SolverState, trial: Trial) -> tuple[Any, Any]:
    """Guard signs and guards after a step without an event; a guard beyond zero is so by rounding and is set to 0."""
    guard_sign = side(evolver, solver, trial.g)
    return guard_sign, jnp.where(guard_sign * trial.g < 0, 0.0, trial.g)


def side(evolver, solver: SolverState, g):
    """(slots,) the side of zero of each guard where the guards are g: that of a guard that may fire has not changed."""
    return jnp.where(firing(evolver, solver), solver.guard_sign, jnp.where(g == 0, solver.guard_sign, jnp.sign(g)))


def suspects(evolver, solver: SolverState, trial: Trial, inside):
    """Whether a guard may have been crossed: a cheap test without false negatives."""
    crossed = firing(evolver, solver) & (solver.guard_sign * trial.g <= 0)
    rates = solver.rate, *inside, trial.rate
    return jnp.any(crossed | ~clear(evolver.method.sample_fractions, solver.guard_sign, solver.g, rates, trial.h))


def hides(evolver, solver: SolverState, trial: Trial, inside, t, x):
    """(slots,) whether a guard may have zeros inside the step from (t, x) that its ends do not show.

    False in float32, where the rates of a guard that starts at zero may be nothing but rounding.
    """
    if is_short(trial.g):
        return jnp.zeros(trial.g.shape, bool)
    hybrid = evolver.hybrid
    each = [hybrid.calls.once(functools.partial(rounding, guards), "rounding", guards) for guards in hybrid.guards]
    least = STRAIGHT * _tolerance(evolver, jax.lax.stop_gradient(by_mode(solver.mode, each, t, x)))
    rates = solver.rate, *inside, trial.rate
    return hidden(evolver.method.sample_fractions, solver.guard_sign, solver.g, trial.g, rates, trial.h, least)


def _tolerance(evolver, guard_tolerance):
    """(slots,) what the tolerances of the state are for the guards, from the guards' rounding."""
    atol, rtol = evolver.method.atol, evolver.method.rtol
    return atol + rtol * (guard_tolerance / digits(GUARD_ROUNDING, guard_tolerance))


def finds(evolver, solver: SolverState, trial: Trial, bracket: RootBracket):
    """Whether an event still has to be located, and whether the trial ends at one."""
    signs, given_up = read_signs(evolver, solver, trial, bracket), bracket.tries > PATIENCE
    found = jnp.any(signs.crossed | signs.turn | trial.hidden)
    event = (found | (bracket.guard_index >= 0)) & ~(given_up & ~jnp.any(signs.crossed))
    far = jnp.any((signs.crossed & ~signs.lands) | signs.turn | trial.hidden)
    return event, event & jnp.any(signs.lands) & (~far | given_up)


def read_signs(evolver, solver: SolverState, trial: Trial, bracket: RootBracket) -> Signs:
    """Which guards crossed zero during a trial, have an extremum near zero inside it, or a root at its end."""
    fires = firing(evolver, solver)
    crossed = fires & is_beyond(solver, trial)
    # A guard with an extremum inside the step: the step is cut there if the extremum may lie beyond zero.
    d0, d1 = trial.h * solver.rate, trial.h * trial.rate
    turns = (d0 * d1 < 0) & (solver.guard_sign * d0 < 0) & (solver.guard_sign * trial.g > 0)
    theta = turning_point(solver.g, d0, trial.g, d1)
    extreme, _ = cubic(theta, solver.g, d0, trial.g, d1)
    drop = jnp.minimum(jnp.abs(solver.g - extreme), jnp.abs(trial.g - extreme))
    none = digits(1e-9, theta)
    doubt = 0.2 * drop + 64.0 * (theta * (1 - theta)) ** 2 * miss(trial)
    if is_short(trial.x):  # then the motion's error hides slow impacts
        doubt = doubt + _tolerance(evolver, solver.guard_tolerance)
    turn = turns & (solver.guard_sign * extreme <= doubt) & (theta > none) & (theta < 1 - none)
    ahead = -trial.g / jnp.where(trial.rate == 0, nonzero(1e-300, trial.rate), trial.rate)
    close = fires & (solver.guard_sign * trial.rate < 0) & (jnp.abs(ahead) <= digits(NEAR, ahead) * solver.h)
    lands = close & ((bracket.guard_index >= 0) | jnp.any(crossed))
    lands = lands | ((bracket.tries > PATIENCE) & crossed)
    return Signs(crossed, turn, theta, lands, ahead)


def pending(solver: SolverState):
    """`ALONE` or `FIRST` if a jump comes next without a flow before it, else 0."""
    return solver.memory[Memory._fields.index("pending")]


def has_fired(evolver, solver: SolverState):
    """(slots,) bool: the guard whose event was the last, if the mode is still the same."""
    slots = evolver.hybrid.slots
    first = 0 if solver.mode is None else slots * solver.mode
    last = solver.memory[Memory._fields.index("guard_index")]
    return (jnp.arange(slots, dtype=jnp.int32) + first).astype(last.dtype) == last


def table(evolver, mode, table: np.ndarray):
    """The row of a table for the present mode."""
    return jnp.asarray(table[0]) if len(table) == 1 else jnp.asarray(table)[mode]


def next_bracket(evolver, solver: SolverState, trial: Trial, bracket: RootBracket) -> RootBracket:
    """The next target after a guard was, or may have been, crossed: the earliest root or extremum.

    The first trial was only suspected of an event; if there is none the target is the same step again.
    """
    signs, h = read_signs(evolver, solver, trial, bracket), trial.h
    d0, d1 = h * solver.rate, h * trial.rate
    # A guard that starts at zero first moves away from it: its root lies after the extremum.
    lo = jnp.where((solver.g == 0) & (d0 * d1 < 0), turning_point(solver.g, d0, trial.g, d1), 0.0)
    roots = jnp.where(signs.crossed, h * hermite_root(lo, solver.g, d0, trial.g, d1), jnp.inf)
    guard_index = jnp.argmin(roots).astype(jnp.int32)
    cut = jnp.min(jnp.where(signs.turn, h * signs.theta, jnp.where(trial.hidden, 0.5 * h, jnp.inf)))
    # The trial ended before the targeted root: one Newton step, limited to the bracket (else bisection).
    aimed = jnp.maximum(bracket.guard_index, 0)
    newton = h + signs.ahead[aimed]
    newton = jnp.where((newton > h) & (newton < bracket.beyond), newton, 0.5 * (h + bracket.beyond))
    undershot = (bracket.guard_index >= 0) & ~jnp.any(signs.crossed)
    root = jnp.where(undershot, newton, roots[guard_index])
    guard_index = jnp.where(undershot, aimed, jnp.where(jnp.any(signs.crossed), guard_index, -1))
    # Where the cubic is very flat its root may stagnate at one end: then bisect.
    root = jnp.where((bracket.tries > 10) & ~undershot, 0.5 * root, root)
    target = jax.lax.stop_gradient(jnp.minimum(root, cut))
    beyond = jax.lax.stop_gradient(jnp.where(undershot, bracket.beyond, h))
    return RootBracket(target, beyond, jnp.where(root <= cut, guard_index, -1).astype(jnp.int32), bracket.tries + 1)
