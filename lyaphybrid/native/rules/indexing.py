"""Rules for indices that are known only at run time.

Indices out of bounds are treated as in JAX: slices are shifted into the array; gathers and scatters clip, fill or drop
according to their mode.
"""

from collections.abc import Callable

import numpy as np

from ..elementary import arithmetic as a
from ..lowering.emitter import Entry
from ..lowering.jax_versions import index_mode
from ..lowering.lowering import Lowering, rule
from ..lowering.types import INDEX, llvm_type
from ..lowering.unsupported import UnsupportedError
from ..lowering.values import Entries, Lazy, filled, memory_of
from .moving import moved


def _index(b: Lowering, entry: Entry, dtype) -> Entry:
    """An index as a 64-bit integer."""
    return a.converted(b, dtype, entry, INDEX)


def _clipped(b: Lowering, index: Entry, most: int) -> Entry:
    """An index between 0 and `most`."""
    if most <= 0:
        return 0
    return a.minimum(b, INDEX, a.maximum(b, INDEX, index, 0), most)


def _in_bounds(b: Lowering, index: Entry, most: int) -> Entry:
    return b.logic("and", a.compare(b, INDEX, "ge", index, 0), a.compare(b, INDEX, "le", index, most))


def _corner(b: Lowering, starts, atoms, shape, lengths) -> list[Entry]:
    """The first indices of a slice of these lengths, shifted into the array."""
    found = []
    for start, atom, n, m in zip(starts, atoms, shape, lengths, strict=True):
        found.append(_clipped(b, _index(b, b.entry_of(start), atom.aval.dtype), n - m))
    return found


@rule("dynamic_slice")
def dynamic_slice(b, eqn, value, *starts):
    aval = eqn.outvars[0].aval
    corner = _corner(b, starts, eqn.invars[1:], value.shape, aval.shape)
    return moved(b, aval, value, lambda i: [b.index_sum(x, start) for x, start in zip(i, corner, strict=True)])


@rule("dynamic_update_slice")
def dynamic_update_slice(b, eqn, value, update, *starts):
    aval = eqn.outvars[0].aval
    corner = _corner(b, starts, eqn.invars[2:], value.shape, update.shape)
    if b.is_small(aval.shape):
        where = lambda i: ([b.index_sum(x, start) for x, start in zip(i, corner, strict=True)], True)  # noqa: E731
        return _scatter_small(
            b, b.entries(value), b.entries(update), where, llvm_type(aval.dtype), lambda old, new: new
        )
    if isinstance(update, Lazy):
        update = b.in_memory(update)  # a lazy update may read elements that are overwritten
    found = b.to_write(value, aval.dtype, [update])
    b.write(found, update, corner)
    return found


def _scatter_small(
    b: Lowering, array: Entries, update: Entries, where: Callable, type_: str, combine: Callable
) -> Entries:
    """A small array with the entries of `update`; where(indices) -> (indices in the array, whether to write)."""
    found = array.copy()
    for i in np.ndindex(update.shape):
        to, applies = where(list(i))
        for place in np.ndindex(array.shape):
            condition = applies
            for index, here in zip(to, place, strict=True):
                condition = b.logic("and", condition, a.equal(b, INDEX, index, here))
            found[place] = b.select(condition, type_, combine(found[place], update[i]), found[place])
    return found


