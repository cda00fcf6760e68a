"""Consistent points of a differential–algebraic equation, by Newton iteration, and their derivatives."""

from typing import Any, Protocol

import jax.numpy as jnp
from jaxtyping import Array

from ..._linalg.linear_systems import matmul
from ..._linalg.roots import root
from .semi_linear import Constrained, InverseBlocks

__all__ = ["PointEquations", "landed", "solved"]


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

    def corrected(turned, off):
        differential_part, constraint = off
        return matmul(turned.differential_part, differential_part) + matmul(turned.constraint, constraint)

    return root(left, inverse_blocks, corrected, guess, tolerance)
