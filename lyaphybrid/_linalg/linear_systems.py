"""Linear systems inside a loop: small ones without calls of LAPACK, so that the loop is compiled to one program.

Most return inverses instead of factors: applying one to a frame is then a product of matrices, without substitution.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

__all__ = [
    "UNROLLED",
    "FactoredInverse",
    "condition",
    "divided",
    "factored",
    "inverse",
    "matmul",
    "separated",
    "sparse_matmul",
    "split",
]

UNROLLED = 12  # most rows for which the elimination is unrolled
MOST_TERMS_UNROLLED = 4  # most terms of a product that are added one by one
POWERS_OF_CONDITION = 32  # with this root of a ratio of units of 1e12 the condition is off by a factor of 2.4
NO_COUPLING = 1e-13  # entries below this times the largest one of their row are rounding
SPARSE = 0.5  # a known matrix with a smaller fraction of nonzero entries is applied entry by entry


def inverse(matrix: Float[Array, "n n"]) -> tuple[Float[Array, "n n"], Float[Array, ""]]:
    """The inverse, and the sign of the determinant; not finite where the matrix is singular."""
    n = matrix.shape[0]
    if n == 0:
        return matrix, jnp.ones((), matrix.dtype)
    if n <= 2:
        return _in_closed_form(matrix)
    if n > UNROLLED:
        factors, sign = factored(matrix)
        return factors @ jnp.eye(n, dtype=matrix.dtype), sign
    return _eliminated(matrix, jnp.eye(n, dtype=matrix.dtype))


class FactoredInverse(eqx.Module):
    """The inverse of a matrix as a linear function, by its LU factors: a quarter of the work of writing it out."""

    both: Float[Array, "n n"]  # L below the diagonal, U on it and above
    pivots: Int[Array, " n"]  # the row that each row was exchanged with

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the matrix."""
        return self.both.shape

    def __matmul__(self, right):
        return jax.scipy.linalg.lu_solve((self.both, self.pivots), right)


def factored(matrix: Float[Array, "n n"]) -> tuple[FactoredInverse, Float[Array, ""]]:
    """The inverse by LU factors, and the sign of the determinant; not finite where the matrix is singular."""
    both, pivots = jax.scipy.linalg.lu_factor(matrix)
    exchanges = jnp.sum(pivots != jnp.arange(len(pivots), dtype=pivots.dtype))
    sign = jnp.prod(jnp.sign(jnp.diagonal(both))) * jnp.where(exchanges % 2 == 0, 1.0, -1.0)
    return FactoredInverse(both, pivots), sign.astype(matrix.dtype)


def condition(matrix: Float[Array, "n n"]) -> Float[Array, ""]:
    """The least condition number that a matrix A can have in any units of its rows and columns, ρ(|A⁻¹| |A|).

    Not finite where A is singular.

    Source:
        F. L. Bauer, Numer. Math. 5 (1963) 73, doi:10.1007/BF01385880.
    """
    size = jnp.abs(matrix)
    matrix = jnp.where(size > NO_COUPLING * jnp.max(size, axis=1, keepdims=True), matrix, 0.0)
    there, back = jnp.abs(matrix), jnp.abs(inverse(matrix)[0])
    grown = jax.lax.fori_loop(0, POWERS_OF_CONDITION, lambda _, v: back @ (there @ v), jnp.ones_like(matrix[0]))
    return jnp.max(grown) ** (1 / POWERS_OF_CONDITION)


def divided(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """The solution of one system, matrix⁻¹ right, for less than the inverse takes; not finite where it is singular."""
    n = matrix.shape[0]
    if n <= 2:
        return matmul(inverse(matrix)[0], right)
    if n > UNROLLED:
        return jnp.linalg.solve(matrix, right)
    return _eliminated(matrix, right[:, None])[0][:, 0]


def _in_closed_form(matrix):
    """The inverse for one or two rows: the adjugate over the determinant."""
    if matrix.shape[0] == 1:
        return 1 / matrix, jnp.sign(matrix[0, 0])
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    return jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / determinant, jnp.sign(determinant)


def _eliminated(matrix, right):
    """matrix⁻¹ right and the sign of the determinant; Gauss–Jordan, the largest entry of each column is the pivot.

    The right side is kept apart, so that JAX sees a linear function of it.
    """
    n, sign = matrix.shape[0], jnp.ones((), matrix.dtype)
    places = jnp.arange(n)[:, None]
    for j in range(n):
        size = jnp.abs(matrix[j:, j])
        pivot = j + jnp.argmax(jax.lax.stop_gradient(size))
        top = jax.lax.dynamic_index_in_dim(matrix, pivot, keepdims=False)[j]
        sign = sign * jnp.sign(top) * jnp.where(pivot == j, 1.0, -1.0)
        shares = jnp.where(places == pivot, matrix[j][None, :], matrix)[:, j]
        matrix, right = (_cleared(one, shares, top, j, pivot) for one in (matrix, right))
    return right, sign


def _cleared(rows, shares, top, j: int, pivot):
    """Rows j and `pivot` exchanged, row j divided by its pivot, and its multiples subtracted from the others."""
    places = jnp.arange(rows.shape[0])[:, None]
    row = jax.lax.dynamic_index_in_dim(rows, pivot, keepdims=False) / top
    rows = jnp.where(places == pivot, rows[j][None, :], rows)
    return jnp.where(places == j, row[None, :], rows - shares[:, None] * row[None, :])


def separated(rows: np.ndarray) -> bool:
    """Whether as many columns of E₁ (d, n) are not zero as it has rows: unit vectors span its kernel."""
    return bool(np.any(rows != 0, axis=0).sum() == rows.shape[0])


def split(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For E₁ (d, n) of full rank: a right inverse (n, d) and a basis (n, n − d) of its kernel.

    If E₁ is `separated`, the basis consists of unit vectors and both are sparse.
    """
    d, n = rows.shape
    if separated(rows):
        there = np.any(rows != 0, axis=0)
        right, kernel = np.zeros((n, d)), np.eye(n)[:, ~there]
        right[there] = np.linalg.inv(rows[:, there])
        return right, kernel
    _, _, directions = np.linalg.svd(rows)
    return np.linalg.pinv(rows), directions[d:].T


def matmul(a: Array, b: Array) -> Array:
    """A @ b, (n, m) @ (m,) or (m, k); few terms are written out, so that XLA can fuse them with their neighbours.

    A may also be a linear function with a shape and ``@``, as the inverse of a banded matrix.
    """
    if not hasattr(a, "dtype") or a.shape[1] > MOST_TERMS_UNROLLED or a.shape[1] == 0:
        return a @ b
    rows = [a[:, j] * b[j] if b.ndim == 1 else a[:, j][:, None] * b[j][None, :] for j in range(a.shape[1])]
    return sum(rows[1:], rows[0])


def sparse_matmul(matrix, x):
    """Matrix @ x; for a known sparse matrix (NumPy) without the zero entries."""
    if not isinstance(matrix, np.ndarray):
        return matmul(matrix, x)
    if matrix.shape[0] > UNROLLED or np.count_nonzero(matrix) > SPARSE * matrix.size:
        return jnp.asarray(matrix, x.dtype) @ x
    nothing = jnp.zeros(x.shape[1:], x.dtype)

    def entry(weight, value):
        return value if weight == 1 else weight * value

    rows = [[entry(float(row[j]), x[j]) for j in np.flatnonzero(row)] for row in matrix]
    return jnp.stack([sum(terms[1:], terms[0]) if terms else nothing for terms in rows])
