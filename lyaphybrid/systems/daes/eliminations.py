"""Semi-explicit DAEs whose constraints are linear in the algebraic variables, which are then eliminated explicitly.

For x' = f(t, x, z) and 0 = g(t, x) + C z with a constant C, no stage of a method has to iterate: z = −C⁻¹ g(t, x). The
jaxpr of the user's function shows which parts are constant and which component depends on which. A half-explicit
method is then the ordinary Runge–Kutta method for x, to the last digit.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._jax.jaxprs import by_component, needed, partially_evaluated
from ..._linalg.linear_systems import inverse, matmul
from .semi_linear import Constrained, InverseBlocks

__all__ = ["Eliminated", "with_eliminations"]

MOST_COMPONENTS_CONSTANT = 16  # components, up to which we look for a constant C


class Eliminated(Constrained):
    """The field of such a DAE, with its parameters bound (`args` is not used).

    Attributes:
        held: indices of the differential components.
        solved: indices of the algebraic components.
        turned: C⁻¹ (a, a).
        within: the field before the elimination.
    """

    held: tuple[int, ...] = eqx.field(static=True)
    solved: tuple[int, ...] = eqx.field(static=True)
    turned: Float[Array, "a a"]
    within: Constrained

    def singularities(self, t, x, args):
        """As in the field before the elimination, which may look at more than Ē."""
        return self.within.singularities(t, x, args)

    def differential_part(self, t, x, args):
        """The differential components w (d,) of a point, or (d, k) of a frame."""
        del t, args
        return jnp.stack([x[i] for i in self.held])

    def components(self, t, differential_part) -> list:
        """All components, as a list, of the consistent point with the differential components `differential_part`."""
        known = dict(zip(self.held, differential_part, strict=True)) | dict.fromkeys(
            self.solved, jnp.zeros_like(differential_part[0])
        )
        off = self._of_list(t)(self._in_order(known))[self.n_differential :]
        found = [-sum(row[j] * off[j] for j in range(len(self.solved))) for row in self.turned]
        return self._in_order(known | dict(zip(self.solved, found, strict=True)))

    def slope_of(self, t, differential_part):
        """The derivative w' as a function of t and w (d,) alone."""
        return self._of_list(t)(self.components(t, differential_part))[: self.n_differential]

    def sensitivity(self, t, x) -> Float[Array, "a d"]:
        """The matrix ∂z/∂w = −C⁻¹ ∂g/∂w (a, d) at a point."""
        return -matmul(self.turned, below(self, t, x, None, self.held))

    def raised(self, sensitivity, change):
        """The change (n,) or (n, k) of all components, from a change (d,) or (d, k) of the differential ones."""
        return self.put_together(change, matmul(sensitivity, change))

    def put_together(self, held, solved):
        """All components, or rows of a frame, in their order, from the differential and the algebraic ones."""
        rows = dict(zip(self.held, held, strict=True)) | dict(zip(self.solved, solved, strict=True))
        return jnp.stack(self._in_order(rows))

    def inverse_blocks(self, t, x, args, share: Any = None) -> InverseBlocks:
        """The blocks of Ē⁻¹ at (t, x); with a share, those of an implicit stage."""
        if share is not None:
            return super().inverse_blocks(t, x, args, share)
        d, kind = self.n_differential, x.dtype
        sensitivity = self.sensitivity(t, x)
        differential_part = self.raised(sensitivity, jnp.eye(d, dtype=kind))
        constraint = jnp.zeros((x.shape[0], len(self.solved)), kind).at[np.array(self.solved)].set(self.turned)
        terms = jnp.abs(x) + self.raised(jnp.abs(sensitivity), jnp.abs(self.differential_part(t, x, None)))
        return InverseBlocks(differential_part, constraint, jnp.ones((), kind), terms)

    def _in_order(self, components: dict) -> list:
        return [components[i] for i in range(len(components))]

    def _of_list(self, t):
        n = len(self.held) + len(self.solved)
        return by_component(lambda t, x: self.residual(t, x, None), t, jnp.zeros(n, self.turned.dtype))


def below(dae: Constrained, t, x, args, components):
    """The columns of ∂f₂/∂x for these components, each differentiated by itself: no products with zeros."""
    of_list = by_component(lambda t, x: dae.constraint(t, x, args), t, x)

    def column(i):
        return jax.jvp(lambda one: of_list([*x[:i], one, *x[i + 1 :]]), (x[i],), (jnp.ones_like(x[i]),))[1]

    return jnp.stack([column(i) for i in components], axis=1)


def with_eliminations(dae: Constrained, t, x, args) -> Constrained:
    """The field with its args bound and constant subexpressions evaluated; an `Eliminated` where C is constant."""
    t, d = jnp.asarray(t), dae.n_differential
    residual = partially_evaluated(lambda t, x: dae.residual(t, x, args), t, x)
    bound = dataclasses.replace(dae, residual=lambda t, x, args: residual(t, x))
    rows = dae.rows(t, args)
    if not isinstance(rows, np.ndarray) or not d < rows.shape[1] <= MOST_COMPONENTS_CONSTANT:
        return bound
    held = [int(i) for i in np.argmax(rows, axis=1)]
    if not np.array_equal(rows, np.eye(rows.shape[1])[held]):
        return bound
    solved = [i for i in range(rows.shape[1]) if i not in held]
    closed = jax.make_jaxpr(lambda t, x: below(bound, t, x, None, solved))(t, x)
    if not needed(closed).isdisjoint(closed.jaxpr.invars):
        return bound
    turned, _ = inverse(below(bound, t, x, None, solved))
    return Eliminated(dae.leading, bound.residual, d, tuple(held), tuple(solved), turned, bound)
