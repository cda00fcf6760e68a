"""Banded matrices, factorised by blocks in a loop inside the compiled program.

A matrix of bandwidth b is block tridiagonal with blocks of b rows. Each step of the elimination inverts one block, with
pivoting inside the block: that is stable if the matrix is diagonally dominant or definite by blocks, as it is for
networks. It takes O(m b²) operations, and O(m b) for each right-hand side, instead of O(m³) for a full inverse.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .linear_systems import inverse

__all__ = ["BlockFactors", "factorised", "probes", "solve"]


class BlockFactors(NamedTuple):
    """Block factors of a block tridiagonal matrix."""

    turned: Array  # (count, b, b) inverses of the diagonal blocks after elimination
    below: Array  # (count, b, b) blocks below the diagonal
    above: Array  # (count, b, b) blocks above the diagonal


def probes(m: int, bandwidth: int) -> np.ndarray:
    """(m, 2 b + 1) sums of unit vectors, 2 b + 1 rows apart: a banded matrix times these shows all of its entries."""
    return np.eye(2 * bandwidth + 1)[np.arange(m) % (2 * bandwidth + 1)]


def factorised(seen: Float[Array, "m c"]) -> tuple[BlockFactors, Float[Array, ""]]:
    """Factors of a matrix from its product with `probes`, and the sign of its determinant."""
    b = (seen.shape[1] - 1) // 2
    diagonal, below, above = (_blocks(seen, b, shift) for shift in (0, -1, 1))

    def eliminate(state, row):
        turned, over, sign = state  # of the block before
        here, left, right = row
        turned, own = inverse(here - left @ turned @ over)
        return (turned, right, sign * own), turned

    start = jnp.zeros((b, b), seen.dtype), jnp.zeros((b, b), seen.dtype), jnp.ones((), seen.dtype)
    (_, _, sign), turned = jax.lax.scan(eliminate, start, (diagonal, below, above))
    return BlockFactors(turned, below, above), sign


def solve(factors: BlockFactors, right: Float[Array, "m *k"]) -> Float[Array, "m *k"]:
    """The solution for one right-hand side (m,), or several (m, k)."""
    count, b, _ = factors.turned.shape
    m, several = right.shape[0], right.reshape(right.shape[0], -1)
    given = jnp.pad(several, ((0, count * b - m), (0, 0))).reshape(count, b, -1)
    nothing = jnp.zeros_like(given[0])

    def forward(before, row):  # before: the solution in the previous block
        turned, left, one = row
        found = turned @ (one - left @ before)
        return found, found

    _, halfway = jax.lax.scan(forward, nothing, (factors.turned, factors.below, given))

    def back(after, row):
        turned, over, one = row
        found = one - turned @ over @ after
        return found, found

    _, solution = jax.lax.scan(back, nothing, (factors.turned, factors.above, halfway), reverse=True)
    return solution.reshape(count * b, -1)[:m].reshape(right.shape)


def _blocks(seen, b: int, shift: int):
    """Blocks (count, b, b) on the diagonal (shift 0), below (−1) or above it (1); padding rows are those of 1."""
    m, colours = seen.shape
    count = -(-m // b)
    i = np.arange(count * b).reshape(count, b, 1) + np.zeros((1, 1, b), int)
    j = (np.arange(count)[:, None, None] + shift) * b + np.arange(b)[None, None, :] + np.zeros((1, b, 1), int)
    there = (i < m) & (j >= 0) & (j < m) & (np.abs(i - j) <= b)
    found = seen.ravel()[np.where(there, i * colours + j % colours, 0)]
    return jnp.where(there, found, jnp.asarray((i == j) & (i >= m), seen.dtype))
