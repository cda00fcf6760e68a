"""A loop over small arrays, written number by number, so that many runs of it can go side by side.

Under `jax.vmap` each number then is a row of lanes, and each operation one of vector registers; arrays would become
arrays of rows, which XLA writes to memory and reads back (Lorenz by RK4, eight lanes: 57 ns a lane and step, not 16).
For a single run there is `components`, whose rows are those of the frame.
"""

import functools
import math
import operator
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from ._jaxprs import applied, evaluated
from .components import ENTRYWISE

__all__ = ["while_loop"]

MOST = 64  # numbers that an array is taken apart into


class Numbers:
    """A small array, as an array of its entries."""

    def __init__(self, entries: np.ndarray):
        self.entries = entries


def while_loop(goes_on: Callable, step: Callable, state: Any) -> Any:
    """`jax.lax.while_loop`, its condition and its body done number by number."""
    leaves, structure = jax.tree.flatten(state)

    def of_leaves(function):
        return jax.make_jaxpr(lambda leaves: jax.tree.leaves(function(jax.tree.unflatten(structure, leaves))))(leaves)

    asked, body = of_leaves(goes_on), of_leaves(step)
    found = _loop(
        lambda values: evaluated(asked, values, _equation)[0], lambda values: evaluated(body, values, _equation), leaves
    )
    return jax.tree.unflatten(structure, [_together(one) for one in found])


def _loop(goes_on, step, start: list) -> list:
    """A loop over values, each an array or `Numbers`."""
    start = [_apart(one) for one in start]
    shapes = [one.entries.shape if isinstance(one, Numbers) else None for one in start]

    def flat(values):
        pairs = zip(values, shapes, strict=True)
        return [_together(one) if shape is None else list(_apart(one).entries.flat) for one, shape in pairs]

    def restored(leaves):
        pairs = zip(leaves, shapes, strict=True)
        return [one if shape is None else Numbers(_array(shape, one)) for one, shape in pairs]

    def asked(leaves):
        return goes_on(restored(leaves))

    def once(leaves):
        return flat(step(restored(leaves)))

    return restored(jax.lax.while_loop(asked, once, flat(start)))


def _array(shape, entries) -> np.ndarray:
    """Of objects, in the order of a C array."""
    found = np.empty(shape, object)
    for index, one in zip(np.ndindex(found.shape), entries, strict=True):
        found[index] = one
    return found


def _apart(value) -> Any:
    """A small array as `Numbers`; anything else as it is."""
    if isinstance(value, Numbers):
        return value
    shape = np.shape(value)
    if not shape or math.prod(shape) > MOST or jnp.issubdtype(jnp.result_type(value), jax.dtypes.extended):
        return value
    return Numbers(_array(shape, [jnp.asarray(value)[index] for index in np.ndindex(shape)]))


def _together(value) -> Any:
    return jnp.stack(list(value.entries.flat)).reshape(value.entries.shape) if isinstance(value, Numbers) else value


def _entries(value) -> np.ndarray:
    return value.entries if isinstance(value, Numbers) else _array((), [value])


def _equation(closed: ClosedJaxpr, eqn, operands: list) -> list:
    name = eqn.primitive.name
    if name in ("jit", "pjit"):
        return evaluated(eqn.params["jaxpr"], operands, _equation)
    if name == "while":
        return _while(eqn, operands)
    shape = eqn.outvars[0].aval.shape
    if (name in ENTRYWISE or name in RULES) and math.prod(shape) <= MOST:
        parts = [_apart(one) for one in operands]
        if all(isinstance(one, Numbers) or not np.shape(one) for one in parts):
            found = _entrywise(eqn, parts, shape) if name in ENTRYWISE else RULES[name](eqn, *map(_entries, parts))
            if found is not None:
                return [Numbers(found) if shape else found.item()]
    return applied(closed, eqn, [_together(one) for one in operands])


def _while(eqn, operands: list) -> list:
    conditions, bodies = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
    asked, used, start = operands[:conditions], operands[conditions:][:bodies], operands[conditions + bodies :]
    return _loop(
        lambda values: evaluated(eqn.params["cond_jaxpr"], [*asked, *values], _equation)[0],
        lambda values: evaluated(eqn.params["body_jaxpr"], [*used, *values], _equation),
        start,
    )


def _entrywise(eqn, parts, shape) -> np.ndarray:
    spread = [np.broadcast_to(_entries(one), shape) for one in parts]
    return _array(shape, [eqn.primitive.bind(*(one[i] for one in spread), **eqn.params) for i in np.ndindex(shape)])


# The rules: (equation, arrays of entries) -> array of entries; None where arrays have to do.


def _broadcast(eqn, operand):
    shape, sizes = eqn.params["shape"], [1] * len(eqn.params["shape"])
    for axis, size in zip(eqn.params["broadcast_dimensions"], operand.shape, strict=True):
        sizes[axis] = size
    return np.broadcast_to(operand.reshape(sizes), shape)


def _slice(eqn, operand):
    strides = eqn.params["strides"] or (1,) * operand.ndim
    ends = zip(eqn.params["start_indices"], eqn.params["limit_indices"], strides, strict=True)
    return operand[tuple(slice(*one) for one in ends)]


def _reshape(eqn, operand):
    return None if eqn.params["dimensions"] else operand.reshape(eqn.params["new_sizes"])


def _pad(eqn, operand, filling):
    around, shape = eqn.params["padding_config"], eqn.outvars[0].aval.shape
    if any(inside or low < 0 or high < 0 for low, high, inside in around):
        return None
    found = _array(shape, [filling.item()] * math.prod(shape))
    found[tuple(slice(low, low + size) for (low, *_), size in zip(around, operand.shape, strict=True))] = operand
    return found


def _dot(eqn, left, right):
    contracted, batch = eqn.params["dimension_numbers"]
    return None if batch != ((), ()) else np.asarray(np.tensordot(left, right, contracted), object)


def _reduced(fold):
    def rule(eqn, operand):
        axes = eqn.params["axes"]
        stay = [axis for axis in range(operand.ndim) if axis not in axes]
        groups = operand.transpose(*stay, *axes).reshape(*(operand.shape[axis] for axis in stay), -1)
        return _array(groups.shape[:-1], [functools.reduce(fold, groups[i]) for i in np.ndindex(groups.shape[:-1])])

    return rule


RULES: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": lambda eqn, *operands: np.concatenate(operands, eqn.params["dimension"]),
    "dot_general": _dot,
    "pad": _pad,
    "reduce_and": _reduced(operator.and_),
    "reduce_max": _reduced(jnp.maximum),
    "reduce_min": _reduced(jnp.minimum),
    "reduce_or": _reduced(operator.or_),
    "reduce_sum": _reduced(operator.add),
    "reshape": _reshape,
    "slice": _slice,
    "squeeze": lambda eqn, operand: operand.reshape(eqn.outvars[0].aval.shape),
    "stack": lambda eqn, *operands: np.stack(operands, eqn.params["axis"]),
    "transpose": lambda eqn, operand: operand.transpose(eqn.params["permutation"]),
}
