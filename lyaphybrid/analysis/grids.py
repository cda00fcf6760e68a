"""Grids of starts: the middles of the cells of a box."""

from typing import Any

import numpy as np

from .._arguments import integers, numbers, require

__all__ = ["box_of", "grid_of"]


def box_of(x0: Any) -> np.ndarray:
    """The corners (2, n) of a box of starts."""
    corners = np.asarray(numbers("x0", x0), float)
    box = corners.ndim == 2 and corners.shape[0] == 2 and bool(np.all(np.isfinite(corners)))
    require(box, f"x0 must be the two corners of a box of starts, (2, n); got shape {corners.shape}.")
    low, high = corners
    require(bool(np.any(low != high)), f"The corners of the box must differ; got {low.tolist()} twice.")
    return corners


def grid_of(corners: np.ndarray, shape: Any) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """The starts (m, n) in the middles of so many cells, and the varied components with their values."""
    low, high = corners
    varied, counts = np.flatnonzero(low != high), integers("shape", shape, 1, 10**9)
    require(len(counts) == len(varied), f"shape must have one number for each of the {len(varied)} varied components.")
    axes = {
        int(i): low[i] + (high[i] - low[i]) * (np.arange(count) + 0.5) / count
        for i, count in zip(varied, counts, strict=True)
    }
    mesh = np.meshgrid(*axes.values(), indexing="ij")
    grid = np.tile(low, (mesh[0].size, 1))
    for i, values in zip(axes, mesh, strict=True):
        grid[:, i] = values.ravel()
    return grid, axes
