"""Tolerances for float64 and float32.

Tolerances are written for float64. For float32 states each is replaced by one that keeps the same fraction of the
available digits; the functions here do that, from any array of the type. For float64 they return their argument.
"""

import math

import jax
import jax.numpy as jnp

__all__ = [
    "GUARD_ROUNDING",
    "DOUBLE",
    "LEAST_TOLERANCE",
    "cure",
    "digits",
    "eps",
    "is_short",
    "nonzero",
    "require_double",
    "share",
]

DOUBLE = 2.220446049250313e-16  # eps of float64
GUARD_ROUNDING = 64 * DOUBLE  # rounding error of a guard, relative to its terms
LEAST_TOLERANCE = 32  # in units of `eps`: a smaller relative error estimate is rounding (float32: 3.8e-6)


def cure(name: str) -> str:
    """How to come to float64."""
    if jax.config.read("jax_enable_x64"):
        return f"JAX computes in float64 here: give {name} in float64."
    return "For float64 set jax.config.update('jax_enable_x64', True) before the first array is made."


def eps(like) -> float:
    """The distance from 1 to the next floating-point number of the type."""
    return float(jnp.finfo(like.dtype).eps)


def is_short(like) -> bool:
    """Whether the type has fewer digits than float64; sums of many terms are then compensated."""
    return eps(like) > DOUBLE


def share(like) -> float:
    """The number of digits of the type as a fraction of those of float64."""
    return math.log(eps(like)) / math.log(DOUBLE)


def digits(tolerance: float, like) -> float:
    """A relative tolerance for the type: 1e-12, three quarters of the digits of float64, becomes 5e-6 in float32."""
    return tolerance ** share(like)


def nonzero(number: float, like) -> float:
    """A tiny number that protects quotients and roots from 0, raised so that it does not underflow in the type."""
    return max(number, 100 * float(jnp.finfo(like.dtype).tiny))


def require_double(name: str, x, who: str) -> None:
    """Raise a ValueError if x, converted to JAX's default floating type if it has none, is not float64."""
    x = jnp.asarray(x)
    x = x if jnp.issubdtype(x.dtype, jnp.floating) else jnp.zeros((), float)
    if is_short(x):
        raise ValueError(f"{name} is {x.dtype}: {who} needs float64. {cure(name)}")
