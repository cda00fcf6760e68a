"""Rules that only move entries: nothing is computed, and for small arrays there is no code at run time."""

import jax
import numpy as np

from ..elementary import arithmetic as a
from ..lowering.lowering import KEEPS_ROWS, KEEPS_SEAMS, Lowering, in_rows, rule
from ..lowering.seams import MOST_SEAMS, Seams, united, within
from ..lowering.types import INDEX, llvm_type
from ..lowering.values import Buffer, Lazy, RowVectors, Value, filled, seams_of, size


def moved(b: Lowering, aval, value: Value, where, first: int | None = None) -> Value:
    """The array whose entry at `indices` is the entry of `value` at `where(indices)`.

    `first`: where it begins along the first axis of `value`, if that is its own first axis.
    """
    if b.is_small(aval.shape):
        places = np.ndindex(aval.shape)
        return filled(aval.shape, [b.element_at(value, where(list(i)), aval.dtype) for i in places])
    value = b.readable(value, aval.dtype, cut=first is not None)
    found = b.lazy(
        aval.shape, aval.dtype, lambda i: b.element_at(value, where(i), aval.dtype), [value], is_cheap(value)
    )
    if first is not None:
        found.seams = within(seams_of(value), first, aval.shape[0])
    return found


def is_cheap(value: Value) -> bool:
    """Whether elements may be read again for each use."""
    return not isinstance(value, Lazy) or value.cheap or value.buffer is not None


@rule("broadcast_in_dim")
def broadcast(b, eqn, value, *lengths):
    aval, axes = eqn.outvars[0].aval, eqn.params["broadcast_dimensions"]
    if isinstance(value, np.ndarray) and b.is_small(aval.shape):
        shape = [1] * len(aval.shape)
        for axis, n in zip(axes, value.shape, strict=True):
            shape[axis] = n
        return np.broadcast_to(value.reshape(shape), aval.shape)
    own = value.shape
    same_first = axes[:1] == (0,) and own[0] == aval.shape[0]
    value = b.readable(value, aval.dtype, often=size(own) < size(aval.shape), cut=same_first)
    where = lambda i: [0 if n == 1 else i[axis] for axis, n in zip(axes, own, strict=True)]  # noqa: E731
    return moved(b, aval, value, where, 0 if same_first else None)


@in_rows("broadcast_in_dim")
def _(b, eqn, value, *lengths):
    aval, axes = eqn.outvars[0].aval, eqn.params["broadcast_dimensions"]
    if axes[-1] != len(aval.shape) - 1 or value.shape[-1] != aval.shape[-1] or not b.is_small(aval.shape):
        return None
    shape = [1] * (len(aval.shape) - 1)
    for axis, n in zip(axes[:-1], value.shape[:-1], strict=True):
        shape[axis] = n
    return RowVectors(np.broadcast_to(value.vectors.reshape(shape), aval.shape[:-1]), aval.shape, aval.dtype)


@rule("tile")
def tile(b, eqn, value):
    if isinstance(value, np.ndarray) and b.is_small(eqn.outvars[0].aval.shape):
        return np.tile(value, eqn.params["reps"])
    shape = value.shape
    where = lambda indices: [_remainder(b, i, n) for i, n in zip(indices, shape, strict=True)]  # noqa: E731
    return moved(b, eqn.outvars[0].aval, b.at_hand(value), where)


def _remainder(b: Lowering, index, n: int):
    return a.remainder(b, INDEX, index, n)


@rule("reshape", "squeeze", "expand_dims")
def reshape(b, eqn, value, *lengths):
    aval = eqn.outvars[0].aval
    if eqn.primitive.name == "reshape" and (order := eqn.params["dimensions"]) is not None:
        value = permuted(b, value, order, aval.dtype)
    if isinstance(value, np.ndarray):
        return value.reshape(aval.shape)
    if isinstance(value, Lazy) and value.buffer is None:
        kept = [axis for axis, n in enumerate(value.shape) if n != 1]
        new = [axis for axis, n in enumerate(aval.shape) if n != 1]
        if [value.shape[axis] for axis in kept] == [aval.shape[axis] for axis in new]:  # axes of length 1 come or go
            to = dict(zip(kept, new, strict=True))
            ndim = len(value.shape)
            return moved(b, aval, value, lambda i: [i[to[axis]] if axis in to else 0 for axis in range(ndim)])
    return Buffer(b.in_memory(value).memory, aval.shape, aval.dtype)


