"""What movers without modes have in common: no constraints, and nothing between two points."""

from typing import ClassVar

import jax.numpy as jnp

from ..frames import LOST
from ..propagation import LONGEST_BLIND

__all__ = ["Unconstrained"]


class Unconstrained:
    """Answers of a mover that knows no modes and no constraints."""

    def onto_mode(self, mode, t, x):
        """There are no modes, and no constraints."""
        del mode, t, x

    def admitted(self, t, x, mode):
        """Every state may be a start."""
        del t, mode
        return x, False

    def kept_to_constraints(self, c, clock):
        """There are none."""
        del clock
        return c

    def inspected(self, c, clock):
        """There is nothing that could be left."""
        del clock
        return c

    by_fixed_steps: ClassVar[bool] = False

    def rests(self, c, clock, x):
        """Whether the motion stays near x or leaves for ever is not seen: where no jump is ahead, is known anyhow."""
        del c, clock, x
        return jnp.asarray(False), jnp.asarray(False)

    def least_length(self, c, jumps):
        """Columns that so many jumps have left with no more than this (and rounding) are lost.

        After many jumps rounding alone makes columns dependent: that is unresolved, not lost.
        """
        del c
        return jnp.where(jumps <= 1, LOST, jnp.where(jumps <= LONGEST_BLIND, 0.0, -jnp.inf))

    def in_each_mode(self):
        """There are no modes."""
        return (self,)
