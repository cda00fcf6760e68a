"""The numbers in args by name: "rho", "spring.rate", "rates" and "rates[2]", "0" of a list; "args" where it is one."""

import operator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._jax.tracing import is_typed_key

__all__ = ["ArgsEntry", "described", "entries", "entry_named", "entry_of", "name_of", "number_of"]


class ArgsEntry(NamedTuple):
    """The place of an entry in args: the number of its leaf, and the index of one number in that (None: all of it)."""

    leaf: int
    index: tuple[int, ...] | None  # pyright: ignore[reportIncompatibleMethodOverride]

    def of(self, args) -> Any:
        """The value of the entry."""
        leaf = jax.tree.leaves(args)[self.leaf]
        return leaf if self.index is None else np.asarray(leaf)[self.index]

    def placed(self, args, value) -> Any:
        """The args with another value of the entry; PRNG keys stay as they are given."""
        leaves, structure = jax.tree.flatten(args)
        leaf = leaves[self.leaf]
        value = value if is_typed_key(value) else _in_kind_of(leaf, value)
        leaves[self.leaf] = value if self.index is None else _with_number(jnp.asarray(leaf), self.index, value)
        return jax.tree.unflatten(structure, leaves)


def entries(args) -> dict[str, ArgsEntry]:
    """The whole entries by name: numbers and arrays."""
    return {name: ArgsEntry(i, None) for i, name in _named(args)}


def _named(args) -> list[tuple[int, str]]:
    """The number and the name of each leaf that holds numbers, or PRNG keys."""
    paths = jax.tree_util.tree_leaves_with_path(args)
    return [(i, name_of(path)) for i, (path, leaf) in enumerate(paths) if _holds_numbers(leaf)]


def entry_named(args, name: str) -> ArgsEntry | None:
    """The entry of that name, whole or a single number of an array; None if there is none.

    Raises:
        ValueError: if two entries have this name, as of ``{"a.b": 1.0, "a": {"b": 2.0}}``.
    """
    found = [ArgsEntry(i, None) for i, own in _named(args) if own == name]
    whole, bracket, index = name.partition("[")
    for i, own in _named(args) if bracket else ():
        shape = np.shape(ArgsEntry(i, None).of(args)) if own == whole else ()
        numbers = index.removesuffix("]").split(",")
        fits = name.endswith("]") and len(numbers) == len(shape) and all(one.strip().isdecimal() for one in numbers)
        place = tuple(map(int, numbers)) if fits and shape else ()
        if place and all(map(operator.lt, place, shape)):
            found.append(ArgsEntry(i, place))
    if len(found) > 1:
        raise ValueError(f"{len(found)} entries of args have the name {name!r}: rename all but one.")
    return found[0] if found else None


def _holds_numbers(leaf: Any) -> bool:
    return eqx.is_array_like(leaf) and not (isinstance(leaf, np.ndarray) and leaf.dtype.kind not in "biufc")


def entry_of(args, name: str) -> ArgsEntry:
    """The entry of that name; a ValueError names those that there are."""
    entry = entry_named(args, name)
    if entry is None:
        raise ValueError(f"{name!r} is no entry of args: args has {described(args)}.")
    return entry


def number_of(args, name: str) -> ArgsEntry:
    """The entry of that name, which is a single number; a ValueError if it is not."""
    entry = entry_of(args, name)
    if shape := np.shape(entry.of(args)):
        raise ValueError(f"The parameter {name!r} must be a single number, such as {name}[0]; got shape {shape}.")
    return entry


def described(args) -> str:
    """The names of the entries, for messages: arrays with their first and last number."""
    shapes = {name: np.shape(entry.of(args)) for name, entry in entries(args).items()}
    return ", ".join(name + _ends(name, shape) for name, shape in shapes.items()) or "nothing"


def _ends(name: str, shape: tuple[int, ...]) -> str:
    if 0 in shape or not shape:
        return ""
    first, last = [0] * len(shape), [length - 1 for length in shape]
    return f" ({name}{first} … {name}{last})"


def name_of(path) -> str:
    """The name of a leaf whose path JAX gives."""
    return jax.tree_util.keystr(path, simple=True, separator=".") or "args"


def _in_kind_of(leaf: Any, value: Any):
    """A value in the precision of the entry that it replaces; whole entries take values that are not."""
    kind, value = jnp.result_type(leaf), jnp.asarray(value)
    inexact = jnp.issubdtype(value.dtype, jnp.inexact)
    # A float takes the precision of what it meets: so does a value in its place.
    meets = inexact and (isinstance(leaf, float) or getattr(leaf, "weak_type", False))
    fraction = inexact and not jnp.issubdtype(kind, jnp.inexact)
    return value if meets or fraction or kind == jnp.result_type(0) else value.astype(kind)


def _with_number(array, index, value):
    """The array with one number set to a value of `_in_kind_of`: one of integers takes the type of a float."""
    return (array.astype(value.dtype) if jnp.issubdtype(value.dtype, jnp.inexact) else array).at[index].set(value)
