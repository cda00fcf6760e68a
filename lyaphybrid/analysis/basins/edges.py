"""`edge_state`: the motion on the boundary between two basins, to which neither side leads."""

import dataclasses
import functools
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from ..._arguments import Real, positive, require, require_values, whole
from ..._keywords import explains_keywords, user_level
from ..._text import Table, in_brackets, per_unit, with_error
from ...engine import preparation
from ...integrators.base import Method
from ...results.result import Data, Result, in_time, states_along
from ...results.resuming import Resumable
from ...statuses import OK, STATUS
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import iterates
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from .basins import ATTEMPTS_OF_START, LAST_SAMPLES, Basins
from .recognition import Metric, arrived
from .sampling import Sampled, Sampling, gap_and_transient

__all__ = ["EdgeState", "edge_state"]

STARTS_BETWEEN = 15  # starts between two that are told apart at once
UNEVEN_BY = 0.382  # of the distance of two of them: by so much all are moved where none tells the two sides apart
CLOSE_PAIR, PARTED_PAIR = 1e-9, 1e-4  # distances of the pair, relative to the scale of the attractors
SAMPLES_OF_PAIR = 16  # samples of the pair in one run
FAR_PAIR, SUDDEN = 1e-2, 100.0  # a pair that is so far apart, and that much farther than a sample before, is seen late
CLOSER_BY, MOST_TIMES_CLOSER = 4.0, 6  # samples are then so much closer, so many times at most


class EdgeState(Resumable, Result, eqx.Module):
    """A motion on the boundary between two basins.

    Attributes:
        t: (m,) times; x: (m, n) states on the boundary, to about a ten-thousandth of the extent of the attractors.
        modes: (m,) indices.
        rate: at which two motions on both sides part, after the first time if there are more: the largest exponent of
            the motion on the boundary.
        stderr: its standard error, of the several times that they parted; nan of one.
        rounds: how often the pair was brought together again.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> wells = lh.Flow(lambda t, x, a: jnp.stack([x[1], x[0] - x[0] ** 3 - 0.5 * x[1]]))
        >>> found = lh.basins(wells, [[-2.0, -1.0], [2.0, 1.0]], shape=(20, 10), t1=80.0)
        >>> edge = lh.edge_state(wells, found, t1=60.0, settle=80.0)
        >>> bool(abs(edge.x[-1]).max() < 1e-3)  # the saddle between the wells
        True
    """

    t: np.ndarray
    x: np.ndarray
    modes: np.ndarray
    rate: float
    stderr: float
    rounds: int
    state_labels: Labels = eqx.field(static=True)

    def resume(self, t1: Real) -> "EdgeState":
        """Go on along the boundary to the length t1, with the same settings: bit by bit what one call to t1 gives.

        Args:
            t1: the whole length, beyond what was reached.

        Returns:
            An `EdgeState` of the whole motion.

        Raises:
            ValueError: on a t1 that is not beyond the end; where this is not the object that `lh.edge_state` has
                returned (a copy of it, or one out of a file).

        Example:
            >>> import jax.numpy as jnp, lyaphybrid as lh
            >>> cubic = lh.Map(lambda n, x, a: 1.5 * x - x**3)
            >>> found = lh.basins(cubic, [[-1.3], [1.2]], shape=(50,), t1=100)
            >>> short = lh.edge_state(cubic, found, t1=100, settle=200)
            >>> longer = short.resume(400)
            >>> longer.rounds > short.rounds, bool(longer.t[-1] >= 400)
            (True, True)
        """
        go_on = self._goes_on("lh.edge_state", "Begin anew, with the same Basins.")
        positive("t1, a length,", t1)
        return go_on(self, t1)

    def _table(self) -> Table:
        names = [self.state_labels.name(i) for i in range(self.x.shape[1])]
        rows = [(f"{t:.6g}", *(f"{value:.6g}" for value in x)) for t, x in zip(self.t[-4:], self.x[-4:], strict=True)]
        rate = f"{self.rate:.6g}" if np.isnan(self.stderr) else with_error(self.rate, self.stderr)
        unit = self.state_labels.time_unit
        said = [f"motions on both sides part at the rate {rate}{per_unit(unit)}, seen {self.rounds} times"]
        return Table(
            f"Edge state: {len(self.t)} points, the last of them", rows, said, (in_brackets("t", unit), *names)
        )

    def _data(self) -> Data:
        variables = {"x": (("t", "state"), self.x), "modes": ("t", self.modes)}
        more = {"rate": self.rate, "stderr": self.stderr, "rounds": self.rounds}
        t = ("t", self.t, in_time(self.state_labels.time_unit))
        return Data(variables, {"t": t, **states_along(self.state_labels, self.x.shape[1])}, more)


