"""Where in a step a guard crosses zero, and on which side of zero it is after a jump.

The `guard_sign` of a guard is the sign that it has or is about to have. A step is cut at an extremum that might lie
beyond zero, and where there may be more than one (`turns`), so that every crossing is a change of sign between the ends
of a step.
"""

from typing import Any

import jax
import jax.numpy as jnp

from .._jax.precision import GUARD_ROUNDING, digits, nonzero
from ..systems.daes.semi_linear import is_constrained

__all__ = ["arm", "cubic", "errors_by", "hermite_root", "jets", "rates", "rounding", "to_arm", "turning_point"]

ALGEBRAIC = 1e-12  # relative rounding of algebraic unknowns, which may be small differences of large terms


def rates(guards, t, x, f):
    """The guards (slots,) and their time derivatives (slots,) along the flow f."""
    return jax.jvp(guards, (t, x), (jnp.ones_like(t), f))


def rounding(guards, t, x):
    """(slots,) the rounding errors of the guards that the rounding of time and state causes."""
    return _rounding_at(guards, t, x)(t, x)


def errors_by(guards, t, x, errors):
    """(slots,) how far errors (n,) of the state's components may put each guard off."""
    return jnp.sum(jnp.abs(jax.jacfwd(guards, argnums=1)(t, x) * errors[None, :]), axis=1)


def _rounding_at(guards, t, x):
    """(time, state) -> (slots,) the guards' rounding errors for a time and a state of this size, linear at (t, x)."""
    moving, gradient = jax.jacfwd(guards, argnums=(0, 1))(t, x)
    return lambda t, x: (
        digits(GUARD_ROUNDING, x) * (jnp.abs(moving * t) + jnp.sum(jnp.abs(gradient * x[None, :]), axis=1))
    )


def jets(guards, field, t, x):
    """The guards, their first and second time derivatives along the field: (slots,) each."""

    def first(t, x):
        return rates(guards, t, x, field(t, x))

    (g, rate), (_, second) = jax.jvp(first, (t, x), (jnp.ones_like(t), field(t, x)))
    return g, rate, second


def to_arm(guards, field, t, x, h):
    """The arguments of `arm` from the guards: g, rate, second, guard_tolerance and step_rounding, (slots,) each."""
    f, bend = jax.jvp(field, (t, x), (jnp.ones_like(t), field(t, x)))
    rounding_at, part = _rounding_at(guards, t, x), ALGEBRAIC / GUARD_ROUNDING if is_constrained(field) else 1.0
    step_rounding = rounding_at(h, jnp.abs(f) * h + 0.5 * jnp.abs(bend) * h * h)
    return *jets(guards, field, t, x), rounding_at(t, x), part * step_rounding


def arm(g, rate, second, guard_tolerance, step_rounding, h, t, fired) -> tuple[Any, Any, Any, Any]:
    """(guard_sign, guards, rates, flat), (slots,) each: the side of zero of each guard, and exact zeros.

    A guard that is zero up to rounding takes its sign from its rate; if the rate is zero too, from its second
    derivative (at the exit from sticking v = v̇ = 0): it is `flat`. A rate that is rounding is set to zero; otherwise,
    at late times with coarse resolution, the guard would seem to turn back through zero first.

    Args:
        g: the guards.
        rate: their first time derivatives.
        second: their second time derivatives.
        guard_tolerance: their rounding.
        step_rounding: the guards' rounding that belongs to the distance that the state moves in a step, because a
            state that passes through zero was rounded before. (The change of the guard itself would be too large: while
            only one of two copies is past an event, their distance bends so sharply that all of it would count as
            rounding.)
        h: the controller's step, the local time scale.
        t: the time, whose rounding enters the rates.
        fired: the guard that has just fired here; its root is known only to the accuracy of the flow.
    """
    curve = 0.5 * jnp.abs(second) * h * h
    found = digits(1e-9, g) * jnp.maximum(jnp.abs(rate) * h, curve)
    zero = jnp.abs(g) <= guard_tolerance + jnp.where(fired, found, step_rounding)
    flat = zero & (jnp.abs(rate) * h <= digits(1e-8, g) * curve + digits(GUARD_ROUNDING, g) * jnp.abs(t * second) * h)
    guard_sign = jnp.where(flat, jnp.sign(second), jnp.where(zero, jnp.sign(rate), jnp.sign(g)))
    return guard_sign, jnp.where(zero, 0.0, g), jnp.where(flat, 0.0, rate), flat


def cubic(theta, g0, d0, g1, d1):
    """Value and slope at theta of the cubic with values g0, g1 and slopes d0, d1 at theta = 0 and 1."""
    a = d0 + d1 - 2 * (g1 - g0)
    b = g1 - g0 - d0 - a
    return g0 + theta * (d0 + theta * (b + theta * a)), d0 + theta * (2 * b + theta * 3 * a)


def turning_point(g0, d0, g1, d1):
    """The extremum theta in (0, 1) of a cubic whose slopes at the ends have opposite signs."""
    a = 3 * (d0 + d1 - 2 * (g1 - g0))
    b = 2 * (3 * (g1 - g0) - 2 * d0 - d1)
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * d0, nonzero(1e-300, a)))
    q = -0.5 * (b + jnp.where(b >= 0, root, -root))
    # d0 / q and q / a are the two roots of a θ² + b θ + d0; take the one inside (0, 1).
    first = d0 / q  # q is at least half of the root
    second = q / jnp.where(a == 0, nonzero(1e-300, a), a)
    inside = (first >= 0) & (first <= 1)
    return jnp.clip(jnp.where(inside, first, second), 0.0, 1.0)


def hermite_root(lo, g0, d0, g1, d1):
    """The root in (lo, 1) of the cubic, by Newton steps kept inside a shrinking bracket."""
    falling = jnp.sign(g1)  # the sign beyond the root

    def narrow(_, state):
        left, right, theta = state
        value, slope = cubic(theta, g0, d0, g1, d1)
        beyond = value * falling >= 0
        left, right = jnp.where(beyond, left, theta), jnp.where(beyond, theta, right)
        newton = theta - value / jnp.where(slope == 0, nonzero(1e-300, slope), slope)
        good = ((newton > left) & (newton < right)) | (newton == theta)  # the latter at the root itself
        return left, right, jnp.where(good, newton, 0.5 * (left + right))

    chord = g0 / jnp.where(g0 == g1, 1.0, g0 - g1)
    start = jnp.where((chord > lo) & (chord <= 1), chord, 0.5 * (lo + 1))
    return jax.lax.fori_loop(0, 12, narrow, (lo, jnp.ones_like(lo), start))[2]
