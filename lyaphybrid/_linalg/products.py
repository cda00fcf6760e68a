"""Eigenvalues of a product of matrices, each with small relative error; units in which its entries are even."""

import numpy as np
import scipy  # its submodules load on first use, which takes a tenth of a second

__all__ = ["even_units", "in_units", "product_eigenvalues"]

ORTHOGONAL_ITERATIONS = 60  # number of orthogonal iterations
ROTATION_ROUNDING = 1e-12  # entries of the last rotation below this are rounding and set to zero
COUPLED = 1e-100  # relative size of an entry below which it is zero: the product of units would leave all numbers


def product_eigenvalues(matrices: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Complex eigenvalues (n,) of matrices[-1] @ … @ matrices[0], and ln|·| (n,) of them, however small they are.

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
    start, turned, uppers = np.eye(len(matrices[0])), np.eye(len(matrices[0])), []
    for _ in range(ORTHOGONAL_ITERATIONS):
        last, uppers = start, []
        for matrix in matrices:
            last, upper = np.linalg.qr(matrix @ last)
            uppers.append(upper)
        start, turned = last, start.T @ last
    turned = np.where(np.abs(turned) > ROTATION_ROUNDING, turned, 0.0)
    ends = [k for k in range(1, len(turned) + 1) if not np.any(turned[k:, :k])]
    blocks = [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]
    found = [_of_block(turned[block, block], [upper[block, block] for upper in uppers]) for block in blocks]
    values, logs = (np.concatenate(part) for part in zip(*found, strict=True))
    return values, logs


def _of_block(turned: np.ndarray, uppers: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The eigenvalues of `turned` @ uppers[-1] @ … @ uppers[0], all of one modulus, and ln|·| of them."""
    product, log_size = turned * 0 + np.eye(len(turned)), 0.0
    for upper in uppers:
        product = upper @ product
        size = float(np.max(np.abs(product)))
        if size == 0:
            break
        product, log_size = product / size, log_size + np.log(size)
    values = np.linalg.eigvals(turned @ product).astype(complex)
    sizes = np.abs(values)
    logs = np.where(sizes > 0, np.log(np.where(sizes > 0, sizes, 1.0)) + log_size, -np.inf)
    return values * np.exp(log_size), logs


def even_units(matrix: np.ndarray) -> np.ndarray:
    """(n,) powers of 2: in these units of x, rows and columns of a map of x are of one size; 1 if it is not finite.

    Source:
        B. N. Parlett & C. Reinsch, Balancing a matrix for calculation of eigenvalues and eigenvectors, Numer. Math. 13
        (1969) 293, doi:10.1007/BF02165404.
    """
    size = np.max(np.abs(matrix), initial=0.0)
    if size == 0 or not np.isfinite(size):
        return np.ones(len(matrix))
    matrix = np.where(np.abs(matrix) > COUPLED * size, matrix / size, 0.0)
    with np.errstate(invalid="ignore"):  # SciPy takes the units for permutations, too, which are not used here
        return scipy.linalg.matrix_balance(matrix, permute=False, separate=True)[1][0]


def in_units(matrix: np.ndarray, units: np.ndarray) -> np.ndarray:
    """A matrix (…, n, n) that maps x to x, for x in other units (n,)."""
    return matrix * units / units[:, None]