@rule("gather")
def gather(b, eqn, value, indices):
    numbers, sizes, mode = eqn.params["dimension_numbers"], eqn.params["slice_sizes"], index_mode(eqn)
    aval, index_type, shape = eqn.outvars[0].aval, eqn.invars[1].aval.dtype, value.shape
    if mode not in ("clip", "drop", "promise"):
        raise UnsupportedError(f"gather in the mode {mode}")
    gone = {*numbers.collapsed_slice_dims, *numbers.operand_batching_dims}
    free = [axis for axis in range(len(shape)) if axis not in gone]
    indices = b.readable(indices, index_type) if not b.is_small(aval.shape) else indices

    def at(i):
        batch = [x for place, x in enumerate(i) if place not in numbers.offset_dims]
        offset = [x for place, x in enumerate(i) if place in numbers.offset_dims]
        full, inside = [0] * len(shape), True
        for axis, source in zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True):
            full[axis] = batch[source]
        for place, axis in enumerate(numbers.start_index_map):
            start = _index(b, b.element_at(indices, [*batch, place], index_type), index_type)
            if mode == "drop":
                inside = b.logic("and", inside, _in_bounds(b, start, shape[axis] - sizes[axis]))
            full[axis] = _clipped(b, start, shape[axis] - sizes[axis])
        for axis, x in zip(free, offset, strict=True):
            full[axis] = b.index_sum(full[axis], x)
        found = b.element_at(source_value, full, aval.dtype)
        return b.select(inside, llvm_type(aval.dtype), found, eqn.params["fill_value"])  # None where all are inside

    if b.is_small(aval.shape):
        source_value = value
        return filled(aval.shape, [at(list(i)) for i in np.ndindex(aval.shape)])
    source_value = b.readable(b.at_hand(value), aval.dtype)
    only_reads = not isinstance(indices, Lazy) or indices.cheap
    return b.lazy(aval.shape, aval.dtype, at, [source_value, indices], cheap=only_reads)


_SCATTERS = {
    "scatter": lambda b, dtype, old, new: new,
    "scatter-update": lambda b, dtype, old, new: new,
    "scatter-add": a.add,
    "scatter-sub": a.subtract,
    "scatter-mul": a.multiply,
    "scatter-max": a.maximum,
    "scatter-min": a.minimum,
}


@rule(*_SCATTERS)
def scatter(b, eqn, value, indices, updates):
    combine, numbers, mode = _SCATTERS[eqn.primitive.name], eqn.params["dimension_numbers"], index_mode(eqn)
    aval, index_type, shape = eqn.outvars[0].aval, eqn.invars[1].aval.dtype, value.shape
    if mode not in ("clip", "drop", "promise"):
        raise UnsupportedError(f"scatter in the mode {mode}")
    gone = {*numbers.inserted_window_dims, *numbers.operand_batching_dims}
    free = [axis for axis in range(len(shape)) if axis not in gone]
    window = dict(zip(free, (updates.shape[axis] for axis in numbers.update_window_dims), strict=True))
    few = b.is_small(aval.shape) and b.is_small(updates.shape)

    def where(i):
        batch = [x for place, x in enumerate(i) if place not in numbers.update_window_dims]
        offset = [x for place, x in enumerate(i) if place in numbers.update_window_dims]
        full, inside = [0] * len(shape), True
        for axis, source in zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True):
            full[axis] = batch[source]
        for place, axis in enumerate(numbers.scatter_dims_to_operand_dims):
            start = _index(b, b.element_at(indices, [*batch, place], index_type), index_type)
            most = shape[axis] - window.get(axis, 1)
            if mode != "clip":
                inside = b.logic("and", inside, _in_bounds(b, start, most))
            full[axis] = _clipped(b, start, most)
        for axis, x in zip(free, offset, strict=True):
            full[axis] = b.index_sum(full[axis], x)
        return full, inside

    if few:
        joined = lambda old, new: combine(b, aval.dtype, old, new)  # noqa: E731
        return _scatter_small(b, b.entries(value), b.entries(updates), where, llvm_type(aval.dtype), joined)
    indices, updates = b.readable(b.at_hand(indices), index_type), b.at_hand(updates)
    if not b.is_small(updates.shape):
        updates = b.in_memory(updates, aval.dtype)
    found = b.to_write(value, aval.dtype, [indices, updates])

    def one(i):
        to, inside = where(i)
        new = b.element_at(updates, i, aval.dtype)
        if combine is not _SCATTERS["scatter"] and combine is not _SCATTERS["scatter-update"]:
            new = combine(b, aval.dtype, b.load_element(found, to), new)
        elif inside is True:
            b.store_element(found, to, new)
            return
        b.store_element(found, to, b.select(inside, llvm_type(aval.dtype), new, b.load_element(found, to)))

    if memory_of(updates) is None:
        for i in np.ndindex(updates.shape):
            one(list(i))
    else:
        b.for_each_index(updates.shape, one)
    return b.held(found)