class _Straddling(NamedTuple):
    """Two motions at one time and in one mode, one on each side."""

    t: float
    mode: Any
    x: np.ndarray  # (2, n)


@explains_keywords
def edge_state(
    system: Flow | Map | Hybrid | EventDriven,
    found: Basins,
    args: Any = None,
    *,
    t1: Real,
    settle: Real,
    between: tuple[int, int] = (0, 1),
    period: Real | None = None,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    max_steps: int = ATTEMPTS_OF_START,
) -> EdgeState:
    """Follow the boundary between two basins to what attracts on it: a saddle, an unstable cycle, a chaotic saddle.

    Two starts, one in each basin, are brought together by bisection, and both are followed until they have parted; then
    they are brought together again, where they are then. What is between them stays near the boundary.

    Args:
        system: as in `basins`.
        found: what `basins` found of it, with the same args and period.
        args: pytree of parameters.
        t1: length of the motion on the boundary.
        settle: time within which a start beside the boundary arrives at its attractor; longer than that in `basins`.
        between: the two attractors, by their numbers.
        period: of the forcing, as in `basins`; None: for a map one iteration, else settle/64.
        t0: time at the start, as in `basins`.
        mode: mode at the start, as in `basins`.
        method: as for `lh.lyapunov_spectrum`.
        max_steps: most attempts of a step in one run.

    Returns:
        An `EdgeState` with `.t`, `.x`, `.modes`, `.rate`, `.resume(t1)`; after Ctrl-C of the motion until then. Where
        it repeats, `lh.floquet` finds the orbit from its end. What is computed decides which way it goes, so that it
        has no derivatives by parameters: take those of the orbit.

    Raises:
        ValueError: on arguments that do not fit; where there is no boundary between these two basins alone.

    Source:
        J. D. Skufca, J. A. Yorke & B. Eckhardt, Edge of chaos in a parallel shear flow, Phys. Rev. Lett. 96 (2006)
        174101, doi:10.1103/PhysRevLett.96.174101.

    Example:
        x → 3x/2 − x³ has the fixed points ±1/√2, and between them 0 with the exponent ln 3/2.

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> cubic = lh.Map(lambda n, x, a: 1.5 * x - x**3)
        >>> edge = lh.edge_state(cubic, lh.basins(cubic, [[-1.3], [1.2]], shape=(50,), t1=100), t1=100, settle=200)
        >>> bool(abs(edge.rate - jnp.log(1.5)) < 1e-6)
        True
    """
    require_values("edge_state", args, t0)
    require(isinstance(found, Basins), f"found must be a Basins, of lh.basins; got {found!r}.")
    for name, value in (("t1, a length,", t1), ("settle, a length,", settle)):
        positive(name, value)
    if period is not None:
        positive("period", period)
    whole("max_steps", max_steps, least=1)
    count = len(found.attractors)
    apart = len(between) == 2 and all(0 <= one < count for one in between) and between[0] != between[1]
    require(apart, f"between must be the numbers of two of the {count} attractors; got {between!r}.")
    start = _nearest(found, *between)
    problem, first, t0, mode = preparation.prepare(system, start[0], args, t0, method, mode)
    gap, transient = gap_and_transient(system, settle, period)
    sampling = Sampling(system, problem.args, method, gap, max_steps, first.dtype)

    def run(t: float, mode, rows, before: float, samples: int, gap: float = gap) -> Sampled:
        seen = dataclasses.replace(sampling, gap=gap)(rows, t, mode, before, samples)
        if np.any(seen.status == STATUS.interrupted):  # of half a pair nothing can be told
            raise KeyboardInterrupt
        return seen

    def classes(t: float, mode, rows) -> np.ndarray:
        points, modes, status = run(t, mode, rows, transient, LAST_SAMPLES)
        return np.where(status == OK, arrived(points, modes, found.metric, found.attractors), -1)

    forced = period is not None or iterates(system)
    along = _Along(run, classes, between, forced, found.metric, float(t0), labels_of(system, problem.shape))
    return along.followed(_Way(_Straddling(float(t0), mode, start), (), (), gap, 0), t1)


