"""Consistent points of a differential–algebraic equation, by Newton iteration, and their derivatives."""

from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.precision import eps
from ..._linalg.linear_systems import matmul
from ..._linalg.roots import last_correction, root
from .semi_linear import Constrained, InverseBlocks

__all__ = ["PointEquations", "PointTolerance", "landed", "solved", "to_rounding"]

ROUNDING_OF_TERMS = 64.0  # of the terms of the equations, in units of eps: no correction gets smaller


class PointTolerance(NamedTuple):
    """How well a point is found: to atol + rtol |x|."""

    rtol: Any
    atol: Any


def to_rounding(x) -> PointTolerance:
    """The finest tolerance; the absolute one is for components that cancel functions of time alone."""
    return PointTolerance(jnp.asarray(1e-14, x.dtype), 4 * eps(x))


def _allowed(inverse_blocks: InverseBlocks, x, tolerance: PointTolerance, shrinks):
    """How large each entry (n,) of the last correction may be."""
    relative = last_correction(tolerance.rtol, shrinks) * jnp.abs(x)
    return relative + tolerance.atol + ROUNDING_OF_TERMS * eps(x) * inverse_blocks.terms


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
    return solved(dae, args, t, dae.differential_part(t, x, args), x, to_rounding(x))[0]


def solved(
    dae: PointEquations, args, t, base, guess, tolerance: PointTolerance, share: Any = None, known: Any = None
) -> tuple[Array, InverseBlocks]:
    """The x (n,) with E₁ x = base (d,) and f₂(t, x) = 0, by Newton iteration; nan where it does not converge.

    With a share, as in implicit stages, E₁ x − share w'(t, x) = base. The second result is Ē⁻¹ at the last iterate but
    one; it carries no derivative. `known` is one at a point nearby, as for `root`.
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

    return root(left, inverse_blocks, corrected, guess, tolerance, _allowed, known)
