"""Stalled runs under a transformation, where no host looks on (`host.paces` judges the others, and says why).

The attempts of a run are given out in windows. After each it is asked how many more the rest would take at this pace;
if these are far more than are left, several windows in a row, the run will not reach its end: it stops as stalled.
Within a window nothing is added to the loop.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..native import seldom
from ..statuses import RUNNING, STATUS
from .states import StepState, stop

__all__ = ["ATTEMPTS_OF_WINDOW", "FOREVER", "Goal", "Window", "begun", "looked"]

FOREVER = 2**31 - 1  # attempts, where the user gives no limit; who gives one decides alone
ATTEMPTS_OF_WINDOW = 1_000_000
MOST_HOPELESS = 3  # windows in a row after which a run is stopped
FAR_MORE = 10.0  # a window is hopeless if the rest needs this times the attempts that are left


class Goal(NamedTuple):
    """The end of the run."""

    time: Array  # since the run began; inf where jumps alone end it
    jumps: Any  # since the run began; None where they do not end it


class Window(NamedTuple):
    """What is remembered from one window to the next."""

    left: Array  # attempts after the present window
    time: Array  # since the run began, at the start of the window
    jumps: Array  # the same
    hopeless: Array  # windows in a row without enough progress


def begun(carry: StepState, elapsed, budget) -> tuple[StepState, Window]:
    """The carry with the attempts of the first window, all of them where there is a limit; and the window."""
    first = jnp.where(budget == FOREVER, jnp.asarray(ATTEMPTS_OF_WINDOW, budget.dtype), budget)
    window = Window(budget - first, jax.lax.stop_gradient(elapsed + carry.s), carry.jumps, jnp.asarray(0, jnp.int32))
    return carry._replace(budget=first), window


def looked(window: Window, carry: StepState, elapsed, goal: Goal) -> tuple[StepState, Window]:
    """Where a window is spent: judge it, and give out the next, or stop the run."""
    spent = (carry.budget <= 0) & (window.left > 0) & (carry.status == RUNNING)
    now = jax.lax.stop_gradient((elapsed + carry.s, goal.time)), carry.jumps, goal.jumps
    budget, window = jax.lax.cond(
        spent, seldom(_next_window), lambda window, budget, *now: (budget, window), window, carry.budget, *now
    )
    return stop(carry._replace(budget=budget), STATUS.stalled, window.hopeless >= MOST_HOPELESS), window


def _next_window(window: Window, budget, times, jumps, last_jump) -> tuple[Array, Window]:
    """The attempts of the next window, and the window at its start."""
    time, end = times
    more = _windows(end - time, time - window.time)
    if last_jump is not None:
        numbers = (number.astype(time.dtype) for number in (last_jump - jumps, jumps - window.jumps))
        more = jnp.minimum(more, _windows(*numbers))
    # Where only jumps end the run and time passes, `waiting` knows when no jump is to be expected.
    waits = jnp.isinf(more) & (time > window.time)
    far = (more * ATTEMPTS_OF_WINDOW > FAR_MORE * window.left.astype(time.dtype)) & ~waits
    first = jnp.minimum(window.left, jnp.asarray(ATTEMPTS_OF_WINDOW, budget.dtype))
    hopeless = jnp.where(far, window.hopeless + 1, jnp.zeros_like(window.hopeless))
    return first, Window(window.left - first, time, jumps, hopeless)


def _windows(rest, done):
    """How many such windows the rest would take; inf if nothing was done."""
    return jnp.where(done > 0, rest / jnp.where(done > 0, done, 1.0), jnp.inf)
