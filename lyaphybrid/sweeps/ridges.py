"""Ridges of a function on a grid of two dimensions, to a fraction of a cell.

C. Steger, An unbiased detector of curvilinear structures, IEEE Trans. Pattern Anal. Mach. Intell. 20 (1998) 113,
doi:10.1109/34.659930: a point is on a ridge where the first derivative across the ridge vanishes, the second one is
negative; both are those of the function smoothed by a Gaussian.
"""

from typing import Any

import numpy as np
import scipy  # its submodules load on first use: this one takes a tenth of a second

__all__ = ["ridge_points"]


def ridge_points(values: np.ndarray, width: float, sharpest: float) -> tuple[np.ndarray, np.ndarray]:
    """Points on ridges in units of cells (m, 2), and the second derivative across each (m,), negative.

    Args:
        values: (a, b); nan where the function is not known: no ridge is found near.
        width: standard deviation of the Gaussian, in cells.
        sharpest: part of the ridges, by their second derivative, of which the sharper ones are returned.
    """
    known = np.isfinite(values)
    filled = np.where(known, values, np.min(values[known]) if np.any(known) else 0.0)
    derivative = {order: scipy.ndimage.gaussian_filter(filled, width, order=order) for order in _ORDERS}
    gradient = np.stack([derivative[1, 0], derivative[0, 1]], axis=-1)
    hessian = np.stack([derivative[2, 0], derivative[1, 1], derivative[1, 1], derivative[0, 2]], axis=-1)
    curvatures, directions = np.linalg.eigh(hessian.reshape(*values.shape, 2, 2))
    least, across = curvatures[..., 0], directions[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = -(np.sum(gradient * across, axis=-1) / least)[..., None] * across
    near = scipy.ndimage.gaussian_filter(known.astype(float), width) > 1 - 1e-6
    on = near & (least < 0) & np.all(np.abs(offset) <= 0.5, axis=-1)
    on[[0, -1]] = on[:, [0, -1]] = False
    places, bend = np.argwhere(on) + offset[on], least[on]
    if not len(bend):
        return places, bend
    sharp = bend <= np.quantile(bend, sharpest)
    return places[sharp], bend[sharp]


_ORDERS: Any = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
