"""Small linear systems, solved within a loop that stays one kernel: LAPACK's calls would not.

Inverses, not factors: what they are applied to, frames above all, is then a product of matrices and no recursion.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

__all__ = ["inverse", "product", "split", "times"]

UNROLLED = 12  # rows up to which the elimination is written out
WRITTEN_OUT = 4  # terms of a product that are added one by one
SPARSE = 0.5  # a known matrix with fewer nonzero entries than this part is applied entry by entry


def inverse(matrix: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], Float[Array, ""]]:
    """The inverse, and the sign of the determinant; not finite where the matrix is singular."""
    n = matrix.shape[0]
    if n == 0:
        return matrix, jnp.ones((), matrix.dtype)
    if n <= 2:
        return _in_closed_form(matrix)
    if n > UNROLLED:
        return jnp.linalg.inv(matrix), jnp.sign(jnp.linalg.det(matrix))
    return _by_elimination(matrix)


def _in_closed_form(matrix):
    """Of one or two rows: the adjugate over the determinant."""
    if matrix.shape[0] == 1:
        return 1 / matrix, jnp.sign(matrix[0, 0])
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    return jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / determinant, jnp.sign(determinant)


def _by_elimination(matrix):
    """Gauss and Jordan, the largest entry of each column as its pivot."""
    n = matrix.shape[0]
    both, sign = jnp.concatenate([matrix, jnp.eye(n, dtype=matrix.dtype)], axis=1), jnp.ones((), matrix.dtype)
    for j in range(n):
        size = jnp.abs(both[j:, j])
        pivot = j + jnp.argmax(jax.lax.stop_gradient(size))
        chosen = jax.lax.dynamic_index_in_dim(both, pivot, keepdims=False)
        places = jnp.arange(n)[:, None]
        both = jnp.where(places == pivot, both[j][None, :], both)
        sign = sign * jnp.sign(chosen[j]) * jnp.where(pivot == j, 1.0, -1.0)
        row = chosen / chosen[j]
        both = jnp.where(places == j, row[None, :], both - both[:, j][:, None] * row[None, :])
    return both[:, n:], sign


def split(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For E₁ (d, n) of full rank a right inverse (n, d) and a basis (n, n − d) of its kernel.

    Where some columns of E₁ are zero and the others are square both are unit vectors at heart: most entries are zero.
    """
    d, n = rows.shape
    there = np.any(rows != 0, axis=0)
    if there.sum() == d:
        right, kernel = np.zeros((n, d)), np.eye(n)[:, ~there]
        right[there] = np.linalg.inv(rows[:, there])
        return right, kernel
    _, _, directions = np.linalg.svd(rows)
    return np.linalg.pinv(rows), directions[d:].T


def product(a: Array, b: Array) -> Array:
    """A @ b (n, m) @ (m,) or (m, k); of few terms written out, so that it is part of what comes before and after."""
    if a.shape[1] > WRITTEN_OUT or a.shape[1] == 0:
        return a @ b
    rows = [a[:, j] * b[j] if b.ndim == 1 else a[:, j][:, None] * b[j][None, :] for j in range(a.shape[1])]
    return sum(rows[1:], rows[0])


def times(matrix, x):
    """Matrix @ x; where the matrix is known and mostly empty, without its zeros."""
    if not isinstance(matrix, np.ndarray):
        return product(matrix, x)
    if matrix.shape[0] > UNROLLED or np.count_nonzero(matrix) > SPARSE * matrix.size:
        return jnp.asarray(matrix, x.dtype) @ x
    nothing = jnp.zeros(x.shape[1:], x.dtype)

    def entry(weight, value):
        return value if weight == 1 else weight * value

    rows = [[entry(float(row[j]), x[j]) for j in np.flatnonzero(row)] for row in matrix]
    return jnp.stack([sum(terms[1:], terms[0]) if terms else nothing for terms in rows])
