"""How much of each column of a frame may be rounding along the columns that replace lost ones.

Rounding leaves in each column a share ε along them. Where they grow faster, so does the share, until the column is one
of them: the next loss would take it, and not them.
"""

import math
from types import ModuleType

import jax.numpy as jnp

from .._jax.precision import eps

__all__ = ["is_foreign", "shares_after", "shares_of_none"]

LARGEST_SHARE = math.log(1e-3)  # a column with a larger share may be something else than it was


def shares_of_none(k: int, like, xp: ModuleType = jnp):
    """(k,) ln of the shares of columns of which none was lost."""
    return xp.full(k, math.log(eps(like)), like.dtype)


def shares_after(before, log_r, lost, xp: ModuleType = jnp):
    """(k,) ln of the shares after an orthonormalisation with ln R_ii (k,); inf for columns that replace lost ones."""
    replaced = xp.isinf(before)
    ahead = xp.max(xp.where(replaced & ~lost, log_r, -xp.inf), initial=-xp.inf)
    grown = xp.where(replaced, 0.0, before) + ahead - log_r
    return xp.where(replaced, xp.inf, xp.maximum(grown, math.log(eps(log_r))))


def is_foreign(shares, xp: ModuleType = jnp):
    """Whether a column may be mostly rounding."""
    return xp.any((shares > LARGEST_SHARE) & xp.isfinite(shares))
