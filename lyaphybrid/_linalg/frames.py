"""Frames: k perturbations of a point, held as the columns of an (n, k) array, and their orthonormalisation.

The diagonal R_ii that an orthonormalisation throws away is positive; its logarithms are what exponents are
made of (Benettin et al., Meccanica 15 (1980) 9, doi:10.1007/BF02128236). A column that has become dependent
on the ones before it is *lost*: its ln R_ii is -inf in truth, and it is reported as lost rather than summed. One that
a jump only makes short, if by 1e-20, is not: what tells them apart is the size of the terms that cancel.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._jax.precision import digits, eps, is_short, nonzero

__all__ = ["KINDS", "orthonormalise", "refill", "staggered", "unit_vectors"]

KINDS = ("mgs", "lapack", "cholesky")
FEW = 4  # up to so many rows a product is written out: no loop
UNROLL = 16  # up to so many columns Gram–Schmidt is unrolled: 1.2 to 1.5 times as fast as a loop, but longer to compile
BLOCKS_FROM = 32  # from so many columns on products of matrices are faster (n=64: 58 µs, column by column 148)
PANEL = 32  # columns of a panel, at most
UNEVEN = 300.0  # a larger ratio of lengths in a panel may cost more than 1e-11 of its orthogonality
LOST = 1e-12  # a column is lost at a jump where its residual is below this, relative to its length before
DEPENDENT = 1e-13  # and after several where it is below this, relative to its length now; always, to its own terms
ROUNDING = 4  # what is left of a lost column in float32, in units of eps and its length
CLEARED = 4  # times, of the columns before it: then rows of 1e-60 of the others are right
TINY = 1e-290  # a length


def kind_for(k: int) -> str:
    """The orthonormalisation that ``"auto"`` stands for, by the number of columns."""
    return "mgs" if k < BLOCKS_FROM else "cholesky"


def unit_vectors(n: int, k: int, dtype, paired: bool = False) -> np.ndarray:
    """The first k unit vectors (n, k); paired: of e_q1 … e_qm, e_pm … e_p1, n = 2m, x = (q, p)."""
    m = n // 2 if paired else n
    frame = np.zeros((n, k), dtype)
    frame[[*range(m), *reversed(range(m, n))][:k], range(k)] = 1
    return frame


def orthonormalise(
    frame: Float[Array, "n k"],
    kind: str = "mgs",
    absolute: Any = 0.0,
    relative: float = 0.0,
    sizes: Float[Array, "n k"] | None = None,
) -> tuple[Float[Array, "n k"], Float[Array, " k"], Array]:
    """Orthonormal columns spanning the same nested subspaces, and ln R_ii.

    Args:
        frame: (n, k), k ≤ n.
        kind: "mgs", modified Gram–Schmidt; "lapack", Householder QR; "cholesky", block Gram–Schmidt with
            Cholesky panels, and column by column where these are ill-conditioned.
        absolute: a column whose residual is at most absolute + relative · its norm is lost.
        relative: see absolute; 0 (static) asks for no such test.
        sizes: magnitude of the terms of each entry, where it is known: a column is then lost only if moreover every
            entry of its residual is at most `DEPENDENT` · the terms that it is the sum of. What is short by itself,
            and not by cancellation, is no rounding, however short.

    Returns:
        The columns (n, k), zero where lost; ln R_ii (k,), zero where lost; and which columns were lost (k,).
    """
    tolerance = _tolerance(frame, absolute, relative) if tracked(relative) else 0.0
    tolerance = jnp.where(jnp.isfinite(tolerance), jnp.maximum(tolerance, 0.0), -1.0)  # an overflow is no loss
    columns, lengths = _columns_and_lengths(frame, kind, tolerance if tracked(relative) else None)
    lost = lengths <= tolerance
    if sizes is not None:
        columns, lengths, lost = jax.lax.cond(
            jnp.any(lost),
            lambda *_: _entry_by_entry(frame, sizes, tolerance),
            lambda *found: found,
            columns,
            lengths,
            lost,
        )
    log_r = jnp.log(jnp.where(lost, 1.0, jnp.maximum(lengths, nonzero(TINY, lengths))))
    return jnp.where(lost[None, :], 0.0, columns), log_r, lost


def _tolerance(frame, absolute, relative: float):
    """Residuals up to which columns are lost.

    In float32 what a strong stretch leaves of a column is not far above rounding: a column is lost only where it is
    short against itself and against what it was.
    """
    if not is_short(frame):
        return absolute + relative * _norm(frame)
    return jnp.where(absolute < 0, -1.0, ROUNDING * eps(frame) * jnp.minimum(4.0, _norm(frame)))


def _columns_and_lengths(frame, kind: str, tolerance):
    """By the way asked for. What is left of a lost column is rounding: later ones must not lose its direction."""
    floors = None if tolerance is None else _floors(tolerance)
    if kind == "mgs":
        k = frame.shape[1]
        if k <= 3 and floors is not None:
            return _by_columns(frame, floors)
        return (_unrolled if k <= UNROLL else _in_a_loop)(frame, floors)
    found = _householder(frame) if kind == "lapack" else _cholesky(frame, floors)
    if tolerance is None:
        return found
    again = jnp.any(found[1] <= tolerance)
    return jax.lax.cond(again, lambda _: _in_a_loop(frame, floors), lambda found: found, found)


def _floors(tolerance):
    """The squares up to which columns are lost."""
    return jnp.where(tolerance < 0, -1.0, tolerance**2)


def tracked(relative: float) -> bool:
    """Whether a relative tolerance asks for lost columns at all (the choice is static)."""
    return relative > 0


def _norm(v):
    """The Euclidean norm along the first axis, with a derivative at 0."""
    square = jnp.sum(v * v, axis=0)
    return _root(square)


def _root(square):
    """The square root, with a derivative at 0; nan stays, for a column that is no number must not look lost."""
    nothing = square <= 0
    return jnp.where(nothing, 0.0, jnp.sqrt(jnp.where(nothing, 1.0, square)))


def _scaled(columns, squares):
    """Orthogonal columns made orthonormal, and their lengths."""
    lengths = _root(squares)
    return columns / jnp.maximum(lengths, nonzero(TINY, lengths))[None, :], lengths


def _inverse(square, floors, j):
    """1/|column j|²; 0 where the column is lost."""
    inverse = 1 / jnp.maximum(square, nonzero(TINY, square))
    return inverse if floors is None else jnp.where(square > floors[j], inverse, 0.0)


def _by_columns(frame, floors=None):
    """Modified Gram–Schmidt as it stands in books, written out pair by pair.

    Where columns may be lost each is cleared of the earlier ones twice: what the first time leaves of one that nearly
    depends on them is rounding in part (20 neurons: 1e-10 of a lost column), and would make a frame that is not
    orthonormal.
    """
    y = [frame[:, j] for j in range(frame.shape[1])]
    squares = []

    def less(v, i):
        return v - (y[i] @ v * _inverse(squares[i], floors, i)) * y[i]

    for j in range(len(y)):
        if floors is not None:
            y[j] = functools.reduce(less, range(j), y[j])
        squares.append(y[j] @ y[j])
        y[j + 1 :] = [less(v, j) for v in y[j + 1 :]]
    return _scaled(jnp.stack(y, axis=1), jnp.stack(squares))


def _overlaps(column, rest):
    """Column @ rest."""
    if len(column) > FEW:
        return column @ rest
    return functools.reduce(jnp.add, [one * row for one, row in zip(column, rest, strict=True)])


def _remove(rest, column, j: int | Array, floors):
    """Take the direction of column j out of all later columns; also |column j|²."""
    overlap = _overlaps(column, rest)
    square = overlap[j]
    share = jnp.where(jnp.arange(rest.shape[1]) > j, overlap * _inverse(square, floors, j), 0.0)
    return rest - column[:, None] * share[None, :], square


def _cleared(rest, column, j: int | Array, squares, floors):
    """The column j without what is still in it of all earlier ones."""
    share = jnp.where(jnp.arange(rest.shape[1]) < j, (column @ rest) * _inverse(squares, floors, slice(None)), 0.0)
    return column - rest @ share


def _unrolled(frame, floors=None):
    """The same, one column against all others."""
    squares: list = []
    for j in range(frame.shape[1]):
        column = frame[:, j]
        if floors is not None and j > 0:
            known = jnp.stack([*squares, *[jnp.zeros_like(squares[0])] * (frame.shape[1] - j)])
            column = _cleared(frame, column, j, known, floors)
            frame = frame.at[:, j].set(column)
        frame, square = _remove(frame, column, j, floors)
        squares.append(square)
    return _scaled(frame, jnp.stack(squares))


def _in_a_loop(frame, floors=None):
    """The same as a loop, for many columns."""

    def remove(j, state):
        rest, squares = state
        column = jax.lax.dynamic_index_in_dim(rest, j, axis=1, keepdims=False)
        if floors is not None:
            column = _cleared(rest, column, j, squares, floors)
            rest = jax.lax.dynamic_update_index_in_dim(rest, column, j, axis=1)
        rest, square = _remove(rest, column, j, floors)
        return rest, squares.at[j].set(square)

    k = frame.shape[1]
    return _scaled(*jax.lax.fori_loop(0, k, remove, (frame, jnp.zeros(k, frame.dtype))))


def _entry_by_entry(frame, sizes, tolerance):
    """Column by column, with the size of what each entry is the sum of; also which columns are lost.

    Rows may be of very different sizes, as behind a reset of what was fast before, and a column is judged by the entry
    that is known best. What a small row holds comes out where clearing leaves no more than that of the large ones:
    each time leaves rounding of what was left before.
    """

    def clear(j, state):
        columns, known, lengths, lost = state
        y, size = frame[:, j], sizes[:, j]
        for _ in range(CLEARED):
            share = y @ columns
            y, size = y - columns @ share, size + known @ jnp.abs(share)
        length = _norm(y)
        gone = (length <= tolerance[j]) & jnp.all(jnp.abs(y) <= digits(DEPENDENT, y) * size)
        inverse = jnp.where(gone, 0.0, 1 / jnp.maximum(length, nonzero(TINY, length)))
        new = columns.at[:, j].set(y * inverse), known.at[:, j].set(size * inverse)
        return *new, lengths.at[j].set(length), lost.at[j].set(gone)

    k, nothing = frame.shape[1], jnp.zeros_like(frame)
    start = nothing, nothing, nothing[0], jnp.zeros(k, bool)
    columns, _, lengths, lost = jax.lax.fori_loop(0, k, clear, start)
    return columns, lengths, lost


def _householder(frame):
    q, r = jnp.linalg.qr(frame)
    diagonal = jnp.diagonal(r)
    sign = jnp.where(diagonal < 0, -1.0, 1.0)
    return q * sign[None, :], jnp.abs(diagonal)


def _cholesky(frame, floors=None):
    """Half the columns, then the other half less what they share, and so on; panels by their Gram matrices.

    Nearly all of it are products of matrices: at 64 columns two thirds of the time of LAPACK. A panel loses its
    orthogonality as the square of its condition number; a panel for which that matters is rare, for its columns
    are neighbours, and then all is done column by column.
    """
    columns, lengths, uneven = orthonormal_by_blocks(frame)
    good = (uneven < UNEVEN) & jnp.all(jnp.isfinite(lengths))
    return jax.lax.cond(good, lambda _: (columns, lengths), lambda frame: _in_a_loop(frame, floors), frame)


@jax.jit
def orthonormal_by_blocks(frame):
    """Orthonormal columns, their lengths, and the largest ratio of lengths in one panel.

    `lyaphybrid.native` knows this function by its name, and computes the same in place, by BLAS and LAPACK. Within,
    columns lie as rows: XLA's products of a transposed matrix with another cost up to thirty times as much.
    """
    columns, lengths, uneven = _halved(frame.T)
    return columns.T, lengths, uneven


def _halved(columns):
    """Orthonormal columns, their lengths, and the largest ratio of lengths in one panel; columns lie as rows (k, n)."""
    k = columns.shape[0]
    if k <= PANEL:
        columns, lengths = _by_gram_matrix(columns)
        return columns, lengths, jnp.max(lengths) / jnp.min(lengths)
    first, first_lengths, one = _halved(columns[: k // 2])
    rest = columns[k // 2 :]
    rest, rest_lengths, other = _halved(rest - (rest @ first.T) @ first)
    lengths = jnp.concatenate([first_lengths, rest_lengths])
    return jnp.concatenate([first, rest]), lengths, jnp.maximum(one, other)


def _by_gram_matrix(panel):
    """Y = Q R with R from YᵀY = Rᵀ R = L D Lᵀ, D = diag(R)²; columns lie as rows: Qᵀ = D^(-1/2) L⁻¹ Yᵀ.

    Elimination, L⁻¹ grows where zeros would.
    """
    k = panel.shape[0]
    index = jnp.arange(k)

    def eliminate(j, state):
        row, column = state[j], jax.lax.dynamic_index_in_dim(state, j, axis=1, keepdims=False)
        factor = jnp.where(index > j, column / row[j], 0.0)[:, None]
        below = (index > j)[:, None] & (index == j)[None, :]
        return jnp.where(below, -factor, state - factor * row[None, :])

    state = jax.lax.fori_loop(0, k, eliminate, panel @ panel.T)
    lengths = jnp.sqrt(jnp.diagonal(state))
    inverse = jnp.tril(state, -1) + jnp.eye(k, dtype=state.dtype)
    return (inverse / lengths[:, None]) @ panel, lengths


def staggered(frame: Float[Array, "n k"]) -> Float[Array, "n m"]:
    """Rows that do not all begin at the same place of a memory page: several at once would be in each other's way.

    64 disks with all columns: what an event does to the frame takes two thirds of the time.
    """
    return jnp.pad(frame, ((0, 0), (0, 4))) if frame.shape[1] % 32 == 0 else frame


def refill(frame: Float[Array, "n k"], project, live: Array) -> tuple[Float[Array, "n k"], Int[Array, " k"]]:
    """Move the live columns to the front and fill the empty ones with new directions, where there is room.

    A direction that is gone stays gone for its exponent; its column goes on with a fresh direction of the
    tangent space, so that a later loss is seen as a loss.

    Args:
        frame: (n, k), orthonormal columns and zeros.
        project: dx (n,) -> its projection onto the tangent space of the present mode.
        live: (k,), which columns are not empty.

    Returns:
        The frame, and where each of its columns was before: new[i] came from old[source[i]].
    """
    n, k = frame.shape
    count = jnp.sum(live)
    place = jnp.where(live, jnp.cumsum(live) - 1, count + jnp.cumsum(~live) - 1)
    source = jnp.argmax(place[None, :] == jnp.arange(k)[:, None], axis=1).astype(jnp.int32)
    frame = frame[:, source]
    basis = jax.vmap(project)(jnp.eye(n, dtype=frame.dtype))  # rows: projected unit vectors

    def fill(j, frame):
        rest = basis
        for _ in range(2):  # twice is enough to be orthogonal to rounding
            overlap = jnp.sum(rest[:, :, None] * frame[None, :, :], axis=1)
            rest = rest - jnp.sum(overlap[:, None, :] * frame[None, :, :], axis=-1)
        lengths = _norm(rest.T)
        best = jnp.argmax(lengths)
        fresh = rest[best] / jnp.maximum(lengths[best], nonzero(TINY, lengths))
        wanted = (j >= count) & (lengths[best] > digits(1e-6, lengths))
        return jnp.where(wanted & (jnp.arange(k) == j)[None, :], fresh[:, None], frame)

    return jax.lax.fori_loop(0, k, fill, frame), source


def log_abs_det(matrix: Float[Array, "n n"]) -> Float[Array, ""]:
    """ln|det| by Gaussian elimination with row pivoting, as a loop of vector operations; -inf if singular."""
    n = matrix.shape[0]
    index = jnp.arange(n)

    def eliminate(j, state):
        a, total = state
        column = jax.lax.dynamic_index_in_dim(a, j, axis=1, keepdims=False)
        pivot = jnp.argmax(jnp.where(index >= j, jnp.abs(column), -1.0))
        row, other = a[pivot], a[j]
        value = row[j]
        a = jnp.where((index == pivot)[:, None], other[None, :], a)
        a = jnp.where((index == j)[:, None], row[None, :], a)
        column = jax.lax.dynamic_index_in_dim(a, j, axis=1, keepdims=False)
        factor = jnp.where(index > j, column / jnp.where(value == 0, 1.0, value), 0.0)
        size = jnp.abs(value)
        regular = size > nonzero(TINY, size)
        log = jnp.where(regular, jnp.log(jnp.where(regular, size, 1.0)), -jnp.inf)
        return a - factor[:, None] * row[None, :], total + log

    return jax.lax.fori_loop(0, n, eliminate, (matrix, jnp.zeros((), matrix.dtype)))[1]
