"""How much of each column of a frame may be rounding along the columns that replace lost ones.

Rounding leaves in each column a share ε along each of them. Where they grow faster, so does the share, until the column
is one of them: the next loss would take it, and not them. A loss of that direction takes its share away.
"""

import math
from types import ModuleType

import jax.numpy as jnp

from .._jax.precision import eps

__all__ = ["is_foreign", "rearranged", "shares_after", "shares_of_none"]

LARGEST_SHARE = math.log(1e-3)  # a column with a larger share may be something else than it was


def shares_of_none(k: int, like, xp: ModuleType = jnp):
    """(k, k) ln of the share of column i along column j, if that replaces a lost one: then entry (j, j) is inf."""
    return xp.full((k, k), math.log(eps(like)), like.dtype)


def shares_after(before, log_r, lost, xp: ModuleType = jnp):
    """(k, k) the shares after an orthonormalisation with ln R_ii (k,), in which columns (k,) were lost."""
    replaced, least = xp.isinf(xp.diagonal(before)), math.log(eps(log_r))
    grown = xp.where(xp.isinf(before), 0.0, before) + log_r[None, :] - log_r[:, None]
    counts = ~replaced[:, None] & (replaced & ~lost)[None, :]
    return _with_replaced(xp.where(counts, xp.maximum(grown, least), least), replaced, xp)


def rearranged(shares, source, replaced, xp: ModuleType = jnp):
    """The shares of columns in another order, column i from source[i] (k,); `replaced` (k,) are new ones."""
    moved = shares[source][:, source]
    return _with_replaced(moved, replaced | xp.isinf(xp.diagonal(moved)), xp)


def is_foreign(shares, xp: ModuleType = jnp):
    """Whether a column may be mostly rounding."""
    return xp.any((shares > LARGEST_SHARE) & xp.isfinite(shares))


def _with_replaced(shares, replaced, xp: ModuleType):
    return xp.where(xp.eye(len(shares), dtype=bool) & replaced[None, :], xp.inf, shares)
