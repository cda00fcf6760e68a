"""Standard errors from the blocks of a run."""

from types import ModuleType
from typing import Any

import numpy as np

__all__ = ["standard_error"]

FEWEST_BATCHES = 4
SURE = 2.75  # standard deviations of chance: of independent blocks 1 comparison in 100 is taken for correlation


def standard_error(xp: ModuleType, growth, lengths, mean, count, total) -> Any:
    """One standard error of a mean growth per unit of length: √(c Σ_b (g_b − λ l_b)² m/(m − 1)) / Σ_b l_b.

    c is 1, or more where blocks are seen to be correlated.

    Args:
        xp: NumPy or `jax.numpy`.
        growth: (blocks, …) g; 0 where a block was not reached.
        lengths: (blocks,) l, likewise.
        mean: (…) λ.
        count: m, the number of blocks that were reached, at least 2.
        total: Σ l.
    """
    mean = xp.asarray(mean)
    deviations = growth - mean[None] * _beside(lengths, mean)
    squares = xp.sum(deviations**2, axis=0) * count / (count - 1)
    return xp.sqrt(_correlation(xp, deviations, lengths) * squares) / total


def _correlation(xp: ModuleType, deviations, lengths):
    """(…) how much larger the variance of the mean is than that of independent blocks; at least 1.

    Blocks are joined by w = 2, 4, 8 … to batches. Where the variance of the mean by batches is larger than chance would
    have it, blocks are correlated. The largest of these is nearest to the truth, that of batches longer than the
    correlation. By few batches it counts t² times, t = 1 + 1/2ν + 1/4ν² the quantile of Student's distribution of ν
    degrees of freedom that corresponds to one standard error.

    Of independent blocks the ratio to the variance by blocks is about 1, its own variance 2(w − 1)(2w − 1)/3w²ν; its
    quantiles are those of χ² by Wilson & Hilferty.

    As do G. S. Fishman & L. S. Yarberry, INFORMS J. Comput. 9 (1997) 296, doi:10.1287/ijoc.9.3.296.
    """
    length = _or_one(xp, xp.sum(lengths))
    deviations = deviations - xp.sum(deviations, axis=0)[None] * _beside(lengths / length, deviations[0])
    single, many = _variance(xp, deviations, lengths)
    largest = xp.ones_like(single)
    while len(lengths) >= 2 * FEWEST_BATCHES:
        deviations, lengths = _joined(xp, deviations), _joined(xp, lengths)
        variance, batches = _variance(xp, deviations, lengths)
        ratio, w, freedom = variance / _or_one(xp, single), many / batches, xp.maximum(batches - 1, 1.0)
        scatter = 2 / 9 * (w - 1) * (2 * w - 1) / (3 * w**2 * freedom)
        correlated = (ratio > (1 - scatter + SURE * scatter**0.5) ** 3) & (batches > FEWEST_BATCHES - 0.5)
        student = 1 + 0.5 / freedom + 0.25 / freedom**2
        largest = xp.where(correlated, xp.maximum(largest, ratio * student**2), largest)
    return largest


def _variance(xp: ModuleType, deviations, lengths):
    """(…) the variance of the sum, and the number of batches, (Σ l)²/Σ l²: fewer where they are not equally long."""
    batches = xp.sum(lengths) ** 2 / _or_one(xp, xp.sum(lengths**2))
    return xp.sum(deviations**2, axis=0) * batches / xp.maximum(batches - 1, 1.0), batches


def _joined(xp: ModuleType, values):
    """Sums (blocks/2, …) of neighbours; the last one is alone if their number is odd."""
    if len(values) % 2:
        values = xp.concatenate([values, xp.zeros_like(values[:1])])
    return values[0::2] + values[1::2]


def _beside(lengths, mean):
    return lengths.reshape(-1, *(1,) * np.ndim(mean))


def _or_one(xp: ModuleType, value):
    return xp.where(value == 0, 1.0, value)
