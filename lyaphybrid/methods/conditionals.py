"""Functions that XLA computes once, because they stand behind a conditional; and sines there in vector registers."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.extend.core import jaxpr_as_fun

from .._jaxprs import applied, evaluated
from .circular import LARGEST, cosine, sine

__all__ = ["LANES", "behind_a_conditional", "in_lanes"]

LANES = 4  # float64 numbers in a vector register
OURS: dict[str, Callable] = {"sin": sine, "cos": cosine}


def behind_a_conditional(function: Callable) -> Callable:
    """The function of numbers or arrays; XLA does not know that the first is always a number, and never repeats it."""

    def chosen(*operands):
        first = jax.tree.leaves(operands)[0]
        shapes = jax.eval_shape(function, *operands)

        def nothing(*operands):
            del operands
            return jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), shapes)

        return jax.lax.cond(jnp.all(first == first), function, nothing, *operands)

    return chosen


def in_lanes(function: Callable) -> Callable:
    """The function, with its sines and cosines of float64 computed here where all their angles allow it; on a CPU.

    It stands behind a conditional, which XLA does not repeat. What is made of numbers inside the function becomes a
    vector in the register that needs it; made outside it would have to reach memory before it is read.
    """

    def chosen(*operands):
        closed, shape = jax.make_jaxpr(function, return_shape=True)(*operands)
        leaves, angles = jax.tree.leaves(operands), []
        if jax.default_backend() == "cpu":
            _with_ours(closed, leaves, angles)
        if not angles:
            return behind_a_conditional(function)(*operands)
        # What the angles do not need, XLA removes here.
        moderate = jnp.stack([jnp.all(jnp.abs(angle) < LARGEST) for angle in angles]).all()
        results = jax.lax.cond(moderate, lambda *leaves: _with_ours(closed, leaves, []), jaxpr_as_fun(closed), *leaves)
        return jax.tree.unflatten(jax.tree.structure(shape), results)

    return chosen


def _with_ours(closed, leaves, angles: list) -> list:
    """What the function gives with our sines; collects their angles."""

    def rule(closed, eqn, operands):
        name = eqn.primitive.name
        if name in ("jit", "pjit"):
            return evaluated(eqn.params["jaxpr"], operands, rule)
        if name in OURS and eqn.outvars[0].aval.dtype == jnp.float64:
            angles.append(operands[0])
            return [OURS[name](operands[0])]
        return applied(closed, eqn, operands)

    return evaluated(closed, list(leaves), rule)
