"""A field linearised at a stage point, as linear functions of frames; with or without constraints."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.columns import each_column, linear_at
from ..._linalg.linear_systems import matmul, sparse_matmul
from ...systems.daes.eliminations import Eliminated
from ...systems.daes.semi_linear import Constrained, is_constrained, parts_of

__all__ = ["FrameFunctions", "linearised"]


class FrameFunctions(NamedTuple):
    """Linear functions of frames (n, k)."""

    inverse_block: Array  # (n, d), with lift E₁ Y = Y for columns Y tangent to the constraints
    differential_part: Callable  # Y ↦ E₁ Y
    slope: Callable  # Y ↦ (E₁ Y)' = E₁' Y + A₁ Y
    derivative: Callable  # Y ↦ Y' = Ē⁻¹ [A₁; −A₂'] Y


def linearised(field: Any, t, x: Array, share: Any = None) -> FrameFunctions:
    """A field linearised at (t, x); with a share h a_ii the lift is that of an implicit stage."""
    if share is None and not is_constrained(field):
        slope = linear_at(lambda x: field(t, x), x)
        return FrameFunctions(jnp.eye(x.shape[0], dtype=x.dtype), lambda frame: frame, slope, slope)
    dae, args = parts_of(field, x.shape[0])
    if share is None and isinstance(dae, Eliminated):
        return _along_content(dae, t, x)
    return _along(dae, args, t, x, share)


def _along(dae: Constrained, args, t, x, share) -> FrameFunctions:
    inverse_blocks = dae.inverse_blocks(t, x, args, share)
    slope = linear_at(lambda x: dae.slope(t, x, args), x)

    def derivative(frame):
        onwards = jnp.ones_like(t), dae.velocity(inverse_blocks, t, x, args)

        def rates(dx):
            def below(t, x):  # A₂ dx
                return jax.jvp(lambda x: dae.constraint(t, x, args), (x,), (dx,))[1]

            rate = jax.jvp(lambda x: dae.residual(t, x, args), (x,), (dx,))[1]
            return rate[: dae.n_differential], jax.jvp(below, (t, x), onwards)[1]

        differential, turning = each_column(rates, frame)
        return matmul(inverse_blocks.differential_part, differential) - matmul(inverse_blocks.constraint, turning)

    return FrameFunctions(
        inverse_blocks.differential_part, lambda frame: sparse_matmul(dae.rows(t, args), frame), slope, derivative
    )


def _along_content(dae: Eliminated, t, x) -> FrameFunctions:
    """The same with d numbers per column: Q = [dw; L dw], dw' = D dw, and therefore Q' = [dw'; L dw' + L' dw]."""
    w = dae.differential_part(t, x, None)
    onwards = jnp.ones_like(t), dae.slope_of(t, w)
    fall, turning = jax.jvp(lambda t, w: dae.sensitivity(t, jnp.stack(dae.components(t, w))), (t, w), onwards)
    slopes = jax.jacfwd(lambda w: dae.slope_of(t, w))(w)

    def differential_part(frame):
        return dae.differential_part(t, frame, None)

    def slope(frame):
        return matmul(slopes, differential_part(frame))

    def derivative(frame):
        change = slope(frame)
        return dae.put_together(change, matmul(fall, change) + matmul(turning, differential_part(frame)))

    return FrameFunctions(dae.raised(fall, jnp.eye(len(w), dtype=x.dtype)), differential_part, slope, derivative)
