"""Roots by Newton's method, for use inside a compiled loop, and their derivatives."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._jax.jaxprs import explicit

__all__ = ["LAST_CORRECTION", "root"]

MOST_ITERATIONS = 12  # without convergence there is no root
LAST_CORRECTION = 1e-2  # of √tolerance; the correction after a smaller one is negligible, as convergence is quadratic


def of_unit_size(turned, x, tolerance):
    """How large the last correction of unknowns of size 1 may be."""
    del turned
    return LAST_CORRECTION * jnp.sqrt(tolerance) * (1 + jnp.abs(x))


def root(
    left: Callable,
    backward: Callable,
    corrected: Callable,
    guess: Array,
    tolerance: Any,
    allowed: Callable = of_unit_size,
) -> tuple[Array, Any]:
    """The root of equations by Newton's method from a guess; nan where it does not converge.

    The derivative of the root is that of one Newton step at the root (implicit function theorem). The rule uses the
    root itself, so that higher derivatives exist; the iteration is never differentiated.

    Args:
        left: x ↦ the negative residuals, a pytree. It may close over values that are traced.
        backward: x ↦ the inverse of the Jacobian, or the Jacobian, in any form; it may close over such values, too.
        corrected: (what `backward` gives, negative residuals) ↦ the correction of x.
        guess: the first x.
        tolerance: of the result, a pytree that `allowed` takes; by default a number, relative to 1 + |x|.
        allowed: (what `backward` gives, x, tolerance) ↦ how large each entry of the last correction may be. It closes
            over nothing.

    Returns:
        The root, and what `backward` gives at the last iterate but one, which carries no derivative.
    """
    (of_left, in_left), (of_backward, in_backward) = explicit(left, guess), explicit(backward, guess)

    @jax.custom_jvp
    def solution(in_left, in_backward, guess, tolerance):
        def again(state):
            tries, x, dx, _ = state
            x = x + dx
            turned = of_backward(in_backward, x)
            return tries + 1, x, corrected(turned, of_left(in_left, x)), turned

        def is_far(state):
            _, x, dx, turned = state
            return ~jnp.all(jnp.abs(dx) <= allowed(turned, x, tolerance))

        def goes_on(state):
            return (state[0] == 0) | (is_far(state) & (state[0] < MOST_ITERATIONS))

        blank = jax.tree.map(
            lambda one: jnp.zeros(one.shape, one.dtype), jax.eval_shape(of_backward, in_backward, guess)
        )
        start = jnp.asarray(0, jnp.int32), guess, jnp.zeros_like(guess), blank
        _, x, dx, turned = state = jax.lax.while_loop(goes_on, again, start)
        return jnp.where(is_far(state), jnp.nan, x + dx), turned

    @solution.defjvp
    def _(operands, changes):
        in_left, in_backward, *_ = operands
        x, near = solution(*operands)
        _, off = jax.jvp(lambda numbers: of_left(numbers, x), (in_left,), (changes[0],))
        return (x, near), (corrected(of_backward(in_backward, x), off), jax.tree.map(_no_change, near))

    return solution(in_left, in_backward, guess, tolerance)


def _no_change(value):
    """The zero derivative of a value; integers have one of a type of their own."""
    return jnp.zeros_like(value) if eqx.is_inexact_array(value) else np.zeros(value.shape, jax.dtypes.float0)
