"""The Floquet multipliers of an orbit, and its stability."""

import functools
from typing import NamedTuple

import numpy as np

from ..._jax.precision import digits
from ..._linalg import frames
from ..._linalg.foreign_shares import is_foreign, rearranged, shares_after, shares_of_none
from ..._linalg.products import even_units, in_units, product_eigenvalues
from ...errors import RunFailedError
from ...systems.event_driven import EventDriven
from ...systems.smooth import Map
from .motion.growths import growths_of
from .motion.motions import Motion, MotionPiece
from .shooting import OrbitIterate

__all__ = ["matrices_of", "multipliers_of", "seen_in_turns", "stability_of"]

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
    unsure: bool  # whether a direction that counts as destroyed may only be short


def matrices_of(flow: Motion, orbit: OrbitIterate) -> list[np.ndarray]:
    """The derivatives (n, n) of the pieces of an orbit; of shorter pieces where rounding could hide a direction.

    What a motion contracts by more than 1e-15 in one piece looks destroyed, as what it contracts beside a direction
    that it stretches. In shorter pieces it does not; what a jump destroys is gone in each of them.
    """
    return [one for piece in orbit.pieces for one in _cut(flow, piece, orbit.units, MOST_HALVINGS, False)]


def _cut(flow: Motion, piece: MotionPiece, units: np.ndarray, halvings: int, mild: bool) -> list[np.ndarray]:
    """The derivatives of the parts of a piece; `mild`: the flow beside it contracts little in an equal time."""
    sizes = _left_of(piece, units)
    left, alone = sizes[-1], bool(np.all(sizes[:-1] >= HARDLY_LEFT))
    by_jump = left <= NOTHING_LEFT and (mild or alone and _is_bound(flow, piece))
    if left >= HARDLY_LEFT or by_jump or not halvings:
        return [piece.matrix]
    halves = _halves(flow, piece)
    mild = any(not half.jumps and _left_of(half, units)[-1] > MUCH_LEFT for half in halves)
    parts = [_cut(flow, half, units, halvings - 1, mild and half.jumps > 0) for half in halves]
    return [one for part in parts for one in part] or [piece.matrix]


def _left_of(piece: MotionPiece, units: np.ndarray) -> np.ndarray:
    """What a piece leaves of its directions, the least last: of their lengths, and beside what it stretches.

    It is 1 where the piece is not finite.
    """
    matrix = in_units(piece.matrix, units)
    if not len(matrix) or not np.all(np.isfinite(matrix)):
        return np.ones(1)
    sizes = np.linalg.svd(matrix, compute_uv=False)
    return sizes / max(1.0, sizes[0])


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
    destroyed, unsure = _destroyed(matrices)
    lost = n - destroyed
    found[lost:], logs[lost:] = 0.0, -np.inf
    if ones:
        together, logs = np.concatenate([np.ones(ones, complex), found]), np.concatenate([np.zeros(ones), logs])
        order = np.argsort(-logs, kind="stable")
        return OrbitMultipliers(together[order], logs[order], found, unsure)
    others = np.delete(found, np.argmin(np.abs(found - 1))) if autonomous else found
    return OrbitMultipliers(found, logs, others, unsure)


def seen_in_turns(flow: Motion, orbit: OrbitIterate, found: OrbitMultipliers) -> OrbitMultipliers:
    """The multipliers, those that seem destroyed by what a turn does to columns that are orthonormalised on the way.

    The derivative of a piece cannot tell much contraction from a loss; each step can, and each jump.
    """
    n, base, seems = len(orbit.nodes[0].x), orbit.nodes[0], np.isneginf(found.logs)
    discrete = isinstance(flow.problem.system, Map)
    whole = len(found.logs) == n > 1 and base.without is None and flow.symmetry is None
    if not np.any(seems) or discrete or not whole:
        return found
    smooth = not any(piece.jumps for piece in orbit.pieces) and not any(_is_bound(flow, one) for one in orbit.pieces)
    growths = growths_of(flow, base, float(orbit.period), smooth and not isinstance(flow.problem.system, EventDriven))
    if growths is None:
        return found._replace(logs=np.where(seems, np.nan, found.logs) if smooth else found.logs, unsure=True)
    values = np.where(seems, growths.signs * np.exp(growths.logs), found.values)
    return found._replace(values=values, logs=np.where(seems, growths.logs, found.logs), unsure=growths.unsure)


def _direction_of_product(product: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The product but for its size, which may be smaller than any number."""
    product = matrix @ product
    return product / (np.max(np.abs(product), initial=0.0) or 1.0)


def stability_of(others: np.ndarray, like, isolated: bool) -> str:
    """The stability from the multipliers that are not 1 by necessity; `isolated`: of an orbit in no family."""
    near = digits(CIRCLE, like)
    sizes = np.abs(others)
    if np.any(sizes > 1 + near):
        return "unstable"
    on = others[sizes >= 1 - near]
    if not len(on) and (len(others) or isolated):  # with one component a motion that returns is attracted at once
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


def _destroyed(matrices: list[np.ndarray]) -> tuple[int, bool]:
    """The number of directions that the orbit destroys, over up to n turns, and whether it is unsure.

    Each piece is judged by itself, like a jump in `frames`: over a whole period contraction alone may reach the size of
    rounding, within one piece it must not. What is left may become rounding beside what was destroyed, as in the loop.
    """
    n = len(matrices[0])
    columns, gone, unsure = np.eye(n), np.zeros(n, bool), False
    shares = shares_of_none(n, columns, np)
    for matrix in matrices * n:
        scale = digits(frames.LOST, matrix) * max(1.0, float(np.max(np.abs(matrix))))
        columns, lengths = _independent(matrix @ columns, scale)
        lost = lengths == 0
        shares = shares_after(shares, np.log(np.where(lost, 1.0, lengths)), lost, np)
        unsure = unsure or bool(is_foreign(shares, np))
        order = np.argsort(lost, kind="stable")  # new directions come after what is left
        gone = (gone | lost)[order]
        columns, shares = _completed(columns[:, order], n - int(np.sum(lost))), rearranged(shares, order, gone, np)
    return int(np.sum(gone)), unsure


def _independent(columns: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal columns and their lengths; zero where a column depends on those before it."""
    out, lengths = np.zeros_like(columns), np.zeros(columns.shape[1])
    for j, column in enumerate(columns.T):
        for _ in range(2):
            column = column - out @ (out.T @ column)
        length = np.linalg.norm(column)
        if length > scale:
            out[:, j], lengths[j] = column / length, length
    return out, lengths


def _completed(columns: np.ndarray, count: int) -> np.ndarray:
    """The first `count` columns, which are orthonormal, and others that complete the basis."""
    return np.concatenate([columns[:, :count], np.linalg.svd(columns[:, :count])[0][:, count:]], axis=1)
