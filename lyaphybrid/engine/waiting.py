"""Waiting for a jump: where jumps alone end a block, whether there will be another one."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

__all__ = ["EVER", "FAR", "LONG", "Waiting", "begun", "hopeless", "next_block", "waited"]

LONG = 1_000_000  # attempts without a jump, after which no more is expected
STILL, STILL_FIXED = 10_000, 100_000  # attempts in which the state does not move; the same of fixed steps
FAR = 1e15  # a step over the longest interval between jumps: time no longer resolves such an interval
EVER = 1e40  # a step, where there was no jump yet


class Waiting(NamedTuple):
    """What is known since the last jump."""

    attempts: Array
    still: Array  # attempts since the state has left the neighbourhood of …
    x: Array  # … this
    growth: Array  # of the block up to the last jump: what comes after it belongs to no jump …
    log_volume: Any  # … and its volume
    lost: Array  # whether no more jump is expected


def begun(x, growth, log_volume) -> Waiting:
    """At the start of a run."""
    zero = jnp.asarray(0, jnp.int32)
    return Waiting(zero, zero, x, growth, log_volume, jnp.asarray(False))


def next_block(waiting: Waiting | None, growth, log_volume) -> Waiting | None:
    """A new block begins with these sums."""
    return None if waiting is None else waiting._replace(growth=growth, log_volume=log_volume)


def waited(evolver, clock, before, after) -> Waiting:
    """After a span, from the carries before and after it."""
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
        lost=~jumped & ((attempts > LONG) | (still > long) | leaves),
    )


def hopeless(waiting: Waiting, clock):
    """Whether a block without an end in time waits in vain."""
    return waiting.lost & jnp.isinf(clock.length)
