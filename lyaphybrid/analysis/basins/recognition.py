"""Attractors as sets of points, and which of them a motion has arrived at.

A few long runs, the pilots, show the attractors: those whose late points lie among each other's are on the same one. A
motion has arrived at an attractor if its last points lie within a radius of the attractor's: a small one where the
points repeat, else a few times the distance between neighbouring points.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..diagrams.attractors import at_rest, period, turns_of

__all__ = ["Attractor", "Metric", "arrived", "distances", "found_in"]

CYCLE_REPEATS = 1e-6  # relative to the range of each component: points of a cycle repeat to this
CYCLE_RADIUS = 1e-3  # of the points of a cycle, relative to the ranges
NEIGHBOUR_DISTANCES = 4.0  # the radius of other attractors, in distances between neighbours …
NEIGHBOURS_QUANTILE = 0.98  # … of this quantile
SHARED_POINTS = 0.5  # part of the late points of a run that lie among those of an attractor, if it is the same
CYCLES_APART = 0.25  # of the distance of two cycles: their radius is not larger
LEAST_EXTENT = 1e-3  # least range of a component, relative to that of the starts
WORTH_THREADS = 10_000  # points: the search among fewer ends before threads have begun
OTHER_MODE = 1e6  # distance of points in different modes


class Attractor(NamedTuple):
    """The points of an attractor.

    Attributes:
        points: (p, n) of a cycle the p points that repeat, of any other as many as were seen.
        modes: (p,) indices.
        period: p of a cycle, in samples; 0 of any other.
        radius: relative to the scale.
    """

    points: np.ndarray
    modes: np.ndarray
    period: int
    radius: float


class Metric(NamedTuple):
    """How far points are from each other.

    Attributes:
        scale: (n,) ranges of the components, none of them 0; 2π of an angle.
        angles: components that are angles.
    """

    scale: np.ndarray
    angles: tuple[int, ...]

    @classmethod
    def of(cls, points: np.ndarray, box: np.ndarray, angles: tuple[int, ...]) -> "Metric":
        """From points (…, n) of attractors; where these have next to no extent, from that of the box (n,) of starts."""
        rows = points.reshape(-1, points.shape[-1])
        rows = rows[np.all(np.isfinite(rows), axis=1)]
        ranges = np.ptp(rows, axis=0) if len(rows) else np.zeros(len(box))
        box = np.where(box > 0, box, np.max(box))
        scale = np.where(ranges > LEAST_EXTENT * box, ranges, box)
        scale[list(angles)] = 2 * np.pi
        return cls(scale, angles)

    def placed(self, points: np.ndarray, modes: np.ndarray) -> np.ndarray:
        """Points (…, n) relative to the scale, angles on a circle, with the mode as one component more."""
        turned = points[..., list(self.angles)]
        circles = np.concatenate([np.cos(turned), np.sin(turned)], axis=-1) / (2 * np.pi)
        lines = np.delete(points / self.scale, self.angles, axis=-1)
        return np.concatenate([lines, circles, OTHER_MODE * modes[..., None]], axis=-1)


def found_in(points: np.ndarray, modes: np.ndarray, metric: Metric, known: Sequence[Attractor]) -> list[Attractor]:
    """The known attractors, and those that the late points (runs, samples, n) of other runs show."""
    attractors = list(known)
    turns = turns_of(points.shape[-1], metric.angles)
    repeats = at_rest(points, turns, metric.scale, period(np, points, turns, metric.scale, CYCLE_REPEATS))
    for i in np.argsort(repeats == 0, kind="stable"):  # cycles first: runs that still converge to one are on it
        half = points.shape[1] // 2
        late, mode, p = points[i, half:], modes[i, half:], int(repeats[i])
        if not np.all(np.isfinite(late)):
            continue
        if any(np.mean(distances(one, late, mode, metric) < one.radius) >= SHARED_POINTS for one in attractors):
            continue
        if p:
            attractors.append(Attractor(late[-p:], mode[-p:], p, CYCLE_RADIUS))
        else:
            radius = max(CYCLE_RADIUS, NEIGHBOUR_DISTANCES * _spacing(metric.placed(late, mode)))
            attractors.append(Attractor(late, mode, 0, radius))
    return _told_apart(attractors, metric)


def arrived(points: np.ndarray, modes: np.ndarray, metric: Metric, attractors: Sequence[Attractor]) -> np.ndarray:
    """(m,) index of the attractor at which the last points (m, samples, n) are; −1 where they are at none."""
    nearest, label = np.full(len(points), 1.0), np.full(len(points), -1, np.int32)
    for k, one in enumerate(attractors):
        distance = np.max(distances(one, points, modes, metric), axis=1) / one.radius
        closer = distance < nearest
        nearest[closer], label[closer] = distance[closer], k
    return label


def distances(attractor: Attractor, points, modes, metric: Metric) -> np.ndarray:
    """Distances (…) of points (…, n) from the attractor's, relative to the scale; infinite for what is not finite."""
    tree = _tree(metric.placed(attractor.points, attractor.modes))
    placed = metric.placed(points, modes)
    finite = np.all(np.isfinite(placed), axis=-1)
    found = np.full(placed.shape[:-1], np.inf)
    wanted = placed[finite]
    found[finite] = tree.query(wanted, workers=-1 if len(wanted) > WORTH_THREADS else 1)[0]
    return found


def _tree(placed):
    """The points as a tree for searches."""
    from scipy.spatial import KDTree  # a quarter of a second, for this alone

    return KDTree(placed)


def _spacing(placed) -> float:
    """How far points lie from their nearest neighbours, all but a few of them."""
    return float(np.quantile(_tree(placed).query(placed, k=2)[0][:, 1], NEIGHBOURS_QUANTILE))


def _told_apart(attractors: list[Attractor], metric: Metric) -> list[Attractor]:
    """The same with radii of cycles so small that no two overlap."""
    apart = []
    for one in attractors:
        others = [np.min(distances(other, one.points, one.modes, metric)) for other in attractors if other is not one]
        least = CYCLES_APART * min(others, default=np.inf)
        apart.append(one._replace(radius=min(one.radius, least)) if one.period else one)
    return apart
