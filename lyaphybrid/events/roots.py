"""Where in a step a guard crosses zero, and on which side of zero it stands after a jump.

A slot's `side` is the sign that the guard has or is about to have. The guarantee: with at most one extremum of a guard
inside an accepted step no crossing is missed, because a step is cut at an extremum that might lie beyond zero, so that
every crossing shows as a change of sign between the ends of a step.
"""

from typing import Any

import jax
import jax.numpy as jnp

from .._jax.precision import BLUR, digits, nonzero

__all__ = ["arm", "cubic", "hermite_root", "jets", "rates", "rounding", "turning_point"]


def rates(guards, t, x, f):
    """The guards (slots,) and their rates along the flow f."""
    return jax.jvp(guards, (t, x), (jnp.ones_like(t), f))


def rounding(guards, t, x):
    """The rounding of the guards (slots,): of the time and of the state, as the guards feel them."""
    moving, gradient = jax.jacfwd(guards, argnums=(0, 1))(t, x)
    return digits(BLUR, x) * (jnp.abs(moving * t) + jnp.sum(jnp.abs(gradient * x[None, :]), axis=1))


def jets(guards, field, t, x):
    """The guards, their first and second time derivatives along the field: (slots,) each."""

    def first(t, x):
        return rates(guards, t, x, field(t, x))

    (g, rate), (_, second) = jax.jvp(first, (t, x), (jnp.ones_like(t), field(t, x)))
    return g, rate, second


def arm(g, rate, second, blur, h, t, fired) -> tuple[Any, Any, Any, Any]:
    """The side (slots,) where each guard stands or is about to, guards and rates with zeros made exact, which are flat.

    A guard that is zero up to rounding takes its side from its rate, and where that is zero too from its
    second derivative: the exit from a stick has v = v̇ = 0. A rate that is rounding must not be kept: late, when an
    instant is blurred, it would show a guard that first turns back through zero.

    Args:
        g: the guards.
        rate: their first derivatives in time.
        second: their second derivatives.
        blur: their rounding.
        h: the step of the controller, the local scale of time.
        t: the time, whose rounding enters the rates.
        fired: which slot has just fired here (its own root was only found to the accuracy of the flow).
    """
    loose = jnp.where(fired, digits(1e-9, g), digits(1e-12, g))
    curve = 0.5 * jnp.abs(second) * h * h
    zero = jnp.abs(g) <= loose * jnp.maximum(jnp.abs(rate) * h, curve) + blur
    flat = zero & (jnp.abs(rate) * h <= digits(1e-8, g) * curve + digits(BLUR, g) * jnp.abs(t * second) * h)
    side = jnp.where(flat, jnp.sign(second), jnp.where(zero, jnp.sign(rate), jnp.sign(g)))
    return side, jnp.where(zero, 0.0, g), jnp.where(flat, 0.0, rate), flat


def cubic(theta, g0, d0, g1, d1):
    """Value and slope at theta of the cubic with values g0, g1 and slopes d0, d1 at theta = 0 and 1."""
    a = d0 + d1 - 2 * (g1 - g0)
    b = g1 - g0 - d0 - a
    return g0 + theta * (d0 + theta * (b + theta * a)), d0 + theta * (2 * b + theta * 3 * a)


def turning_point(g0, d0, g1, d1):
    """The extremum theta in (0, 1) of the cubic whose end slopes differ in sign."""
    a = 3 * (d0 + d1 - 2 * (g1 - g0))
    b = 2 * (3 * (g1 - g0) - 2 * d0 - d1)
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * d0, nonzero(1e-300, a)))
    q = -0.5 * (b + jnp.where(b >= 0, root, -root))
    # d0 / q and q / a are the two roots of a θ² + b θ + d0; the slopes' signs say which one lies inside.
    first = d0 / jnp.where(q == 0, nonzero(1e-300, q), q)
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
        good = (newton > left) & (newton < right)
        return left, right, jnp.where(good, newton, 0.5 * (left + right))

    chord = g0 / jnp.where(g0 == g1, 1.0, g0 - g1)
    start = jnp.where((chord > lo) & (chord < 1), chord, 0.5 * (lo + 1))
    return jax.lax.fori_loop(0, 12, narrow, (lo, jnp.ones_like(lo), start))[2]
