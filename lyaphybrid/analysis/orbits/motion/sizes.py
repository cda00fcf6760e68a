"""The sizes of the components of a state along a motion, so that nothing depends on the units of the state."""

import dataclasses

import numpy as np

from ...._jax.precision import nonzero
from ...._linalg.products import even_units, in_units
from ....integrators import RungeKutta
from ....integrators.base import Method
from ....integrators.implicit.on_constraints import ConstrainedMethod

__all__ = ["LEAST_SCALE", "extents_of", "finer", "mixing_of", "sizes_of", "units_of"]

LEAST_SCALE = 1e-6  # least size of a component, relative to what it was, and to what others make of it
NOTHING_OF = 1e-28  # units of components differ by less: 1e12 and 1e-12 are a factor of 1e24
# The default absolute tolerance is no more than this fraction of the smallest component.
ATOL_OF_SIZE = 1e-11


def mixing_of(matrix: np.ndarray, slope: np.ndarray, length: float) -> np.ndarray:
    """What each component makes of the others (n, n), at most, growth and rates apart.

    Args:
        matrix: (n, n) the derivative of a motion.
        slope: (n, n) that of the field on it; a long motion contracts away what mixes on the way.
        length: of the motion: nothing mixes for longer.
    """
    least = 1.0, 1 / length
    parts = [
        np.abs(part) / max(small, float(np.linalg.norm(in_units(part, even_units(part)))))
        for part, small in zip((matrix, slope), least, strict=True)
        if np.all(np.isfinite(part))
    ]
    return np.maximum.reduce([np.zeros(matrix.shape), *parts])


def sizes_of(points: np.ndarray, mixing: np.ndarray, least: np.ndarray | float = 0.0) -> np.ndarray:
    """The largest |x| (n,) of each component along a motion (samples, n).

    What is zero but for rounding has the size of what the other components add to it by the mixing (n, n); and no size
    is below the `least`. What is smaller than `NOTHING_OF` the largest is zero in any units, as on an axis of symmetry
    after Newton's method.
    """
    largest = np.max(np.abs(np.asarray(points, float)), axis=0)
    added = mixing @ largest
    sizes = np.maximum(np.where(largest > LEAST_SCALE * added, largest, added), least)
    return np.where(sizes > NOTHING_OF * np.max(sizes), sizes, np.max(sizes) or 1.0)


def extents_of(points: np.ndarray, sizes: np.ndarray, least: float = LEAST_SCALE) -> np.ndarray:
    """How far each component moves (n,) along a motion (samples, n); its size where it does not, or is rounding."""
    across, largest = np.ptp(points, axis=0), np.max(np.abs(np.asarray(points, float)), axis=0)
    return np.where((across > least * sizes) & (largest >= sizes), across, sizes)


def units_of(extents: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Units (n,) in which a map of the state is as even as it can be, from the extents of the components on."""
    even = even_units(in_units(matrix, extents))
    return extents * np.clip(even, LEAST_SCALE, 1 / LEAST_SCALE)  # what couples by rounding alone has any units


def finer(method: Method, points: np.ndarray, mixing: np.ndarray) -> Method:
    """The method, whose absolute tolerance is small beside the components along a motion (samples, n)."""
    if not isinstance(method, RungeKutta | ConstrainedMethod):  # others have none
        return method
    largest = np.max(np.abs(points), axis=0)
    # What is zero but for rounding has the size of what cancels there.
    sizes = np.maximum(largest, mixing @ largest)
    atol = ATOL_OF_SIZE * float(np.min(sizes[sizes > 0], initial=1.0))
    return dataclasses.replace(method, atol=method.atol * 0 + nonzero(atol, points)) if atol < method.atol else method
