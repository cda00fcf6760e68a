"""Where only a number of jumps ends a block: decide whether another jump is still to be expected."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

__all__ = ["EVER", "LONGEST_STEP", "MOST_ATTEMPTS_WITHOUT_JUMP", "Waiting", "init", "hopeless", "next_block", "waited"]

MOST_ATTEMPTS_WITHOUT_JUMP = 1_000_000  # no jump is expected after this number of attempts without one
STILL, STILL_FIXED = 10_000, 100_000  # or if the state is at rest for so many attempts; STILL_FIXED: of fixed steps
LONGEST_STEP = 1e15  # or if a step is this times the longest interval between jumps, which time then no longer resolves
EVER = 1e40  # the same for the step itself, before the first jump


class Waiting(NamedTuple):
    """What was observed since the last jump."""

    attempts: Array  # step attempts since the last jump
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


def waited(evolver, clock, before, after) -> Waiting:
    """Update after a span, from the carries before and after it."""
    was: Waiting = before.waiting
    jumped = after.jumps != before.jumps
    spent = jnp.maximum(before.budget - after.budget, 1)
    attempts = jnp.where(jumped, 0, was.attempts + spent)
    rests, leaves = evolver.rests(after, clock, was.x)
    still = jnp.where(rests & ~jumped, was.still + spent, 0)
    long = STILL_FIXED if evolver.by_fixed_steps else STILL
    return Waiting(
        attempts=attempts,
        still=still,
        x=jnp.where(still > 0, was.x, after.x),
        growth=jnp.where(jumped, after.growth, was.growth),
        log_volume=None if was.log_volume is None else jnp.where(jumped, after.log_volume, was.log_volume),
        lost=~jumped & ((attempts > MOST_ATTEMPTS_WITHOUT_JUMP) | (still > long) | leaves),
    )


def hopeless(waiting: Waiting, clock):
    """Whether the block has no end in time and no further jump is expected."""
    return waiting.lost & jnp.isinf(clock.length)
