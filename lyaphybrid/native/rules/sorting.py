"""Rules for sorting: few entries by unrolled exchanges, many by merge sort."""

import jax
import jax.numpy as jnp
import numpy as np

from ..elementary import arithmetic as a
from ..lowering.emitter import Entry
from ..lowering.expansion import traced
from ..lowering.jax_versions import axis_of_greatest
from ..lowering.lowering import Lowering, rule
from ..lowering.types import kind, llvm_type
from ..lowering.unsupported import UnsupportedError

_FEW_ENTRIES = 16


def _before(b: Lowering, dtype, x: Entry, y: Entry) -> Entry:
    """Whether x comes before y; nan comes last."""
    less = a.compare(b, dtype, "lt", x, y)
    if kind(dtype) != "f":
        return less
    return b.logic("or", less, b.logic("and", a.is_nan(b, dtype, y), b.negation(a.is_nan(b, dtype, x))))


@rule("sort")
def sort(b, eqn, *values):
    """A stable sort of all operands by the first `num_keys` of them."""
    axis, keys, dtypes = eqn.params["dimension"], eqn.params["num_keys"], [atom.aval.dtype for atom in eqn.invars]

    def precedes(xs, ys):  # the first key that differs decides
        found: Entry = False
        for k in reversed(range(keys)):
            tie = b.negation(b.logic("or", _before(b, dtypes[k], xs[k], ys[k]), _before(b, dtypes[k], ys[k], xs[k])))
            found = b.logic("or", _before(b, dtypes[k], xs[k], ys[k]), b.logic("and", tie, found))
        return found

    n = values[0].shape[axis]
    if all(isinstance(value, np.ndarray) for value in values) and n <= _FEW_ENTRIES:
        return _by_exchanges(b, values, axis, dtypes, precedes)
    return _by_merging(b, values, axis, dtypes, precedes)


@rule("top_k")
def top_k(b, eqn, value):
    """The k largest along an axis in decreasing order, and their indices; nan counts as the largest.

    Of equal ones the first comes first, as JAX says, also of -0 and 0: XLA takes 0 for the larger one.
    """
    k, axis = eqn.params["k"], axis_of_greatest(eqn)
    of_places = eqn.outvars[1].aval.dtype

    def greatest(x):
        places = jax.lax.broadcasted_iota(of_places, x.shape, axis)
        backwards = [jax.lax.rev(one, (axis,)) for one in (x, places)]
        found = jax.lax.sort(backwards, dimension=axis, is_stable=True, num_keys=1)
        return [jax.lax.slice_in_dim(jax.lax.rev(one, (axis,)), 0, k, axis=axis) for one in found]

    return b.run(traced(greatest, [eqn.invars[0].aval]), [value])


_IN_TOTAL_ORDER = {"eq_to": jax.lax.eq, "lt_to": jax.lax.lt, "le_to": jax.lax.le}


@rule(*_IN_TOTAL_ORDER)
def in_total_order(b, eqn, x, y):
    """Comparisons of floats by sign and size of their bits: −nan < −∞ < … < −0 < 0 < … < ∞ < nan."""
    relation = _IN_TOTAL_ORDER[eqn.primitive.name]

    def compared(x, y):
        return relation(_place_in_order(x), _place_in_order(y))

    return b.run(traced(compared, [atom.aval for atom in eqn.invars]), [x, y])


def _place_in_order(x):
    """Integers in the order of the floats: of negative ones all bits but the sign are turned round."""
    if not jnp.issubdtype(x.dtype, jnp.floating):
        return x
    integers = np.dtype(f"int{8 * x.dtype.itemsize}")
    bits = jax.lax.bitcast_convert_type(x, integers)
    negative = jax.lax.shift_right_arithmetic(bits, jnp.full_like(bits, 8 * x.dtype.itemsize - 1))
    return bits ^ (negative & np.iinfo(integers).max)


def _by_exchanges(b, values, axis, dtypes, precedes):
    found = [np.moveaxis(np.array(value), axis, -1) for value in values]
    n = found[0].shape[-1]
    for i in np.ndindex(found[0].shape[:-1]):
        for end in range(n - 1, 0, -1):
            for j in range(end):
                low, high = [x[(*i, j)] for x in found], [x[(*i, j + 1)] for x in found]
                exchange = precedes(high, low)
                for x, dtype, p, q in zip(found, dtypes, low, high, strict=True):
                    x[(*i, j)] = b.select(exchange, llvm_type(dtype), q, p)
                    x[(*i, j + 1)] = b.select(exchange, llvm_type(dtype), p, q)
    return [np.moveaxis(x, -1, axis) for x in found]


def _by_merging(b, values, axis, dtypes, precedes):
    """Merge sort: sorted runs of length 1, 2, 4, … are merged, alternately into one of two buffers."""
    shape, n = values[0].shape, values[0].shape[axis]
    if any(kind(dtype) not in "biuf" for dtype in dtypes):
        raise UnsupportedError("sort of this type")
    here = [b.new_buffer(shape, dtype) for dtype in dtypes]
    there = [b.new_buffer(shape, dtype) for dtype in dtypes]
    for buffer, value in zip(here, values, strict=True):
        b.write(buffer, value, [0] * len(shape))
    rest = [m for k, m in enumerate(shape) if k != axis]
    width = 1
    while width < n:

        def merge(i, here=here, there=there, width=width):
            def at(place):
                return [*i[:axis], place, *i[axis:]]

            def load(place):
                return [b.load_element(x, at(place)) for x in here]

            def pair(run, _):
                start = b.index_times(run, 2 * width)
                middle = a.minimum(b, np.int64, b.index_sum(start, width), n)
                end = a.minimum(b, np.int64, b.index_sum(start, 2 * width), n)

                def one(step, carried):
                    left, right = carried
                    place = b.index_sum(start, step)
                    inside = a.compare(b, np.int64, "lt", place, end)
                    # Clamped indices: elements outside of a run are read but not used.
                    xs, ys = load(a.minimum(b, np.int64, left, n - 1)), load(a.minimum(b, np.int64, right, n - 1))
                    has_left = a.compare(b, np.int64, "lt", left, middle)
                    has_right = a.compare(b, np.int64, "lt", right, end)
                    from_right = b.logic("and", has_right, b.logic("or", b.negation(has_left), precedes(ys, xs)))
                    to = at(a.minimum(b, np.int64, place, n - 1))
                    for x, y, buffer, dtype in zip(xs, ys, there, dtypes, strict=True):
                        type_ = llvm_type(dtype)
                        new = b.select(from_right, type_, y, x)
                        b.store_element(buffer, to, b.select(inside, type_, new, b.load_element(buffer, to)))
                    moved_left = b.logic("and", inside, b.negation(from_right))
                    moved_right = b.logic("and", inside, from_right)
                    return [
                        b.select(moved_left, "i64", b.index_sum(left, 1), left),
                        b.select(moved_right, "i64", b.index_sum(right, 1), right),
                    ]

                b.count_up(2 * width, one, [(start, "i64"), (middle, "i64")])

            b.count_up(-(-n // (2 * width)), pair)

        b.for_each_index(rest, merge)
        here, there = there, here
        width *= 2
    return [b.held(buffer) for buffer in here]
