"""The implicit stages of the continuous QR method, solved column by column.

Of the differential parts C = E₁ Q (d, k) of orthonormal columns Q = L C, with S = M C the slope (E₁ Y)' of the columns
and G = D L C their derivative Y',

    C' = S − C B,    B = upp(QᵀG) + low(QᵀG)ᵀ.

B is an upper triangular matrix, so column j depends on columns up to j alone. With Σ = Lᵀ D L + (Lᵀ D L)ᵀ,

    c_j' = P_j c_j − c_j w_j,    w_j = c_jᵀ Σ c_j / 2,    P_1 = M,    P_{j+1} = P_j − c_j (Σ c_j)ᵀ,

and w_j is the rate of growth. A stage is therefore k systems of d equations, one after the other, whose Jacobians are
P_{j+1} − w_j; all columns at once would be one system of d k equations.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.precision import eps
from ..._linalg.linear_systems import divided, matmul
from ..._linalg.roots import root
from .linearised import FrameFunctions

__all__ = ["StageMatrices", "solved_columns"]

FINEST_COLUMN = 1e4  # the least tolerance of a column, in units of rounding


class StageMatrices(NamedTuple):
    """The matrices of a stage, or of several with one more axis, the first."""

    slope: Array  # M (d, d)
    stretching: Array  # Σ (d, d)

    @classmethod
    def of(cls, here: FrameFunctions) -> "StageMatrices":
        """Those of a field linearised at a point."""
        lift = here.inverse_block
        half = matmul(lift.T, here.derivative(lift))
        return cls(here.slope(lift), half + half.T)


def solved_columns(stages: StageMatrices, weights, base, guess, tolerance) -> tuple[Array, Array, Array]:
    """The parts C_i of s stages that are solved together: C_i − Σ_l w_il C_l' = base_i; nan where this fails.

    Args:
        stages: their matrices, with an axis (s,) in front.
        weights: w (s, s), the step times the coefficients of the method.
        base: (s, d, k).
        guess: (s, d, k).
        tolerance: of the result.

    Returns:
        C (s, d, k), C' (s, d, k) and the rates of growth (s, k).
    """

    def column(slopes, given):
        at, first = given
        parts = _solved(slopes, stages.stretching, weights, at, first, tolerance)
        changes, rates, later = jax.vmap(_changing)(slopes, stages.stretching, parts)
        return later, (parts, changes, rates)

    columns_first = jnp.moveaxis(base, 2, 0), jnp.moveaxis(guess, 2, 0)
    _, (parts, changes, rates) = jax.lax.scan(column, stages.slope, columns_first)
    return jnp.moveaxis(parts, 0, 2), jnp.moveaxis(changes, 0, 2), rates.T


def _changing(slope, stretching, part):
    """The derivative c' (d,) of a column, its rate of growth, and P (d, d) of the next column."""
    stretched = matmul(stretching, part)
    rate = part @ stretched / 2
    return matmul(slope, part) - rate * part, rate, slope - part[:, None] * stretched[None, :]


def _solved(slopes, stretching, weights, base, guess, tolerance):
    """The parts (s, d) of one column, by Newton's method.

    An error ε of a column is one of about ‖Df‖ ε in its rate of growth, which no later stage damps, as it does errors
    of slopes: in a stiff flow the root must be far better than the tolerance. Its square takes one iteration more.
    """
    fine = jnp.maximum(tolerance, FINEST_COLUMN * eps(guess)) ** 2
    shape, unit = guess.shape, jnp.eye(guess.shape[1], dtype=guess.dtype)

    def left(flat):
        parts = flat.reshape(shape)
        changes, _, _ = jax.vmap(_changing)(slopes, stretching, parts)
        return (base - parts + matmul(weights, changes)).ravel()

    def jacobian(flat):
        _, rates, later = jax.vmap(_changing)(slopes, stretching, flat.reshape(shape))
        by_part = later - rates[:, None, None] * unit[None]
        coupled = jnp.einsum("il,lab->ialb", weights, by_part).reshape(flat.size, flat.size)
        return jnp.eye(flat.size, dtype=flat.dtype) - coupled

    return root(left, jacobian, divided, guess.ravel(), fine)[0].reshape(shape)
