"""Reverse-mode derivatives through loops whose number of iterations is not known in advance.

Reverse mode needs the state before every iteration. Here a bounded number of checkpoints is stored and the states
between them are recomputed: A. Griewank & A. Walther, ACM Trans. Math. Softw. 26 (2000) 19, doi:10.1145/347837.347846.
This loop is slower, so it is used for reverse passes only; values and forward derivatives come from the plain loop.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

from ..native import ONE_WAY

__all__ = ["CHECKPOINTS", "both_ways", "checkpointed"]

CHECKPOINTS = 64  # most checkpoints of a loop, half of them in the forward pass; an even number
UNREACHED = 2**30  # an iteration that is never reached

# REVERSIBLE[s, r]: the most iterations that can be reversed with s checkpoints, the start included, if no iteration is
# recomputed more than r times: the binomial coefficient of s + r over s.
REVERSIBLE = np.array(
    [[min(math.comb(s + r, s), UNREACHED) for r in range(64)] for s in range(CHECKPOINTS + 1)], np.int32
)


class CheckpointStack(NamedTuple):
    """The checkpoints, as a stack."""

    states: Any  # leaves with a first axis (checkpoints,)
    turns: Array  # (checkpoints,) the iteration before which each was stored
    count: Array  # pyright: ignore[reportIncompatibleMethodOverride]


def checkpointed(goes_on: Callable, step: Callable, state: Any) -> Any:
    """A loop like `jax.lax.while_loop` with reverse-mode but without forward-mode derivatives."""
    state = jax.tree.map(jnp.asarray, state)
    step, goes_on = (jax.tree.map(_as_array, eqx.filter_closure_convert(each, state)) for each in (step, goes_on))
    return _loop((step, state), jax.tree.map(_fixed, goes_on))


def _as_array(leaf):
    """JAX 0.8 has constants, such as tables of numbers, of an array type that Equinox does not recognise."""
    return jnp.asarray(leaf) if hasattr(leaf, "dtype") else leaf


def _is_float(leaf) -> bool:
    """Whether a leaf has derivatives."""
    return hasattr(leaf, "dtype") and jnp.issubdtype(leaf.dtype, jnp.inexact)


def _fixed(leaf):
    return jax.lax.stop_gradient(leaf) if _is_float(leaf) else leaf


@eqx.filter_custom_vjp
def _loop(moving, goes_on):
    step, state = moving
    # Not `goes_on` and `step` themselves: JAX hashes the functions of a loop, and these have no hash.
    return jax.lax.while_loop(lambda state: goes_on(state), lambda state: step(state), state)  # noqa: PLW0108


@_loop.def_fwd
def _forwards(perturbed, moving, goes_on):
    """The loop, storing equally spaced states; when the buffer is full every other state is dropped."""
    del perturbed
    step, state = moving
    room, nothing = CHECKPOINTS // 2, jnp.zeros(CHECKPOINTS, jnp.int32)
    stack = jax.tree.map(lambda leaf: jnp.zeros((CHECKPOINTS, *jnp.shape(leaf)), jnp.result_type(leaf)), state)

    def thinned(kept, apart):
        def every_other(array):
            return array.at[: room // 2].set(array[:room:2])

        turns, states = every_other(kept.turns), jax.tree.map(every_other, kept.states)
        return CheckpointStack(states, turns, kept.count // 2), 2 * apart

    def turn(loop):
        state, now, kept, apart = loop
        kept, apart = jax.lax.cond(kept.count == room, thinned, lambda *same: same, kept, apart)
        return step(state), now + 1, _push_checkpoint(kept, state, now, now % apart == 0), apart

    start = state, nothing[0], CheckpointStack(stack, nothing, nothing[0]), nothing[0] + 1
    state, turns, kept, _ = jax.lax.while_loop(lambda loop: goes_on(loop[0]), turn, start)
    return state, (kept, turns)


@_loop.def_bwd
def _backwards(residuals, back, perturbed, moving, goes_on):
    del perturbed, goes_on
    (kept, turns), (step, state) = residuals, moving
    free, bound = eqx.partition(step, _is_float)

    def pulled(state, back):
        floats, others = eqx.partition(state, _is_float)

        def after(free, floats):
            return eqx.filter(eqx.combine(free, bound)(eqx.combine(floats, others)), _is_float)

        return jax.vjp(after, free, floats)[1](back)

    def turn(loop):
        now, back, gradient, kept = loop
        state, kept = _state_before(now, step, kept)
        more, back = pulled(state, back)
        done = (kept.turns[kept.count - 1] == now).astype(jnp.int32)
        return now - 1, back, jax.tree.map(jnp.add, gradient, more), kept._replace(count=kept.count - done)

    floats = eqx.filter(state, _is_float)
    back = jax.tree.map(lambda leaf, given: jnp.zeros_like(leaf) if given is None else given, floats, back)
    start = turns - 1, back, jax.tree.map(jnp.zeros_like, free), kept
    _, back, gradient, _ = jax.lax.while_loop(lambda loop: loop[0] >= 0, turn, start)
    return gradient, back


def _push_checkpoint(kept: CheckpointStack, state, turn, when) -> CheckpointStack:
    """Push one more checkpoint, if `when` holds."""

    def put(kept, state):
        states = jax.tree.map(lambda stack, leaf: stack.at[kept.count].set(leaf), kept.states, state)
        return CheckpointStack(states, kept.turns.at[kept.count].set(turn), kept.count + 1)

    return jax.lax.cond(when, put, lambda kept, _: kept, kept, state)


def _state_before(turn, step: Callable, kept: CheckpointStack) -> tuple[Any, CheckpointStack]:
    """The state before an iteration, recomputed from the last checkpoint; sets further checkpoints optimally."""
    last = kept.count - 1

    def next_one(kept, now):
        return now + _distance(CHECKPOINTS + 1 - kept.count, turn + 1 - now)

    def onwards(walk):
        state, now, kept, at = walk
        state, now = step(state), now + 1
        due = now == at
        kept = _push_checkpoint(kept, state, now, due)
        return state, now, kept, jnp.where(due, next_one(kept, now), at)

    state, now = jax.tree.map(lambda stack: stack[last], kept.states), kept.turns[last]
    walk = state, now, kept, next_one(kept, now)
    state, _, kept, _ = jax.lax.while_loop(lambda walk: walk[1] < turn, onwards, walk)
    return state, kept


def _distance(checkpoints, turns):
    """The number of iterations to the next checkpoint, from the numbers of free checkpoints and of iterations."""
    reach = jnp.asarray(REVERSIBLE)[checkpoints]
    again = jnp.clip(jnp.sum(reach < turns), 1, REVERSIBLE.shape[1] - 1)
    return jnp.where(checkpoints > 1, jnp.minimum(reach[again - 1], turns - 1), UNREACHED)


def both_ways(forward: Callable, backward: Callable) -> Callable:
    """A function with values and forward derivatives from `forward`, and reverse derivatives from `backward`.

    Args:
        forward: a function of pytrees with array leaves (traced) and other leaves (static).
        backward: the same function in a form with reverse derivatives.
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
                return eqx.filter(which(*given), _is_float)

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
    """The derivative of `forward` in the direction of `changes`; its transpose is that of `backward`."""
    n, fixed = len(leaves), len(leaves) + len(kept)

    def pushed(*given):
        base, kept, changes = given[:n], list(given[n:fixed]), given[fixed:]
        return jax.tree.leaves(jax.jvp(lambda *base: forward(list(base), kept), base, changes)[1])

    def pulled(*given):
        base, kept, back = given[:n], list(given[n:fixed]), given[fixed:]

        def wanted(*base):  # leave out zero cotangents: times an infinite derivative they give nan
            found = jax.tree.leaves(backward(list(base), kept))
            return [x for x, cotangent in zip(found, back, strict=True) if cotangent is not None]

        return jax.vjp(wanted, *base)[1]([cotangent for cotangent in back if cotangent is not None])

    return derivative_p.bind(*leaves, *kept, *changes, pushed=pushed, pulled=pulled, linear=n)


# A linear map given together with its transpose. JAX's own `linear_call` does the same, but cannot be vmapped.
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
    """Second derivatives are forward derivatives of the forward form."""
    del pulled, linear
    changes = [ad.instantiate_zeros(change) for change in changes]
    found, change = jax.jvp(lambda *x: list(pushed(*x)), tuple(operands), tuple(changes))
    return found, eqxi.nondifferentiable_backward(change, msg=ONE_WAY)


def _transposed(back, *operands, pushed, pulled, linear):
    del pushed
    fixed = eqxi.nondifferentiable(operands[: len(operands) - linear], msg=ONE_WAY)
    back = [None if isinstance(one, ad.Zero) else one for one in back]
    return [None] * len(fixed) + list(pulled(*fixed, *back))


def _batched(operands, axes, *, pushed, pulled, linear):
    """Batch over the changes; operands without a batch axis are not repeated."""
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
