"""How intricate basins are: their entropy, and the dimension of the boundaries between them."""

from typing import NamedTuple

import numpy as np

from ..._arguments import require

__all__ = ["BoundaryDimension", "Entropy", "boundary_dimension", "entropy"]

LEAST_BOXES_ALONG = 8  # of a size along each side, if it is to count


class Entropy(NamedTuple):
    """Entropies of boxes with their standard errors.

    Attributes:
        all: mean entropy of boxes; boundary: of those that hold several classes, nan where none does.
        all_stderr: standard error; boundary_stderr: likewise.
    """

    all: float
    all_stderr: float
    boundary: float
    boundary_stderr: float


class BoundaryDimension(NamedTuple):
    """The dimension of the boundary.

    Attributes:
        dimension: d − α, where the share of boxes with several classes grows as the α-th power of their size.
        stderr: of the fit.
        sizes: of the boxes, between the middles of their outermost cells; shares: of them that hold several classes.
    """

    dimension: float
    stderr: float
    sizes: np.ndarray
    shares: np.ndarray


def _boxes(labels: np.ndarray, size: int) -> np.ndarray:
    """(boxes, size^d) the labels in boxes of so many cells; cells that fill no box are left out."""
    whole = tuple(length // size * size for length in labels.shape)
    cut = labels[tuple(slice(0, length) for length in whole)]
    split = cut.reshape([part for length in whole for part in (length // size, size)])
    d = labels.ndim
    return split.transpose([*range(0, 2 * d, 2), *range(1, 2 * d, 2)]).reshape(-1, size**d)


def entropy(labels: np.ndarray, size: int) -> Entropy:
    """Entropies −Σ p ln p of the classes in boxes of `size` cells along each side."""
    require(2 <= size <= min(labels.shape) // 2, f"size must be from 2 to {min(labels.shape) // 2}; got {size}.")
    boxes = _boxes(labels, size)
    total, several = np.zeros(len(boxes)), np.zeros(len(boxes), int)
    for one in np.unique(labels):
        share = np.mean(boxes == one, axis=1)
        several += share > 0
        total -= np.where(share > 0, share * np.log(np.where(share > 0, share, 1.0)), 0.0)
    mixed = total[several > 1]

    def error(values) -> float:
        return float(np.std(values, ddof=1) / len(values) ** 0.5) if len(values) > 1 else np.nan

    return Entropy(float(np.mean(total)), error(total), float(np.mean(mixed)) if len(mixed) else np.nan, error(mixed))


def boundary_dimension(labels: np.ndarray) -> BoundaryDimension:
    """From the shares of boxes of 2, 4, 8, … cells that hold several classes."""
    most = min(labels.shape) // LEAST_BOXES_ALONG
    require(most >= 8, f"A boundary's dimension needs at least 64 cells along each side; the grid is {labels.shape}.")
    cells, shares = 2 ** np.arange(1, int(np.log2(most)) + 1), []
    for size in cells:
        boxes = _boxes(labels, int(size))
        shares.append(np.mean(np.any(boxes != boxes[:, :1], axis=1)))
    sizes, shares = cells - 1, np.array(shares)
    require(bool(np.all(shares > 0)), "There is no boundary: all starts on the grid belong to one class.")
    (slope, _), covariance = np.polyfit(np.log(sizes), np.log(shares), 1, cov=len(sizes) > 3 or "unscaled")
    return BoundaryDimension(labels.ndim - float(slope), float(np.sqrt(covariance[0, 0])), sizes, shares)
