"""Linear functions in double-double arithmetic: each number is an unevaluated sum of two floating-point numbers.

Sums and products of pairs: T. J. Dekker, A floating-point technique for extending the available precision, Numer. Math.
18 (1971) 224, doi:10.1007/BF01397083.

The numbers in the function are rounded themselves. To see how much of a result that decides, each factor can be changed
by some units in the last place. A small result that changes little is small by the structure of the function; a result
that changes by as much as its own size is rounding.
"""

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from .jaxprs import MOVING, applied, evaluated
from .precision import eps

__all__ = ["DoubleDouble", "UnknownError", "added", "changed", "divided", "multiplied", "negated", "precise", "total"]

CHANGE = 4  # change of factors, in units of eps
ON_BOTH_PARTS = MOVING | {"copy", "neg"}  # primitives that are applied to both parts separately


class DoubleDouble(NamedTuple):
    """The sum of two arrays; the second is at most the rounding error of the first."""

    high: Array
    low: Array


class UnknownError(ValueError):
    """The function uses other operations than sums and products."""


def _sum(a, b) -> DoubleDouble:
    s = a + b
    back = s - a
    return DoubleDouble(s, (a - (s - back)) + (b - back))


@jax.custom_jvp
def _leading_half(a):
    """The number truncated to the first half of its digits."""
    whole = jnp.int64 if a.dtype == jnp.float64 else jnp.int32
    last = (2 - math.frexp(eps(a))[1] + 1) // 2
    bits = lax.bitcast_convert_type(a, whole) & jnp.asarray(-(1 << last), whole)
    return lax.bitcast_convert_type(bits, a.dtype)


@_leading_half.defjvp
def _same(a, da):
    return _leading_half(*a), *da


def _product(a, b) -> DoubleDouble:
    """The product from halves, whose products are exact, so that the compiler may fuse products and sums freely."""
    a1, b1 = _leading_half(a), _leading_half(b)
    a2, b2 = a - a1, b - b1
    s, e = _sum(a1 * b1, a1 * b2)
    s, f = _sum(s, a2 * b1)
    return _renormalised(s, (e + f) + a2 * b2)


def _renormalised(high, low) -> DoubleDouble:
    s = high + low
    return DoubleDouble(s, low - (s - high))


