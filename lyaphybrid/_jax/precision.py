"""What the numbers of a type can tell apart.

Tolerances are written for float64. Where a state is float32 each becomes the same share of the digits that there are:
the functions here say what that is, from any array of the type. In float64 they give back what they are given.
"""

import math

import jax.numpy as jnp

__all__ = ["BLUR", "CURE", "DOUBLE", "LEAST", "digits", "eps", "is_short", "nonzero", "require_double", "share"]

DOUBLE = 2.220446049250313e-16  # eps of float64
CURE = "For float64 set jax.config.update('jax_enable_x64', True) before the first array is made."
BLUR = 64 * DOUBLE  # rounding of a guard, relative to its terms
LEAST = 32  # units of `eps`: an error estimate below is rounding (float32: 3.8e-6)


def eps(like) -> float:
    """The distance from 1 to the next number."""
    return float(jnp.finfo(like.dtype).eps)


def is_short(like) -> bool:
    """Whether sums of many terms lose digits that matter: they are then kept with what rounding leaves over."""
    return eps(like) > DOUBLE


def share(like) -> float:
    """How many digits there are, as a part of those of float64."""
    return math.log(eps(like)) / math.log(DOUBLE)


def digits(tolerance: float, like) -> float:
    """A relative tolerance: 1e-12, three quarters of the digits of float64, is 5e-6 in float32."""
    return tolerance ** share(like)


def nonzero(number: float, like) -> float:
    """A number that only keeps quotients and roots from 0: one that does not underflow."""
    return max(number, 100 * float(jnp.finfo(like.dtype).tiny))


def require_double(name: str, x, who: str) -> None:
    """Raise a ValueError where x, or what JAX makes of numbers that have no floating type, is not float64."""
    x = jnp.asarray(x)
    x = x if jnp.issubdtype(x.dtype, jnp.floating) else jnp.zeros((), float)
    if is_short(x):
        raise ValueError(f"{name} is {x.dtype}: {who} needs float64. {CURE}")
