"""Semi-explicit DAEs whose constraints are linear in the algebraic variables: these are solved for by hand.

Where x' = f(t, x, z) and 0 = g(t, x) + C z with a constant C, no stage of a method need iterate: z = −C⁻¹ g(t, x). What
is constant, and which component depends on which, is read from the jaxpr of the user's function. A half-explicit method
is then the ordinary one for x, in numbers too.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._jax.jaxprs import by_component, needed, settled
from ..._linalg.linear_systems import inverse, product
from .semi_linear import Constrained, Lifts

__all__ = ["Eliminated", "prepared"]

FEW = 16  # components up to which it is asked whether there is such a C


class Eliminated(Constrained):
    """The field of such a DAE; its parameters are in it already.

    Attributes:
        held: components that are differential.
        solved: the others.
        turned: C⁻¹.
    """

    held: tuple[int, ...] = eqx.field(static=True)
    solved: tuple[int, ...] = eqx.field(static=True)
    turned: Float[Array, "a a"]

    def content(self, t, x, args):
        """W: the differential components of a point, or of a frame."""
        del t, args
        return jnp.stack([x[i] for i in self.held])

    def components(self, t, content) -> list:
        """All components of the point with this content, as a list."""
        known = dict(zip(self.held, content, strict=True)) | dict.fromkeys(self.solved, jnp.zeros_like(content[0]))
        off = self._of_list(t)(self._in_order(known))[self.n_differential :]
        found = [-sum(row[j] * off[j] for j in range(len(self.solved))) for row in self.turned]
        return self._in_order(known | dict(zip(self.solved, found, strict=True)))

    def slope_of(self, t, content):
        """W' as a function of w alone."""
        return self._of_list(t)(self.components(t, content))[: self.n_differential]

    def sensitivity(self, t, x) -> Float[Array, "a d"]:
        """∂z/∂w = −C⁻¹ ∂g/∂x at a point."""
        return -product(self.turned, below(self, t, x, None, self.held))

    def raised(self, sensitivity, change):
        """The change of all components with a change (d,) or (d, k) of the content."""
        return self.put_together(change, product(sensitivity, change))

    def put_together(self, held, solved):
        """Components, or rows of a frame, in their order."""
        rows = dict(zip(self.held, held, strict=True)) | dict(zip(self.solved, solved, strict=True))
        return jnp.stack(self._in_order(rows))

    def lifts(self, t, x, args, share: Any = None) -> Lifts:
        """Ē⁻¹ at (t, x)."""
        if share is not None:
            return super().lifts(t, x, args, share)
        d, kind = self.n_differential, x.dtype
        content = self.raised(self.sensitivity(t, x), jnp.eye(d, dtype=kind))
        constraint = jnp.zeros((x.shape[0], len(self.solved)), kind).at[np.array(self.solved)].set(self.turned)
        return Lifts(content, constraint, jnp.ones((), kind))

    def _in_order(self, components: dict) -> list:
        return [components[i] for i in range(len(components))]

    def _of_list(self, t):
        n = len(self.held) + len(self.solved)
        return by_component(lambda t, x: self.residual(t, x, None), t, jnp.zeros(n, self.turned.dtype))


def below(dae: Constrained, t, x, args, components):
    """Columns of ∂f₂/∂x; the other components are held fixed, and no zeros are multiplied with."""
    of_list = by_component(lambda t, x: dae.constraint(t, x, args), t, x)

    def column(i):
        return jax.jvp(lambda one: of_list([*x[:i], one, *x[i + 1 :]]), (x[i],), (jnp.ones_like(x[i]),))[1]

    return jnp.stack([column(i) for i in components], axis=1)


def prepared(dae: Constrained, t, x, args) -> Constrained:
    """The field with what does not depend on t and x computed here and now; `Eliminated` where it can be."""
    t, d = jnp.asarray(t), dae.n_differential
    residual = settled(lambda t, x: dae.residual(t, x, args), t, x)
    bound = dataclasses.replace(dae, residual=lambda t, x, args: residual(t, x))
    rows = dae.rows(t, args)
    if not isinstance(rows, np.ndarray) or not d < rows.shape[1] <= FEW:
        return bound
    held = [int(i) for i in np.argmax(rows, axis=1)]
    if not np.array_equal(rows, np.eye(rows.shape[1])[held]):
        return bound
    solved = [i for i in range(rows.shape[1]) if i not in held]
    closed = jax.make_jaxpr(lambda t, x: below(bound, t, x, None, solved))(t, x)
    if not needed(closed).isdisjoint(closed.jaxpr.invars):
        return bound
    turned, _ = inverse(below(bound, t, x, None, solved))
    return Eliminated(dae.leading, bound.residual, d, tuple(held), tuple(solved), turned)
