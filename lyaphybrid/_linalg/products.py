"""Eigenvalues of a product of matrices, the small ones as well as the large."""

import numpy as np

__all__ = ["product_eigenvalues"]

TURNS = 60  # of orthogonal iteration
SETTLED = 1e-12  # what is left of a rotation between two turns, and taken for none: a rounding of one factor


def product_eigenvalues(matrices: list[np.ndarray]) -> np.ndarray:
    """Complex eigenvalues (n,) of matrices[-1] @ … @ matrices[0].

    In the product itself the rounding of the largest hides the smallest. With A_i Q_i = Q_{i+1} R_i it is similar to
    (Q_0ᵀ Q_m) R_{m−1} … R_0, whatever Q_0 is. Orthogonal iteration leaves blocks of Q_0ᵀ Q_m only where eigenvalues are
    of one size; then the matrix is triangular but for these, and each eigenvalue is found to its own size.

    Args:
        matrices: (n, n) each, in the order in which they act.

    Source:
        A. Bojanczyk, G. H. Golub & P. Van Dooren, The periodic Schur decomposition, Proc. SPIE 1770 (1992) 31,
        doi:10.1117/12.130915.
    """
    start = first = last = triangle = np.eye(len(matrices[0]))
    for _ in range(TURNS):
        first, last, triangle = start, start, np.eye(len(start))
        for matrix in matrices:
            last, upper = np.linalg.qr(matrix @ last)
            triangle = upper @ triangle
        start = last
    turned = first.T @ last
    return np.linalg.eigvals(np.where(np.abs(turned) > SETTLED, turned, 0.0) @ triangle).astype(complex)