class _Way(NamedTuple):
    """Where the pair is, the points on the way there, and by how much it has parted (ln) in what time, each round.

    Samples are `gap` apart, after they were made closer `finer` times.
    """

    pair: _Straddling
    path: tuple[tuple[float, np.ndarray, Any], ...]
    rates: tuple[tuple[float, float], ...]
    gap: float
    finer: int


class _Along(NamedTuple):
    """How a boundary is followed."""

    run: Callable
    classes: Callable
    between: tuple[int, int]
    forced: bool  # samples are a period apart
    metric: Metric
    t0: float
    labels: Labels

    def followed(self, way: _Way, t1: Real) -> EdgeState:
        """On the way until t1; or until Ctrl-C, if there is something to return."""
        try:
            while not way.path or way.path[-1][0] < self.t0 + float(t1):
                pair = _together(way.pair, self.between, self.classes, self.metric)
                first = (pair.t, np.mean(pair.x, axis=0), pair.mode)
                way, pair, later, rate = self._followed_to_the_end(way, pair)
                way = way._replace(pair=pair, path=(*way.path, first, *later), rates=(*way.rates, rate))
        except KeyboardInterrupt:
            if not way.path:
                raise
            reached = way.path[-1][0] - self.t0
            warnings.warn(f"interrupted at {reached:.6g} of {float(t1):.6g}: .resume goes on.", stacklevel=user_level())
        return self._as_result(way)._resumed_by(functools.partial(self._again, way))

    def _followed_to_the_end(self, way: _Way, together: _Straddling):
        """The pair until it has parted, with samples close enough to see it part; the way with their gap.

        Where closer samples do not help either, it is a jump that parts them so suddenly: then they stay as they were.
        """
        *at_first, in_time = _parted(together, self.run, way.gap, self.metric)
        require(
            in_time or not self.forced or bool(at_first[1]),
            f"Two motions beside the boundary part within one period from t = {together.t:g} on: nothing of it can be "
            "seen. Its orbit may be found by lh.floquet, from a start near the boundary.",
        )
        if in_time or self.forced or way.finer == MOST_TIMES_CLOSER:
            return way, *at_first
        for finer in range(way.finer + 1, MOST_TIMES_CLOSER + 1):
            closer = way._replace(gap=way.gap / CLOSER_BY ** (finer - way.finer), finer=finer)
            *seen, in_time = _parted(together, self.run, closer.gap, self.metric)
            if in_time:
                return closer, *seen
        return way._replace(finer=MOST_TIMES_CLOSER), *at_first

    def _again(self, way: _Way, found: EdgeState, t1: Real) -> EdgeState:
        reached = float(found.t[-1]) - self.t0
        require(float(t1) > reached, f"t1 must be beyond the {reached:.15g} that was reached; got {t1!r}.")
        return self.followed(way, t1)

    def _as_result(self, way: _Way) -> EdgeState:
        settled = way.rates[1:] or way.rates  # the first time they may come in from afar
        each = np.array([grown / time for grown, time in settled])
        stderr = float(np.std(each, ddof=1) / len(each) ** 0.5) if len(each) > 1 else np.nan
        rate = float(sum(grown for grown, _ in settled) / sum(time for _, time in settled))
        t, x, modes = zip(*way.path, strict=True)
        modes = np.array([0 if mode is None else int(mode) for mode in modes], np.int32)
        return EdgeState(np.array(t), np.array(x), modes, rate, stderr, len(way.rates), self.labels)


