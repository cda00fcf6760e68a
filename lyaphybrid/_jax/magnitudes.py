"""How large the terms are that a linear function adds up: what the rounding of its result is relative to.

A result that is small against its terms is rounding; one that has small terms is small. Where A has the entries a_ij,
|A| has the |a_ij|, and those of the matrices in between where A is their product: |A| |dx| bounds the terms of A dx one
by one, and an entry of A that is zero adds nothing (N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd
ed. (SIAM 2002), section 3.1, doi:10.1137/1.9780898718027).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from .jaxprs import MOVING, applied, evaluated

__all__ = ["UNKNOWN", "absolute"]

UNKNOWN = 1e150  # so large that anything may be rounding; its products are finite


class Size(NamedTuple):
    """The magnitude of what depends on dx."""

    array: Array


def absolute(function: Callable) -> Callable:
    """|A| of a linear function A, both from arrays (n,) to arrays; `UNKNOWN` where it does more than add and multiply.

    Example:
        >>> import jax.numpy as jnp
        >>> from lyaphybrid._jax.magnitudes import absolute
        >>> print(absolute(lambda dx: jnp.stack([dx[0] - dx[1], 3 * dx[1]]))(jnp.array([1.0, 1.0])))
        [2. 3.]
    """

    def magnitude(size):
        (found,) = _through(jax.make_jaxpr(function)(size), [Size(size)])
        return jnp.minimum(found.array if isinstance(found, Size) else jnp.abs(found), _unknown(size.dtype))

    return magnitude


def _through(closed: ClosedJaxpr, inputs: list) -> list:
    return evaluated(closed, inputs, _through_equation)


def _through_equation(closed: ClosedJaxpr, eqn, operands: list) -> list:
    if not any(isinstance(one, Size) for one in operands):
        return applied(closed, eqn, operands)
    name, first = eqn.primitive.name, operands[0]
    if name in ("jit", "pjit"):
        return _through(eqn.params["jaxpr"], operands)
    if name == "cond" and not isinstance(first, Size):
        branches = [lambda rest, one=one: list(map(_magnitude, _through(one, rest))) for one in eqn.params["branches"]]
        return list(map(Size, lax.switch(first, branches, operands[1:])))
    if name in ENTRYWISE and (name != "div" or not isinstance(operands[1], Size)):
        return [Size(ENTRYWISE[name](*jnp.broadcast_arrays(*map(_magnitude, operands))))]
    if name in ALIKE and (name != "select_n" or not isinstance(first, Size)):
        return list(map(Size, applied(closed, eqn, list(map(_magnitude, operands)))))
    return [Size(jnp.full(out.aval.shape, _unknown(out.aval.dtype), out.aval.dtype)) for out in eqn.outvars]


def _unknown(dtype) -> float:
    """`UNKNOWN`, or in float32 what is as large there: products of two are finite."""
    return min(UNKNOWN, float(jnp.finfo(dtype).max) ** 0.49) if jnp.issubdtype(dtype, jnp.floating) else 1.0


def _magnitude(value):
    """Its own; what is no real number is an index or a choice, and stays."""
    if isinstance(value, Size):
        return value.array
    return jnp.abs(value) if jnp.issubdtype(value.dtype, jnp.floating) else value


# By the name of a primitive: what becomes of the magnitudes of its operands …
ENTRYWISE: dict[str, Callable] = {
    "add": lax.add,
    "add_any": lax.add,
    "copy": lambda x: x,
    "div": lax.div,
    "mul": lax.mul,
    "neg": lambda x: x,
    "sub": lax.add,
}
# … or it does with them what it does with the operands.
ALIKE = MOVING | {"cumsum", "dot_general", "reduce_sum", "scatter-add"}
