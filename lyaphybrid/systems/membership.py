"""In which of the flow set and the jump set a state lies: the question; `engine.memberships` answers it."""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from .._jax.tracing import traced

__all__ = ["Membership", "membership"]


class Membership(NamedTuple):
    """Whether a state lies in the flow set C, and in the jump set D, up to rounding.

    Attributes:
        flow: in C: where the motion may flow.
        jump: in D: where a transition may fire, a guard being at zero or on its fired side, or a clock ticking.
    """

    flow: Any
    jump: Any

    @property
    def where(self) -> str:
        """The word: C, D, both or neither; not under a transformation."""
        if traced(self):
            raise ValueError("Membership.where is for values on the host; under jit, vmap or grad use .flow and .jump.")
        return {(True, True): "both", (True, False): "C", (False, True): "D", (False, False): "neither"}[
            bool(self.flow), bool(self.jump)
        ]

    def __repr__(self) -> str:
        return f"Membership({self.where if not traced(self) else 'under a transformation'})"


@functools.singledispatch
def membership(system, x, args: Any, t, mode) -> Membership:
    """Where the state x (n,) lies at the time t, in the mode of this name or index.

    A smooth system flows everywhere; `engine.memberships` adds the answers for those that jump.
    """
    del system, x, args, t, mode
    return Membership(jnp.asarray(True), jnp.asarray(False))
