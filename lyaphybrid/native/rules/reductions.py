"""Rules for sums, products, extrema and their indices along axes; for cumulative ones; and for matrix products."""

import functools
from collections.abc import Callable

import numpy as np

from ..elementary import arithmetic as a
from ..lowering.lowering import in_rows, rule
from ..lowering.types import INDEX, kind, llvm_type
from ..lowering.values import Lazy, RowVectors, filled, scalar, size

SIDE_BY_SIDE = 4  # independent partial sums of a long sum; a power of two

_IN_ANY_ORDER = "max", "min", "and", "or", "xor"  # the result does not depend on the order

# name: (function of two entries, its neutral element)
_FOLDS: dict[str, tuple[Callable, Callable]] = {
    "sum": (a.add, a.zero),
    "prod": (a.multiply, lambda dtype: a.folded(dtype, lambda x: x, 1)),
    "max": (a.maximum, a.least),
    "min": (a.minimum, a.greatest),
    "and": (lambda b, dtype, x, y: _bits(b, dtype, "and", x, y), lambda dtype: True if kind(dtype) == "b" else -1),
    "or": (lambda b, dtype, x, y: _bits(b, dtype, "or", x, y), a.zero),
    "xor": (lambda b, dtype, x, y: _bits(b, dtype, "xor", x, y), a.zero),
}


def _bits(b, dtype, operation, x, y):
    if kind(dtype) == "b":
        return b.logic(operation, x, y)
    return b.binary(operation, llvm_type(dtype), x, y, commutes=True)


@rule(*(f"reduce_{name}" for name in _FOLDS))
def reduce(b, eqn, value):
    name = eqn.primitive.name.removeprefix("reduce_")
    fold, neutral = _FOLDS[name]
    aval, dtype, axes, shape = eqn.outvars[0].aval, eqn.invars[0].aval.dtype, eqn.params["axes"], value.shape
    kept = [axis for axis in range(len(shape)) if axis not in axes]
    over = [shape[axis] for axis in axes]
    if isinstance(value, np.ndarray):
        groups = value.transpose(*kept, *axes).reshape(*aval.shape, size(over))
        return filled(aval.shape, [_folded(b, name, dtype, groups[i]) for i in np.ndindex(aval.shape)])

    def source(indices, inner):
        found = [0] * len(shape)
        for axis, i in zip((*kept, *axes), (*indices, *inner), strict=True):
            found[axis] = i
        return found

    if 0 in over or size(over) == 0:
        result = b.new_buffer(aval.shape, aval.dtype)
        b.for_each_index(aval.shape, lambda i: b.store_element(result, i, neutral(dtype)))
        return b.held(result)
    if kept and kept[-1] == len(shape) - 1:  # add whole rows: the last axis is the innermost loop, which vectorises
        result = b.new_buffer(aval.shape, aval.dtype)
        b.for_each_index(aval.shape, lambda i: b.store_element(result, i, neutral(dtype)))

        def take_in(i):
            inner, outer = i[: len(over)], i[len(over) :]
            old = b.load_element(result, outer)
            b.store_element(result, outer, fold(b, dtype, old, b.element_at(value, source(outer, inner))))

        b.for_each_index([*over, *aval.shape], take_in)
        return b.held(result)

    def total(indices):
        def take_in(inner, so_far):
            return fold(b, dtype, so_far, b.element_at(value, source(indices, inner)))

        return _total(b, over, take_in, lambda x, y: fold(b, dtype, x, y), (neutral(dtype), llvm_type(dtype)))

    if not aval.shape:
        return scalar(total([]))
    result = b.new_buffer(aval.shape, aval.dtype)
    b.for_each_index(aval.shape, lambda i: b.store_element(result, i, total(i)))
    return b.held(result)


def _total(b, over, take_in, together, start):
    """A reduction over all indices; along the last axis by independent partial results, which run in parallel."""
    *outer, last = over
    if last < 2 * SIDE_BY_SIDE:
        return b.fold_indices(over, lambda inner, so_far: [take_in(inner, so_far[0])], [start])[0]
    turns = last // SIDE_BY_SIDE

    def several(inner, so_far):
        first = b.index_times(inner[-1], SIDE_BY_SIDE)
        return [take_in([*inner[:-1], b.index_sum(first, k)], sum_) for k, sum_ in enumerate(so_far)]

    sums = b.fold_indices([*outer, turns], several, [start] * SIDE_BY_SIDE)
    if rest := last - turns * SIDE_BY_SIDE:

        def what_is_left(inner, so_far):
            return [take_in([*inner, turns * SIDE_BY_SIDE + k], sum_) for k, sum_ in enumerate(so_far)]

        sums[:rest] = b.fold_indices(outer, what_is_left, [(sum_, start[1]) for sum_ in sums[:rest]])
    while len(sums) > 1:
        sums = [together(*pair) for pair in zip(sums[::2], sums[1::2], strict=True)]
    return sums[0]


