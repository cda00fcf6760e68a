"""How long the next step is: the first one, the controller's, the shortest, and what is left of a block."""

import jax
import jax.numpy as jnp

from ..._jax.precision import digits, eps, nonzero
from ...integrators.base import Method
from ..states import Clock, StepState
from .trials import SolverState, Trial

__all__ = ["cut_at_end", "first_step", "least_step", "next_step"]


def first_step(method: Method, x, f):
    """The first step of a run: by the sizes of the state and of the field, in units of the tolerances."""
    if not method.adaptive:
        return jnp.asarray(method.fixed_step, x.dtype)
    scale = method.atol + method.rtol * jnp.abs(x)
    size, speed = jnp.sqrt(jnp.mean((x / scale) ** 2)), jnp.sqrt(jnp.mean((f / scale) ** 2))
    # A state at rest is moved by rounding alone: that says nothing, and guards are judged on the scale of a step.
    usual = jnp.minimum(0.01 * size / jnp.maximum(speed, nonzero(1e-300, x)), 1.0)
    return _bounded(method, jax.lax.stop_gradient(jnp.where((size > 1e-5) & (speed > 1e-5), usual, 1e-6)))


def _bounded(method: Method, h):
    """No step is longer than the method allows."""
    longest = method.longest_step
    return h if longest is None else jnp.minimum(h, longest)


def cut_at_end(rest, h):
    """A step of h, or all that is left where this is hardly more (h alone, times a constant, would be hoisted)."""
    last = rest * (1 - digits(1e-9, rest)) <= h
    return jnp.where(last, rest, h), last


def least_step(c: StepState, clock: Clock):
    """A step below the resolution of time goes nowhere."""
    length = jnp.where(jnp.isfinite(clock.length), clock.length, 0.0)
    return 1e-3 * eps(length) * jnp.maximum(jnp.abs(clock.base + c.s), length) + nonzero(1e-150, length)


def next_step(method: Method, solver: SolverState, tr: Trial, ratio, passed):
    """What the method's controller asks for, in the order in which its error estimate falls."""
    order, by = method.error_order, method.controller
    log_ratio = jnp.log(jnp.clip(ratio, 1e-10, 1e10))  # nan, from a state out of bounds, stays nan
    exponent = -(by.now / order) * log_ratio + (by.last / order) * solver.log_ratio
    factor = jnp.clip(by.safety * jnp.exp(exponent), by.shrink, by.grow)
    smaller = jnp.maximum(by.safety * jnp.exp(-log_ratio / order), by.shrink)
    smaller = jnp.where(jnp.isfinite(ratio), jnp.minimum(smaller, by.safety), by.shrink)
    whole = tr.h >= 0.99 * solver.h
    # A step that was cut at an event, a tick or the block's end says nothing against the controller's h.
    h = jnp.where(whole, tr.h * factor, jnp.maximum(solver.h, tr.h * factor))
    h = _bounded(method, jnp.where(passed, h, tr.h * smaller))
    return jax.lax.stop_gradient(h), jnp.where(whole & passed, log_ratio, solver.log_ratio)
