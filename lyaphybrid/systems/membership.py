"""Membership of a state in the flow set and the jump set: the generic function; `engine.memberships` implements it."""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from .._jax.tracing import traced

__all__ = ["Membership", "membership"]


class Membership(NamedTuple):
    """Whether a state lies in the flow set C, and in the jump set D, up to rounding.

    Attributes:
        flow: in C, where the motion may flow.
        jump: in D, where a transition may fire: a guard is at zero or on its fired side, or a clock ticks.
    """

    flow: Any
    jump: Any

    @property
    def where(self) -> str:
        """The membership as a word, "C", "D", "both" or "neither"; not under jit, vmap or grad."""
        if traced(self):
            raise ValueError("Membership.where is for values on the host; under jit, vmap or grad use .flow and .jump.")
        return {(True, True): "both", (True, False): "C", (False, True): "D", (False, False): "neither"}[
            bool(self.flow), bool(self.jump)
        ]

    def __repr__(self) -> str:
        return f"Membership({self.where if not traced(self) else 'under a transformation'})"


@functools.singledispatch
def membership(system, x, args: Any, t, mode) -> Membership:
    """The membership of the state x (n,) at time t, in the mode of this name or index.

    This is the answer for a smooth system, which flows everywhere; `engine.memberships` registers those of the others.
    """
    del system, x, args, t, mode
    return Membership(jnp.asarray(True), jnp.asarray(False))
