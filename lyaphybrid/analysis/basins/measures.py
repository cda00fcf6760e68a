"""How intricate basins are: their entropy, and the dimension of the boundaries between them."""

from typing import NamedTuple

import numpy as np

from ..._arguments import require

__all__ = ["BoundaryDimension", "Entropy", "boundary_dimension", "entropy"]

LEAST_LENGTHS = 16  # the grid is so many times as long as the greatest distance of a pair
PARTS_ALONG = 4  # of the grid along each side, for errors


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
        dimension: d − α, where the share of pairs of starts that belong to different classes grows as the α-th power of
            their distance, along the axis where α is least.
        stderr: its standard error, from parts of the grid and of the distances.
        sizes: the distances, in cells; shares: of the pairs that belong to different classes.
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
    """From the shares of pairs of cells 1, 2, 3, 4, 6, … apart that belong to different classes.

    Both cells of such a pair are near the boundary, so that the exponent of each axis bounds the dimension from below.
    It is reached by an axis along which lines cross all of the boundary; lines along a graph's height cross it once.
    """
    length = min(labels.shape)
    require(
        length >= 64, f"A boundary's dimension needs at least 64 cells along each side; the grid is {labels.shape}."
    )
    farthest = 2 * np.log2(length // LEAST_LENGTHS)
    sizes = np.unique(np.round(np.sqrt(2) ** np.arange(int(farthest) + 1)).astype(int))
    pairs = [_pairs_that_differ(np.moveaxis(labels, axis, 0), sizes) for axis in range(labels.ndim)]
    fits = [_power_of(sizes, *one) for one in pairs if np.all(np.any(one[0] > 0, axis=1))]
    require(bool(fits), "There is no boundary: all starts on the grid belong to one class.")
    power, stderr, shares = min(fits, key=lambda fit: fit[0])
    return BoundaryDimension(labels.ndim - power, stderr, sizes, shares)


def _pairs_that_differ(labels: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(sizes, parts) of the pairs along the first axis those that differ, in parts of the grid; (parts,) all pairs.

    All distances have pairs around the same middles.
    """
    last = len(labels) - sizes[-1]
    starts = [(sizes[-1] - size) // 2 for size in sizes]
    differ = [
        labels[at : at + last] != labels[at + size : at + size + last] for at, size in zip(starts, sizes, strict=True)
    ]
    return np.stack([_in_parts(one) for one in differ]), _in_parts(np.ones_like(differ[0]))


def _in_parts(cells: np.ndarray) -> np.ndarray:
    """(parts,) sums over the parts of the grid, `PARTS_ALONG` along each side."""
    sums = cells.astype(float)
    for axis, length in enumerate(cells.shape):
        sums = np.add.reduceat(sums, np.arange(PARTS_ALONG) * length // PARTS_ALONG, axis=axis)
    return sums.ravel()


def _power_of(sizes: np.ndarray, differ: np.ndarray, pairs: np.ndarray) -> tuple[float, float, np.ndarray]:
    """The exponent of the shares, its standard error, and the shares.

    The error is from leaving out one part of the grid after the other (the jackknife), from the distances of the points
    from the line, and from what half of the sizes alone would give.
    """
    scale, middle = np.log(sizes), len(sizes) // 2

    def power(shares: np.ndarray, some: slice = slice(None)) -> float:
        return float(np.polyfit(scale[some], np.log(shares[some]), 1)[0])

    shares = differ.sum(axis=1) / pairs.sum()
    (slope, _), covariance = np.polyfit(scale, np.log(shares), 1, cov=True)
    left_out = (differ.sum(axis=1)[:, None] - differ) / (pairs.sum() - pairs)
    without = [power(one) for one in left_out.T if np.all(one > 0)]
    jackknife = (len(without) - 1) * float(np.var(without)) if without else 0.0
    trend = power(shares, slice(middle + 1)) - power(shares, slice(middle, None))
    return float(slope), float(np.sqrt(jackknife + covariance[0, 0] + trend**2 / 4)), shares
