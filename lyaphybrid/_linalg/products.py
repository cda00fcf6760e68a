"""Eigenvalues of a product of matrices, each with small relative error; units in which its entries are even."""

import numpy as np
import scipy.linalg

__all__ = ["even_units", "in_units", "product_eigenvalues"]

ORTHOGONAL_ITERATIONS = 60  # number of orthogonal iterations
ROTATION_ROUNDING = 1e-12  # entries of the last rotation below this are rounding and set to zero


def product_eigenvalues(matrices: list[np.ndarray]) -> np.ndarray:
    """Complex eigenvalues (n,) of matrices[-1] @ … @ matrices[0].

    In the product itself rounding of the largest eigenvalues hides the smallest. With A_i Q_i = Q_{i+1} R_i the product
    is similar to (Q_0ᵀ Q_m) R_{m−1} … R_0 for every orthogonal Q_0. After orthogonal iteration Q_0ᵀ Q_m is diagonal
    except for blocks of eigenvalues of equal modulus. The matrix is then block triangular, and each eigenvalue is
    accurate relative to its own size.

    Args:
        matrices: (n, n) each, in the order in which they act.

    Source:
        A. Bojanczyk, G. H. Golub & P. Van Dooren, The periodic Schur decomposition, Proc. SPIE 1770 (1992) 31,
        doi:10.1117/12.130915.
    """
    start = first = last = triangle = np.eye(len(matrices[0]))
    for _ in range(ORTHOGONAL_ITERATIONS):
        first, last, triangle = start, start, np.eye(len(start))
        for matrix in matrices:
            last, upper = np.linalg.qr(matrix @ last)
            triangle = upper @ triangle
        start = last
    turned = first.T @ last
    return np.linalg.eigvals(np.where(np.abs(turned) > ROTATION_ROUNDING, turned, 0.0) @ triangle).astype(complex)


def even_units(matrix: np.ndarray) -> np.ndarray:
    """(n,) powers of 2: in these units of x, rows and columns of a map of x are of one size; 1 if it is not finite.

    Source:
        B. N. Parlett & C. Reinsch, Balancing a matrix for calculation of eigenvalues and eigenvectors, Numer. Math. 13
        (1969) 293, doi:10.1007/BF02165404.
    """
    if not np.all(np.isfinite(matrix)):
        return np.ones(len(matrix))
    return scipy.linalg.matrix_balance(matrix, permute=False, separate=True)[1][0]


def in_units(matrix: np.ndarray, units: np.ndarray) -> np.ndarray:
    """A matrix (…, n, n) that maps x to x, for x in other units (n,)."""
    return matrix * units / units[:, None]
