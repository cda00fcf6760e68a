"""Checks of numbers given by the user; each error says what was given and what is allowed."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from jaxtyping import Array, Float

from ._jax.tracing import traced

__all__ = [
    "Frame",
    "Key",
    "Progress",
    "Real",
    "State",
    "Times",
    "attempts",
    "positive",
    "real",
    "require",
    "whole",
]

# What public functions take. A list stands for an array: it becomes one within, which type checkers cannot follow.
if TYPE_CHECKING:
    Real: TypeAlias = Any
    State: TypeAlias = Any
    Frame: TypeAlias = Any
    Times: TypeAlias = Any
else:
    Real = float | Float[Array, ""]
    State = Float[Array, " n"] | Float[Array, "m n"] | Float[np.ndarray, "..."] | Sequence[Any]
    Frame = Float[Array, "n k"] | Float[np.ndarray, "n k"] | Sequence[Sequence[float]] | None
    Times = str | Float[Array, " blocks"] | Float[np.ndarray, " blocks"] | Sequence[float] | None
Key: TypeAlias = Array | None  # of `jax.random.key`
Progress: TypeAlias = bool | Callable[..., Any] | None


def require(condition: bool, message: str) -> None:
    """Raise a ValueError unless the condition holds."""
    if not condition:
        raise ValueError(message)


def real(name: str, value: Any) -> None:
    """Require a finite real number; a traced value is not checked."""
    if not traced(value):
        require(_is_number(value) and abs(float(value)) < np.inf, f"{name} must be a finite number; got {value!r}.")


def positive(name: str, value: Any) -> None:
    """Require a finite positive number; a traced value is not checked."""
    if not traced(value):
        good = _is_number(value) and 0 < float(value) < np.inf
        require(good, f"{name} must be positive and finite; got {value!r}.")


def whole(name: str, value: Any, least: int) -> None:
    """Require an integer of at least `least`."""
    good = isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= least
    require(good, f"{name} must be an integer of at least {least}; got {value!r}.")


def attempts(max_steps: Any) -> None:
    """Require a limit on the attempts of a step: a positive integer, or None for no limit."""
    if max_steps is not None and not traced(max_steps):
        whole("max_steps", max_steps, least=1)


def require_one_start(verb: str, x0: Any) -> None:
    """Require a single start, not several at once."""
    shape = np.shape(x0)
    require(len(shape) == 1, f"{verb} follows one orbit: x0 must have shape (n,); got {shape}. Call it for each start.")


def require_values(verb: str, *values: Any) -> None:
    """Require values, which there are none of under a transformation."""
    missing = "under jit, vmap and grad there are none. Call it outside of them, once for each set of values."
    require(not traced(values), f"{verb} decides from values, and {missing}")


def _is_number(value) -> bool:
    if isinstance(value, bool | str | bytes | type(None)):
        return False
    array = np.asarray(value)
    return array.ndim == 0 and array.dtype.kind in "iuf"
