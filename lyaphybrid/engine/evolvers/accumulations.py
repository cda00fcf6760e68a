"""Events that accumulate in closed-form flows: until when they can be told apart."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.precision import BLUR, digits, nonzero
from ...events.saltations import instant
from .landing import LEAST, SHRUNK

__all__ = ["accumulated", "hidden_below", "named"]

PATIENCE = 30  # short intervals in a row


def hidden_below(guard, t, x, velocity) -> Array:
    """Up to which length rounding of a guard (t, x) -> number hides a flight from it and back."""
    gradient, moving, rate = instant(guard, t, x, velocity)
    guard_tolerance = digits(BLUR, x) * (jnp.sum(jnp.abs(gradient * x)) + jnp.abs(moving * t))
    return 4 * guard_tolerance / jnp.where(rate == 0, nonzero(1e-300, rate), jnp.abs(rate))


def accumulated(dt, longest, streak, more: Any = 1.0, again=None, hides=None) -> tuple[Array, Array, Array]:
    """The longest interval, the streak of short ones, and whether the run ends there.

    In time a run ends where intervals are short. Where jumps are counted (`hides` is given) it goes on as long as
    double precision tells them apart.

    Args:
        dt: the interval up to this event.
        longest: the longest one before.
        streak: of short intervals.
        more: what a short interval adds to it.
        again: whether the event is the same as the last one.
        hides: the shortest flight that rounding does not hide.
    """
    longest = jnp.maximum(longest, dt)
    if hides is None:
        short, over = dt < digits(1e-9, dt) * longest, jnp.asarray(False)
    else:
        short = dt == 0
        hidden = ~short & (dt < SHRUNK * longest) & again & (dt < hides)
        over = hidden | ((dt > 0) & (dt < LEAST * longest))
    streak = jnp.where(short, streak + more, 0.0)
    return longest, streak, over | (streak > PATIENCE)


def named(which, dtype) -> Array:
    """What an event is called, as one vector of numbers."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(which)]).astype(dtype)
