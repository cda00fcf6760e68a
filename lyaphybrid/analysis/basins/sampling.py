"""Runs of many starts at once, of which the last samples are kept."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from ...engine import problems
from ...engine.host.lanes import map_lanes
from ...integrators.base import Method
from ...statuses import STATUS
from ...systems.kinds import iterates
from ..indicators.following import follow

__all__ = ["Sampled", "Sampling", "gap_and_transient"]

SAMPLES_PER_LENGTH = 64  # of the transient, where no period is given


class Sampled(NamedTuple):
    """The last samples of runs: states (m, samples, n), modes (m, samples) and statuses (m,)."""

    points: np.ndarray
    modes: np.ndarray
    status: np.ndarray


def gap_and_transient(system, length, period) -> tuple[float, float]:
    """The time between two samples, and a multiple of it of at least that length."""
    gap = float(period or (1.0 if iterates(system) else float(length) / SAMPLES_PER_LENGTH))
    return gap, gap * float(np.ceil(float(length) / gap - 1e-9))


class _Lane(eqx.Module):
    """One start: (shared, start) -> its last points, modes and status."""

    transient: float = eqx.field(static=True)
    times: tuple[float, ...] = eqx.field(static=True)  # of the samples, after the transient
    max_steps: int = eqx.field(static=True)

    def __call__(self, shared, x):
        system, args, method, mode, t0 = shared
        times = np.array(self.times)
        run = follow(
            None, problems.point, system, x, args, k=0, t1=self.times[-1], t0=t0, transient=self.transient, times=times,
            blocks=len(times), mode=mode, frame=None, method=method, max_steps=self.max_steps, progress=None,
        )  # fmt: skip
        _, points, modes, _ = run.collected
        return points, modes, run.status


@dataclasses.dataclass(frozen=True)
class Sampling:
    """How starts are run: samples `gap` apart, at most `max_steps` attempts in a run, in the precision `dtype`.

    `free`: samples may be taken at any times, for the motion is not forced, as far as is known.
    """

    system: Any
    args: Any
    method: Method | None
    gap: float
    max_steps: int
    dtype: Any
    free: bool = False

    def __call__(
        self, rows, t, mode, transient: float, samples: int, report=None, *, spread: bool = False, stride: int = 1
    ) -> Sampled:
        """Run from the starts (m, n) at the time t and in a mode; after Ctrl-C some are `STATUS.interrupted`.

        `spread`: at random times, if they are free, so that a cycle is seen all round: equal gaps may be its period.
        `stride`: samples are that many gaps apart, as a mean, each time another whole number of them.
        """
        lane, shared = self.lane(transient, samples, spread and self.free, stride), self.shared(t, mode)
        (points, modes, status), done = map_lanes(lane, shared, np.asarray(rows, self.dtype), progress=report)
        return Sampled(points, modes, np.where(done, status, np.int32(STATUS.interrupted)))

    def lane(self, transient: float, samples: int, spread: bool = False, stride: int = 1) -> _Lane:
        """The run of one start."""
        generator = np.random.default_rng(2)
        parts = np.cumsum(generator.integers(1, 2 * stride, samples)).astype(float)
        if spread:
            parts[:-1] -= generator.uniform(0.0, 1.0, samples - 1)
        return _Lane(float(transient), tuple((self.gap * parts).tolist()), self.max_steps)

    def shared(self, t, mode):
        """What all starts share."""
        return self.system, self.args, self.method, mode, np.asarray(t, self.dtype)
