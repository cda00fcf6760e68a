"""The search for attractors: by pilots, a few long runs, and then by runs that have arrived at none of these."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...statuses import OK
from .keeping import KeptSteps, as_arrays, attractors_in
from .recognition import Attractor, Metric, found_in, merged, revisits, with_more
from .sampling import Sampled

__all__ = ["LONGER_TRANSIENT", "Search"]

PILOT_RUNS, PILOT_SAMPLES = 96, 400  # runs that show the attractors, and their samples
LONGER_TRANSIENT = 4  # the transient of these, and of runs that had not arrived, is so many times longer
LONGER_STRIDE = 8  # samples of runs on motions that nearly repeat are so much rarer …
MOST_THAT_DO_NOT_REPEAT = 16  # … if they are no more than that: a conservative system shows one for each start


class Search(NamedTuple):
    """How attractors are found: `run(rows, transients, samples, stride=…)` in steps that a checkpoint keeps."""

    run: Callable[..., Sampled]
    steps: KeptSteps

    def by_pilots(self, grid, angles: tuple[int, ...]) -> tuple[Metric, list[Attractor]]:
        """The metric, and the attractors that some of the starts show."""
        rows = grid[np.random.default_rng(0).permutation(len(grid))[:PILOT_RUNS]]

        def metric_of(shown: Sampled) -> Metric:
            late = shown.points[shown.status == OK, shown.points.shape[1] // 2 :]
            return Metric.of(late, np.ptp(grid, axis=0), angles)

        scale, by, *found = self.steps(functools.partial(self._shown, rows, LONGER_TRANSIENT, 1, metric_of, []))
        metric = Metric(scale, angles)
        return metric, self._told_apart(rows[by], attractors_in(found), metric, 0)

    def by_late(self, grid, metric: Metric, known: list[Attractor]) -> list[Attractor]:
        """The known attractors, and those that starts which have arrived at none of them show."""
        rows = grid[np.random.default_rng(1).permutation(len(grid))[:PILOT_RUNS]]

        def shown(rows, stride: int) -> tuple[np.ndarray, list[Attractor]]:
            given = rows, 4 * LONGER_TRANSIENT, stride, lambda shown: metric, known
            _, by, *found = self.steps(functools.partial(self._shown, *given))
            return rows[by], attractors_in(found)

        by, found = shown(rows, 1)
        if len(found) == len(known) and not self.steps.interrupted:
            # On a torus a motion that nearly repeats moves on slowly, and seems not to stay.
            by, found = shown(rows[:MOST_THAT_DO_NOT_REPEAT], LONGER_STRIDE)
            if any(revisits(one, metric) for one in found[len(known) :]):  # a cycle, whose period is not seen so
                return known
        return self._told_apart(by, found, metric, len(known))

    def _shown(self, rows, transients: int, stride: int, metric_of, known) -> list[np.ndarray]:
        """The scale of the metric, which rows showed the attractors that were not known, and all attractors."""
        shown = self.run(rows, transients, PILOT_SAMPLES, stride=stride)
        good, metric = np.flatnonzero(shown.status == OK), metric_of(shown)
        found, by = found_in(shown.points[good], shown.modes[good], metric, known) if len(good) else (known, [])
        return [metric.scale, good[by], *as_arrays(found)]

    def _told_apart(self, rows, found: list[Attractor], metric: Metric, known: int) -> list[Attractor]:
        """The attractors, of which these rows showed all but the known ones, after longer runs if that is needed.

        On a motion that nearly repeats some hundred samples leave gaps, in which those of another start may lie: where
        several attractors do not repeat, longer runs tell whether they are one.
        """
        new = [k for k in range(known, len(found)) if not found[k].period]
        count = sum(not one.period for one in found)
        if not new or not 2 <= count <= MOST_THAT_DO_NOT_REPEAT or self.steps.interrupted:
            return found

        def told_apart() -> list[np.ndarray]:
            starts = rows[np.subtract(new, known)]
            longer, attractors = self.run(starts, LONGER_TRANSIENT, PILOT_SAMPLES, stride=LONGER_STRIDE), list(found)
            for k, points, modes, status in zip(new, *longer, strict=True):
                if status == OK:
                    attractors[k] = with_more(attractors[k], points, modes, metric)
            return as_arrays(merged(attractors, metric, known))

        return attractors_in(self.steps(told_apart))
