"""Entries beyond the end of an array: JAX takes the last entry instead, without a word, where NumPy raises an error."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from ..._jax.jaxprs import inside, is_call
from ..._jax.tracing import is_typed_key, traced

__all__ = ["Beyond", "entry_beyond_the_end"]

# What JAX makes of a fixed index before it uses it.
FOLDED: dict[str, Callable] = {
    "lt": lambda params, a, b: a < b,
    "add": lambda params, a, b: a + b,
    "select_n": lambda params, which, a, b: np.where(which, b, a),
    "convert_element_type": lambda params, a: a.astype(params["new_dtype"]),
    "broadcast_in_dim": lambda params, a: _spread(a, params["shape"], params["broadcast_dimensions"]),
    "concatenate": lambda params, *parts: np.concatenate(parts, params["dimension"]),
}


class Beyond(NamedTuple):
    """An entry that an array does not have."""

    eqn: Any  # the equation that reads or writes it
    entry: int
    shape: tuple[int, ...]  # of the array
    axis: int


def entry_beyond_the_end(closed: ClosedJaxpr, given: Sequence = ()) -> Beyond | None:
    """The first entry beyond the end of its array that a function reads or writes, by an index fixed in the function.

    Args:
        closed: the function.
        given: the values of its arguments, as far as they are known; None for the others.
    """
    known = dict(zip(closed.jaxpr.constvars, closed.consts, strict=True))
    known |= dict(zip(closed.jaxpr.invars, given, strict=False))

    def read(atom):
        value = atom.val if isinstance(atom, Literal) else known.get(atom)
        return np.asarray(value) if _is_index(value) else None

    for eqn in closed.jaxpr.eqns:
        values = [read(atom) for atom in eqn.invars]
        rule = FOLDED.get(eqn.primitive.name)
        if rule and all(value is not None for value in values):
            known[eqn.outvars[0]] = rule(eqn.params, *values)
        own = USES.get(eqn.primitive.name, _none)(eqn, values)
        if own:
            return own
        for inner in inside(eqn):
            own = entry_beyond_the_end(inner, values if is_call(eqn) else ())
            if own:
                return own
    return None


def _is_index(value) -> bool:
    """Whether it is known, and consists of integers or truth values."""
    array = hasattr(value, "__array__")  # those of JAX 0.8's constants are of a type of their own
    if traced(value) or is_typed_key(value) or not (isinstance(value, int) or array):
        return False
    return np.dtype(np.result_type(value) if isinstance(value, int) else value.dtype).kind in "bui"


def _spread(a, shape, dimensions) -> np.ndarray:
    placed = np.ones(len(shape), int)
    placed[list(dimensions)] = np.shape(a)
    return np.broadcast_to(np.reshape(a, placed), shape)


def _none(eqn, values) -> None:
    return None


def _of_slice(eqn, values) -> Beyond | None:
    shape = eqn.invars[0].aval.shape
    for axis, (start, size) in enumerate(zip(values[1:], eqn.params["slice_sizes"], strict=True)):
        if start is not None and not 0 <= int(start) <= shape[axis] - size:
            return Beyond(eqn, int(start), shape, axis)
    return None


def _of_indices(eqn, values, indices, axes) -> Beyond | None:
    """Of the rows of indices of a gather or scatter, whose columns belong to these axes of the array."""
    shape = eqn.invars[0].aval.shape
    if indices is None or indices.size == 0:
        return None
    rows = indices.reshape(-1, indices.shape[-1])
    for column, axis in zip(rows.T, axes, strict=True):
        wrong = column[(column < 0) | (column >= shape[axis])]
        if wrong.size:
            return Beyond(eqn, int(wrong[0]), shape, axis)
    return None


def _of_gather(eqn, values) -> Beyond | None:
    wanted = eqn.params["mode"] == jax.lax.GatherScatterMode.CLIP or eqn.params["fill_value"] is not None
    return None if wanted else _of_indices(eqn, values, values[1], eqn.params["dimension_numbers"].start_index_map)


def _of_scatter(eqn, values) -> Beyond | None:
    if eqn.params["mode"] == jax.lax.GatherScatterMode.CLIP:
        return None
    axes = eqn.params["dimension_numbers"].scatter_dims_to_operand_dims
    return _of_indices(eqn, values, values[1], axes)


USES = {"dynamic_slice": _of_slice, "gather": _of_gather}
HOW = ("add", "sub", "mul", "min", "max")  # the names of scatters differ between versions of JAX
USES |= dict.fromkeys(("scatter", *(f"scatter{join}{how}" for join in "-_" for how in HOW)), _of_scatter)
