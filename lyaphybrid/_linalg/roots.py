"""Roots by Newton's method, for use inside a compiled loop, and their derivatives."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._jax.jaxprs import explicit

__all__ = ["last_correction", "root"]

MOST_ITERATIONS = 12  # without convergence there is no root
LEAST_FACTOR = 1e-3  # smaller ones may be luck
SLOWEST_CHORD = 0.2  # corrections that shrink less than by this factor want a new inverse
LAST_CORRECTION = 1e-2  # of √tolerance; the correction after a smaller one is negligible, as convergence is quadratic


class Iteration(NamedTuple):
    """The state of the search."""

    tries: Array
    x: Array
    dx: Array  # the next correction
    turned: Any  # the inverse that gave it
    anew: Any = None  # whether that was taken at x …
    shrinks: Any = None  # … and the factor by which corrections have shrunk the last time; None if always


def last_correction(tolerance, shrinks):
    """How large the last one may be, relative to the size of the unknowns.

    Newton's corrections shrink to their square (`shrinks` is None), those by the inverse of another point by a factor.
    """
    if shrinks is None:
        return LAST_CORRECTION * jnp.sqrt(tolerance)
    return LAST_CORRECTION**2 * tolerance / jnp.maximum(shrinks, LEAST_FACTOR)


def of_unit_size(turned, x, tolerance, shrinks):
    """How large the last correction of unknowns of size 1 may be."""
    del turned
    return last_correction(tolerance, shrinks) * (1 + jnp.abs(x))


def root(
    left: Callable,
    backward: Callable,
    corrected: Callable,
    guess: Array,
    tolerance: Any,
    allowed: Callable = of_unit_size,
    known: Any = None,
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
        allowed: (what `backward` gives, x, tolerance, shrinks) ↦ how large each entry of the last correction may be. It
            closes over nothing.
        known: what `backward` gives at a point nearby. It serves as long as corrections shrink fast (the chord method),
            for many unknowns, where `backward` takes longest. None: a new one for each correction.

    Returns:
        The root, and what `backward` gives at the last iterate but one, which carries no derivative.
    """
    (of_left, in_left), (of_backward, in_backward) = explicit(left, guess), explicit(backward, guess)

    @jax.custom_jvp
    def solution(in_left, in_backward, guess, tolerance, known):
        def again(state: Iteration):
            tries, x = state.tries + 1, state.x + state.dx
            if known is None:
                turned = of_backward(in_backward, x)
                return Iteration(tries, x, corrected(turned, of_left(in_left, x)), turned)
            anew = (state.tries > 1) & (state.shrinks > SLOWEST_CHORD)
            turned = jax.lax.cond(anew, lambda: of_backward(in_backward, x), lambda: state.turned)
            dx = corrected(turned, of_left(in_left, x))
            return Iteration(tries, x, dx, turned, anew, _ratio(dx, state))

        def is_far(state: Iteration):
            near = jnp.abs(state.dx) <= allowed(state.turned, state.x, tolerance, None)
            if known is not None:
                others = jnp.abs(state.dx) <= allowed(state.turned, state.x, tolerance, state.shrinks)
                near = jnp.where(state.anew, near, others)
            return ~jnp.all(near)

        def goes_on(state: Iteration):
            most = MOST_ITERATIONS if known is None else 2 * MOST_ITERATIONS
            return (state.tries == 0) | (is_far(state) & (state.tries < most))

        first = Iteration(jnp.asarray(0, jnp.int32), guess, jnp.zeros_like(guess), known)
        if known is None:
            kind = jax.eval_shape(of_backward, in_backward, guess)
            first = first._replace(turned=jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), kind))
        else:
            first = first._replace(anew=jnp.asarray(False), shrinks=jnp.ones((), guess.dtype))
        last = jax.lax.while_loop(goes_on, again, first)
        return jnp.where(is_far(last), jnp.nan, last.x + last.dx), last.turned

    @solution.defjvp
    def _(operands, changes):
        in_left, in_backward, *_ = operands
        x, near = solution(*operands)
        _, off = jax.jvp(lambda numbers: of_left(numbers, x), (in_left,), (changes[0],))
        return (x, near), (corrected(of_backward(in_backward, x), off), jax.tree.map(_no_change, near))

    return solution(in_left, in_backward, guess, tolerance, known)


def _no_change(value):
    """The zero derivative of a value; integers have one of a type of their own."""
    return jnp.zeros_like(value) if eqx.is_inexact_array(value) else np.zeros(value.shape, jax.dtypes.float0)


def _ratio(dx, before: Iteration):
    """By which factor a correction is smaller than the one before; 1 for the first."""
    size, last = jnp.max(jnp.abs(dx), initial=0), jnp.max(jnp.abs(before.dx), initial=0)
    return jnp.where((before.tries == 0) | (last == 0), 1.0, size / jnp.where(last == 0, 1.0, last))
