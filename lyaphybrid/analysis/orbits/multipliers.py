"""The multipliers of an orbit, and what they say of its stability."""

import numpy as np

from ..._jax.precision import digits
from ..._linalg import frames
from ..._linalg.products import product_eigenvalues

__all__ = ["multipliers_of", "stability_of"]

CIRCLE = 1e-7  # from the unit circle: nearer than this a multiplier is on it
DEPENDENT = 1e-6  # part of a direction that is left across the others: less is rounding


def multipliers_of(matrices: list[np.ndarray], known: np.ndarray, free: int, autonomous: bool):
    """All multipliers (free,), the largest first, and the others: those that decide on the stability.

    Two multipliers that are 1 because orbits come in a family belong to one eigenvector: computed, they are off by the
    root of the rounding. The space of directions that are known to be carried to themselves is divided out before.

    Args:
        matrices: (n, n) of the pieces, in the order in which they act.
        known: (n, d) directions at the start whose multipliers are 1, that along the flow among them if there are any.
        free: how many perturbations there are.
        autonomous: whether one multiplier is 1 along the flow.
    """
    matrices, ones = _divided(matrices, known)
    found = product_eigenvalues(matrices) if len(matrices[0]) else np.zeros(0, complex)
    found = found[np.argsort(-np.abs(found), kind="stable")]
    n = len(found)
    found = found[: free - ones]
    found[n - _destroyed(matrices) :] = 0.0
    if ones:
        together = np.concatenate([np.ones(ones, complex), found])
        return together[np.argsort(-np.abs(together), kind="stable")], found
    return found, np.delete(found, np.argmin(np.abs(found - 1))) if autonomous else found


def stability_of(others: np.ndarray, like) -> str:
    """The stability by the multipliers that are not 1 in any case."""
    near = digits(CIRCLE, like)
    sizes = np.abs(others)
    if np.any(sizes > 1 + near):
        return "unstable"
    on = others[sizes >= 1 - near]
    if len(others) and not len(on):
        return "stable"
    return "elliptic" if len(on) and np.all(np.abs(np.imag(on)) > near) else "neutral"


def _divided(matrices: list[np.ndarray], known: np.ndarray) -> tuple[list[np.ndarray], int]:
    """The matrices of what is left when the known directions and what becomes of them are divided out; their number."""
    if not known.shape[1]:
        return matrices, 0
    left, sizes, _ = np.linalg.svd(known / np.linalg.norm(known, axis=0), full_matrices=True)
    ones = int(np.sum(sizes > DEPENDENT * sizes[0]))
    along, first = left[:, :ones], left[:, ones:]
    across, divided = first, []
    for i, matrix in enumerate(matrices):
        along = np.linalg.qr(matrix @ along)[0]
        after = first if i == len(matrices) - 1 else np.linalg.svd(along, full_matrices=True)[0][:, ones:]
        divided.append(after.T @ matrix @ across)
        across = after
    return divided, ones


def _destroyed(matrices: list[np.ndarray]) -> int:
    """How many directions the orbit destroys, over as many turns as it may take.

    Each piece is judged by itself, like a jump in `frames`: contraction over a whole period may be as strong as
    rounding, within one piece it must not be.
    """
    n = len(matrices[0])
    columns = np.eye(n)
    for matrix in matrices * n:
        moved = matrix @ columns
        scale = digits(frames.LOST, matrix) * max(1.0, float(np.max(np.abs(matrix))))
        columns = _independent(moved, scale)
    return int(np.sum(np.all(columns == 0, axis=0)))


def _independent(columns: np.ndarray, scale: float) -> np.ndarray:
    """Orthonormal columns, zero where one depends on those before."""
    out = np.zeros_like(columns)
    for j, column in enumerate(columns.T):
        for _ in range(2):
            column = column - out @ (out.T @ column)
        length = np.linalg.norm(column)
        out[:, j] = column / length if length > scale else 0.0
    return out
