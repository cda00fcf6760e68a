"""Checks of numbers given by the user; each error says what was given and what is allowed."""

import functools
import os
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import jax
import jax.numpy as jnp
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
    "flag",
    "integers",
    "is_key",
    "is_number",
    "is_one_of",
    "numbers",
    "parameters",
    "random_key",
    "positive",
    "real",
    "require",
    "shape",
    "whole",
    "words",
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


MOST = 2**63 - 1  # the largest integer of 64 bits
BYTES_OF_FLOAT = 8  # bytes of a float64
KINDS = "biufc"  # of NumPy's types that are numbers


def require(condition: bool, message: str) -> None:
    """Raise a ValueError unless the condition holds."""
    if not condition:
        raise ValueError(message)


def real(name: str, value: Any) -> None:
    """Require a finite real number; a traced value is not checked."""
    if not traced(value):
        require(is_number(value) and abs(float(value)) < np.inf, f"{name} must be a finite number; got {value!r}.")


def positive(name: str, value: Any) -> None:
    """Require a finite positive number; a traced value is not checked."""
    if not traced(value):
        good = is_number(value) and 0 < float(value) < np.inf
        require(good, f"{name} must be positive and finite; got {value!r}.")


def whole(name: str, value: Any, least: int, each: int = 0) -> None:
    """Require an integer of at least `least`, and that this machine's memory holds so many rows of `each` floats."""
    good = isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= least
    require(good, f"{name} must be an integer of at least {least}; got {value!r}.")
    require(int(value) <= MOST, f"{name} must be an integer of at most {MOST}; got {value!r}.")
    taken = int(value) * each * BYTES_OF_FLOAT
    require(
        taken < _memory(),
        f"{name} must be smaller: {value} would take {taken / 2**30:.3g} GiB, more than the memory of this machine.",
    )


@functools.cache
def _memory() -> int:
    """The memory of this machine in bytes."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # a system that does not say
        return MOST


def flag(name: str, value: Any) -> None:
    """Require a truth value."""
    good = isinstance(value, bool | np.bool_) or (isinstance(value, int) and value in (0, 1))
    require(good, f"{name} must be True or False; got {value!r}.")


def is_one_of(value: Any, words: Iterable[str]) -> bool:
    """Whether the value is one of the words; of what cannot be compared it is false."""
    return isinstance(value, str) and value in tuple(words)


def is_key(value: Any) -> bool:
    """Whether it is a `jax.random.key`, or the two integers of an older one."""
    if traced(value) or not isinstance(value, jax.Array | np.ndarray):
        return traced(value)
    if jnp.issubdtype(value.dtype, jax.dtypes.prng_key):
        return value.shape == ()
    return value.dtype == np.uint32 and value.shape == (2,)


def random_key(name: str, value: Any) -> None:
    """Require a key of JAX's random numbers, or None."""
    good = value is None or is_key(value)
    require(good, f"{name} must be a jax.random.key(seed), or None; got {value!r}.")


def words(name: str, value: Any) -> tuple[str, ...]:
    """One name, or a sequence of them, as a tuple."""
    given = (value,) if isinstance(value, str) else value
    good = isinstance(given, Sequence) and len(given) > 0 and all(isinstance(one, str) for one in given)
    require(good, f"{name} must be a name, or a sequence of names; got {value!r}.")
    return tuple(given)


def integers(name: str, value: Any, least: int, most: int) -> tuple[int, ...]:
    """A sequence of integers from `least` to `most`, as a tuple."""
    try:
        given = tuple(value)
    except TypeError:
        given = None
    good = given is not None and all(
        isinstance(one, int | np.integer) and not isinstance(one, bool) and least <= one <= most for one in given
    )
    require(good, f"{name} must be integers from {least} to {most}; got {value!r}.")
    return tuple(map(int, given or ()))


