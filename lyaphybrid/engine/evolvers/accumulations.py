"""Events of closed-form flows without time between them: those that accumulate (Zeno), or that a jump brings about."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.precision import GUARD_ROUNDING, digits, nonzero
from ...events.saltations import instant
from .landing import SHRUNK_INTERVAL, SMALLEST_INTERVAL

__all__ = ["accumulated", "brought_about", "hidden_below", "named"]

MOST_SHORT_INTERVALS = 30  # more short intervals in a row end the run
LATEST_CROSSING = 1e-9  # part of the longest interval by which a guard that the flow brought to zero may be beyond it


def hidden_below(guard, t, x, velocity) -> Array:
    """The longest flight from a guard (t, x) -> number and back to it that the guard's rounding can hide."""
    guard_tolerance, rate = _rounding(guard, t, x, velocity)
    return 4 * guard_tolerance / jnp.where(rate == 0, nonzero(1e-300, rate), jnp.abs(rate))


def brought_about(guard, t, x, velocity, longest, before=None) -> Array:
    """Whether it was a jump, or the start, and not the flow, that brought the guard of an event that is due to zero.

    Args:
        guard: (t, x) -> number.
        t: the instant.
        x: (n,) the state.
        velocity: (n,) of the flow there.
        longest: the longest interval between two events.
        before: (n,) the state before the jumps of this instant, if it is known.
    """
    guard_tolerance, rate = _rounding(guard, t, x, velocity)
    least = 4 * guard_tolerance + digits(LATEST_CROSSING, x) * longest * jnp.abs(rate)
    beyond = guard(t, x) < -least
    return beyond if before is None else beyond | (jnp.abs(guard(t, before)) > least)


def _rounding(guard, t, x, velocity) -> tuple[Array, Array]:
    """The rounding of a guard (t, x) -> number, and its rate along the flow."""
    gradient, moving, rate = instant(guard, t, x, velocity)
    return digits(GUARD_ROUNDING, x) * (jnp.sum(jnp.abs(gradient * x)) + jnp.abs(moving * t)), rate


def accumulated(dt, longest, streak, more: Any = 1.0, again=None, hides=None) -> tuple[Array, Array, Array]:
    """Update the longest interval and the count of short ones; also returns whether the run ends (Zeno).

    A run whose length is a time ends after many short intervals. A run whose length is a number of jumps (`hides` is
    given) goes on as long as double precision separates the events.

    Args:
        dt: the interval up to this event.
        longest: the longest interval before it.
        streak: count of short intervals in a row.
        more: how much a short interval adds to the count.
        again: whether the event has the same label as the previous one.
        hides: the shortest flight that rounding does not hide.
    """
    longest = jnp.maximum(longest, dt)
    if hides is None:
        short, over = dt < digits(1e-9, dt) * longest, jnp.asarray(False)
    else:
        short = dt == 0
        hidden = ~short & (dt < SHRUNK_INTERVAL * longest) & again & (dt < hides)
        over = hidden | ((dt > 0) & (dt < SMALLEST_INTERVAL * longest))
    streak = jnp.where(short, streak + more, 0.0)
    return longest, streak, over | (streak > MOST_SHORT_INTERVALS)


def named(which, dtype) -> Array:
    """The label `which` of an event as one vector (m,) of numbers."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(which)]).astype(dtype)
