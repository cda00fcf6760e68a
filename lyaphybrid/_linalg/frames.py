"""Frames: k perturbations of a point, held as the columns of an (n, k) array, and their orthonormalisation.

The diagonal entries R_ii of an orthonormalisation are positive; exponents are averages of their logarithms (Benettin et
al., Meccanica 15 (1980) 9, doi:10.1007/BF02128236). A column that is linearly dependent on earlier columns is *lost*:
its exact ln R_ii is -inf, and it is reported as lost instead of added. A column that a jump only makes short, even by a
factor of 1e-20, is not lost: the two cases differ in the magnitude of the terms that cancel.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._jax.precision import digits, eps, is_short, nonzero

__all__ = ["QR_ALGORITHMS", "generic_frame", "orthonormalise", "orthonormalise_after_jump", "refill", "unit_vectors"]

QR_ALGORITHMS = ("mgs", "lapack", "cholesky")
MOST_ROWS_UNROLLED = 4  # products with at most so many rows are written out without a loop
UNROLL = 16  # Gram–Schmidt with at most so many columns is unrolled: faster than a loop, but longer to compile
BLOCKS_FROM = 32  # from this number of columns block Gram–Schmidt is faster than column by column
PANEL = 32  # most columns of a panel
UNEVEN = 300.0  # with a larger ratio of lengths in a panel the orthogonality error may exceed 1e-11
LOST = 1e-12  # after one jump a column is lost if its residual is below this, relative to its length before the jump
DEPENDENT = 1e-13  # after several jumps, if it is below this relative to its present length
# After a jump whose terms are known: if its residual is below BY_TERMS · LOST, and its entries are rounding of their
# terms, below DEPENDENT of them, or n/2 times that where n > SUMS_OF_FEW. Columns that became short before, each by
# 1e-4, enlarge what rounding leaves of a lost one, up to 2e-9 for 20 neurons, and real ones are as short: one that is
# EXAMINED times longer, and within eps of its terms, is in doubt.
BY_TERMS, EXAMINED, SUMS_OF_FEW = 10.0, 1e5, 16
LOST_RESIDUAL = 4  # residual of a lost column in float32, in units of eps times its length
DECIDES = 0.01  # an entry decides the length of a column if it is larger than this times the largest one
REORTHOGONALISATIONS = 4  # times that earlier columns are removed: then rows of 1e-60 times the others are accurate too
SMALLEST_LENGTH = 1e-290  # lower bound of a length, to avoid division by zero


def kind_for(k: int) -> str:
    """The orthonormalisation that ``"auto"`` stands for, by the number of columns."""
    return "mgs" if k < BLOCKS_FROM else "cholesky"


def unit_vectors(n: int, k: int, dtype, paired: bool = False) -> np.ndarray:
    """The first k unit vectors (n, k); paired: in the order e_q1 … e_qm, e_pm … e_p1, where x = (q, p), n = 2m."""
    m = n // 2 if paired else n
    frame = np.zeros((n, k), dtype)
    frame[[*range(m), *reversed(range(m, n))][:k], range(k)] = 1
    return frame


def generic_frame(n: int, k: int, dtype) -> np.ndarray:
    """A fixed orthonormal frame (n, k) in generic directions."""
    q, r = np.linalg.qr(np.random.default_rng(20101).standard_normal((n, k)))
    return (q * np.sign(np.diag(r))).astype(dtype)


def orthonormalise(
    frame: Float[Array, "n k"],
    kind: str = "mgs",
    absolute: Any = 0.0,
    relative: float = 0.0,
) -> tuple[Float[Array, "n k"], Float[Array, " k"], Array]:
    """Orthonormal columns spanning the same nested subspaces, and ln R_ii.

    Args:
        frame: (n, k), k ≤ n.
        kind: "mgs", modified Gram–Schmidt; "lapack", Householder QR; "cholesky", block Gram–Schmidt with
            Cholesky panels, and column by column where these are ill-conditioned.
        absolute: a column is lost if its residual is at most absolute + relative · its norm.
        relative: see absolute; 0 (static) switches the test off.

    Returns:
        The columns (n, k), zero where lost; ln R_ii (k,), zero where lost; and which columns were lost (k,).
    """
    tolerance = _tolerance(frame, absolute, relative) if tracked(relative) else 0.0
    columns, lengths = _columns_and_lengths(frame, kind, tolerance if tracked(relative) else None)
    return _found(columns, lengths, lengths <= tolerance)


def orthonormalise_after_jump(
    frame: Float[Array, "n k"], kind: str, absolute: Any, sizes: Float[Array, "n k"]
) -> tuple[tuple[Float[Array, "n k"], Float[Array, " k"], Array], Array]:
    """As `orthonormalise`, of columns that a jump has moved, the magnitudes `sizes` of whose terms are known.

    A column is lost if it is short and every entry of its residual is rounding of its terms: one that is short without
    cancellation is not rounding, however short it is. Also whether it is doubtful that the others are not lost.
    """
    tolerance = (1 if is_short(frame) else BY_TERMS) * _tolerance(frame, absolute, LOST)
    n = frame.shape[0]
    examined, noise = EXAMINED * tolerance, DEPENDENT * (1.0 if n <= SUMS_OF_FEW else n / 2)
    columns, lengths = _columns_and_lengths(frame, kind, examined)
    short = lengths <= examined
    columns, lengths, lost, doubtful = jax.lax.cond(
        jnp.any(short),
        lambda *_: _entry_by_entry(frame, sizes, tolerance, noise),
        lambda *found: (*found, jnp.asarray(False)),
        columns,
        lengths,
        short,
    )
    return _found(columns, lengths, lost), doubtful


def _found(columns, lengths, lost):
    """The columns, ln R_ii, and which are lost."""
    log_r = jnp.log(jnp.where(lost, 1.0, jnp.maximum(lengths, nonzero(SMALLEST_LENGTH, lengths))))
    return _zero_where(lost, columns), log_r, lost


def _zero_where(lost, columns):
    """The columns, those that are lost set to zero; a large frame is rewritten only if there are any."""
    if columns.shape[1] < BLOCKS_FROM:
        return jnp.where(lost[None, :], 0.0, columns)
    return jax.lax.cond(
        jnp.any(lost), lambda lost, columns: jnp.where(lost[None, :], 0.0, columns), lambda _, same: same, lost, columns
    )


def _tolerance(frame, absolute, relative: float):
    """(k,) the largest residual at which each column is lost.

    In float32 a strong stretching leaves residuals not far above rounding: a column is lost only if it is short
    relative to both its present length and its length before. An overflow is not a loss.
    """
    norms = _column_norms(frame)
    tolerance = absolute + relative * norms
    if is_short(frame):
        tolerance = jnp.where(absolute < 0, -1.0, LOST_RESIDUAL * eps(frame) * jnp.minimum(4.0, norms))
    return jnp.where(jnp.isfinite(tolerance), jnp.maximum(tolerance, 0.0), -1.0)


def _columns_and_lengths(frame, kind: str, tolerance):
    """Orthonormalise by `kind`; a lost column is rounding, so its direction is not removed from later columns."""
    floors = None if tolerance is None else _floors(tolerance)
    if kind == "mgs":
        k = frame.shape[1]
        if k <= 3 and floors is not None:
            return _by_columns(frame, floors)
        return modified_gram_schmidt(frame) if floors is None else _column_by_column(frame, floors)
    found = _householder(frame) if kind == "lapack" else _cholesky(frame, floors)
    if tolerance is None:
        return found
    again = jnp.any(found[1] <= tolerance)
    return jax.lax.cond(again, lambda _: _in_a_loop(frame, floors), lambda found: found, found)


@jax.jit
def modified_gram_schmidt(frame):
    """Orthonormal columns (n, k) and their lengths (k,); `lyaphybrid.native` recognises this function by its name."""
    return _column_by_column(frame)


def _column_by_column(frame, floors=None):
    return (_unrolled if frame.shape[1] <= UNROLL else _in_a_loop)(frame, floors)


def _floors(tolerance):
    """(k,) the squared length at or below which each column is lost."""
    return jnp.where(tolerance < 0, -1.0, tolerance**2)


def tracked(relative: float) -> bool:
    """Whether lost columns are tested for: the relative tolerance is positive (static)."""
    return relative > 0


def _column_norms(v):
    """The Euclidean norm along the first axis, with a derivative at 0."""
    return _square_root(jnp.sum(v * v, axis=0))


def _square_root(square):
    """The square root, with a derivative at 0; nan stays nan, so that such a column does not look lost."""
    nothing = square <= 0
    return jnp.where(nothing, 0.0, jnp.sqrt(jnp.where(nothing, 1.0, square)))


def _scaled(columns, squares):
    """Normalise orthogonal columns; returns them and their lengths (k,)."""
    lengths = _square_root(squares)
    return columns / _divisor(lengths)[None, :], lengths


def _inverse(square, floors, j):
    """1/|column j|²; 0 where the column is lost."""
    there = square > (0.0 if floors is None else jnp.maximum(floors[j], 0.0))
    return jnp.where(there, 1 / _divisor(square, there), 0.0)


def _divisor(value, wanted: Any = True):
    """The value where it is wanted and not too small, else 1: a division by 0 makes reverse derivatives nan."""
    return jnp.where(wanted & (value > nonzero(SMALLEST_LENGTH, value)), value, 1.0)


def _by_columns(frame, floors=None):
    """Modified Gram–Schmidt in its textbook form, written out pair by pair.

    Where columns may be lost, earlier columns are removed twice from each: the first pass leaves rounding of a nearly
    dependent column (1e-10 of a lost column for 20 neurons), and the frame would not be orthonormal.
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
    """The products (k,) of one column with all columns."""
    if len(column) > MOST_ROWS_UNROLLED:
        return column @ rest
    return functools.reduce(jnp.add, [one * row for one, row in zip(column, rest, strict=True)])