def numbers(name: str, value: Any, dtype: Any = None) -> Any:
    """The real numbers that were given, as an array; a traced value is not checked.

    Args:
        name: of the argument, for the error.
        value: an array, a sequence, a number.
        dtype: None: its own, in the byte order of this machine.

    Raises:
        ValueError: on what is not made of real numbers, on masked entries.
    """
    if traced(value):
        return jnp.asarray(value, dtype)
    array = _array(value)
    if array is None or array.dtype.kind not in "biuf" or isinstance(value, np.ma.MaskedArray):
        raise ValueError(f"{name} must be an array of numbers; got {value!r}.")
    own = float if array.dtype.kind != "f" or array.dtype.itemsize > BYTES_OF_FLOAT else array.dtype.newbyteorder("=")
    return array.astype(dtype or own)


def shape(name: str, value: Any) -> tuple[int, ...]:
    """The shape of the numbers that were given, of which there is at least one."""
    found = numbers(name, value).shape
    require(0 not in found, f"{name} must hold numbers; got an array of shape {found}.")
    return found


def parameters(name: str, leaf: Any) -> Any:
    """A leaf of the parameters as the functions get it: arrays in this machine's byte order, all else as it is.

    Raises:
        ValueError: on what is neither a number nor an array of numbers, on integers beyond 64 bits.
    """
    wanted = isinstance(leaf, bool | int | float | complex | jax.Array | jax.ShapeDtypeStruct)
    if isinstance(leaf, np.ndarray | np.generic):
        wanted = leaf.dtype.kind in KINDS and not isinstance(leaf, np.ma.MaskedArray)
    cure = (
        "Take the arrays of a module apart: arrays, rest = equinox.partition(module, equinox.is_array), give the "
        "arrays as args, and in the function write equinox.combine(args, rest)."
        if callable(leaf)
        else "What is none belongs into the function itself, as by functools.partial."
    )
    require(wanted, f"{name} must hold numbers, or arrays of numbers; got {leaf!r}. {cure}")
    if isinstance(leaf, int) and not -MOST - 1 <= leaf <= MOST:
        raise ValueError(f"{name} holds {leaf!r}, an integer that does not fit into 64 bits: write it as a float.")
    if isinstance(leaf, np.ndarray | np.generic):
        # A copy: who changes the array later, changes nothing of a result that goes on with it.
        return np.array(leaf, float if leaf.dtype == np.longdouble else leaf.dtype.newbyteorder("="))
    return leaf


def attempts(max_steps: Any) -> None:
    """Require a limit on the attempts of a step: a positive integer, or None for no limit."""
    if max_steps is not None and not traced(max_steps):
        whole("max_steps", max_steps, least=1)


def require_one_start(verb: str, x0: Any, rows: bool = False) -> None:
    """Require a single start, not several at once; `rows`: it has one row for each body."""
    found, one = shape("x0", x0), "(N, d), one row a body" if rows else "(n,)"
    cure = "Call it for each start."
    require(len(found) == 1 + rows, f"{verb} follows one orbit: x0 must have shape {one}; got {found}. {cure}")


def require_values(verb: str, *values: Any) -> None:
    """Require values, which there are none of under a transformation."""
    missing = (
        "under jit, vmap and grad there are none. Call it outside of them, once for each set of values; derivatives "
        "by parameters are those of lh.lyapunov_gradient."
    )
    require(not traced(values), f"{verb} decides from values, and {missing}")


def is_number(value: Any) -> bool:
    """Whether it is a single real number, of Python, NumPy or JAX."""
    if isinstance(value, bool | str | bytes | type(None)):
        return False
    array = _array(value)
    return array is not None and array.ndim == 0 and array.dtype.kind in "iuf"


def _array(value: Any) -> np.ndarray | None:
    """NumPy's array of a value, or None of what makes none."""
    try:
        return np.asarray(value)
    except (TypeError, ValueError, OverflowError):  # a key, a ragged list, …
        return None
