"""Consistent points of a differential–algebraic equation, by Newton iteration, and their derivatives."""

from typing import Any, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.jaxprs import explicit
from ..._linalg.linear_systems import matmul
from .semi_linear import Constrained, InverseBlocks

__all__ = ["PointEquations", "landed", "solved"]

STAGE_ITERATIONS = 12  # Newton iterations; without convergence the stage fails
LAST_CORRECTION = 1e-2  # of √tolerance; the correction after a smaller one is negligible, as convergence is quadratic


class PointEquations(Protocol):
    """The interface that `solved` needs; `Constrained` has it."""

    @property
    def n_differential(self) -> int:
        """The number d of differential components."""
        ...

    def differential_part(self, t, x, args) -> Any:
        """As in `Constrained`."""
        ...

    def slope(self, t, x, args) -> Any:
        """As in `Constrained`."""
        ...

    def constraint(self, t, x, args) -> Any:
        """As in `Constrained`."""
        ...

    def inverse_blocks(self, t, x, args, share: Any) -> InverseBlocks:
        """As in `Constrained`."""
        ...


def landed(dae: Constrained, args, t, x):
    """The point (n,) on the constraints with the differential part E₁ x of x (n,)."""
    return solved(dae, args, t, dae.differential_part(t, x, args), x, jnp.asarray(1e-14, x.dtype))[0]


def solved(dae: PointEquations, args, t, base, guess, tolerance, share: Any = None) -> tuple[Array, InverseBlocks]:
    """The x (n,) with E₁ x = base (d,) and f₂(t, x) = 0, by Newton iteration; nan where it does not converge.

    With a share, as in implicit stages, E₁ x − share w'(t, x) = base. The second result is Ē⁻¹ at the last iterate but
    one; it carries no derivative.
    """

    def left(x):
        """The negative residuals of the equations at x."""
        own = dae.differential_part(t, x, args)
        own = own if share is None else own - share * dae.slope(t, x, args)
        return base - own, -dae.constraint(t, x, args)

    def inverse_blocks(x):
        return dae.inverse_blocks(t, x, args, share)

    (of_left, in_left), (of_lifts, in_lifts) = explicit(left, guess), explicit(inverse_blocks, guess)
    return _implicit(of_left, of_lifts)(in_left, in_lifts, guess, tolerance)


def _implicit(left, inverse_blocks):
    """The solution as a function of the values that its equations close over (`in_left`, `in_lifts`).

    Its derivative is that of one Newton step at the solution (implicit function theorem). The rule uses the solution
    itself, so that higher derivatives exist; the iteration is never differentiated.
    """

    def corrected(turned, off):
        differential_part, constraint = off
        return matmul(turned.differential_part, differential_part) + matmul(turned.constraint, constraint)

    @jax.custom_jvp
    def solution(in_left, in_lifts, guess, tolerance):
        def again(state):
            tries, x, dx, _ = state
            x = x + dx
            turned = inverse_blocks(in_lifts, x)
            return tries + 1, x, corrected(turned, left(in_left, x)), turned

        def is_far(state):
            _, x, dx, _ = state
            return ~(jnp.max(jnp.abs(dx) / (1 + jnp.abs(x))) <= LAST_CORRECTION * jnp.sqrt(tolerance))

        def goes_on(state):
            return (state[0] == 0) | (is_far(state) & (state[0] < STAGE_ITERATIONS))

        blank = jax.tree.map(
            lambda one: jnp.zeros(one.shape, one.dtype), jax.eval_shape(inverse_blocks, in_lifts, guess)
        )
        start = jnp.asarray(0, jnp.int32), guess, jnp.zeros_like(guess), blank
        _, x, dx, turned = state = jax.lax.while_loop(goes_on, again, start)
        return jnp.where(is_far(state), jnp.nan, x + dx), turned

    @solution.defjvp
    def _(operands, changes):
        in_left, in_lifts, *_ = operands
        x, near = solution(*operands)
        _, off = jax.jvp(lambda numbers: left(numbers, x), (in_left,), (changes[0],))
        return (x, near), (corrected(inverse_blocks(in_lifts, x), off), jax.tree.map(jnp.zeros_like, near))

    return solution
