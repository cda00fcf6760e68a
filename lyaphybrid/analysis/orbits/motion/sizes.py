"""The sizes of the components of a state along a motion, so that nothing depends on the units of the state."""

import dataclasses

import numpy as np

from ...._jax.precision import nonzero
from ...._linalg.products import even_units, in_units
from ....integrators import RungeKutta
from ....integrators.base import Method
from ....integrators.implicit.on_constraints import ConstrainedMethod

__all__ = ["LEAST_SCALE", "extents_of", "finer", "sizes_of", "units_of"]

LEAST_SCALE = 1e-6  # least size of a component, relative to what it was, and to what others make of it
# The default absolute tolerance is no more than this fraction of the smallest component.
ATOL_OF_SIZE = 1e-11


def sizes_of(points: np.ndarray, matrix: np.ndarray, least: np.ndarray | float = 0.0) -> np.ndarray:
    """The largest |x| (n,) of each component along a motion (samples, n) with the derivative `matrix` (n, n).

    What is zero but for rounding has the size of what the other components add to it, growth apart; and no size is
    below the `least`.
    """
    largest, added = np.max(np.abs(np.asarray(points, float)), axis=0), 0.0
    if np.all(np.isfinite(matrix)):
        growth = max(1.0, float(np.linalg.norm(in_units(matrix, even_units(matrix)))))
        added = np.abs(matrix) @ largest / growth
    sizes = np.maximum(np.where(largest > LEAST_SCALE * added, largest, added), least)
    return np.where(sizes > 0, sizes, np.max(sizes) or 1.0)


def extents_of(points: np.ndarray, sizes: np.ndarray, least: float = LEAST_SCALE) -> np.ndarray:
    """How far each component moves (n,) along a motion (samples, n); its size where it does not, or is rounding."""
    across, largest = np.ptp(points, axis=0), np.max(np.abs(np.asarray(points, float)), axis=0)
    return np.where((across > least * sizes) & (largest >= sizes), across, sizes)


def units_of(extents: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Units (n,) in which a map of the state is as even as it can be, from the extents of the components on."""
    even = even_units(in_units(matrix, extents))
    return extents * np.clip(even, LEAST_SCALE, 1 / LEAST_SCALE)  # what couples by rounding alone has any units


def finer(method: Method, points: np.ndarray, matrix: np.ndarray) -> Method:
    """The method, whose absolute tolerance is small beside the components along a motion (samples, n)."""
    if not isinstance(method, RungeKutta | ConstrainedMethod):  # others have none
        return method
    largest = np.max(np.abs(points), axis=0)
    # What is zero but for rounding has the size of what cancels there.
    sizes = np.maximum(largest, np.abs(matrix) @ largest)
    atol = ATOL_OF_SIZE * float(np.min(sizes[sizes > 0], initial=1.0))
    return dataclasses.replace(method, atol=method.atol * 0 + nonzero(atol, points)) if atol < method.atol else method
