"""`basins`: to which attractor each start of a grid, or of a random sample, leads."""

import functools
import os
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from ... import plots
from ..._arguments import Key, Progress, Real, integers, is_key, positive, require, require_values, whole
from ..._keywords import explains_keywords
from ..._text import Table, with_error
from ...engine import preparation
from ...engine.host.reporting import reporter
from ...integrators.base import Method
from ...results.result import Data, Result, states_along
from ...statuses import OK, STATUS
from ...systems.daes.semi_linear import DAE
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import iterates
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from ..grids import box_of, grid_of
from . import measures
from .keeping import KeptSteps, kept_steps
from .recognition import Attractor, Metric, arrived
from .sampling import Sampled, Sampling, gap_and_transient
from .search import LONGER_TRANSIENT, Search

__all__ = ["BasinRun", "Basins", "basins"]

LAST_SAMPLES = 3  # last samples of a run, all of which must be at an attractor
STARTS_OF_STEP = 4096  # starts that a checkpoint keeps together
NO_CLASS = "undecided"
ATTEMPTS_OF_START = 10_000_000


class Basins(Result, eqx.Module):
    """Classes of starts: attractors, and whatever else runs end as.

    Attributes:
        labels: index of the class of each start, in the shape of the grid, or (m,).
        names: of the classes: "attractor 0", … in the order of `attractors`, then names of statuses, then "undecided".
        attractors: their points (p, n), angles in (−π, π], modes (p,), and period in samples, 0 where points do not
            repeat: those of a torus or of chaos, and of a limit cycle, as samples do not follow its period. Two that
            are nearer than 1e-5 of the extents are one.
        shares: (classes,) parts of the starts; stderr: (classes,) of independent starts √(p (1 − p) / m).
        starts: (m, n), as rows in the order of the labels.
        axes: the varied components and their values, of a grid; empty for random starts.
        metric: the scale of each component in which distances from attractors are measured.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> wells = lh.Flow(lambda t, x, a: jnp.stack([x[1], x[0] - x[0] ** 3 - 0.5 * x[1]]))
        >>> found = lh.basins(wells, [[-2.0, -1.0], [2.0, 1.0]], shape=(20, 10), t1=80.0)
        >>> found.names, found.shares.tolist()
        (('attractor 0', 'attractor 1'), [0.5, 0.5])
    """

    labels: np.ndarray
    names: tuple[str, ...] = eqx.field(static=True)
    attractors: tuple[Attractor, ...]
    starts: np.ndarray
    axes: dict[int, np.ndarray]
    metric: Metric
    state_labels: Labels = eqx.field(static=True)

    @property
    def shares(self) -> np.ndarray:
        """(classes,) parts of the starts."""
        return np.bincount(self.labels.ravel(), minlength=len(self.names)) / self.labels.size

    @property
    def stderr(self) -> np.ndarray:
        """(classes,) standard errors of the shares, of independent random starts."""
        return np.sqrt(self.shares * (1 - self.shares) / self.labels.size)

    def entropy(self, size: int = 5) -> measures.Entropy:
        """Basin entropies over boxes of `size` cells along each side, with standard errors; for grids.

        A. Daza, A. Wagemakers, B. Georgeot, D. Guéry-Odelin & M. A. F. Sanjuán, Sci. Rep. 6 (2016) 31416,
        doi:10.1038/srep31416.

        Raises:
            ValueError: for random starts; on a size that fits no two boxes along a side.
        """
        self._require_grid()
        return measures.entropy(self.labels, size)

    def boundary_dimension(self) -> measures.BoundaryDimension:
        """The dimension of the boundaries in the space of the grid, by the exponent of uncertainty; for grids.

        The share of pairs of starts that lead to different attractors grows as a power of their distance: the space's
        dimension less the boundary's.

        S. W. McDonald, C. Grebogi, E. Ott & J. A. Yorke, Physica D 17 (1985) 125, doi:10.1016/0167-2789(85)90001-6.

        Raises:
            ValueError: for random starts; for fewer than 64 cells along a side; where there is no boundary.
        """
        self._require_grid()
        return measures.boundary_dimension(self.labels)

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The classes over a grid of two components. `style` goes to what it draws."""
        self._require_grid()
        require(len(self.axes) == 2, f"A picture needs a grid of two components; this one has {len(self.axes)}.")
        return plots.basins(self, ax, **style)

    def _require_grid(self) -> None:
        require(bool(self.axes), "This needs starts on a grid, shape=…; these are random ones.")

    def _table(self) -> Table:
        rows = []
        for i, (name, share, error) in enumerate(zip(self.names, self.shares, self.stderr, strict=True)):
            what = ""
            if i < len(self.attractors):
                period = self.attractors[i].period
                what = f"repeats after {period}" if period else "does not repeat"
            rows.append((name, what, f"{share:.6g}" if self.axes else with_error(share, error)))
        kind = "grid" if self.axes else "sample"
        return Table(f"Basins: {self.labels.size} starts, a {kind}", rows, [], ("class", "samples", "share"))

    def _data(self) -> Data:
        along = [self.state_labels.name(i) for i in self.axes] or ["start"]
        coordinates = {self.state_labels.name(i): values for i, values in self.axes.items()}
        n = self.starts.shape[1]
        variables = {
            "labels": (tuple(along), self.labels),
            "shares": ("class", self.shares),
            "starts": (("start", "state"), self.starts) if not self.axes else None,
        }
        more = {} if self.axes else states_along(self.state_labels, n)
        return Data(variables, {"class": list(self.names), **coordinates, **more})


@explains_keywords
def basins(
    system: Flow | Map | Hybrid | EventDriven,
    x0: Any,
    args: Any = None,
    *,
    t1: Real,
    shape: Any = None,
    starts: int | None = None,
    key: Key = None,
    period: Real | None = None,
    angles: Any = (),
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    max_steps: int = ATTEMPTS_OF_START,
    progress: Progress = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
) -> Basins:
    """Which attractor each start leads to.

    Some runs from among the starts, followed for long, show the attractors: cycles, whose samples repeat, and sets of
    points, for tori and chaos. Runs that still drift show none. Each start is then run for t1, and belongs to the
    attractor at which its last samples are, if none other is about as near. Runs that have not arrived go on for four
    times as long; they may show attractors that were not seen before. What has not settled even then is "undecided": a
    longer t1 decides. Runs that end otherwise (escape, accumulation, deadlock) are classes of their own, by status.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (2, n) corners of the box of starts; components that are equal in both corners are not varied.
        args: pytree of parameters.
        t1: length of each run before samples count (iterations for a map).
        shape: numbers of cells along the varied components: a grid of the cells' middles.
        starts: number of random starts instead, drawn with `key`: shares then have standard errors.
        key: a `jax.random.key`, for `starts`.
        period: of the forcing: samples are one period apart, and t1 is made a multiple of it. None: for a map one
            iteration, for any other system t1/64, and at random times in runs that show attractors.
        angles: components modulo 2π.
        t0: time at the start.
        mode: mode at the start, where there are several and the system does not determine it.
        method: as for `lh.lyapunov_spectrum`.
        max_steps: most attempts of a step in one run.
        progress: True for a bar, or a function of the fraction done.
        checkpoint: path of a file which keeps what is done, some thousand starts at a time, every few seconds and after
            Ctrl-C.
        resume: go on from that file, if it is there: the result is that of a run that never stopped.

    Returns:
        A `Basins` with `.labels`, `.names`, `.attractors`, `.shares`, `.entropy()`, `.boundary_dimension()`, `.plot()`.
        Labels are whole numbers and have no derivatives.

    Raises:
        ValueError: on arguments that do not fit; where `checkpoint` is the file of another run.
        OSError: where `checkpoint` cannot be written from the start.

    Source:
        P. J. Menck, J. Heitzig, N. Marwan & J. Kurths, How basin stability complements the linear-stability paradigm,
        Nature Phys. 9 (2013) 89, doi:10.1038/nphys2516.

    Example:
        Newton's method for z³ = 1: three basins of one third each, by symmetry.

        >>> import jax, jax.numpy as jnp, lyaphybrid as lh
        >>> def newton(n, x, args):
        ...     a, b = x
        ...     c, d = (a**2 - b**2) / (a**2 + b**2) ** 2, -2 * a * b / (a**2 + b**2) ** 2  # 1/z²
        ...     return jnp.stack([2 * a + c, 2 * b + d]) / 3
        >>> found = lh.basins(lh.Map(newton), [[-1.0, -1.0], [1.0, 1.0]], starts=2000, key=jax.random.key(0), t1=60)
        >>> len(found.attractors), bool(abs(found.shares - 1 / 3).max() < 5 * found.stderr.max())
        (3, True)
    """
    how = {"period": period, "angles": angles, "t0": t0, "mode": mode, "method": method, "max_steps": max_steps}
    run = BasinRun.of(system, x0, args, t1, (shape, starts, key), **how)
    with run.kept(checkpoint, resume) as steps:
        return run.found(steps, progress)


class BasinRun(NamedTuple):
    """What is run to find basins."""

    sampling: Sampling
    grid: np.ndarray  # (m, n) the starts
    axes: dict[int, np.ndarray]
    t0: float
    mode: Any
    transient: float
    angles: tuple[int, ...]
    labels: Labels

    @classmethod
    def of(cls, system, x0, args, t1, starts: tuple, *, period, angles, t0, mode, method, max_steps) -> "BasinRun":
        """The run that the arguments of `basins` describe; `starts` is shape, starts and key."""
        require(not isinstance(system, DAE), "basins takes no lh.DAE: starts of a box are not on its constraints.")
        require_values("basins", x0, args)
        positive("t1, a length,", t1)
        whole("max_steps", max_steps, least=1)
        corners = box_of(x0)
        angles = integers("angles", angles, 0, corners.shape[1] - 1)
        if period is not None:
            positive("period", period)
        grid, axes = _starts(corners, *starts)
        problem, first, _, mode = preparation.prepare(system, grid[0], args, t0, method, mode)
        preparation.warn_of_small_units(corners, problem.method)
        gap, transient = gap_and_transient(system, t1, period)
        free = period is None and not iterates(system)
        sampling = Sampling(system, problem.args, method, gap, max_steps, first.dtype, free)
        return cls(sampling, grid, axes, float(t0), mode, transient, angles, labels_of(system, problem.shape))

    def kept(self, checkpoint: Any, resume: bool) -> AbstractContextManager[KeptSteps]:
        """The steps of this run with its file, if it has one."""
        first = np.asarray(self.grid[0], self.sampling.dtype)
        length = np.array([self.transient, self.sampling.gap, self.sampling.max_steps])
        same = {"box, shape, starts or key": self.grid, "t1, period or max_steps": length, "angles": self.angles}
        return kept_steps(checkpoint, resume, self.sampling, (self.t0, self.mode, first), same)

    def found(self, steps: KeptSteps, progress: Progress = None) -> Basins:
        """The basins, step by step."""

        def run(rows, times: int, samples: int, report=None, stride: int = 1) -> Sampled:
            length, spread = times * self.transient, samples > LAST_SAMPLES
            seen = self.sampling(rows, self.t0, self.mode, length, samples, report, spread=spread, stride=stride)
            steps.interrupted |= bool(np.any(seen.status == STATUS.interrupted))
            return seen

        labels, attractors, status, metric = _classified(self.grid, run, self.angles, steps, progress)
        labels, names = _named(labels, status, len(attractors))
        shape = tuple(len(values) for values in self.axes.values()) or (len(self.grid),)
        return Basins(labels.reshape(shape), names, tuple(attractors), self.grid, self.axes, metric, self.labels)


def _starts(corners, shape, starts, key):
    """The starts (m, n), and of a grid the varied components with their values."""
    require((shape is None) != (starts is None), f"Give one of shape=… and starts=…; got {shape!r} and {starts!r}.")
    if starts is not None:
        whole("starts", starts, least=1)
        require(is_key(key), f"starts needs key=jax.random.key(seed), to draw them; got {key!r}.")
        low, high = corners
        return low + (high - low) * np.asarray(jax.random.uniform(key, (starts, len(low)))), {}
    return grid_of(corners, shape)


def _classified(grid, run, angles, steps: KeptSteps, progress):
    """Labels (m,) of all starts, −1 where undecided; the attractors; the statuses (m,); the metric."""
    search = Search(run, steps)
    metric, attractors = search.by_pilots(grid, angles)
    labels, status = _arrived(grid, run, metric, attractors, steps, progress)
    for _ in range(2):
        late = np.flatnonzero((labels < 0) & (status == OK))
        if not len(late):
            break
        if not steps.interrupted:
            attractors = search.by_late(grid[late], metric, attractors)
        if steps.interrupted:  # they had not arrived
            status[late] = STATUS.interrupted
            break
        labels[late], status[late] = steps(functools.partial(_after_longer_runs, grid[late], run, metric, attractors))
    return np.where(status == OK, labels, -1), attractors, status, metric


def _arrived(grid, run, metric, attractors, steps: KeptSteps, progress) -> tuple[np.ndarray, np.ndarray]:
    """Labels (m,) and statuses (m,) of all starts, in pieces if they are kept."""
    size, report = STARTS_OF_STEP if steps.are_kept else len(grid), reporter(progress)
    labels, status = np.full(len(grid), -1, np.int32), np.full(len(grid), STATUS.interrupted, np.int32)
    for first in range(0, len(grid), size):
        rows = grid[first : first + size]

        def one(rows=rows, first=first) -> list[np.ndarray]:
            def fraction(part: float) -> None:
                report((first + part * len(rows)) / len(grid))

            last = run(rows, 1, LAST_SAMPLES, fraction)
            return [arrived(last.points, last.modes, metric, attractors), last.status]

        if steps.interrupted:
            break
        labels[first : first + size], status[first : first + size] = steps(one)
    report(None)
    return labels, status


def _after_longer_runs(grid, run, metric, attractors) -> list[np.ndarray]:
    """Labels and statuses of starts that have not arrived, after longer runs."""
    again = run(grid, LONGER_TRANSIENT, LAST_SAMPLES)
    return [arrived(again.points, again.modes, metric, attractors), again.status]


def _named(labels, status, count: int):
    """Labels of attractors, then of the statuses that occur, then of what is undecided; and the names of all."""
    names, labels = [f"attractor {i}" for i in range(count)], labels.copy()
    for code in sorted({int(one) for one in status} - {OK}):
        labels[status == code] = len(names)
        names.append(STATUS(code).name)
    if np.any(labels < 0):
        labels[labels < 0] = len(names)
        names.append(NO_CLASS)
    return labels, tuple(names)
