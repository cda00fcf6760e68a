"""Rows by which a cycle's monodromy matrix acts: of its phase, and of what decays; of equal multipliers, too."""

import numpy as np
import scipy  # its submodules load on first use, which takes a tenth of a second

from .products import even_units, in_units

__all__ = ["eigenrows"]

VANISHED = 1e-12  # a multiplier below this, relative to the monodromy matrix, is a destroyed direction
MAP_ERROR = 1e-11  # of the monodromy matrix, relative to it
KNOWN_DIRECTION = 0.01  # largest error of an eigenvector that counts as known
EIGENSPACE_ERRORS = 100.0  # so many errors of the matrix are nothing


def eigenrows(monodromy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Z (n,) of the phase; the other multipliers (m,), the largest first; their rows I (m, n), I·v = 1, |v| = 1.

    Multipliers that cannot be told apart have the rows of some basis of their eigenspace, if this has as many
    dimensions: then I_i·v_j = 0 for i ≠ j. Where it has fewer, a Jordan block, the rows are nan.
    """
    units = even_units(monodromy)
    matrix = in_units(monodromy, units)
    values, left, right = scipy.linalg.eig(matrix, left=True, right=True)  # pyright: ignore
    left, own = left.conj().T, int(np.argmin(np.abs(values - 1)))
    least = VANISHED * np.linalg.norm(matrix)
    kept = [i for i in np.argsort(-np.abs(values), kind="stable") if i != own and abs(values[i]) > least]
    error = max(MAP_ERROR * float(np.linalg.norm(matrix)), abs(values[own] - 1))
    rows = np.full((len(kept), len(matrix)), np.nan, complex)
    for group in _alike(values[kept], left[kept], right[:, kept], error):
        chosen = [kept[i] for i in group]
        bases = left[chosen], right[:, chosen]
        if len(group) > 1:
            bases = _eigenspace(matrix, complex(np.mean(values[chosen])), len(group), error)
        if bases is not None:
            of, vectors = bases[0] / units, bases[1] * units[:, None]
            vectors = vectors / np.linalg.norm(vectors, axis=0)
            rows[group] = np.linalg.solve(of @ vectors, of)
    return np.real(left[own]) / units, values[kept], rows


def _alike(values, left, right, error: float) -> list[np.ndarray]:
    """Groups of eigenvalues whose eigenvectors an error of the matrix would mix."""
    if not len(values):
        return []
    overlap = np.abs(np.einsum("in,ni->i", left, right))  # 1 / condition of the eigenvalue
    most = np.maximum(overlap[:, None], overlap)  # both are small where the two vectors are nearly one
    mixed = error > KNOWN_DIRECTION * most * np.abs(values[:, None] - values)
    count, of = scipy.sparse.csgraph.connected_components(mixed, directed=False)
    return [np.flatnonzero(of == i) for i in range(count)]


def _eigenspace(matrix, value: complex, m: int, error: float):
    """Rows (m, n) and columns (n, m) that span the eigenspace; None if it has not m dimensions."""
    u, sizes, vh = np.linalg.svd(matrix - (value.real if value.imag == 0 else value) * np.eye(len(matrix)))
    if np.sum(sizes <= EIGENSPACE_ERRORS * error) != m:
        return None
    rows, columns = u[:, -m:].conj().T, vh[-m:].conj().T
    return (rows, columns) if np.linalg.cond(rows @ columns) < 1 / KNOWN_DIRECTION**2 else None