def _folded(b, name, dtype, entries):
    fold, neutral = _FOLDS[name]
    entries = entries.ravel().tolist()
    if not entries:
        return neutral(dtype)
    while name in _IN_ANY_ORDER and len(entries) > 2:  # in pairs: less waiting for one another
        pairs = zip(entries[::2], entries[1::2], strict=False)
        entries = [fold(b, dtype, *pair) for pair in pairs] + entries[len(entries) // 2 * 2 :]
    return functools.reduce(functools.partial(fold, b, dtype), entries)


@in_rows("reduce_sum", "reduce_prod", "reduce_max", "reduce_min")
def _(b, eqn, value):
    name = eqn.primitive.name.removeprefix("reduce_")
    axes, aval = eqn.params["axes"], eqn.outvars[0].aval
    last = len(value.shape) - 1
    if last in axes:
        return None
    kept = [axis for axis in range(last) if axis not in axes]
    lead = aval.shape[:-1]
    groups = value.vectors.transpose(*kept, *axes).reshape(*lead, size([value.shape[axis] for axis in axes]))
    vectors = filled(lead, [_folded(b, name, value.dtype, groups[i]) for i in np.ndindex(lead)])
    return RowVectors(vectors, aval.shape, aval.dtype)


@rule("argmax", "argmin")
def arg_extremum(b, eqn, value):
    """The first index of the extremum, or of the first nan if there is one."""
    (axis,), aval, dtype = eqn.params["axes"], eqn.outvars[0].aval, eqn.invars[0].aval.dtype
    relation, type_, n = ("gt" if eqn.primitive.name == "argmax" else "lt"), llvm_type(dtype), value.shape[axis]

    def better(entry, best):
        found = a.compare(b, dtype, relation, entry, best)
        if kind(dtype) != "f":
            return found
        first_nan = b.logic("and", a.is_nan(b, dtype, entry), b.negation(a.is_nan(b, dtype, best)))
        return b.logic("or", first_nan, b.logic("and", found, b.negation(a.is_nan(b, dtype, best))))

    def taken(entry, place, best, best_place):
        wins = better(entry, best)
        return b.select(wins, type_, entry, best), b.select(wins, "i64", place, best_place)

    def source(indices, i):
        return [*indices[:axis], i, *indices[axis:]]

    if isinstance(value, np.ndarray):

        def one(indices):
            best, place = value[tuple(source(indices, 0))], 0
            for i in range(1, n):
                best, place = taken(value[tuple(source(indices, i))], i, best, place)
            return a.converted(b, INDEX, place, aval.dtype)

        return filled(aval.shape, [one(i) for i in np.ndindex(aval.shape)])
    value = b.in_memory(value)

    def searched(indices):
        def step(i, carried):
            return taken(b.load_element(value, source(indices, i)), i, *carried)

        start = [(b.load_element(value, source(indices, 0)), type_), (0, "i64")]
        return a.converted(b, INDEX, b.count_up(n, step, start)[1], aval.dtype)

    if not aval.shape:
        return scalar(searched([]))
    result = b.new_buffer(aval.shape, aval.dtype)
    b.for_each_index(aval.shape, lambda i: b.store_element(result, i, searched(i)))
    return b.held(result)


_CUMULATIVE = {"cumsum": a.add, "cumprod": a.multiply, "cummax": a.maximum, "cummin": a.minimum}


@rule(*_CUMULATIVE)
def cumulative(b, eqn, value):
    fold, axis, reverse = _CUMULATIVE[eqn.primitive.name], eqn.params["axis"], eqn.params["reverse"]
    aval, dtype, n = eqn.outvars[0].aval, eqn.invars[0].aval.dtype, value.shape[axis]
    if isinstance(value, np.ndarray):
        found = np.array(value)
        lanes = np.moveaxis(found, axis, 0)[:: -1 if reverse else 1]  # a view
        for i in range(1, n):
            for j in np.ndindex(lanes.shape[1:]):
                lanes[(i, *j)] = fold(b, dtype, lanes[(i - 1, *j)], lanes[(i, *j)])
        return found
    result = b.new_buffer(aval.shape, aval.dtype)
    b.write(result, value, [0] * len(aval.shape))

    def one(i):
        step, rest = i[0], i[1:]
        now = b.index_sum(n - 2, b.index_times(step, -1)) if reverse else b.index_sum(step, 1)
        before = b.index_sum(now, 1 if reverse else -1)
        here, there = ([*rest[:axis], x, *rest[axis:]] for x in (now, before))
        b.store_element(result, here, fold(b, dtype, b.load_element(result, there), b.load_element(result, here)))

    if n > 1:
        b.for_each_index([n - 1, *(m for k, m in enumerate(aval.shape) if k != axis)], one)
    return result


# --- products of matrices --------------------------------------------------------------------------------------------


@rule("dot_general")
def dot(b, eqn, left, right):
    (left_over, right_over), (left_batch, right_batch) = eqn.params["dimension_numbers"]
    aval, dtype = eqn.outvars[0].aval, eqn.outvars[0].aval.dtype
    dtypes = [atom.aval.dtype for atom in eqn.invars]
    left_free = [k for k in range(len(left.shape)) if k not in (*left_over, *left_batch)]
    right_free = [k for k in range(len(right.shape)) if k not in (*right_over, *right_batch)]
    over = [left.shape[k] for k in left_over]

    def places(indices, inner):
        batch, rest = indices[: len(left_batch)], indices[len(left_batch) :]
        in_left, in_right = [0] * len(left.shape), [0] * len(right.shape)
        for axes, found, values in (
            (left_batch, in_left, batch), (right_batch, in_right, batch), (left_over, in_left, inner),
            (right_over, in_right, inner), (left_free, in_left, rest[: len(left_free)]),
            (right_free, in_right, rest[len(left_free) :]),
        ):  # fmt: skip
            for axis, i in zip(axes, values, strict=True):
                found[axis] = i
        return in_left, in_right

    def term(indices, inner):
        in_left, in_right = places(list(indices), list(inner))
        x, y = b.element_at(left, in_left, dtypes[0]), b.element_at(right, in_right, dtypes[1])
        return a.multiply(b, dtype, a.converted(b, dtypes[0], x, dtype), a.converted(b, dtypes[1], y, dtype))

    if isinstance(left, np.ndarray) and isinstance(right, np.ndarray) and b.is_small(aval.shape):

        def entry(indices):
            found = None
            for inner in np.ndindex(*over):
                found = term(indices, inner) if found is None else a.add(b, dtype, found, term(indices, inner))
            return a.zero(dtype) if found is None else found

        return filled(aval.shape, [entry(i) for i in np.ndindex(aval.shape)])
    left, right = b.in_memory(left, dtypes[0]), b.in_memory(right, dtypes[1])
    result = b.new_buffer(aval.shape, dtype)
    b.for_each_index(aval.shape, lambda i: b.store_element(result, i, a.zero(dtype)))
    if 0 in over:
        return b.held(result)
    outer, n = list(aval.shape[:-1]), len(aval.shape[:-1])

    def step(i):  # the last axis of the result is the innermost loop, which vectorises
        inner, indices = i[n : n + len(over)], [*i[:n], *i[n + len(over) :]]
        b.store_element(result, indices, a.add(b, dtype, b.load_element(result, indices), term(indices, inner)))

    b.for_each_index([*outer, *over, *aval.shape[n:]], step)
    return b.held(result)


@in_rows("dot_general")
def _(b, eqn, left, right):
    (left_over, right_over), (left_batch, _) = eqn.params["dimension_numbers"]
    aval = eqn.outvars[0].aval
    if left_batch or not aval.shape or not b.is_small(aval.shape):
        return None
    if any(atom.aval.dtype != aval.dtype for atom in eqn.invars):
        return None
    if any(isinstance(value, Lazy) or not isinstance(value, np.ndarray | RowVectors) for value in (left, right)):
        return None
    left_free = [k for k in range(len(left.shape)) if k not in left_over]
    right_free = [k for k in range(len(right.shape)) if k not in right_over]
    if right_free and isinstance(right, RowVectors) and right_free[-1] == len(right.shape) - 1:
        x = b.entries(left).transpose(*left_free, *left_over).reshape(*(left.shape[k] for k in left_free), -1)
        free = [right.shape[k] for k in right_free[:-1]]
        y = right.vectors.transpose(*right_over, *right_free[:-1]).reshape(-1, *free)
    elif not right_free and isinstance(left, RowVectors) and left_free[-1] == len(left.shape) - 1:
        y = b.entries(right).transpose(*right_over).reshape(-1)
        free = [left.shape[k] for k in left_free[:-1]]
        x = left.vectors.transpose(*left_free[:-1], *left_over).reshape(*free, -1)
    else:
        return None
    lead, found = aval.shape[:-1], []
    for i in np.ndindex(lead):
        total, xs, ys = None, x[i[: x.ndim - 1]], y[(slice(None), *i[x.ndim - 1 :])]
        for p, q in zip(xs, ys, strict=True):
            product = a.multiply(b, aval.dtype, p, q)
            total = product if total is None else a.add(b, aval.dtype, total, product)
        found.append(a.zero(aval.dtype) if total is None else total)
    return RowVectors(filled(lead, found), aval.shape, aval.dtype)
