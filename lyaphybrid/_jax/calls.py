"""Functions that are traced once within a program, however often the program uses them."""

from collections.abc import Callable
from typing import Any

import jax

__all__ = ["Calls"]


class Calls:
    """Functions of arrays, each a program of its own: its first use is traced, each further one is a single equation.

    A function may close over values of the program for which this was made, and over no others: not over what is
    traced further in, such as the state within a loop.
    """

    def __init__(self):
        self._known: dict[tuple, tuple[Callable, tuple]] = {}

    def once(self, function: Callable, *key: Any) -> Callable:
        """The function; one that was given before with the same key is taken instead of it.

        Args:
            function: of pytrees of arrays.
            key: all that it closes over; what cannot be compared counts as the same if it is the same object.
        """
        identity = tuple(one if isinstance(one, str | bool | None) else id(one) for one in key)
        if identity not in self._known:
            self._known[identity] = jax.jit(function), key  # objects that are kept keep their id
        return self._known[identity][0]
