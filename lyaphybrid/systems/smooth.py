"""Systems without events: a flow and an iterated map."""

from collections.abc import Callable
from typing import Any

import equinox as eqx

from .bound import require_callable
from .membership import membership

__all__ = ["Flow", "Map"]


class Flow(eqx.Module):
    """A smooth flow, dx/dt = field(t, x, args).

    Args:
        field: ``(t, x, args) -> dx/dt``, x and dx/dt of shape (n,).

    Raises:
        ValueError: if ``field`` is not callable.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> lh.Flow(lambda t, x, args: -args * x)  # doctest: +ELLIPSIS
        Flow(...)
    """

    field: Callable

    def __check_init__(self):
        require_callable("field", self.field, "(t, x, args) -> dx/dt")

    def contains(self, x, args: Any = None, *, t=0.0):
        """Whether x lies in the flow set, which is everything, and in the jump set, which is empty."""
        return membership(self, x, args, t, None)


class Map(eqx.Module):
    """An iterated map, x⁺ = rule(n, x, args), n the number of the iteration as a float.

    Args:
        rule: ``(n, x, args) -> x⁺``, both of shape (n,).

    Raises:
        ValueError: if ``rule`` is not callable.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
    """

    rule: Callable

    def __check_init__(self):
        require_callable("rule", self.rule, "(n, x, args) -> next x")

    def contains(self, x, args: Any = None, *, t=0.0):
        """Whether x lies in the flow set, which is empty, and in the jump set, which is everything."""
        return membership(self, x, args, t, None)
