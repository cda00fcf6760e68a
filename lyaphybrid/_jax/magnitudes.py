"""Magnitudes of the terms that a linear function adds: the scale of the rounding error of its result.

A result much smaller than its terms is rounding; a result with small terms is really small. For a matrix A with entries
a_ij, |A| has the entries |a_ij|; for a product of matrices it is the product of their |·|. |A| |dx| bounds the terms of
A dx entry by entry, and zero entries of A contribute nothing (N. J. Higham, Accuracy and Stability of Numerical
Algorithms, 2nd ed. (SIAM 2002), section 3.1, doi:10.1137/1.9780898718027).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr
from jaxtyping import Array

from .jaxprs import MOVING, applied, evaluated, results_of

__all__ = ["UNKNOWN_MAGNITUDE", "absolute"]

UNKNOWN_MAGNITUDE = 1e150  # so large that every result counts as rounding; products of two are finite


class Size(NamedTuple):
    """The magnitude of a value that depends on dx."""

    array: Array


def absolute(function: Callable) -> Callable:
    """|A| of a linear function A, on arrays (n,); `UNKNOWN_MAGNITUDE` where A does more than add and multiply.

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
    if name in ENTRYWISE_MAGNITUDES and (name != "div" or not isinstance(operands[1], Size)):
        return [Size(ENTRYWISE_MAGNITUDES[name](*jnp.broadcast_arrays(*map(_magnitude, operands))))]
    if name in APPLIED_UNCHANGED and not any(_is_index(one) for one in operands):
        return list(map(Size, applied(closed, eqn, list(map(_magnitude, operands)))))
    differing = results_of(eqn, [isinstance(one, Size) for one in operands])
    if name == "cond" and not isinstance(first, Size):
        return _through_branches(eqn, operands, differing)
    # Results that do not depend on dx are what they are at any dx.
    at_any = applied(closed, eqn, list(map(_array, operands))) if not all(differing) else [None] * len(differing)
    return [
        Size(jnp.full(out.aval.shape, _unknown(out.aval.dtype), out.aval.dtype)) if differs else one
        for out, one, differs in zip(eqn.outvars, at_any, differing, strict=True)
    ]


def _through_branches(eqn, operands: list, differing: Sequence[bool]) -> list:
    """A conditional whose index does not depend on dx."""

    def through(branch):
        def results(operands):
            found = zip(_through(branch, operands), differing, strict=True)
            return [_magnitude(one) if differs else _array(one) for one, differs in found]

        return results

    found = lax.switch(operands[0], list(map(through, eqn.params["branches"])), operands[1:])
    return [Size(one) if differs else one for one, differs in zip(found, differing, strict=True)]


def _array(value):
    return value.array if isinstance(value, Size) else value


def _is_index(value) -> bool:
    """Whether it depends on dx and is an index or a condition: of entries that it chooses nothing is known."""
    return isinstance(value, Size) and not jnp.issubdtype(value.array.dtype, jnp.floating)


def _unknown(dtype) -> float:
    """`UNKNOWN_MAGNITUDE`, or in float32 a number such that products of two are finite."""
    return min(UNKNOWN_MAGNITUDE, float(jnp.finfo(dtype).max) ** 0.49) if jnp.issubdtype(dtype, jnp.floating) else 1.0


def _magnitude(value):
    """The magnitude of a value; integers and booleans (indices, conditions) are returned unchanged."""
    if isinstance(value, Size):
        return value.array
    return jnp.abs(value) if jnp.issubdtype(value.dtype, jnp.floating) else value


# Primitives by name: the operation on the magnitudes of the operands …
ENTRYWISE_MAGNITUDES: dict[str, Callable] = {
    "add": lax.add,
    "add_any": lax.add,
    "copy": lambda x: x,
    "div": lax.div,
    "mul": lax.mul,
    "neg": lambda x: x,
    "sub": lax.add,
}
# … or primitives that are applied to the magnitudes unchanged.
APPLIED_UNCHANGED = MOVING | {"cumsum", "dot_general", "reduce_sum", "scatter-add"}