def _remove(rest, column, j: int | Array, floors):
    """Remove the direction of column j from all later columns; also returns |column j|²."""
    overlap = _overlaps(column, rest)
    square = overlap[j]
    share = jnp.where(jnp.arange(rest.shape[1]) > j, overlap * _inverse(square, floors, j), 0.0)
    return rest - column[:, None] * share[None, :], square


def _cleared(rest, column, j: int | Array, squares, floors):
    """Column j with its remaining components along all earlier columns removed."""
    share = jnp.where(jnp.arange(rest.shape[1]) < j, (column @ rest) * _inverse(squares, floors, slice(None)), 0.0)
    return column - rest @ share


def _unrolled(frame, floors=None):
    """Modified Gram–Schmidt, unrolled: one column at a time is removed from all later ones."""
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
    """Modified Gram–Schmidt as a loop, for many columns."""

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


def terms_of_columns(columns, frame, terms):
    """(n, k) magnitudes of what adds up to the orthonormal columns Q, where QR = the frame, and those of the frame."""
    shares = jnp.abs(columns.T @ frame)

    def one(j, known):
        earlier = jnp.where(jnp.arange(columns.shape[1]) < j, shares[:, j], 0.0)
        length = jnp.maximum(shares[j, j], nonzero(SMALLEST_LENGTH, shares))
        return known.at[:, j].set((terms[:, j] + known @ earlier) / length)

    return jax.lax.stop_gradient(jax.lax.fori_loop(0, columns.shape[1], one, jnp.zeros_like(terms)))


