"""Attractors as sets of points, and which of them a motion has arrived at.

A few long runs, the pilots, show the attractors, if they have settled: those whose late points lie among each other's
are on the same one. A motion has arrived at an attractor if its last points lie within a radius of the attractor's: a
small one where the points repeat, else a few times the distance of points from what their neighbours span.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..diagrams.attractors import apart, at_rest, period, turns_of

__all__ = ["Attractor", "Metric", "arrived", "distances", "found_in", "merged", "revisits", "with_more"]

CYCLE_REPEATS = 1e-6  # relative to the range of each component: points of a cycle repeat to this …
CYCLE_LEFT = 1e-6  # … and are as near to where they converge
SAME_CYCLE = 1e-5  # distance up to which two cycles are one
CYCLE_RADIUS = 1e-3  # of the points of a cycle, relative to the ranges
RADIUS_DISTANCES = 4.0  # the radius of other attractors, in distances of one half of its points from the other …
DISTANCES_QUANTILE = 0.98  # … of this quantile, …
MOST_DISTANCES = 2.0  # … or in the greatest
AS_NEAR = 0.9  # points are as near as others if half of them are nearer than this part of the others
LEAST_DRIFT = 1e-4  # distance below which a run has not drifted
SHRINKING, ROUNDING_EXTENT = 1.5, 1e-9  # a run drifts that shrinks or grows by this factor; extents that are none
SHARED_POINTS = 0.5  # part of the late points of a run that lie around a cycle, if it is on it
POINTS_OF_SET = 2000  # enough for an attractor that does not repeat, from several runs
UNCERTAIN = 0.5  # a motion is at an attractor if its distance is less than this part of that from any other
LINES_THROUGH = 4  # the nearest points through which lines are laid
NEAR_POINTS = 2.0  # how near to one of them, in distances between neighbours
BEYOND_NEIGHBOURS = 1.0  # how far a line through two neighbours counts, in distances between the two
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


def found_in(
    points: np.ndarray, modes: np.ndarray, metric: Metric, known: Sequence[Attractor]
) -> tuple[list[Attractor], list[int]]:
    """The known attractors, and those that other runs (runs, samples, n) show, if they have settled.

    And by which of the runs each of these others was found.
    """
    attractors, by = list(known), []
    turns = turns_of(points.shape[-1], metric.angles)
    repeats = at_rest(points, turns, metric.scale, period(np, points, turns, metric.scale, CYCLE_REPEATS))
    for i in np.argsort(repeats == 0, kind="stable"):  # cycles first: runs that still converge to one are on it
        seen, mode, p = points[i].copy(), modes[i], int(repeats[i])
        seen[:, metric.angles] = np.pi - (np.pi - seen[:, metric.angles]) % (2 * np.pi)
        stays = not p and np.all(np.isfinite(seen)) and _stays(metric.placed(seen, mode))
        late = slice(0 if stays else len(seen) // 2, None)
        k = next((k for k, one in enumerate(attractors) if _is_on(one, seen[late], mode[late], p, metric)), -1)
        if k < 0 and p and _left(points[i], p, turns, metric.scale) <= CYCLE_LEFT:
            attractors.append(Attractor(seen[-p:], mode[-p:], p, CYCLE_RADIUS))
            by.append(int(i))
        elif k < 0 and stays:
            attractors.append(Attractor(seen, mode, 0, CYCLE_RADIUS))
            by.append(int(i))
        elif stays and not attractors[k].period and len(attractors[k].points) < POINTS_OF_SET:
            attractors[k] = with_more(attractors[k], seen, mode, metric)
    return _with_radii(attractors, metric), by


def merged(attractors: Sequence[Attractor], metric: Metric, known: int) -> list[Attractor]:
    """The attractors, of which those after the known ones that do not repeat and lie on another are one with it."""
    kept = list(attractors[:known])
    for one in attractors[known:]:
        for k, other in enumerate(kept):
            if not (one.period or other.period) and (
                _is_on(other, one.points, one.modes, 0, metric) or _is_on(one, other.points, other.modes, 0, metric)
            ):
                kept[k] = with_more(other, one.points, one.modes, metric)
                break
        else:
            kept.append(one)
    return _with_radii(kept, metric)


def revisits(one: Attractor, metric: Metric) -> bool:
    """Whether most points of an attractor are seen more than once, as those of a cycle."""
    placed = metric.placed(one.points, one.modes)
    return bool(np.median(_nearest_of(placed, placed, 2)[0][:, 1]) <= CYCLE_REPEATS)


def _is_on(one: Attractor, late, mode, p: int, metric: Metric) -> bool:
    """Whether a run with these late points is on an attractor."""
    far = distances(one, late, mode, metric)
    if one.period and p:
        return bool(np.max(far[-p:]) <= SAME_CYCLE)
    if one.period:
        return bool(np.mean(far < one.radius) >= SHARED_POINTS)
    return _as_near(far, _between_halves(metric.placed(one.points, one.modes)), SAME_CYCLE)


def with_more(one: Attractor, seen, mode, metric: Metric) -> Attractor:
    """An attractor with more points, but for those that it has: no lines go through a point and itself."""
    far, _ = _nearest_of(metric.placed(one.points, one.modes), metric.placed(seen, mode), 1)
    new = far[:, 0] > SAME_CYCLE
    points, modes = np.concatenate([one.points, seen[new]]), np.concatenate([one.modes, mode[new]])
    return one._replace(points=points, modes=modes)


def _as_near(some, others, least: float) -> bool:
    """Whether some distances are like others, or small."""
    return bool(np.median(some) <= max(least, float(np.quantile(others, AS_NEAR))))


def _left(points, p: int, turns, scale) -> float:
    """How far the last points of a run that nearly repeats are from where they converge, as by a geometric series."""
    third = len(points) // (3 * p) * p
    last = points[-p:], points[-p - third : len(points) - third], points[-p - 2 * third : len(points) - 2 * third]
    later, before = (float(np.max(apart(np, a, b, turns) / scale)) for a, b in zip(last[:2], last[1:], strict=True))
    step = float(np.max(apart(np, points[-third:], points[-third - p : -p], turns) / scale))
    if later <= 4 * step:  # rounding, and no drift
        return later
    return later * later / (before - later) if later < before else np.inf


def _stays(placed) -> bool:
    """Whether points (samples, n) that do not repeat are as far from the first of them as from those just before.

    And whether they do not shrink or grow all along: the last may lie in the middle of a thin ring.
    """
    quarters = np.array_split(placed[len(placed) % 4 :], 4)
    extents = np.std(quarters, axis=1)[:, :-1]  # but of the modes
    steady = np.max(extents, axis=0) <= SHRINKING * np.min(extents, axis=0) + ROUNDING_EXTENT
    turns = np.diff(np.sign(np.diff(extents, axis=0)), axis=0)
    first, _, before, last = quarters
    return bool(np.all(steady | np.any(turns != 0, axis=0))) and _as_near(
        _from_lines(first, last), _from_lines(before, last), LEAST_DRIFT
    )


def arrived(points: np.ndarray, modes: np.ndarray, metric: Metric, attractors: Sequence[Attractor]) -> np.ndarray:
    """(m,) index of the attractor at which the last points (m, samples, n) are; −1 where they are at none."""
    if not attractors:
        return np.full(len(points), -1, np.int32)
    far = np.array([np.max(distances(one, points, modes, metric), axis=1) / one.radius for one in attractors])
    # Among the points of a wide set any state is near a line through some of them, also one on a cycle.
    on_cycle = np.any(far[[one.period > 0 for one in attractors]] < 1.0, axis=0)
    far[[one.period == 0 for one in attractors]] += np.where(on_cycle, np.inf, 0.0)
    label = np.argmin(far, axis=0).astype(np.int32)
    nearest, second = np.sort(np.concatenate([far, np.full_like(far[:1], np.inf)]), axis=0)[:2]
    return np.where((nearest < 1.0) & (nearest <= UNCERTAIN * second), label, np.int32(-1))


def distances(attractor: Attractor, points, modes, metric: Metric) -> np.ndarray:
    """Distances (…) of points (…, n) from an attractor, relative to the scale; infinite for what is not finite.

    Of one that does not repeat, from the lines through its points.
    """
    there = metric.placed(attractor.points, attractor.modes)
    placed = metric.placed(points, modes)
    finite = np.all(np.isfinite(placed), axis=-1)
    found = np.full(placed.shape[:-1], np.inf)
    found[finite] = (
        _nearest_of(there, placed[finite], 1)[0][:, 0] if attractor.period else _from_lines(there, placed[finite])
    )
    return found


def _nearest_of(points, wanted, count: int):
    """The distances (m, count) from the nearest points, and which these are."""
    from scipy.spatial import KDTree  # a quarter of a second, for this alone

    far, which = KDTree(points).query(wanted, k=count, workers=-1 if len(wanted) > WORTH_THREADS else 1)
    return np.reshape(far, (-1, count)), np.reshape(which, (-1, count))


def _from_lines(points, wanted):
    """Distances from lines through any two of the nearest points: along a curve much smaller than from the points.

    Only near the points: in the middle of a ring there are lines, too.
    """
    far, nearest = _nearest_of(points, wanted, LINES_THROUGH)
    spacing = np.quantile(_nearest_of(points, points, 2)[0][:, 1], DISTANCES_QUANTILE)
    found = far[:, 0].copy()
    for i, j in itertools.combinations(range(LINES_THROUGH), 2):
        one = points[nearest[:, i]]
        along, there = points[nearest[:, j]] - one, wanted - one
        square = np.sum(along**2, axis=-1)
        share = np.sum(there * along, axis=-1) / np.where(square > 0, square, 1.0)
        share = np.clip(share, -BEYOND_NEIGHBOURS, 1 + BEYOND_NEIGHBOURS)
        from_line = np.linalg.norm(there - share[:, None] * along, axis=-1)
        found = np.where(far[:, 0] <= NEAR_POINTS * spacing, np.minimum(found, from_line), found)
    return found


def _between_halves(placed):
    """Distances of the second half of some points from the first."""
    half = len(placed) // 2
    return _from_lines(placed[:half], placed[half:])


def _with_radii(attractors: list[Attractor], metric: Metric) -> list[Attractor]:
    """The same with their radii, those of cycles so small that no two overlap."""
    fitted = []
    for one in attractors:
        if one.period:
            others = [
                np.min(distances(other, one.points, one.modes, metric)) for other in attractors if other is not one
            ]
            radius = min(one.radius, CYCLES_APART * min(others, default=np.inf))
        else:
            between = _between_halves(metric.placed(one.points, one.modes))
            most = RADIUS_DISTANCES * float(np.quantile(between, DISTANCES_QUANTILE))
            radius = max(CYCLE_RADIUS, most, MOST_DISTANCES * float(np.max(between)))
        fitted.append(one._replace(radius=float(radius)))
    return fitted
