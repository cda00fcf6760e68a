"""Results from which a run goes on: they carry the state of its loop, as long as the process lives."""

from collections.abc import Callable
from typing import Any, Self

__all__ = ["Resumable"]


class Resumable:
    """A result that knows how to go on.

    The state, with the user's functions, is on the object that a verb returns: no field, for it is no array. A copy has
    none, nor what came out of jit or a file.
    """

    _go_on = None

    def _resumed_by(self, go_on: Callable[..., Any]) -> Self:
        object.__setattr__(self, "_go_on", go_on)
        return self

    def _goes_on(self, verb: str, instead: str) -> Callable[..., Any]:
        """How to go on; a ValueError where that is not known, with what to do instead."""
        if self._go_on is None:
            raise ValueError(
                f"resume needs the object that {verb} has returned, with the state of its loop: this one is a copy, or "
                f"came out of jit, vmap or a file. {instead}"
            )
        return self._go_on

    def __getstate__(self):
        """What is pickled: the loop's state stays behind."""
        return {name: value for name, value in self.__dict__.items() if name != "_go_on"}
