"""Standard errors from the blocks of a run."""

from types import ModuleType
from typing import Any

__all__ = ["standard_error"]


def standard_error(xp: ModuleType, growth, lengths, mean, count, total) -> Any:
    """One standard error of a mean growth per unit of length: √(Σ_b (g_b − λ l_b)² m/(m − 1)) / Σ_b l_b.

    Args:
        xp: NumPy or `jax.numpy`.
        growth: (blocks, …) g; 0 where a block was not reached.
        lengths: (blocks,) l, likewise.
        mean: (…) λ.
        count: m, the number of blocks that were reached, at least 2.
        total: Σ l.
    """
    mean = xp.asarray(mean)
    deviations = growth - mean[None] * lengths.reshape(-1, *(1,) * mean.ndim)
    return xp.sqrt(xp.sum(deviations**2, axis=0) * count / (count - 1)) / total
