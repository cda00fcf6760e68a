"""A few marks as one number, among numbers of a vector."""

import jax.numpy as jnp
import numpy as np

__all__ = ["as_bits", "in_bits"]

MOST_BITS = 20  # marks that are kept, the first ones: a float32 holds so many


def as_bits(mask):
    """The marks (m,) as a number ()."""
    weights = 2.0 ** np.arange(min(mask.shape[0], MOST_BITS))
    return jnp.sum(jnp.where(mask[: len(weights)], weights, 0.0))


def in_bits(number, count: int, xp=jnp):
    """(…, count) the marks in a number (…) from `as_bits`; none where there are too many."""
    place = np.arange(count).reshape(*[1] * number.ndim, count)
    weights = xp.asarray(2.0 ** np.minimum(place, MOST_BITS), number.dtype)
    return (xp.floor(number[..., None] / weights) % 2 == 1) & (place < MOST_BITS)