@in_rows("reshape", "squeeze", "expand_dims")
def _(b, eqn, value, *lengths):
    aval = eqn.outvars[0].aval
    gone = {axis % len(value.shape) for axis in eqn.params.get("dimensions") or ()}
    squeezed = eqn.primitive.name == "squeeze" and len(value.shape) - 1 in gone
    turned = eqn.primitive.name == "reshape" and eqn.params["dimensions"] is not None
    if squeezed or turned or not aval.shape or aval.shape[-1] != value.shape[-1]:
        return None
    return RowVectors(value.vectors.reshape(aval.shape[:-1]), aval.shape, aval.dtype)


@rule("slice")
def slice_(b, eqn, value):
    starts, ends = eqn.params["start_indices"], eqn.params["limit_indices"]
    steps = eqn.params["strides"] or (1,) * len(starts)
    if isinstance(value, np.ndarray):
        return value[tuple(map(slice, starts, ends, steps))]

    def where(indices):
        return [
            b.index_sum(b.index_times(i, step), start) for i, step, start in zip(indices, steps, starts, strict=True)
        ]

    return moved(b, eqn.outvars[0].aval, value, where, starts[0] if steps[0] == 1 else None)


@in_rows("slice")
def _(b, eqn, value):
    aval, starts, ends = eqn.outvars[0].aval, eqn.params["start_indices"], eqn.params["limit_indices"]
    if aval.shape[-1] != value.shape[-1]:
        return None
    steps = eqn.params["strides"] or (1,) * len(starts)
    part = tuple(map(slice, starts[:-1], ends[:-1], steps[:-1]))
    return RowVectors(value.vectors[part], aval.shape, aval.dtype)


@rule("transpose")
def transpose(b, eqn, value):
    return permuted(b, value, eqn.params["permutation"], eqn.outvars[0].aval.dtype)


def permuted(b: Lowering, value: Value, order, dtype) -> Value:
    """An array with its axes permuted to this order."""
    if isinstance(value, np.ndarray):
        return value.transpose(order)
    aval = jax.ShapeDtypeStruct(tuple(value.shape[axis] for axis in order), dtype)
    return moved(b, aval, value, lambda i: [i[order.index(axis)] for axis in range(len(order))])


@in_rows("transpose")
def _(b, eqn, value):
    order, aval = eqn.params["permutation"], eqn.outvars[0].aval
    if order[-1] != len(order) - 1:
        return None
    return RowVectors(value.vectors.transpose(order[:-1]), aval.shape, aval.dtype)


@rule("rev")
def reverse(b, eqn, value):
    axes, shape = eqn.params["dimensions"], value.shape
    if isinstance(value, np.ndarray):
        return np.flip(value, axes)

    def where(indices):
        return [b.index_sum(shape[k] - 1, b.index_times(i, -1)) if k in axes else i for k, i in enumerate(indices)]

    return moved(b, eqn.outvars[0].aval, value, where)


@rule("concatenate")
def concatenate(b, eqn, *values):
    return joined(b, eqn.outvars[0].aval, values, eqn.params["dimension"])


def joined(b: Lowering, aval, values, axis: int) -> Value:
    """The concatenation of arrays along an axis."""
    if b.is_small(aval.shape):
        return np.concatenate([b.entries(value) for value in values], axis)
    firsts = [0, *np.cumsum([value.shape[axis] for value in values]).tolist()]
    if axis == 0 and all(map(is_cheap, values)):
        inner = [[first + seam for seam in seams_of(value)] for value, first in zip(values, firsts[:-1], strict=True)]
        seams = within(united([firsts, *inner]), 0, aval.shape[0])
        if len(seams) <= MOST_SEAMS:
            return _in_pieces(b, aval, values, firsts, seams)
    found, ndim = b.new_buffer(aval.shape, aval.dtype), len(aval.shape)
    corners = [[first if k == axis else 0 for k in range(ndim)] for first in firsts[:-1]]
    b.write_parts(found, list(zip(values, corners, strict=True)))
    return found


