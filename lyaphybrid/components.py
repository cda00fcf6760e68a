"""A function of small arrays, worked out component by component.

XLA writes every array of a loop's body to memory and reads it back for the next operation. LLVM keeps in registers
what it can follow: a number, or a row of them, by itself, but not the parts of an array that is put together in one
place and taken apart in another. So an innermost loop with little work is written in numbers and rows: an array (n,)
is n numbers, an array (n, k) is n rows, and each equation of the loop's jaxpr is done for each of them. What has no
rule below is done with arrays, put together for it. (By RK4 an oscillator with impacts gains 7 % of the time, the
Lorenz system a sixth with LLVM's options of `_compiler`. With more work in a step, by dopri5, it takes 8 % longer.)
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

__all__ = ["by_components", "joined", "split"]

MOST = 4  # numbers or rows that an array is split into


class Parts:
    """An array (n,) as numbers, or an array (…, k) as rows (k,); `entries` are without the last axis then."""

    def __init__(self, shape: tuple[int, ...], values):
        self.shape, self.rows = shape, len(shape) > 1
        self.entries = np.empty(_lead(shape), object)
        for index, value in zip(np.ndindex(self.entries.shape), values, strict=True):
            self.entries[index] = value


def split(tree: Any) -> list:
    """The leaves of a tree; small arrays as tuples of their parts."""
    return [_listed(_taken_apart(leaf)) for leaf in jax.tree.leaves(tree)]


def joined(leaves: list, like: Any) -> Any:
    """The tree that was split; `like` it in its structure and shapes."""
    arrays = [_put_together(one) for one in _restored(leaves, [leaf.shape for leaf in jax.tree.leaves(like)])]
    return jax.tree.unflatten(jax.tree.structure(like), arrays)


def by_components(function: Callable, example: Any) -> Callable[[list], list]:
    """A function of one tree, as one from the split leaves of that tree to the split leaves of its result."""
    structure = jax.tree.structure(example)

    def of_leaves(leaves):
        return jax.tree.leaves(function(jax.tree.unflatten(structure, leaves)))

    closed = jax.make_jaxpr(of_leaves)(jax.tree.leaves(example))
    shapes = [v.aval.shape for v in closed.jaxpr.invars]

    def of_parts(leaves: list) -> list:
        results = evaluated(closed, _restored(leaves, shapes), _equation)
        return [_listed(_taken_apart(one)) for one in results]

    return of_parts


def _lead(shape) -> tuple[int, ...]:
    return shape[:-1] if len(shape) > 1 else shape


def _is_small(shape) -> bool:
    return bool(shape) and 0 not in shape and math.prod(_lead(shape)) <= MOST


def _taken_apart(value) -> Any:
    """The parts of a small array; anything else as it is."""
    if isinstance(value, Parts) or not _is_small(np.shape(value)):
        return value
    array = jnp.asarray(value)
    return Parts(array.shape, [array[index] for index in np.ndindex(_lead(array.shape))])


def _put_together(value):
    return jnp.stack(list(value.entries.flat)).reshape(value.shape) if isinstance(value, Parts) else value


def _listed(value):
    return tuple(value.entries.flat) if isinstance(value, Parts) else value


def _restored(leaves, shapes) -> list:
    return [Parts(shape, leaf) if isinstance(leaf, tuple) else leaf for leaf, shape in zip(leaves, shapes, strict=True)]


def _equation(closed: ClosedJaxpr, eqn, operands: list) -> list:
    name = eqn.primitive.name
    if name in ("jit", "pjit"):
        return evaluated(eqn.params["jaxpr"], operands, _equation)
    if name == "while":
        return _while(eqn, operands)
    touched = any(isinstance(one, Parts) for one in operands) or name in OF_NUMBERS
    found = _by_rule(eqn, operands) if touched else None
    return applied(closed, eqn, [_put_together(one) for one in operands]) if found is None else [found]


def _while(eqn, operands: list) -> list:
    """A loop within: its state is carried in parts."""
    conditions, bodies = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
    asked, used, start = operands[:conditions], operands[conditions:][:bodies], operands[conditions + bodies :]
    shapes = [atom.aval.shape for atom in eqn.outvars]

    def goes_on(leaves):
        return evaluated(eqn.params["cond_jaxpr"], [*asked, *_restored(leaves, shapes)], _equation)[0]

    def once(leaves):
        found = evaluated(eqn.params["body_jaxpr"], [*used, *_restored(leaves, shapes)], _equation)
        return [_listed(_taken_apart(one)) for one in found]

    leaves = [_listed(_taken_apart(one)) for one in start]
    return _restored(jax.lax.while_loop(goes_on, once, leaves), shapes)


def _by_rule(eqn, operands: list):
    """What comes out of an equation; None where there is no rule for it, or for arrays of this size."""
    name = eqn.primitive.name
    if name not in ENTRYWISE and name not in RULES:
        return None
    shape = eqn.outvars[0].aval.shape
    if shape and not _is_small(shape):
        return None
    return _entrywise(eqn, operands, shape) if name in ENTRYWISE else RULES[name](eqn.params, shape, *operands)


def _entrywise(eqn, operands, shape) -> Parts:
    """The operation for each entry; a number among the operands, or an axis of length 1, goes with all of them."""
    lead, parts = _lead(shape), [_taken_apart(one) for one in operands]
    spread = [np.broadcast_to(one.entries, lead) if isinstance(one, Parts) else one for one in parts]

    def entry(index):
        each = [one[index] if isinstance(whole, Parts) else one for one, whole in zip(spread, parts, strict=True)]
        return eqn.primitive.bind(*each, **eqn.params)

    return Parts(shape, [entry(index) for index in np.ndindex(lead)])


# The rules: (parameters, shape of the result, operands) -> the result, None where arrays have to do. An array (k,) may
# be n numbers or a row: what comes out of rows, or of one number repeated, is left whole, and is split when it meets
# numbers.


def _broadcast(params, shape, operand):
    dimensions, last = params["broadcast_dimensions"], len(shape) - 1
    if not isinstance(operand, Parts):
        row = len(shape) == 2 and dimensions == (1,) and np.shape(operand) == shape[1:]
        number = shape == (1,) and not np.shape(operand)
        return Parts(shape, [operand] * shape[0]) if row or number else None
    if len(shape) == 1:
        return jnp.broadcast_to(operand.entries[0], shape) if operand.shape == (1,) else operand
    stays_last = dimensions[-1] == last and operand.shape[-1] == shape[-1]
    if stays_last != operand.rows or (not stays_last and last in dimensions):
        return None
    places = dimensions[:-1] if operand.rows else dimensions
    sizes = [operand.entries.shape[places.index(axis)] if axis in places else 1 for axis in range(last)]
    entries = np.broadcast_to(operand.entries.reshape(sizes), shape[:-1]).flat
    return Parts(shape, entries if operand.rows else [jnp.broadcast_to(one, shape[-1:]) for one in entries])


def _slice(params, shape, operand):
    ranges = list(zip(params["start_indices"], params["limit_indices"], strict=True))
    if params["strides"] is not None and any(stride != 1 for stride in params["strides"]):
        return None
    along = slice(*ranges.pop()) if operand.rows else None
    entries = operand.entries[tuple(slice(*one) for one in ranges)].flat
    return Parts(shape, entries if along in (None, slice(0, operand.shape[-1])) else [row[along] for row in entries])


def _reshape(params, shape, operand):
    if params.get("new_sizes") and params["dimensions"]:  # transposed first
        return None
    if operand.rows and operand.shape[-1] == 1 and shape == operand.shape[:-1] and len(shape) == 1:  # of rows of one
        return Parts(shape, [row[0] for row in operand.entries.flat])
    if operand.rows and len(shape) > 1 and operand.shape[-1] == shape[-1]:
        return Parts(shape, operand.entries.flat)
    if operand.entries.size == 1 and shape == operand.shape[1:]:  # a number, or a row
        return operand.entries.flat[0]
    return Parts(shape, operand.entries.flat) if not operand.rows and len(shape) == 1 else None


def _concatenate(params, shape, *operands):
    parts, rows = [_taken_apart(one) for one in operands], len(shape) > 1
    if not all(isinstance(one, Parts) for one in parts) or (rows and params["dimension"] == len(shape) - 1):
        return None
    return Parts(shape, np.concatenate([one.entries for one in parts], params["dimension"]).flat)


def _pad(params, shape, operand, filling):
    """What is added around the entries, or taken away; a slice has this as its transpose."""
    around, rows = list(params["padding_config"]), operand.rows
    if any(inside for *_, inside in around) or (rows and around.pop() != (0, 0, 0)):
        return None
    filling = jnp.broadcast_to(filling, shape[-1:]) if rows else filling
    result = Parts(shape, [filling] * math.prod(_lead(shape)))
    kept = operand.entries[_within(around, operand.entries.shape, -1)]
    result.entries[_within(around, result.entries.shape, 1)] = kept
    return result


def _within(around, sizes, sign: int) -> tuple[slice, ...]:
    """Without what padding of this sign adds or takes away at both ends."""
    ends = [(max(0, sign * low), max(0, sign * high)) for low, high, _ in around]
    return tuple(slice(low, size - high) for (low, high), size in zip(ends, sizes, strict=True))


def _dot(params, shape, left, right):
    """Numbers times numbers, or numbers times rows."""
    (contracted, batch), left, right = params["dimension_numbers"], _taken_apart(left), _taken_apart(right)
    simple = contracted == ((0,), (0,)) and batch == ((), ())
    if not simple or not isinstance(left, Parts) or not isinstance(right, Parts) or left.rows:
        return None
    del shape
    return functools.reduce(operator.add, [a * b for a, b in zip(left.entries, right.entries, strict=True)])


def _stack(params, shape, *operands):
    if len(shape) > 2 or params["axis"] != 0:
        return None
    return Parts(shape, [_put_together(one) for one in operands])


def _reduced(fold, along):
    """Over some axes: `fold` of two entries, `along` a row (None: arrays have to do)."""

    def rule(params, shape, operand):
        axes, entries = params["axes"], operand.entries
        over_rows = operand.rows and entries.ndim in axes
        if over_rows and (len(shape) > 1 or along is None):
            return None
        gone = [axis for axis in axes if axis < entries.ndim]
        stay = [axis for axis in range(entries.ndim) if axis not in gone]
        groups = entries.transpose(*stay, *gone).reshape(*(entries.shape[axis] for axis in stay), -1)
        folded = [functools.reduce(fold, groups[index]) for index in np.ndindex(groups.shape[:-1])]
        folded = [along(one) for one in folded] if over_rows else folded
        whole = not shape or (operand.rows and not over_rows and len(shape) == 1)  # one number, or one row
        return folded[0] if whole else Parts(shape, folded)

    return rule


ENTRYWISE = {
    *("abs", "add", "add_any", "and", "atan2", "ceil", "clamp", "convert_element_type", "copy", "cos", "cosh", "div"),
    *("eq", "erf", "exp", "exp2", "expm1", "floor", "ge", "gt", "integer_pow", "is_finite", "le", "log", "log1p"),
    *("logistic", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "pow", "rem", "round", "rsqrt", "select_n"),
    *("sign", "sin", "sinh", "sqrt", "square", "sub", "tan", "tanh", "xor"),
}
OF_NUMBERS = {"broadcast_in_dim", "stack"}  # what makes an array of numbers, or rows
RULES: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": _concatenate,
    "dot_general": _dot,
    "pad": _pad,
    "reduce_and": _reduced(operator.and_, None),
    "reduce_max": _reduced(jnp.maximum, jnp.max),
    "reduce_min": _reduced(jnp.minimum, jnp.min),
    "reduce_or": _reduced(operator.or_, None),
    "reduce_sum": _reduced(operator.add, lambda row: jnp.sum(row, dtype=row.dtype)),
    "reshape": _reshape,
    "slice": _slice,
    "squeeze": _reshape,
    "stack": _stack,
}
