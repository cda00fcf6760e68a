"""Points of a differential–algebraic equation: by Newton's method from what is known of them, and their derivatives."""

from typing import Any, Protocol

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.jaxprs import explicit
from ..._linalg.linear_systems import product
from .semi_linear import Constrained, Lifts

__all__ = ["Equations", "landed", "solved"]

ITERATIONS = 12  # of Newton's, before a stage is given up
FAR = 1e-2  # … which stop once a correction is below this times √tolerance: the one after it is its square


class Equations(Protocol):
    """What `solved` asks of the equations of a point: a `Constrained` has it."""

    @property
    def n_differential(self) -> int:
        """Components of the content."""
        ...

    def content(self, t, x, args) -> Any:
        """As in `Constrained`."""
        ...

    def slope(self, t, x, args) -> Any:
        """As in `Constrained`."""
        ...

    def constraint(self, t, x, args) -> Any:
        """As in `Constrained`."""
        ...

    def lifts(self, t, x, args, share: Any) -> Lifts:
        """As in `Constrained`."""
        ...


def landed(dae: Constrained, args, t, x):
    """The point (n,) with the content of x that lies on the constraints."""
    return solved(dae, args, t, dae.content(t, x, args), x, jnp.asarray(1e-14, x.dtype))[0]


def solved(dae: Equations, args, t, base, guess, tolerance, share: Any = None) -> tuple[Array, Lifts]:
    """The x (n,) with E₁ x = base (d,) and f₂(t, x) = 0, by Newton's method; nan where that does not converge.

    With a share of the slope, as in implicit stages, E₁ x − share w'(t, x) = base. Also Ē⁻¹ near there, which has no
    derivative.
    """

    def left(x):
        """What is left of the equations at x."""
        own = dae.content(t, x, args)
        own = own if share is None else own - share * dae.slope(t, x, args)
        return base - own, -dae.constraint(t, x, args)

    def lifts(x):
        return dae.lifts(t, x, args, share)

    (of_left, in_left), (of_lifts, in_lifts) = explicit(left, guess), explicit(lifts, guess)
    return _implicit(of_left, of_lifts)(in_left, in_lifts, guess, tolerance)


def _implicit(left, lifts):
    """The solution as a function of the numbers in its equations; its derivative is that of a step of Newton's from it.

    The step is written with the solution itself, and so has derivatives in its turn. The iteration has none.
    """

    def corrected(turned, off):
        content, constraint = off
        return product(turned.content, content) + product(turned.constraint, constraint)

    @jax.custom_jvp
    def solution(in_left, in_lifts, guess, tolerance):
        def again(state):
            tries, x, dx, _ = state
            x = x + dx
            turned = lifts(in_lifts, x)
            return tries + 1, x, corrected(turned, left(in_left, x)), turned

        def is_far(state):
            _, x, dx, _ = state
            return ~(jnp.max(jnp.abs(dx) / (1 + jnp.abs(x))) <= FAR * jnp.sqrt(tolerance))

        def goes_on(state):
            return (state[0] == 0) | (is_far(state) & (state[0] < ITERATIONS))

        blank = jax.tree.map(lambda one: jnp.zeros(one.shape, one.dtype), jax.eval_shape(lifts, in_lifts, guess))
        start = jnp.asarray(0, jnp.int32), guess, jnp.zeros_like(guess), blank
        _, x, dx, turned = state = jax.lax.while_loop(goes_on, again, start)
        return jnp.where(is_far(state), jnp.nan, x + dx), turned

    @solution.defjvp
    def _(operands, changes):
        in_left, in_lifts, *_ = operands
        x, near = solution(*operands)
        _, off = jax.jvp(lambda numbers: left(numbers, x), (in_left,), (changes[0],))
        return (x, near), (corrected(lifts(in_lifts, x), off), jax.tree.map(jnp.zeros_like, near))

    return solution
