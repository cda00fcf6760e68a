"""Reverse-mode derivatives through loops whose number of turns is not known beforehand.

JAX runs such a loop backwards only if every turn was kept. Here a bounded number of checkpoints is kept, and what lies
between is computed again: P. Stumm & A. Walther, SIAM J. Sci. Comput. 32 (2010) 836, doi:10.1137/080742439. That makes
a slower loop, so it is run for a reverse pass alone: values and forward derivatives come from the fast one.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

__all__ = ["CHECKPOINTS", "both_ways", "checkpointed", "rarely"]

CHECKPOINTS = 64  # of a loop: up to 64·65/2 = 2080 turns are computed twice more, up to 45 760 three times
WITHIN = 16**3  # turns at most, of a loop that is rare and short


def checkpointed(goes_on: Callable, step: Callable, state: Any) -> Any:
    """A loop like `jax.lax.while_loop` that has reverse derivatives, and no forward ones."""
    return eqxi.while_loop(goes_on, step, state, kind="checkpointed", checkpoints=CHECKPOINTS)


def rarely(goes_on: Callable, step: Callable, state: Any) -> Any:
    """A loop of few turns within another: differentiable both ways, and bounded."""
    return eqxi.while_loop(goes_on, step, state, kind="bounded", max_steps=WITHIN)


def both_ways(forward: Callable, backward: Callable) -> Callable:
    """A function with the values and the forward derivatives of one, and the reverse derivatives of the other.

    Args:
        forward: a function of trees, of arrays and of what is static.
        backward: the same function, computed so that it has reverse derivatives.
    """

    @eqx.filter_custom_jvp
    def function(*operands):
        return forward(*operands)

    @function.def_jvp
    def _(operands, changes):
        moving, still = eqx.partition(operands, jax.tree.map(_is_something, changes, is_leaf=_is_none))
        leaves, structure = jax.tree.flatten(moving)
        kept, static = eqx.partition(still, eqx.is_array)
        kept, places = jax.tree.flatten(kept)

        def of_leaves(which):
            def outputs(leaves, kept):
                moving = jax.tree.unflatten(structure, leaves)
                given = eqx.combine(moving, jax.tree.unflatten(places, kept), static)
                return eqx.filter(which(*given), eqx.is_inexact_array)

            return outputs

        value = function(*operands)
        shape = jax.eval_shape(of_leaves(forward), leaves, kept)
        out = _linear(of_leaves(forward), of_leaves(backward), leaves, kept, jax.tree.leaves(changes))
        return value, jax.tree.unflatten(jax.tree.structure(shape), out)

    return function


def _is_none(leaf) -> bool:
    return leaf is None


def _is_something(leaf) -> bool:
    return leaf is not None


def _linear(forward, backward, leaves: list, kept: list, changes: list) -> list:
    """The derivative of `forward` along changes; transposed, the reverse derivative of `backward`."""
    n, fixed = len(leaves), len(leaves) + len(kept)

    def pushed(*given):
        base, kept, changes = given[:n], list(given[n:fixed]), given[fixed:]
        return jax.tree.leaves(jax.jvp(lambda *base: forward(list(base), kept), base, changes)[1])

    def pulled(*given):
        base, kept, back = given[:n], list(given[n:fixed]), given[fixed:]
        _, pull = jax.vjp(lambda *base: jax.tree.leaves(backward(list(base), kept)), *base)
        return pull(list(back))

    return derivative_p.bind(*leaves, *kept, *changes, pushed=pushed, pulled=pulled, linear=n)


# A linear map given twice: as it is, and transposed. JAX's own `linear_call` is that too, but cannot be vmapped.
derivative_p = Primitive("derivative_both_ways")
derivative_p.multiple_results = True


def _apply(*operands, pushed, pulled, linear):
    del pulled, linear
    return pushed(*operands)


def _shapes(*operands, pushed, pulled, linear):
    del pulled, linear
    shapes = jax.eval_shape(pushed, *(jax.ShapeDtypeStruct(one.shape, one.dtype) for one in operands))
    return [ShapedArray(one.shape, one.dtype) for one in shapes]


def _pushed_on(operands, changes, *, pushed, pulled, linear):
    """A second derivative is taken of the first as it is."""
    del pulled, linear
    changes = [ad.instantiate_zeros(change) for change in changes]
    return jax.jvp(lambda *x: list(pushed(*x)), tuple(operands), tuple(changes))


def _transposed(back, *operands, pushed, pulled, linear):
    fixed = operands[: len(operands) - linear]
    shapes = jax.eval_shape(pushed, *(_shape_of(one) for one in operands))
    back = [
        jnp.zeros(shape.shape, shape.dtype) if isinstance(one, ad.Zero) else one
        for one, shape in zip(back, shapes, strict=True)
    ]
    return [None] * len(fixed) + list(pulled(*fixed, *back))


def _shape_of(operand):
    known = operand.aval if ad.is_undefined_primal(operand) else operand  # which may be Python's own number
    return jax.ShapeDtypeStruct(jnp.shape(known), jnp.result_type(known))


def _batched(operands, axes, *, pushed, pulled, linear):
    """Over all changes at once; what does not depend on the lane stays one for all."""
    fixed = len(operands) - linear
    (size,) = {one.shape[axis] for one, axis in zip(operands, axes, strict=True) if axis is not None}
    changes = [
        batching.bdim_at_front(one, axis, size) for one, axis in zip(operands[fixed:], axes[fixed:], strict=True)
    ]
    where = list(axes[:fixed])

    def in_lanes(function):
        return lambda *given: jax.vmap(function, in_axes=(*where, *[0] * (len(given) - fixed)))(*given)

    lanes = {"pushed": in_lanes(pushed), "pulled": in_lanes(pulled)}
    out = derivative_p.bind(*operands[:fixed], *changes, **lanes, linear=linear)
    return out, [0] * len(out)


derivative_p.def_impl(_apply)
derivative_p.def_abstract_eval(_shapes)
ad.primitive_jvps[derivative_p] = _pushed_on
ad.primitive_transposes[derivative_p] = _transposed
batching.primitive_batchers[derivative_p] = _batched
mlir.register_lowering(derivative_p, mlir.lower_fun(_apply, multiple_results=True))
