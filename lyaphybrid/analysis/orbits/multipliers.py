"""The Floquet multipliers of an orbit, and its stability."""

import functools

import numpy as np

from ..._jax.precision import digits
from ..._linalg import frames
from ..._linalg.products import even_units, in_units, product_eigenvalues
from ...errors import RunFailedError
from ...systems.smooth import Map
from .motion.motions import Motion
from .shooting import OrbitIterate, placed, shares_of, shot

__all__ = ["matrices_of", "multipliers_of", "stability_of"]

CIRCLE = 1e-7  # a multiplier nearer to the unit circle than this is on it
DEPENDENT_SINGULAR_VALUE = 1e-6  # relative size below which a singular value means linear dependence

# What is left of a direction beside another where M does not tell whether it is lost: more than rounding, but little.
NOTHING_LEFT, HARDLY_LEFT = 2e-15, 1e-9
CUTS = 4  # pieces that such a piece becomes


def matrices_of(flow: Motion, orbit: OrbitIterate) -> list[np.ndarray]:
    """The derivatives (n, n) of the pieces of an orbit; of shorter pieces where rounding could hide a direction.

    A motion that lingers near a saddle stretches so much in one piece that what it contracts looks destroyed. What a
    jump destroys is gone in a shorter piece, too.
    """
    matrices = [piece.matrix for piece in orbit.pieces]
    left = _least_left(matrices)
    if not NOTHING_LEFT < left < HARDLY_LEFT or isinstance(flow.problem.system, Map):
        return matrices
    try:
        nodes = placed(flow, orbit.nodes[0], orbit.period, CUTS * len(orbit.nodes))
        finer = shot(flow, nodes, shares_of(nodes, orbit.period), orbit.period, 0, orbit.shift)
    except RunFailedError:
        return matrices
    shorter = [piece.matrix for piece in finer.pieces]
    return matrices if finer.torn or _least_left(shorter) < HARDLY_LEFT else shorter


def _least_left(matrices: list[np.ndarray]) -> float:
    """The least ratio of the smallest to the greatest singular value of a matrix; 1 where some are not finite."""
    if not all(np.all(np.isfinite(matrix)) for matrix in matrices):
        return 1.0
    return min(1 / float(np.linalg.cond(matrix)) for matrix in matrices)


def multipliers_of(matrices: list[np.ndarray], known: np.ndarray, free: int, autonomous: bool):
    """All multipliers (free,), the largest first, and those that decide on the stability.

    In a family a double multiplier 1 has only one eigenvector, and rounding would change it by the square root of the
    rounding error. So the directions that are known to be mapped to themselves are divided out first. Nothing depends
    on the units of the state.

    Args:
        matrices: (n, n) of the pieces, in the order in which they act.
        known: (n, d) directions at the start whose multipliers are 1; if there are any, the flow is one of them.
        free: number of degrees of freedom.
        autonomous: whether one multiplier is 1 along the flow.
    """
    units = even_units(functools.reduce(lambda product, matrix: matrix @ product, matrices))
    matrices, ones = _divided([in_units(matrix, units) for matrix in matrices], known / units[:, None])
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
    """The stability from the multipliers that are not 1 by necessity."""
    near = digits(CIRCLE, like)
    sizes = np.abs(others)
    if np.any(sizes > 1 + near):
        return "unstable"
    on = others[sizes >= 1 - near]
    if len(others) and not len(on):
        return "stable"
    return "elliptic" if len(on) and np.all(np.abs(np.imag(on)) > near) else "neutral"


def _divided(matrices: list[np.ndarray], known: np.ndarray) -> tuple[list[np.ndarray], int]:
    """The matrices on the quotient by the known directions and their images; and the number of these."""
    if not known.shape[1]:
        return matrices, 0
    left, sizes, _ = np.linalg.svd(known / np.linalg.norm(known, axis=0), full_matrices=True)
    ones = int(np.sum(sizes > DEPENDENT_SINGULAR_VALUE * sizes[0]))
    along, first = left[:, :ones], left[:, ones:]
    across, divided = first, []
    for i, matrix in enumerate(matrices):
        along = np.linalg.qr(matrix @ along)[0]
        after = first if i == len(matrices) - 1 else np.linalg.svd(along, full_matrices=True)[0][:, ones:]
        divided.append(after.T @ matrix @ across)
        across = after
    return divided, ones


def _destroyed(matrices: list[np.ndarray]) -> int:
    """The number of directions that the orbit destroys, over up to n turns.

    Each piece is judged by itself, like a jump in `frames`: over a whole period contraction alone may reach the size of
    rounding, within one piece it must not.
    """
    n = len(matrices[0])
    columns = np.eye(n)
    for matrix in matrices * n:
        moved = matrix @ columns
        scale = digits(frames.LOST, matrix) * max(1.0, float(np.max(np.abs(matrix))))
        columns = _independent(moved, scale)
    return int(np.sum(np.all(columns == 0, axis=0)))


def _independent(columns: np.ndarray, scale: float) -> np.ndarray:
    """Orthonormal columns; zero where a column depends on those before it."""
    out = np.zeros_like(columns)
    for j, column in enumerate(columns.T):
        for _ in range(2):
            column = column - out @ (out.T @ column)
        length = np.linalg.norm(column)
        out[:, j] = column / length if length > scale else 0.0
    return out
