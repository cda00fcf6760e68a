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

__all__ = ["Pair", "UnknownError", "added", "divided", "multiplied", "negated", "precise", "total"]

CHANGE = 4  # change of factors, in units of eps
OF_BOTH = MOVING | {"copy", "neg"}  # primitives that are applied to both parts separately


class Pair(NamedTuple):
    """The sum of two arrays; the second is at most the rounding error of the first."""

    high: Array
    low: Array


class UnknownError(ValueError):
    """The function uses other operations than sums and products."""


def _sum(a, b) -> Pair:
    s = a + b
    back = s - a
    return Pair(s, (a - (s - back)) + (b - back))


@jax.custom_jvp
def _head(a):
    """The number truncated to the first half of its digits."""
    whole = jnp.int64 if a.dtype == jnp.float64 else jnp.int32
    last = (2 - math.frexp(eps(a))[1] + 1) // 2
    bits = lax.bitcast_convert_type(a, whole) & jnp.asarray(-(1 << last), whole)
    return lax.bitcast_convert_type(bits, a.dtype)


@_head.defjvp
def _same(a, da):
    return _head(*a), *da


def _product(a, b) -> Pair:
    """The product from halves, whose products are exact, so that the compiler may fuse products and sums freely."""
    a1, b1 = _head(a), _head(b)
    a2, b2 = a - a1, b - b1
    s, e = _sum(a1 * b1, a1 * b2)
    s, f = _sum(s, a2 * b1)
    return _tidy(s, (e + f) + a2 * b2)


def _tidy(high, low) -> Pair:
    s = high + low
    return Pair(s, low - (s - high))


def added(a: Pair, b: Pair) -> Pair:
    """The sum."""
    (s, e), (t, f) = _sum(a.high, b.high), _sum(a.low, b.low)
    s, e = _tidy(s, e + t)
    return _tidy(s, e + f)


def negated(a: Pair) -> Pair:
    """The number with the other sign."""
    return Pair(-a.high, -a.low)


def multiplied(a: Pair, b: Pair) -> Pair:
    """The product."""
    p, e = _product(a.high, b.high)
    return _tidy(p, e + (a.high * b.low + a.low * b.high))


def divided(a: Pair, b: Pair) -> Pair:
    """The quotient."""
    q = a.high / b.high
    rest = added(a, negated(multiplied(b, Pair(q, jnp.zeros_like(q)))))
    return _tidy(q, rest.high / b.high)


def total(a: Pair, axis: int) -> Pair:
    """The sum along an axis."""
    high, low = jnp.moveaxis(a.high, axis, 0), jnp.moveaxis(a.low, axis, 0)
    nothing = jnp.zeros_like(high[0])
    return lax.fori_loop(0, len(high), lambda i, s: added(s, Pair(high[i], low[i])), Pair(nothing, nothing))


def precise(function: Callable) -> Callable:
    """A linear function of arrays (n,) as a function of pairs, (dx, seed) -> pair; seed 0 changes no factor.

    Raises `UnknownError`, while tracing, if the function uses other operations than sums and products.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from lyaphybrid._jax.double_double import Pair, precise
        >>> with jax.enable_x64(True):
        ...     dx = Pair(jnp.array([1.0, 1e-20]), jnp.zeros(2))
        ...     found = precise(lambda dx: (dx[0] + dx[1]) - dx[:1])(dx, jnp.array(0.0))
        ...     print(found.high)
        [1.e-20]
    """

    def in_pairs(dx: Pair, seed) -> Pair:
        count = itertools.count(1)

        def factor(value) -> Pair:
            places = jnp.arange(value.size, dtype=value.dtype).reshape(value.shape)
            share = jnp.where(seed == 0, 0.0, CHANGE * eps(value)) * jnp.sin((places + 1.7) * seed + next(count))
            return Pair(value, value * share)

        def through(closed: ClosedJaxpr, inputs: list) -> list:
            return evaluated(
                closed, inputs, lambda closed, eqn, operands: _through(closed, eqn, operands, through, factor)
            )

        return _pair(through(jax.make_jaxpr(function)(dx.high), [dx])[0])

    return in_pairs


def _pair(value) -> Pair:
    return value if isinstance(value, Pair) else Pair(value, jnp.zeros_like(value))


def _through(closed: ClosedJaxpr, eqn, operands: list, through, factor) -> list:
    if not any(isinstance(one, Pair) for one in operands):
        return applied(closed, eqn, operands)
    name, first = eqn.primitive.name, operands[0]
    if name in ("jit", "pjit"):
        return through(eqn.params["jaxpr"], operands)
    if name == "cond" and not isinstance(first, Pair):
        branches = [lambda rest, one=one: list(map(_pair, through(one, rest))) for one in eqn.params["branches"]]
        return lax.switch(first, branches, operands[1:])
    pairs = [isinstance(one, Pair) for one in operands]
    if (name in ("mul", "dot_general") and sum(pairs) == 1) or (name == "div" and pairs == [True, False]):
        left, right = [one if isinstance(one, Pair) else factor(one) for one in operands]
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
    if name in OF_BOTH and not (name == "select_n" and isinstance(first, Pair)):
        found = [applied(closed, eqn, [_part(one, i) for one in operands]) for i in range(2)]
        return list(map(Pair, *found))
    raise UnknownError(name)


def _part(value, i: int):
    """Part i of a pair; other floating-point values have a low part of zero, and indices are returned unchanged."""
    if isinstance(value, Pair):
        return value[i]
    return jnp.zeros_like(value) if i and jnp.issubdtype(value.dtype, jnp.floating) else value


def _alike(left: Pair, right: Pair) -> tuple[Pair, Pair]:
    shape = jnp.broadcast_shapes(left.high.shape, right.high.shape)

    def wide(pair: Pair) -> Pair:
        return Pair(*(jnp.broadcast_to(one, shape) for one in pair))

    return wide(left), wide(right)


def _dot(eqn, left: Pair, right: Pair) -> Pair:
    """All products in an array with batch axes first and the contracted axis last; then the sum over that axis."""
    (over_left, over_right), (batch_left, batch_right) = eqn.params["dimension_numbers"]

    def arranged(array, over, batch):
        free = [axis for axis in range(array.ndim) if axis not in (*over, *batch)]
        array = jnp.transpose(array, (*batch, *free, *over))
        shape = array.shape[: len(batch)], array.shape[len(batch) : len(batch) + len(free)]
        return array, *shape, array.size // math.prod((*shape[0], *shape[1]))

    def spread(pair: Pair, over, batch, before: int, behind: int) -> Pair:
        def one(part):
            part, batches, free, size = arranged(part, over, batch)
            return part.reshape(*batches, *(1,) * before, *free, *(1,) * behind, size)

        return Pair(*map(one, pair))

    free_left = left.high.ndim - len(over_left) - len(batch_left)
    free_right = right.high.ndim - len(over_right) - len(batch_right)
    products = multiplied(
        *_alike(
            spread(left, over_left, batch_left, 0, free_right), spread(right, over_right, batch_right, free_left, 0)
        )
    )
    return total(products, -1)
