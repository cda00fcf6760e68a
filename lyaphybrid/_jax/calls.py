"""Functions that are traced once within a program, even if the program uses them many times."""

from collections.abc import Callable
from typing import Any

import jax

__all__ = ["Calls"]


class Calls:
    """Functions of arrays, each jitted: the first use is traced, every further use is a single equation of the jaxpr.

    A function may close over values of the program for which this object was made, but not over values that are traced
    inside it, such as the state within a loop.
    """

    def __init__(self):
        self._known: dict[tuple, tuple[Callable, tuple]] = {}

    def once(self, function: Callable, *key: Any) -> Callable:
        """The jitted function, or the one given earlier with the same key.

        Args:
            function: of pytrees of arrays.
            key: everything that it closes over; objects other than str, bool and None are compared by identity.
        """
        identity = tuple(one if isinstance(one, str | bool | None) else id(one) for one in key)
        if identity not in self._known:
            self._known[identity] = jax.jit(function), key  # storing the key keeps its objects, and so their ids, alive
        return self._known[identity][0]