def added(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """The sum."""
    (s, e), (t, f) = _sum(a.high, b.high), _sum(a.low, b.low)
    s, e = _renormalised(s, e + t)
    return _renormalised(s, e + f)


def negated(a: DoubleDouble) -> DoubleDouble:
    """The number with the other sign."""
    return DoubleDouble(-a.high, -a.low)


def multiplied(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """The product."""
    p, e = _product(a.high, b.high)
    return _renormalised(p, e + (a.high * b.low + a.low * b.high))


def divided(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    """The quotient."""
    q = a.high / b.high
    rest = added(a, negated(multiplied(b, DoubleDouble(q, jnp.zeros_like(q)))))
    return _renormalised(q, rest.high / b.high)


def total(a: DoubleDouble, axis: int) -> DoubleDouble:
    """The sum along an axis."""
    high, low = jnp.moveaxis(a.high, axis, 0), jnp.moveaxis(a.low, axis, 0)
    nothing = jnp.zeros_like(high[0])
    return lax.fori_loop(
        0, len(high), lambda i, s: added(s, DoubleDouble(high[i], low[i])), DoubleDouble(nothing, nothing)
    )


def changed(value, seed, number: int = 0) -> DoubleDouble:
    """The entries, each changed by some units in its last place that depend on the seed and a number; 0: unchanged."""
    places = jnp.arange(value.size, dtype=value.dtype).reshape(value.shape)
    share = jnp.where(seed == 0, 0.0, CHANGE * eps(value)) * jnp.sin((places + 1.7) * seed + number)
    return DoubleDouble(value, value * share)


def precise(function: Callable) -> Callable:
    """A linear function of arrays (n,) as a function of pairs, (dx, seed) -> pair; seed 0 changes no factor.

    Raises `UnknownError`, while tracing, if the function uses other operations than sums and products.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from lyaphybrid._jax.double_double import DoubleDouble, precise
        >>> with jax.enable_x64(True):
        ...     dx = DoubleDouble(jnp.array([1.0, 1e-20]), jnp.zeros(2))
        ...     found = precise(lambda dx: (dx[0] + dx[1]) - dx[:1])(dx, jnp.array(0.0))
        ...     print(found.high)
        [1.e-20]
    """

    def in_pairs(dx: DoubleDouble, seed) -> DoubleDouble:
        count = itertools.count(1)

        def factor(value) -> DoubleDouble:
            return changed(value, seed, next(count))

        def through(closed: ClosedJaxpr, inputs: list) -> list:
            return evaluated(
                closed, inputs, lambda closed, eqn, operands: _through(closed, eqn, operands, through, factor)
            )

        return _pair(through(jax.make_jaxpr(function)(dx.high), [dx])[0])

    return in_pairs


def _pair(value) -> DoubleDouble:
    return value if isinstance(value, DoubleDouble) else DoubleDouble(value, jnp.zeros_like(value))


def _through(closed: ClosedJaxpr, eqn, operands: list, through, factor) -> list:
    if not any(isinstance(one, DoubleDouble) for one in operands):
        return applied(closed, eqn, operands)
    name, first = eqn.primitive.name, operands[0]
    if name in ("jit", "pjit"):
        return through(eqn.params["jaxpr"], operands)
    if name == "cond" and not isinstance(first, DoubleDouble):
        branches = [lambda rest, one=one: list(map(_pair, through(one, rest))) for one in eqn.params["branches"]]
        return lax.switch(first, branches, operands[1:])
    pairs = [isinstance(one, DoubleDouble) for one in operands]
    if (name in ("mul", "dot_general") and sum(pairs) == 1) or (name == "div" and pairs == [True, False]):
        left, right = [one if isinstance(one, DoubleDouble) else factor(one) for one in operands]
        if name == "dot_general":
            return [_dot(eqn, left, right)]
        return [(multiplied if name == "mul" else divided)(*_alike(left, right))]
    if name in ("add", "add_any", "sub"):
        left, right = _alike(*map(_pair, operands))
        return [added(left, negated(right) if name == "sub" else right)]
    if name == "reduce_sum":
        for axis in sorted(eqn.params["axes"], reverse=True):
            first = total(first, axis)
        return [first]
    if name in ON_BOTH_PARTS and not (name == "select_n" and isinstance(first, DoubleDouble)):
        found = [applied(closed, eqn, [_part(one, i) for one in operands]) for i in range(2)]
        return list(map(DoubleDouble, *found))
    raise UnknownError(name)


def _part(value, i: int):
    """Part i of a pair; other floating-point values have a low part of zero, and indices are returned unchanged."""
    if isinstance(value, DoubleDouble):
        return value[i]
    return jnp.zeros_like(value) if i and jnp.issubdtype(value.dtype, jnp.floating) else value


def _alike(left: DoubleDouble, right: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    shape = jnp.broadcast_shapes(left.high.shape, right.high.shape)

    def wide(pair: DoubleDouble) -> DoubleDouble:
        return DoubleDouble(*(jnp.broadcast_to(one, shape) for one in pair))

    return wide(left), wide(right)


def _dot(eqn, left: DoubleDouble, right: DoubleDouble) -> DoubleDouble:
    """All products in an array with batch axes first and the contracted axis last; then the sum over that axis."""
    (over_left, over_right), (batch_left, batch_right) = eqn.params["dimension_numbers"]

    def arranged(array, over, batch):
        free = [axis for axis in range(array.ndim) if axis not in (*over, *batch)]
        array = jnp.transpose(array, (*batch, *free, *over))
        shape = array.shape[: len(batch)], array.shape[len(batch) : len(batch) + len(free)]
        return array, *shape, array.size // math.prod((*shape[0], *shape[1]))

    def spread(pair: DoubleDouble, over, batch, before: int, behind: int) -> DoubleDouble:
        def one(part):
            part, batches, free, size = arranged(part, over, batch)
            return part.reshape(*batches, *(1,) * before, *free, *(1,) * behind, size)

        return DoubleDouble(*map(one, pair))

    free_left = left.high.ndim - len(over_left) - len(batch_left)
    free_right = right.high.ndim - len(over_right) - len(batch_right)
    products = multiplied(
        *_alike(
            spread(left, over_left, batch_left, 0, free_right), spread(right, over_right, batch_right, free_left, 0)
        )
    )
    return total(products, -1)
