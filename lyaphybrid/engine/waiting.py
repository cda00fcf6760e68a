"""Where only a number of jumps ends a block: decide whether another jump is still to be expected.

Where jumps of one transition alone are awaited, the crossings of a section, others do not end a wait.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

__all__ = ["EVER", "LONGEST_STEP", "MOST_ATTEMPTS_WITHOUT_JUMP", "Waiting", "init", "hopeless", "next_block", "waited"]

MOST_ATTEMPTS_WITHOUT_JUMP = 1_000_000  # no jump is expected after this number of attempts without one
STILL, STILL_FIXED = 10_000, 100_000  # or if the state is at rest for so many attempts; STILL_FIXED: of fixed steps
LONGEST_STEP = 1e15  # or if a step is this times the longest interval between jumps, which time then no longer resolves
EVER = 1e40  # the same for the step itself, before the first jump


class Waiting(NamedTuple):
    """What was observed since the last jump."""

    attempts: Array  # step attempts since the last jump that was awaited
    still: Array  # attempts for which the state has stayed close to x
    x: Array  # (n,)
    growth: Array  # (k,) of the block at the last jump: growth after it belongs to no jump
    log_volume: Any  # of the block at the last jump
    lost: Array  # whether no further jump is expected


def init(x, growth, log_volume) -> Waiting:
    """The value at the start of a run."""
    zero = jnp.asarray(0, jnp.int32)
    return Waiting(zero, zero, x, growth, log_volume, jnp.asarray(False))


def next_block(waiting: Waiting | None, growth, log_volume) -> Waiting | None:
    """The value at the start of a block, with the block's sums."""
    return None if waiting is None else waiting._replace(growth=growth, log_volume=log_volume)


def waited(settings, clock, before, after) -> Waiting:
    """Update after a span, from the carries before and after it."""
    was: Waiting = before.waiting
    jumped = after.jumps != before.jumps
    came = jumped if settings.awaited is None else jumped & _has_come(settings.awaited, before.log, after.log)
    spent = jnp.maximum(before.budget - after.budget, 1)
    attempts = jnp.where(came, 0, was.attempts + spent)
    rests, leaves = settings.evolver.rests(after, clock, was.x)
    still = jnp.where(rests & ~jumped, was.still + spent, 0)
    long = STILL_FIXED if settings.evolver.by_fixed_steps else STILL
    return Waiting(
        attempts=attempts,
        still=still,
        x=jnp.where(still > 0, was.x, after.x),
        growth=jnp.where(jumped, after.growth, was.growth),
        log_volume=None if was.log_volume is None else jnp.where(jumped, after.log_volume, was.log_volume),
        lost=(~came & (attempts > MOST_ATTEMPTS_WITHOUT_JUMP)) | (~jumped & ((still > long) | leaves)),
    )


def _has_come(awaited: int, before, after):
    """Whether the flow has come to a transition between two states of the event log.

    What is at the instant of the row before was caused by the jump there.
    """

    def look(row, found):
        by_flow = (row == 0) | (after.t[row] > after.t[row - 1])
        return found | (by_flow & (after.transition[row] == awaited))

    return jax.lax.fori_loop(before.count, after.count, look, jnp.asarray(False))


def hopeless(waiting: Waiting, clock):
    """Whether the block has no end in time and no further jump is expected."""
    return waiting.lost & jnp.isinf(clock.length)
