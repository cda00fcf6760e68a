"""A field together with its parameters, and the check that a user's function can be called."""

from collections.abc import Callable
from typing import Any

import jax

__all__ = ["Bound", "require_callable"]


def require_callable(name: str, got: Any, signature: str) -> None:
    """Raise a ValueError unless `got` can be called."""
    if not callable(got):
        raise ValueError(f"{name} must be a function {signature}; got {got!r}.{_remedy(got)}")


def _remedy(got: Any) -> str:
    """What to give instead of some things that hold a function, or are what it returns."""
    if hasattr(got, "vector_field"):
        return " Of a diffrax term take the function: lh.Flow(term.vector_field)."
    if isinstance(got, list | tuple) and any(callable(one) or hasattr(one, "field") for one in got):
        return ' Modes have names: {"up": one, "down": other}.'
    if hasattr(got, "shape"):
        return " Give the function itself, not what it returns: f, not f(…)."
    return ""


class Bound:
    """A field with its parameters bound, (t, x) -> dx/dt; `field` and `args` are there for methods that need them."""

    def __init__(self, field: Callable, args: Any, values: Callable | None = None):
        self.field, self.args = field, args
        self.values = values or jax.jit(lambda t, x: field(t, x, args))  # traced once

    def __call__(self, t, x):
        """The field dx/dt (n,) at (t, x)."""
        return self.values(t, x)
