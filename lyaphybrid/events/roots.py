"""Where in a step a guard crosses zero, and on which side of zero it stands after a jump.

The `guard_sign` of a guard is the sign that it has or is about to have. The guarantee: with at most one extremum of a
guard inside an accepted step no crossing is missed, because a step is cut at an extremum that might lie beyond zero, so
that every crossing shows as a change of sign between the ends of a step.
"""

from typing import Any

import jax
import jax.numpy as jnp

from .._jax.precision import BLUR, digits, nonzero
from ..systems.daes.semi_linear import is_constrained

__all__ = ["arm", "cubic", "hermite_root", "jets", "rates", "rounding", "to_arm", "turning_point"]

ALGEBRAIC = 1e-12  # rounding of unknowns that equations decide, whose terms may be larger than they are


def rates(guards, t, x, f):
    """The guards (slots,) and their rates along the flow f."""
    return jax.jvp(guards, (t, x), (jnp.ones_like(t), f))


def rounding(guards, t, x):
    """The rounding of the guards (slots,): of the time and of the state, as the guards feel them."""
    return _felt(guards, t, x)(t, x)


def _felt(guards, t, x):
    """(time, state) -> the rounding of so much time and of so large a state, as the guards at (t, x) feel it."""
    moving, gradient = jax.jacfwd(guards, argnums=(0, 1))(t, x)
    return lambda t, x: digits(BLUR, x) * (jnp.abs(moving * t) + jnp.sum(jnp.abs(gradient * x[None, :]), axis=1))


def jets(guards, field, t, x):
    """The guards, their first and second time derivatives along the field: (slots,) each."""

    def first(t, x):
        return rates(guards, t, x, field(t, x))

    (g, rate), (_, second) = jax.jvp(first, (t, x), (jnp.ones_like(t), field(t, x)))
    return g, rate, second


def to_arm(guards, field, t, x, h):
    """What `arm` asks of the guards: g, rate, second, guard_tolerance and way, (slots,) each."""
    f, bend = jax.jvp(field, (t, x), (jnp.ones_like(t), field(t, x)))
    felt, part = _felt(guards, t, x), ALGEBRAIC / BLUR if is_constrained(field) else 1.0
    way = felt(h, jnp.abs(f) * h + 0.5 * jnp.abs(bend) * h * h)
    return *jets(guards, field, t, x), felt(t, x), part * way


def arm(g, rate, second, guard_tolerance, way, h, t, fired) -> tuple[Any, Any, Any, Any]:
    """The side (slots,) where each guard stands or is about to, guards and rates with zeros made exact, which are flat.

    A guard that is zero up to rounding takes its side from its rate, and where that is zero too from its
    second derivative: the exit from a stick has v = v̇ = 0. A rate that is rounding must not be kept: late, when an
    instant is blurred, it would show a guard that first turns back through zero.

    Args:
        g: the guards.
        rate: their first derivatives in time.
        second: their second derivatives.
        guard_tolerance: their rounding.
        way: the rounding of what the state goes in a step, as the guards feel it: a state that passes through zero was
            rounded before. (The change of the guard itself would be too much. While one of two copies is past an event
            and the other is not, the distance between them bends so sharply that all of it would count as rounding.)
        h: the step of the controller, the local scale of time.
        t: the time, whose rounding enters the rates.
        fired: which slot has just fired here (its own root was only found to the accuracy of the flow).
    """
    curve = 0.5 * jnp.abs(second) * h * h
    found = digits(1e-9, g) * jnp.maximum(jnp.abs(rate) * h, curve)
    zero = jnp.abs(g) <= guard_tolerance + jnp.where(fired, found, way)
    flat = zero & (jnp.abs(rate) * h <= digits(1e-8, g) * curve + digits(BLUR, g) * jnp.abs(t * second) * h)
    guard_sign = jnp.where(flat, jnp.sign(second), jnp.where(zero, jnp.sign(rate), jnp.sign(g)))
    return guard_sign, jnp.where(zero, 0.0, g), jnp.where(flat, 0.0, rate), flat


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