def _nearest(found: Basins, i: int, j: int) -> np.ndarray:
    """The nearest two starts (2, n) that lead to these attractors."""
    from scipy.spatial import KDTree

    labels, places = found.labels.ravel(), found.starts / found.metric.scale
    one, other = np.flatnonzero(labels == i), np.flatnonzero(labels == j)
    for attractor, starts in ((i, one), (j, other)):
        require(len(starts) > 0, f"No start leads to attractor {attractor}: there is nothing to begin with.")
    distance, nearest = KDTree(places[other]).query(places[one])
    closest = int(np.argmin(distance))
    return found.starts[[one[closest], other[np.asarray(nearest)[closest]]]]


def _distance(x: np.ndarray, metric) -> Any:
    """Between the two rows of (2, …, n), relative to the scale."""
    return np.sqrt(np.sum(((x[1] - x[0]) / metric.scale) ** 2, axis=-1))


def _together(pair: _Straddling, between: tuple[int, int], classes: Callable, metric) -> _Straddling:
    """The pair, brought together along the line between them."""
    a, b = pair.x
    even = np.linspace(0.0, 1.0, STARTS_BETWEEN + 2)[:, None]
    uneven = even + UNEVEN_BY * even[1] * ((even > 0) & (even < 1))
    while _distance(np.stack([a, b]), metric) > CLOSE_PAIR:
        for parts in (even, uneven):  # by symmetry a start between may be on the boundary, and stay there
            line = a + parts * (b - a)
            labels = np.array([between[0], *classes(pair.t, pair.mode, line[1:-1]), between[1]])
            changes = np.flatnonzero((labels[:-1] == between[0]) & (labels[1:] == between[1]))
            if len(changes):
                break
        require(
            len(changes) > 0,
            f"Between attractors {between[0]} and {between[1]} lies something else at t = {pair.t:g}: a third basin, "
            "or motions that have not arrived after `settle`. Take a longer one, or two other attractors.",
        )
        before = a, b
        a, b = line[changes[-1]], line[changes[-1] + 1]
        if np.array_equal(before, (a, b)):  # as near as floats can be
            break
    return pair._replace(x=np.stack([a, b]))


def _parted(
    pair: _Straddling, run: Callable, gap: float, metric
) -> tuple[_Straddling, list, tuple[float, float], bool]:
    """The pair after it has parted; points between them on the way; by how much they parted (ln), and in what time.

    The last result is whether that was seen in time: not only when they were far apart.
    """
    first, begun, path = float(_distance(pair.x, metric)), pair.t, []
    last = first
    while True:
        points, modes, _ = run(pair.t, pair.mode, pair.x, 0.0, SAMPLES_OF_PAIR, gap)
        apart = _distance(points, metric)
        alike = (modes[0] == modes[1]) & np.isfinite(apart)  # else one has jumped to another mode
        require(bool(np.any(alike)), f"No two motions at the boundary are in one mode from t = {pair.t:g} on.")
        here, seen = pair, np.flatnonzero(alike)
        for k, after in zip(seen, [*seen[1:], None], strict=True):
            now = pair.t + (k + 1) * gap
            if apart[k] > PARTED_PAIR:
                if after is None and here is not pair:  # whether it stays so the next run shows
                    break
                if after is not None and apart[after] < apart[k]:  # one has jumped, the other is just about to
                    continue
            here = _Straddling(now, None if pair.mode is None else modes[0, k], points[:, k])
            if apart[k] > PARTED_PAIR:
                in_time = apart[k] <= max(FAR_PAIR, SUDDEN * last)
                return here, path, (float(np.log(apart[k] / first)), now - begun), bool(in_time)
            last = float(apart[k])
            path.append((now, np.mean(points[:, k], axis=0), here.mode))
        pair = here
