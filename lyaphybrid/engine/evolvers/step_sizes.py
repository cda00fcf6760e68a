"""Step sizes: the first, the controller's and the shortest one; the rest of a block; the time until a clock ticks."""

from typing import Any

import jax
import jax.numpy as jnp

from ..._jax.precision import digits, eps, nonzero
from ...integrators.base import Method
from ..states import Clock, StepState
from .trials import SolverState, Trial, table

__all__ = [
    "cut_at_end",
    "first_of",
    "first_step",
    "goes_nowhere",
    "next_step",
    "soonest_root",
    "unresolved",
    "until_ticks",
]

SHORTEST = 1e-3  # shortest step, in units of the rounding of the time …
UNDEFINED = 4.0  # … and where the field is undefined just beyond
FAR = 1e-6  # a step that moves the state by more than this part of its size is not too short
TIME_ROUNDING = 4.0  # in units of the rounding of the time: how well the time of a tick is known


def first_step(method: Method, x, f, soonest: Any = jnp.inf):
    """The first step of a run, from the norms of state and vector field in units of the tolerances.

    At rest these say nothing; `soonest`, an estimate of the time until a guard is reached, bounds the step then.
    """
    if not method.adaptive:
        return jnp.asarray(method.fixed_step, x.dtype)
    scale = method.atol + method.rtol * jnp.abs(x)
    size, speed = jnp.sqrt(jnp.mean((x / scale) ** 2)), jnp.sqrt(jnp.mean((f / scale) ** 2))
    # At rest the speed is rounding and the ratio means nothing; it is bounded, as guards are armed on the step's scale.
    usual = jnp.minimum(0.01 * size / jnp.maximum(speed, nonzero(1e-300, x)), 1.0)
    return _bounded(
        method, jax.lax.stop_gradient(jnp.where((size > 1e-5) & (speed > 1e-5), usual, jnp.minimum(soonest, 1e-6)))
    )


def soonest_root(g, rate, second, guard_tolerance):
    """An estimate of the time until one of the guards (slots,) is zero, from their first two time derivatives."""
    distance = jnp.where(jnp.abs(g) > guard_tolerance, jnp.abs(g), jnp.inf)  # not of those that are zero now
    none = nonzero(1e-300, g)
    times = distance / jnp.maximum(jnp.abs(rate), none), jnp.sqrt(2 * distance / jnp.maximum(jnp.abs(second), none))
    return jax.lax.stop_gradient(jnp.min(jnp.minimum(*times)))


def _bounded(method: Method, h):
    """At most the longest step that the method allows."""
    longest = method.longest_step
    return h if longest is None else jnp.minimum(h, longest)


def cut_at_end(rest, h):
    """The step h, or the rest of the block if that is hardly longer; and whether it is the last step.

    The tolerance multiplies `rest`, because XLA would hoist a constant times h out of the loop.
    """
    last = rest * (1 - digits(1e-9, rest)) <= h
    return jnp.where(last, rest, h), last


def goes_nowhere(carry: StepState, clock: Clock, h, ratio, constrained: bool):
    """Whether a rejected step of length h is too short to be repeated with a shorter one.

    Where the field is undefined just beyond the state, the error over tolerance `ratio` is not finite, and steps below
    the rounding of the time may be accepted for ever without any progress. The limit is then higher. With algebraic
    constraints it stays low, because their singularity is detected only at the singular point itself. A spike that runs
    away makes progress in steps far below the rounding of the time.
    """
    length = jnp.where(jnp.isfinite(clock.length), clock.length, 0.0)
    rounding = eps(length) * jnp.maximum(jnp.abs(clock.base + carry.s), length)
    least, nothing = jnp.where(jnp.isfinite(ratio), SHORTEST, UNDEFINED), nonzero(1e-150, length)
    if constrained:
        return h <= SHORTEST * rounding + nothing

    def is_near(f, x):
        return h * jnp.max(jnp.abs(f)) <= digits(FAR, x) * jnp.max(jnp.abs(x))

    short = h <= least * rounding  # rarely
    near = jax.lax.cond(short, is_near, lambda *_: jnp.asarray(False), carry.solver_state.f, carry.x)
    return near | (h <= nothing)


def until_ticks(evolver, carry: StepState, clock: Clock):
    """(clocks,) time to the next tick of each clock; inf where it is not armed in the mode."""
    solver = carry.solver_state
    times = [
        (phase + period * solver.ticks[i] - clock.base) - clock.rest - carry.s
        for i, (period, phase) in enumerate(evolver.clock_times)
    ]
    until = jnp.stack(times)  # a tick that is late by rounding comes now, with the derivatives of its own time
    until = until + jax.lax.stop_gradient(jnp.maximum(until, 0.0) - until)
    return jnp.where(table(evolver, solver.mode, evolver.hybrid.armed), until, jnp.inf)


def unresolved(carry: StepState, clock: Clock, ahead: Any = 0.0):
    """A time so short that the next tick of a clock may come now: the rounding of the time, that far ahead."""
    return TIME_ROUNDING * eps(carry.s) * jnp.maximum(jnp.abs(clock.base), carry.s + ahead)


def first_of(until, carry: StepState, clock: Clock):
    """The clock that ticks first; of several that tick at one time, but for rounding, the first in the list."""
    soonest = jax.lax.stop_gradient(jnp.min(until))
    late = unresolved(carry, clock, jnp.where(jnp.isfinite(soonest), jnp.abs(soonest), 0.0))
    return jnp.argmax(until <= soonest + late)


def next_step(method: Method, solver: SolverState, trial: Trial, ratio, passed):
    """PI step-size controller; ratio is error over tolerance. Returns the next h and the stored log ratio."""
    order, by = method.error_order, method.controller
    log_ratio = jnp.log(jnp.clip(ratio, 1e-10, 1e10))  # clip keeps the nan of a state that is not finite
    exponent = -(by.now / order) * log_ratio + (by.last / order) * solver.log_ratio
    factor = jnp.clip(by.safety * jnp.exp(exponent), by.shrink, by.grow)
    smaller = jnp.maximum(by.safety * jnp.exp(-log_ratio / order), by.shrink)
    smaller = jnp.where(jnp.isfinite(ratio), jnp.minimum(smaller, by.safety), by.shrink)
    whole = trial.h >= 0.99 * solver.h
    # A step that was cut at an event, a tick or the block's end must not make the controller's h smaller.
    h = jnp.where(whole, trial.h * factor, jnp.maximum(solver.h, trial.h * factor))
    h = _bounded(method, jnp.where(passed, h, trial.h * smaller))
    return jax.lax.stop_gradient(h), jnp.where(whole & passed, log_ratio, solver.log_ratio)
