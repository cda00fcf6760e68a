"""Apply a linear function of one perturbation to all columns of a frame.

`jax.vmap` moves the axis of the columns to the front in most operations. Here it stays the last axis through every
equation of the function's jaxpr, so that the entries of a row are contiguous and our compiler can hold a row of the
frame in one vector register. Primitives without a rule below are left to `jax.vmap`.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Literal
from jaxtyping import Array, Float

from .jaxprs import applied, evaluated, is_call, results_of

__all__ = ["each_column", "linear_at"]


class Columns(NamedTuple):
    """A value that depends on the column; the columns are the last axis."""

    array: Array


def each_column(function: Callable, frame: Float[Array, "n k"]) -> Any:
    """The function applied to every column.

    Args:
        function: dx (n,) -> pytree of arrays, linear in dx.
        frame: (n, k).

    Returns:
        The same pytree; each array has one more axis, the last, of length k.
    """
    column = jax.ShapeDtypeStruct(frame.shape[:1], frame.dtype)
    closed, shape = jax.make_jaxpr(function, return_shape=True)(column)
    found = _spread(_through(closed, [Columns(frame)], frame.shape[1]), frame.shape[1])
    return jax.tree.unflatten(jax.tree.structure(shape), found)


def linear_at(function: Callable, x) -> Callable:
    """Frames (n, k) ↦ Df frame, for the derivative Df at x of a function of x."""
    return lambda frame: each_column(lambda dx: jax.jvp(function, (x,), (dx,))[1], frame)


def _through(closed: ClosedJaxpr, inputs: list, k: int) -> list:
    """The outputs of a jaxpr; those that depend on `Columns` are `Columns`."""
    read = {atom for atoms in (closed.jaxpr.outvars, *(eqn.invars for eqn in closed.jaxpr.eqns)) for atom in atoms
            if not isinstance(atom, Literal)}  # fmt: skip

    def rule(closed, eqn, operands):
        return _through_equation(closed, eqn, operands, k, tuple(variable in read for variable in eqn.outvars))

    return evaluated(closed, inputs, rule)


def _through_equation(closed: ClosedJaxpr, eqn, operands: list, k: int, read: tuple[bool, ...]) -> list:
    if not any(isinstance(operand, Columns) for operand in operands):
        return applied(closed, eqn, operands)
    if is_call(eqn):
        return _through_call(eqn.params["jaxpr"], operands, k, read)
    name, differ = eqn.primitive.name, [isinstance(operand, Columns) for operand in operands]
    if name == "cond" and not differ[0]:
        return _through_branches(eqn, operands, k)
    rule = (MIXED.get(name) if LINEAR_IN.get(name, any)(differ) else None) or (
        None if any(differ[1:]) else OF_FIRST.get(name)
    )
    if rule:
        return [Columns(rule(eqn.params, k, *operands))]
    return _by_vmap(closed, eqn, operands, k, results_of(eqn, differ))


def _by_vmap(closed: ClosedJaxpr, eqn, operands: list, k: int, differing: Sequence[bool]) -> list:
    """A primitive without a rule; of results that do not depend on the column one is taken."""
    arrays = [one.array if isinstance(one, Columns) else one for one in operands]
    axes = [-1 if isinstance(one, Columns) else None for one in operands]
    if not k:  # of one column, to take them from
        each = zip(arrays, axes, strict=True)
        arrays = [one if axis is None else jnp.zeros((*one.shape[:-1], 1), one.dtype) for one, axis in each]
    found = jax.vmap(lambda *each: applied(closed, eqn, each), axes, -1)(*arrays)
    columns = found if k else [one[..., :0] for one in found]
    each = zip(columns, found, differing, strict=True)
    return [Columns(column) if differs else one[..., 0] for column, one, differs in each]


def _through_call(closed: ClosedJaxpr, operands: list, k: int, read: tuple[bool, ...]) -> list:
    """A call of a jitted function; only results that are used later are computed."""
    differ = tuple(isinstance(operand, Columns) for operand in operands)
    function, differing = _of_columns(closed, differ, k, read)
    computed = function(*(one.array if isinstance(one, Columns) else one for one in operands))
    found: list[Any] = [None] * len(read)
    for place, one in zip(np.flatnonzero(read), computed, strict=True):
        found[place] = Columns(one) if differing[place] else one
    return found


@functools.lru_cache(maxsize=1024)
def _of_columns(closed: ClosedJaxpr, differ: tuple[bool, ...], k: int, read: tuple[bool, ...]):
    """The jitted function for `Columns` where operands `differ`, and a list that tells which results are `Columns`.

    The list is filled when the function is traced, once.
    """
    differing: list[bool] = []

    def of_arrays(*arrays):
        inputs = [Columns(one) if differs else one for one, differs in zip(arrays, differ, strict=True)]
        found = _through(closed, inputs, k)
        differing[:] = [isinstance(one, Columns) for one in found]
        return [
            one.array if isinstance(one, Columns) else one for one, wanted in zip(found, read, strict=True) if wanted
        ]

    return jax.jit(of_arrays), differing


def _through_branches(eqn, operands, k) -> list:
    """A conditional whose index is the same for all columns."""
    index, *operands = operands
    differing = results_of(eqn, [False, *(isinstance(one, Columns) for one in operands)])

    def through(branch):
        def results(operands):
            found = zip(_through(branch, operands, k), differing, strict=True)
            return [_spread([one], k)[0] if differs else one for one, differs in found]

        return results

    found = lax.switch(index, [through(branch) for branch in eqn.params["branches"]], operands)
    return [Columns(one) if differs else one for one, differs in zip(found, differing, strict=True)]


def _spread(values, k: int = 1) -> list:
    """The values as arrays with a last axis for the columns; values common to all columns are repeated k times."""

    def spread(value):
        return jnp.broadcast_to(jnp.asarray(value)[..., None], (*jnp.shape(value), k))

    return [one.array if isinstance(one, Columns) else spread(one) for one in values]


def _dot(params, k, left, right):
    """Matrix product; the columns' axis follows its operand's free axes, so it is last if that is the right operand."""
    del k
    dimensions = params["dimension_numbers"]
    options = {"precision": params["precision"], "preferred_element_type": params["preferred_element_type"]}
    if isinstance(right, Columns):
        return lax.dot_general(left, right.array, dimensions, **options)
    product = lax.dot_general(left.array, right, dimensions, **options)
    (contracted, _), (_, _) = dimensions
    return jnp.moveaxis(product, left.array.ndim - 1 - len(contracted), -1)


def _updated(k, x, new, starts):
    array, new = _spread((x, new), k)
    return lax.dynamic_update_slice_p.bind(array, new, *_corner(starts))


def _corner(starts):
    """The start indices of a slice, with 0 for the axis of the columns.

    They are for the primitives; the functions of the same names would count negative ones from the end once more.
    """
    return (*starts, jnp.zeros_like(starts[0]))


def _entrywise(operation):
    return lambda _params, _k, *operands: operation(*jnp.broadcast_arrays(*_spread(operands)))


# Rules by name of the primitive: (parameters, number of columns, operands) -> array with the columns last.
MIXED: dict[str, Callable] = {  # any operand may be `Columns`
    "add": _entrywise(lax.add),
    "add_any": _entrywise(lax.add),
    "concatenate": lambda p, k, *parts: lax.concatenate(_spread(parts, k), p["dimension"]),
    "div": _entrywise(lax.div),
    "dot_general": _dot,
    "dynamic_update_slice": lambda p, k, x, new, *starts: _updated(k, x, new, starts),
    "mul": _entrywise(lax.mul),
    "select_n": _entrywise(lax.select_n),
    "stack": lambda p, k, *parts: jnp.stack(_spread(parts, k), p["axis"]),
    "sub": _entrywise(lax.sub),
}
# Of those whose operands may not all be `Columns`: whether they are as the rule takes them.
LINEAR_IN: dict[str, Callable] = {
    "dot_general": lambda differ: not all(differ),
    "dynamic_update_slice": lambda differ: any(differ[:2]) and len(differ) > 2 and not any(differ[2:]),
}
OF_FIRST: dict[str, Callable] = {  # only the first operand is `Columns`
    "broadcast_in_dim": lambda p, k, x: lax.broadcast_in_dim(
        x.array, (*p["shape"], k), (*p["broadcast_dimensions"], len(p["shape"]))
    ),
    "convert_element_type": lambda p, k, x: lax.convert_element_type(x.array, p["new_dtype"]),
    "dynamic_slice": lambda p, k, x, *starts: lax.dynamic_slice_p.bind(
        x.array, *_corner(starts), slice_sizes=(*p["slice_sizes"], k)
    ),
    "neg": lambda p, k, x: lax.neg(x.array),
    "pad": lambda p, k, x, value: lax.pad(x.array, value, (*p["padding_config"], (0, 0, 0))),
    "reduce_sum": lambda p, k, x: jnp.sum(x.array, axis=p["axes"]),
    "reshape": lambda p, k, x: lax.reshape(
        x.array, (*p["new_sizes"], k), p["dimensions"] and (*p["dimensions"], len(p["dimensions"]))
    ),
    "slice": lambda p, k, x: lax.slice(
        x.array, (*p["start_indices"], 0), (*p["limit_indices"], k), p["strides"] and (*p["strides"], 1)
    ),
    "squeeze": lambda p, k, x: lax.squeeze(x.array, p["dimensions"]),
    "transpose": lambda p, k, x: lax.transpose(x.array, (*p["permutation"], len(p["permutation"]))),
}
