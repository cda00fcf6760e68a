"""The Floquet multipliers of an orbit, and its stability."""

import functools
from typing import NamedTuple

import numpy as np

from ..._jax.precision import digits
from ..._linalg import frames
from ..._linalg.products import even_units, in_units, product_eigenvalues
from ...errors import RunFailedError
from ...systems.smooth import Map
from .motion.motions import Motion, MotionPiece
from .shooting import OrbitIterate

__all__ = ["matrices_of", "multipliers_of", "stability_of"]

CIRCLE = 1e-7  # a multiplier nearer to the unit circle than this is on it
DEPENDENT_SINGULAR_VALUE = 1e-6  # relative size below which a singular value means linear dependence

# What is left of a direction beside another where M does not tell whether it is lost: more than rounding, but little.
NOTHING_LEFT, HARDLY_LEFT = 2e-15, 1e-9
MUCH_LEFT = 1e-4  # where the flow leaves so much, what is lost in an equal time was lost by a jump
MOST_HALVINGS = 9  # of a piece
CLEAR_OF_EVENTS = 0.02  # of a piece: distance of its cut from events


class OrbitMultipliers(NamedTuple):
    """The multipliers of an orbit."""

    values: np.ndarray  # (free,), the largest first
    logs: np.ndarray  # (free,) ln|·|, of those too small for a number, too; −inf: the orbit destroys the direction
    deciding: np.ndarray  # those that are not 1 by necessity


def matrices_of(flow: Motion, orbit: OrbitIterate) -> list[np.ndarray]:
    """The derivatives (n, n) of the pieces of an orbit; of shorter pieces where rounding could hide a direction.

    What a motion contracts by more than 1e-15 in one piece looks destroyed, as what it contracts beside a direction
    that it stretches. In shorter pieces it does not; what a jump destroys is gone in each of them.
    """
    return [one for piece in orbit.pieces for one in _cut(flow, piece, orbit.units, MOST_HALVINGS, False)]


def _cut(flow: Motion, piece: MotionPiece, units: np.ndarray, halvings: int, mild: bool) -> list[np.ndarray]:
    """The derivatives of the parts of a piece; `mild`: the flow beside it contracts little in an equal time."""
    left = _left_of(piece, units)
    by_jump = left <= NOTHING_LEFT and (mild or _is_bound(flow, piece))
    if left >= HARDLY_LEFT or by_jump or not halvings:
        return [piece.matrix]
    halves = _halves(flow, piece)
    mild = any(not half.jumps and _left_of(half, units) > MUCH_LEFT for half in halves)
    parts = [_cut(flow, half, units, halvings - 1, mild and half.jumps > 0) for half in halves]
    return [one for part in parts for one in part] or [piece.matrix]


def _left_of(piece: MotionPiece, units: np.ndarray) -> float:
    """What a piece leaves of each direction: of its length, and beside what it stretches; 1 where it is not finite."""
    matrix = in_units(piece.matrix, units)
    if not len(matrix) or not np.all(np.isfinite(matrix)):
        return 1.0
    sizes = np.linalg.svd(matrix, compute_uv=False)
    return float(sizes[-1] / max(1.0, sizes[0]))


def _is_bound(flow: Motion, piece: MotionPiece) -> bool:
    """Whether a mode of a piece has fewer directions than the state has components."""
    if isinstance(flow.problem.system, Map):
        return False
    modes = {int(mode) for mode in [*np.unique(piece.modes), piece.mode]}
    bound = getattr(flow.problem.system, "tangent", ())
    narrow = any(flow.degrees_of_freedom(piece.end._replace(mode=mode)) < len(piece.matrix) for mode in modes)
    return narrow or any(bound[mode] is not None for mode in modes if mode < len(bound))


def _halves(flow: Motion, piece: MotionPiece) -> list[MotionPiece]:
    """The two parts of a piece, cut away from its events; none where it cannot be cut."""
    at = 0.5 * piece.length
    if isinstance(flow.problem.system, Map):
        at = piece.length // 2
    elif piece.events is not None and len(piece.events.t):
        tried = piece.length * np.linspace(0.3, 0.7, 21)
        apart = np.min(np.abs(tried[:, None] - np.asarray(piece.events.t)), axis=1)
        clear = tried[apart > CLEAR_OF_EVENTS * piece.length]
        at = float(clear[np.argmin(np.abs(clear - at))] if len(clear) else tried[np.argmax(apart)])
    if not 0 < at < piece.length:
        return []
    try:
        first = flow.piece(piece.start, at)
        second = flow.piece(first.end._replace(without=piece.start.without), piece.length - at)
    except RunFailedError:
        return []
    same = second.mode == piece.mode and first.jumps + second.jumps == piece.jumps
    return [first, second] if same else []


def multipliers_of(matrices: list[np.ndarray], known: np.ndarray, free: int, autonomous: bool) -> OrbitMultipliers:
    """All multipliers (free,), and those that decide on the stability.

    In a family a double multiplier 1 has only one eigenvector, and rounding would change it by the square root of the
    rounding error. So the directions that are known to be mapped to themselves are divided out first. Nothing depends
    on the units of the state.

    Args:
        matrices: (n, n) of the pieces, in the order in which they act.
        known: (n, d) directions at the start whose multipliers are 1; if there are any, the flow is one of them.
        free: number of degrees of freedom.
        autonomous: whether one multiplier is 1 along the flow.
    """
    units = even_units(functools.reduce(_direction_of_product, matrices))
    matrices, ones = _divided([in_units(matrix, units) for matrix in matrices], known / units[:, None])
    found, logs = product_eigenvalues(matrices) if len(matrices[0]) else (np.zeros(0, complex), np.zeros(0))
    order, n = np.argsort(-logs, kind="stable"), len(found)
    found, logs = found[order][: free - ones], logs[order][: free - ones]
    lost = n - _destroyed(matrices)
    found[lost:], logs[lost:] = 0.0, -np.inf
    if ones:
        together, logs = np.concatenate([np.ones(ones, complex), found]), np.concatenate([np.zeros(ones), logs])
        order = np.argsort(-logs, kind="stable")
        return OrbitMultipliers(together[order], logs[order], found)
    others = np.delete(found, np.argmin(np.abs(found - 1))) if autonomous else found
    return OrbitMultipliers(found, logs, others)


def _direction_of_product(product: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The product but for its size, which may be smaller than any number."""
    product = matrix @ product
    return product / (np.max(np.abs(product), initial=0.0) or 1.0)


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