def is_rounding(frame: Float[Array, "n k"], sizes: Float[Array, "n k"], noise: float) -> Array:
    """(k,) whether an entry of at most `noise` · its terms decides the length of a column, less the earlier ones."""

    def decides(y, rounding):
        return jnp.any(rounding & (jnp.abs(y) > DECIDES * jnp.max(jnp.abs(y))))

    return _entry_by_entry(frame, sizes, jnp.full(frame.shape[1], jnp.inf, frame.dtype), noise, decides)[2]


def _entry_by_entry(frame, sizes, tolerance, noise, judged=lambda y, rounding: jnp.all(rounding)):
    """Gram–Schmidt that tracks the magnitude of the terms of each entry; also which columns are lost, and if in doubt.

    Rows may have very different sizes, for example after a reset of a fast component. A column is not lost if one of
    its entries is known well. Earlier columns are removed several times: each pass leaves only rounding of the previous
    residual, until the large rows no longer hide the small ones.
    """

    def clear(j, state):
        columns, known, lengths, lost, doubtful = state
        y, size = frame[:, j], sizes[:, j]
        for _ in range(REORTHOGONALISATIONS):
            share = y @ columns
            y, size = y - columns @ share, size + known @ jnp.abs(share)
        length = _column_norms(y)
        gone = (length <= tolerance[j]) & judged(y, jnp.abs(y) <= digits(noise, y) * size)
        doubtful |= ~gone & jnp.all(jnp.abs(y) <= eps(y) * size)
        inverse = jnp.where(gone, 0.0, 1 / _divisor(length, ~gone))
        new = columns.at[:, j].set(y * inverse), known.at[:, j].set(size * inverse)
        return *new, lengths.at[j].set(length), lost.at[j].set(gone), doubtful

    k, nothing = frame.shape[1], jnp.zeros_like(frame)
    start = nothing, nothing, nothing[0], jnp.zeros(k, bool), jnp.asarray(False)
    columns, _, lengths, lost, doubtful = jax.lax.fori_loop(0, k, clear, start)
    return columns, lengths, lost, doubtful


