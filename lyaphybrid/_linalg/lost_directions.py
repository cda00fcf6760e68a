"""Decide in double-double arithmetic whether a direction is lost in a step or has only become short."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jax import double_double
from .._jax.columns import each_column
from .._jax.double_double import DoubleDouble
from .._jax.magnitudes import absolute
from .._jax.precision import eps, nonzero
from .frames import SMALLEST_LENGTH

__all__ = ["MOST_COMPONENTS", "is_precise", "log_volume", "may_be_rounding", "orthonormalised"]

MOST_COMPONENTS = 16  # most components of a state; larger ones take too long to compile
REORTHOGONALISATIONS_OF_PAIRS = 10  # as in `frames`: then rows of 1e-300 times the others are accurate too
SEEDS = (0.0, 0.7310585786300049, 1.3247179572447458)  # 0: nothing is changed; two different changes of all numbers
HIDDEN = 2.0  # an entry smaller than this times its change between seeds counts as rounding
LEFT_BY_ROUNDING = (1.25, 64.0)  # an entry is so large, at least in powers of eps and at most in units of it
LARGEST_CHANGE = 0.01  # an entry whose relative change between seeds is larger is unresolved
ROUNDING_OF_PAIRS = 1e4  # in eps² times the magnitude of the terms: smaller entries are rounding of pairs


def is_precise(tangent, x) -> bool:
    """Whether the function (n,) -> (n,) can be evaluated in double-double arithmetic, and is small enough."""
    if x.size > MOST_COMPONENTS:
        return False
    try:
        jax.eval_shape(lambda dx: double_double.precise(tangent)(DoubleDouble(dx, dx), jnp.zeros((), dx.dtype)), x)
    except double_double.UnknownError:
        return False
    return True


def may_be_rounding(frame) -> Array:
    """Whether an entry of orthonormal columns has the size that rounding leaves of a sum that should be zero."""
    sizes, (least, most) = jnp.abs(frame), LEFT_BY_ROUNDING
    return jnp.any((sizes > eps(frame) ** least) & (sizes < most * eps(frame)))


def orthonormalised(tangent, frame) -> tuple[Array, Array, Array, Array]:
    """Apply a linear function to orthonormal columns and orthonormalise the result.

    Returns:
        Columns (n, k), zero where lost; ln R_ii (k,), zero where lost; which columns are lost (k,); and whether all of
        this is certain, that is, not decided by rounding of the function's own numbers or of the frame. A column whose
        length is nothing but such rounding counts as lost, and is not certain: it may only be very short.
    """
    seeds = jnp.asarray(SEEDS, frame.dtype)
    # Loops instead of `vmap`: this is rarely executed, so short code matters more than speed.
    by_pairs = double_double.precise(tangent)

    def images(seed):
        return jax.lax.map(lambda dx: by_pairs(dx, seed), double_double.changed(frame.T, seed))

    moved = jax.lax.map(images, seeds)  # (seeds, k, n)
    sizes = jax.lax.stop_gradient(each_column(absolute(tangent), jnp.abs(frame)))
    k, nothing = frame.shape[1], jnp.zeros_like(frame)

    def one(j, state):
        columns, known, lengths, lost, sure = state
        y, size = jax.tree.map(lambda a: a[:, j], moved), sizes[:, j]  # (seeds, n)

        def clear(i, state):
            y, size = state
            i = i % k
            column = jax.tree.map(lambda a: jnp.where(i < j, a[:, :, i], 0.0), columns)
            y, share = jax.lax.map(lambda both: _without_component(*both), (y, column))
            return y, size + known[:, i] * jnp.abs(share.high[0])

        y, size = jax.lax.fori_loop(0, REORTHOGONALISATIONS_OF_PAIRS * k, clear, (y, size))
        apart, here = jnp.max(jnp.abs(y.high[1:] - y.high[:1]), axis=0), jnp.abs(y.high[0])
        nothing_left, rounding = here <= ROUNDING_OF_PAIRS * eps(frame) ** 2 * size, here <= HIDDEN * apart
        gone, hidden, largest = jnp.all(nothing_left), jnp.all(rounding), jnp.max(here)
        # A next jump may depend on this entry alone: as rounding it would look like a short column there.
        y = jax.tree.map(lambda part: jnp.where(rounding, 0.0, part), y)
        unsure = (apart > LARGEST_CHANGE * here) & (here > LARGEST_CHANGE * largest)
        doubtful = jnp.any(unsure | (rounding & ~nothing_left))
        length = jax.vmap(_vector_length)(y.high)
        inverse = jnp.where(gone | hidden, 0.0, 1 / jnp.maximum(length, nonzero(SMALLEST_LENGTH, length)))
        y = jax.lax.map(
            lambda both: double_double.multiplied(both[0], _as_double_double(jnp.full_like(size, both[1]))),
            (y, inverse),
        )
        return (
            jax.tree.map(lambda a, new: a.at[:, :, j].set(new), columns, y),
            known.at[:, j].set(size * inverse[0]),
            lengths.at[j].set(length[0]),
            lost.at[j].set(gone | hidden),
            sure & (gone | ~doubtful),
        )

    several = jnp.stack([nothing] * len(SEEDS))
    start = DoubleDouble(several, several), nothing, nothing[0], jnp.zeros(k, bool), jnp.asarray(True)
    columns, _, lengths, lost, sure = jax.lax.fori_loop(0, k, one, start)
    log_r = jnp.log(jnp.where(lost, 1.0, jnp.maximum(lengths, nonzero(SMALLEST_LENGTH, lengths))))
    return columns.high[0], log_r, lost, sure


def _without_component(y: DoubleDouble, column: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """Y minus its component along a column of length 1 (up to rounding) or 0, and that component."""

    def product(a, b):
        return double_double.total(double_double.multiplied(a, b), 0)

    square = product(column, column)
    square = square._replace(high=jnp.where(square.high > 0, square.high, 1.0))
    share = double_double.divided(product(y, column), square)
    along = double_double.multiplied(DoubleDouble(*(jnp.broadcast_to(one, y.high.shape) for one in share)), column)
    return double_double.added(y, double_double.negated(along)), share


def log_volume(tangent, n: int, dtype) -> Array:
    """ln|det| of a linear function (n,) -> (n,); -inf if singular."""
    _, log_r, lost, _ = orthonormalised(tangent, jnp.eye(n, dtype=dtype))
    return jnp.where(jnp.any(lost), -jnp.inf, jnp.sum(log_r))


def _as_double_double(array) -> DoubleDouble:
    return DoubleDouble(array, jnp.zeros_like(array))


def _vector_length(v):
    """The length of a vector whose squared entries may underflow; nan if an entry is no finite number."""
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(v)))
    scale = jnp.where(largest > 0, largest, 1.0)
    square = jnp.sum((v / scale) ** 2)
    return jnp.where(square == 0, 0.0, scale * jnp.sqrt(jnp.where(square == 0, 1.0, square)))