def _in_pieces(b: Lowering, aval, values, firsts: list[int], seams: Seams) -> Lazy:
    """A concatenation along the first axis that is not written to memory: each element is read in its piece."""
    pieces = [
        (b.readable(value, aval.dtype, cut=True), first, end)
        for value, first, end in zip(values, firsts[:-1], firsts[1:], strict=True)
        if first < end
    ]

    def read(piece, first, i, rest):
        return b.element_at(piece, [b.index_sum(i, -first), *rest], aval.dtype)

    def at(indices):
        i, *rest = indices
        for piece, first, end in pieces:
            if b.spans.inside(i, first, end):
                return read(piece, first, i, rest)
        found = None  # a loop that is not cut at the seams: of all pieces, each at an index of its own
        for piece, first, end in pieces:
            inside = a.minimum(b, INDEX, a.maximum(b, INDEX, i, first), end - 1)
            entry, here = read(piece, first, inside, rest), a.compare(b, INDEX, "ge", i, first)
            found = entry if found is None else b.select(here, llvm_type(aval.dtype), entry, found)
        return found

    found = b.lazy(aval.shape, aval.dtype, at, [piece for piece, *_ in pieces], cheap=True)
    found.seams = seams
    return found


@rule("stack")
def stack(b, eqn, *values):
    aval, axis = eqn.outvars[0].aval, eqn.params["axis"]
    if b.is_small(aval.shape):
        return np.stack([b.entries(value) for value in values], axis)
    found, ndim = b.new_buffer(aval.shape, aval.dtype), len(aval.shape)
    corners = [[place if k == axis else 0 for k in range(ndim)] for place in range(len(values))]
    b.write_parts(found, [(with_axis(b, value, axis), corner) for value, corner in zip(values, corners, strict=True)])
    return found


def with_axis(b: Lowering, value: Value, axis: int) -> Value:
    """A value with an additional axis of length 1; it must be written immediately, because it counts no uses."""
    if b.is_small(value.shape):
        return np.expand_dims(b.entries(value), axis)
    if axis == 0 and seams_of(value):
        value = b.in_memory(value)
    assert isinstance(value, Lazy | Buffer)
    shape = (*value.shape[:axis], 1, *value.shape[axis:])
    found = Lazy(shape, value.dtype, lambda i: b.element_at(value, [*i[:axis], *i[axis + 1 :]]))
    found.seams = seams_of(value)
    return found


@in_rows("concatenate", "stack")
def _(b, eqn, *values):
    aval, stacks = eqn.outvars[0].aval, eqn.primitive.name == "stack"
    axis = eqn.params["axis" if stacks else "dimension"]
    if axis == len(aval.shape) - 1 or not b.is_small(aval.shape):
        return None
    parts = [b.rows(value, aval.dtype).vectors for value in values]
    return RowVectors(np.stack(parts, axis) if stacks else np.concatenate(parts, axis), aval.shape, aval.dtype)


@rule("split")
def split(b, eqn, value):
    axis, at, found = eqn.params["axis"], 0, []
    for n, variable in zip(eqn.params["sizes"], eqn.outvars, strict=True):
        found.append(_piece(b, variable.aval, value, axis, at))
        at += n
    return found


def _piece(b, aval, value, axis, at):
    return moved(b, aval, value, lambda i: [b.index_sum(x, at) if k == axis else x for k, x in enumerate(i)])


@rule("unstack")
def unstack(b, eqn, value):
    axis = eqn.params["axis"]
    return [
        moved(b, variable.aval, value, lambda i, place=place: [*i[:axis], place, *i[axis:]])
        for place, variable in enumerate(eqn.outvars)
    ]