def _householder(frame):
    q, r = jnp.linalg.qr(frame)
    diagonal = jnp.diagonal(r)
    sign = jnp.where(diagonal < 0, -1.0, 1.0)
    return q * sign[None, :], jnp.abs(diagonal)


def _cholesky(frame, floors=None):
    """In blocks. Where losses are tracked and a block is ill-conditioned: column by column, each reorthogonalised."""
    if floors is None:
        return orthonormal(frame)
    columns, lengths, uneven = orthonormal_by_blocks(frame)
    return _if_even(uneven, columns, lengths, frame, floors)


def _if_even(uneven, columns, lengths, frame, floors):
    good = (uneven < UNEVEN) & jnp.all(jnp.isfinite(lengths))
    return jax.lax.cond(good, lambda _: (columns, lengths), lambda frame: _in_a_loop(frame, floors), frame)


@jax.jit
def orthonormal(frame):
    """Orthonormal columns (n, k) and their lengths (k,).

    `lyaphybrid.native` recognises this function by its name and computes the same in place, by modified Gram–Schmidt in
    vector registers. Elsewhere it is computed in blocks, or column by column where a block is ill-conditioned.
    """
    columns, lengths, uneven = orthonormal_by_blocks(frame)
    return _if_even(uneven, columns, lengths, frame, None)


@jax.jit
def orthonormal_by_blocks(frame):
    """Orthonormal columns (n, k), their lengths (k,), and the largest ratio of lengths in one panel.

    Recursive: one half of the columns, then the other half minus its projection; panels by their Gram matrices. Nearly
    all operations are products of matrices. The orthogonality error of a panel grows with the square of its condition
    number.

    `lyaphybrid.native` recognises this function by its name, too. Inside, columns are stored as rows, because XLA
    multiplies a transposed matrix with another much more slowly.
    """
    columns, lengths, uneven = _halved(frame.T)
    return columns.T, lengths, uneven


def _halved(columns):
    """The same for columns stored as rows (k, n): orthonormal rows, lengths, largest ratio of lengths in a panel."""
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
    """Y = Q R with R from YᵀY = Rᵀ R = L D Lᵀ, D = diag(R)²; columns are stored as rows: Qᵀ = D^(-1/2) L⁻¹ Yᵀ.

    Gaussian elimination; the entries of L⁻¹ are stored in place of the zeros that it makes.
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


def refill(frame: Float[Array, "n k"], project, live: Array) -> tuple[Float[Array, "n k"], Int[Array, " k"]]:
    """Move the live columns to the front and fill empty ones with new directions, while the tangent space has any.

    The exponent of a lost direction stays -inf; its column continues with a new direction of the tangent space, so that
    later losses are detected.

    Args:
        frame: (n, k), orthonormal columns and zeros.
        project: dx (n,) -> its projection onto the tangent space of the present mode.
        live: (k,), which columns are not empty.

    Returns:
        The frame, and the previous index of each column: column i was column source[i] before.
    """
    n, k = frame.shape
    count = jnp.sum(live)
    place = jnp.where(live, jnp.cumsum(live) - 1, count + jnp.cumsum(~live) - 1)
    source = jnp.argmax(place[None, :] == jnp.arange(k)[:, None], axis=1).astype(jnp.int32)
    frame = frame[:, source]
    basis = jax.vmap(project)(jnp.eye(n, dtype=frame.dtype))  # rows: projected unit vectors

    def fill(j, frame):
        rest = basis
        for _ in range(2):  # two passes give orthogonality up to rounding
            overlap = jnp.sum(rest[:, :, None] * frame[None, :, :], axis=1)
            rest = rest - jnp.sum(overlap[:, None, :] * frame[None, :, :], axis=-1)
        lengths = _column_norms(rest.T)
        best = jnp.argmax(lengths)
        wanted = (j >= count) & (lengths[best] > digits(1e-6, lengths))
        fresh = rest[best] / _divisor(lengths[best], wanted)
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
        regular = size > nonzero(SMALLEST_LENGTH, size)
        log = jnp.where(regular, jnp.log(jnp.where(regular, size, 1.0)), -jnp.inf)
        return a - factor[:, None] * row[None, :], total + log

    return jax.lax.fori_loop(0, n, eliminate, (matrix, jnp.zeros((), matrix.dtype)))[1]
