"""At what phase of a cycle a motion is that has come back to it."""

import dataclasses
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ...integrators.base import Method
from ...systems.hybrid import Hybrid
from ...systems.smooth import Flow
from ..trajectories import trajectory

__all__ = ["MovingOn", "PhaseReader"]

POINTS_OF_TURN = 400  # at least, in which an anchor is looked for
WELL_SAMPLED = 0.05  # largest distance of neighbours among them near an anchor, relative to the cycle
AROUND_ANCHOR = 3  # points to each side of it without a jump
ANCHORINGS = 8  # most corrections of the time at which it is passed
LEAST_SPAN = 0.01  # least range of a component, relative to its size, by which distances are measured


@dataclasses.dataclass(frozen=True, eq=False)
class MovingOn:
    """What moves, for runs from the cycle; no pytree, so that results can hold it with the arrays in it."""

    system: Flow | Hybrid
    args: Any
    method: Method

    def field(self, x, mode: int):
        """The velocity (n,) at a state in a mode."""
        fields = self.system.fields if isinstance(self.system, Hybrid) else (self.system.field,)
        assert fields is not None, "it flows"
        return fields[mode](jnp.zeros((), x.dtype), x, self.args)

    def mode(self, index) -> int | None:
        """The mode as runs take it."""
        return int(index) if isinstance(self.system, Hybrid) else None

    def moved(self, x, mode, length: float):
        """State and mode after a length of time."""
        if length <= 0:
            return np.asarray(x), int(mode)
        points, modes = self.along(x, mode, length, 1)
        return points[-1], int(modes[-1])

    def along(self, x, mode, length: float, n: int):
        """States (n + 1, d) and modes (n + 1,) from the start on."""
        x = jnp.asarray(x, float)
        run = trajectory(self.system, x, self.args, t1=length, n=n, mode=self.mode(mode), method=self.method)
        return np.concatenate([x[None], run.x]), np.append(np.int32(mode), run.mode)


class PhaseReader(NamedTuple):
    """Reads phases off where a motion passes beside one point x of the cycle, the anchor, across its velocity.

    There the phase is that of the anchor + Z·(y − x), but for the square of the distance. Unlike the point that is
    nearest to a state the anchor can be one without jumps near by, where the phase depends little on the state.
    """

    motion: MovingOn
    period: float
    phase: float
    x: np.ndarray
    mode: int
    row: np.ndarray
    along: np.ndarray
    scale: np.ndarray
    points: int

    @classmethod
    def of(cls, motion: MovingOn, period: float, x: np.ndarray, mode: np.ndarray, response: np.ndarray):
        """With one of the points (phases, n) of the cycle as the anchor."""
        n = len(x)
        each = -(-POINTS_OF_TURN // n)
        points, modes = motion.along(x[0], mode[0], period, n * each)
        scale = np.maximum(np.ptp(points, axis=0), LEAST_SPAN * np.max(np.abs(points), axis=0))
        scale = np.maximum(scale, LEAST_SPAN**2 * np.max(scale))
        moves = np.max(np.abs(np.diff(points, axis=0)) / scale, axis=1)
        moves = np.where(modes[1:] == modes[:-1], moves, np.inf)
        beside = np.arange(n)[:, None] * each + np.arange(-AROUND_ANCHOR, AROUND_ANCHOR)
        largest = np.max(moves[beside % len(moves)], axis=1)
        swayed = np.max(np.abs(response) * scale, axis=1)  # how much the phase depends on the state
        chosen = np.argmin(np.where(largest <= WELL_SAMPLED, swayed, np.inf))
        j = int(chosen if largest[chosen] <= WELL_SAMPLED else np.argmin(largest))
        velocity = np.asarray(motion.field(jnp.asarray(x[j]), int(mode[j])))
        across = velocity / scale**2
        along = across / (across @ velocity)  # not Z, which may point almost across the velocity
        return cls(motion, period, period * j / n, x[j], int(mode[j]), response[j], along, scale, n * each)

    def read(self, y, mode: int) -> tuple[float, float]:
        """The phase of a state, and how far it is from the cycle, relative to its size; infinite if it never passes."""
        step = self.period / self.points
        points, modes = self.motion.along(y, mode, self.period + 2 * step, self.points + 2)
        far = np.where(modes == self.mode, self._distance(points), np.inf)
        i = 1 + int(np.argmin(far[1:]))  # a turn later than a passage just before the first point
        more = self.along @ (points[i] - self.x)
        i, later = (i - 1, step - more) if more > 0 else (i, -more)
        point, own, last = points[i], modes[i], np.inf
        for _ in range(ANCHORINGS):
            later = float(np.clip(later, 0.0, 2 * step))
            point, own = self.motion.moved(points[i], modes[i], later)
            more = float(self.along @ (point - self.x))
            if abs(more) >= last:
                break
            later, last = later - more, abs(more)
        distance = float(self._distance(point)) if own == self.mode else np.inf
        return self.phase - (i * step + later) + float(self.row @ (point - self.x)), distance

    def _distance(self, points):
        return np.max(np.abs(points - self.x) / self.scale, axis=-1)