@in_rows("split", "unstack")
def _(b, eqn, value):
    axis, at, found = eqn.params["axis"], 0, []
    if axis == len(value.shape) - 1:
        return None
    for variable in eqn.outvars:
        shape = variable.aval.shape
        if eqn.primitive.name == "split":
            part = value.vectors.take(range(at, at + shape[axis]), axis)
            at += shape[axis]
        else:
            part = filled(shape[:-1], np.asarray(value.vectors.take(at, axis), object).ravel().tolist())
            at += 1
        found.append(RowVectors(part, shape, value.dtype))
    return found


@rule("pad")
def pad(b, eqn, value, filling):
    aval, config, fill = eqn.outvars[0].aval, eqn.params["padding_config"], b.entry_of(filling)
    shape = value.shape
    if b.is_small(aval.shape):
        value = b.entries(value)
        found = filled(aval.shape, [fill] * size(aval.shape))
        for i in np.ndindex(shape):
            to = tuple(low + x * (inside + 1) for x, (low, _, inside) in zip(i, config, strict=True))
            if all(0 <= x < n for x, n in zip(to, aval.shape, strict=True)):
                found[to] = value[i]
        return found
    value = b.readable(value, aval.dtype)
    found = b.new_buffer(aval.shape, aval.dtype)
    b.for_each_index(aval.shape, lambda i: b.store_element(found, i, fill))
    # For each axis the part of `value` inside the result: `count` entries from `first` on.
    parts = []
    for (low, _, inside), n, m in zip(config, shape, aval.shape, strict=True):
        step = inside + 1
        first = max(0, -(low // step))
        last = min(n - 1, (m - 1 - low) // step)
        parts.append((first, max(0, last - first + 1), low, step))

    def put(i):
        source = [b.index_sum(x, first) for x, (first, *_) in zip(i, parts, strict=True)]
        to = [b.index_sum(b.index_times(x, step), low) for x, (*_, low, step) in zip(source, parts, strict=True)]
        b.store_element(found, to, b.element_at(value, source, aval.dtype))

    b.for_each_index([count for _, count, *_ in parts], put)
    return found


@in_rows("pad")
def _(b, eqn, value, filling):
    aval, config = eqn.outvars[0].aval, eqn.params["padding_config"]
    plain = isinstance(value, RowVectors) and config[-1] == (0, 0, 0) and b.is_small(aval.shape)
    if not plain or any(inside or low < 0 or high < 0 for low, high, inside in config):
        return None
    found = filled(aval.shape[:-1], [b.entry_of(filling)] * size(aval.shape[:-1]))
    inside = (slice(low, low + n) for (low, *_), n in zip(config[:-1], value.shape, strict=False))
    found[(*inside, ...)] = value.vectors  # without "..." the array of one vector would become an entry of an array
    return RowVectors(found, aval.shape, aval.dtype)


@rule("iota")
def iota(b, eqn, *lengths):
    axis, aval = eqn.params["dimension"], eqn.outvars[0].aval
    if b.is_small(aval.shape):
        numbers = np.arange(aval.shape[axis]).astype(aval.dtype).tolist()
        return filled(aval.shape, [numbers[i[axis]] for i in np.ndindex(aval.shape)])
    return b.lazy(aval.shape, aval.dtype, lambda i: a.converted(b, INDEX, i[axis], aval.dtype), [], cheap=True)


@rule("empty", "empty2")
def empty(b, eqn):
    """An array that is written before it is read; here zeros."""
    aval = eqn.outvars[0].aval
    if b.is_small(aval.shape):
        return filled(aval.shape, [a.zero(aval.dtype)] * size(aval.shape))
    return b.lazy(aval.shape, aval.dtype, lambda i: a.zero(aval.dtype), [], cheap=True)


@rule("optimization_barrier", "device_put")
def unchanged(b, eqn, *values):
    return list(values)


KEEPS_ROWS.add("optimization_barrier")
KEEPS_SEAMS.update(("broadcast_in_dim", "concatenate", "optimization_barrier", "slice", "stack"))
