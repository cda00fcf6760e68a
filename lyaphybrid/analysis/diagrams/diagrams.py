"""Bifurcation diagrams: attractors and exponents against a parameter, from many starts and followed up and down."""

import collections
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ... import _renamed as renamed
from ... import plots
from ..._arguments import (
    Key,
    Progress,
    attempts,
    flag,
    integers,
    is_one_of,
    numbers,
    positive,
    random_key,
    require,
    require_values,
    whole,
)
from ..._entries import number_of
from ..._jax.tracing import array
from ..._keywords import explains_keywords
from ..._text import Table
from ...engine import preparation, problems
from ...engine.blocks import qr_schedule_for
from ...engine.host import driver, lanes
from ...engine.states import MOST_AT_ONCE
from ...integrators.base import Method
from ...results.result import Data, Result, exponents_along, in_time, per_time, states_along
from ...statuses import OK, STATUS
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import iterates
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from ..orbits.periods import check_period
from ..orbits.sides import BEYOND_GUARD
from ..spectra import initial_frame
from . import attractors
from .sections import with_section
from .strobes import RunEnd, StrobeResults, StrobeRun, run, schedule

__all__ = ["BifurcationDiagram", "bifurcation_diagram", "only_parameter"]

START_KINDS = ("random", "up", "down")
ATTEMPTS_OF_CROSSING = 100_000  # most attempts of a step until a section is crossed, in case it never is
MISSING = -1  # status of a lane that was not computed


@dataclasses.dataclass(frozen=True, repr=False)
class BifurcationDiagram(Result):
    """Attractors and exponents over a parameter. The axis `starts` holds the random starts, then up and down.

    Attributes:
        parameter: its name; values: (values,).
        kinds: (starts,) "random", "up" or "down".
        exponents, stderr: (values, starts, k) per unit of time, as of `lh.lyapunov_spectrum`; for a run that ended on a
            cycle only from where it had come near the cycle; nan where a run failed.
        finite_exponents, losses: (values, starts, k) exponents without the times of loss, and the number of losses of
            each column in that time.
        time: (values, starts) over which the exponents are means.
        status: (values, starts) codes; −1 for runs that were not started before Ctrl-C.
        points: (values, starts, samples, n) the last points, once a period; angles are not wrapped.
        labels: (values, starts) "P3w1" (of period 3, one turn of the angles in it): the points repeat to 1e-5 of their
            range, and λ₁ is not positive by 5 standard errors (unless the run is on a cycle that repels: it repeats to
            rounding). "chaos": λ₁ is positive by 5 standard errors, and λ₁ · time > 25. "aperiodic/slow": neither, as
            of quasi-periodic motions, of those that still settle, and of chaos too weak for the run: a longer t1
            decides. "beyond_guard": it began beyond a guard and never came back, so that the guard did not fire. Or
            the name of the status.
        lifetimes: (values, starts) periods after which the motion came near the cycle on which it ended; nan where it
            did not end on one. None unless escape=True.
        angles: components that are angles.
        transient, t1: lengths in periods (or crossings, or iterations).

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.bifurcation_diagram(
        ...     logistic, [[0.1], [0.9]], {"r": 0.0}, over={"r": [2.8, 3.2]}, t1=100, transient=50, samples=16
        ... )
        >>> found.points.shape, found.labels[:, 0].tolist()
        ((2, 6, 16, 1), ['P1w0', 'P2w0'])
    """

    parameter: str
    values: np.ndarray
    kinds: tuple[str, ...]
    exponents: np.ndarray
    stderr: np.ndarray
    finite_exponents: np.ndarray
    losses: np.ndarray
    time: np.ndarray
    status: np.ndarray
    points: np.ndarray
    labels: np.ndarray
    lifetimes: np.ndarray | None
    angles: tuple[int, ...]
    transient: int
    t1: int
    state_labels: Labels = Labels()

    @property
    def escaped(self) -> np.ndarray:
        """(values, starts) whether the motion settled on a periodic attractor within the run."""
        return np.isfinite(self._known_lifetimes())

    def attractors(self) -> list[str]:
        """For each value how often each label was found, of the random starts where there are any."""
        counted = [i for i, kind in enumerate(self.kinds) if kind == "random"] or range(len(self.kinds))
        counts = (collections.Counter(row[list(counted)]) for row in self.labels)
        return [";".join(f"{name}:{m}" for name, m in _most_common(count)) for count in counts]

    def mean_lifetimes(self) -> tuple[np.ndarray, np.ndarray]:
        """(values,) mean lifetimes in periods after the transient and their standard errors, from the random starts.

        The maximum-likelihood estimate for exponential lifetimes of which some outlast the run: the time that all
        motions lived, divided by the number of escapes m; relative error 1/√m; infinite where none escaped. Runs
        that settled within the transient do not count.
        """
        lifetimes = self._known_lifetimes()
        end, random = self.transient + self.t1, np.array([kind == "random" for kind in self.kinds])
        lived = np.where(np.isnan(lifetimes), end, lifetimes)[:, random] - self.transient
        counts = (lived > 0) & (self.status[:, random] == OK)
        total = np.sum(np.where(counts, lived, 0.0), axis=1)
        escapes = np.sum(counts & self.escaped[:, random], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = np.where(total > 0, total / escapes, np.nan)
            return mean, np.where(escapes > 0, mean / np.sqrt(escapes), mean)

    @property
    def plot(self) -> plots.DiagramPlots:
        """Figures: ``plot()`` on two axes; ``plot.bifurcations()`` and ``plot.largest_exponent()`` on one each."""
        return plots.DiagramPlots(self)

    def _known_lifetimes(self) -> np.ndarray:
        if self.lifetimes is None:
            raise ValueError("This diagram has no lifetimes: lh.bifurcation_diagram(…, escape=True) records them.")
        return self.lifetimes

    def _table(self) -> Table:
        values, starts = self.labels.shape
        failed = sum(name in STATUS.__members__ or name == "interrupted" for name in self.labels.flat)
        title = f"Bifurcation diagram over {self.parameter}: {values} values, {starts} runs each, {failed} failed"
        pairs = zip(self.values, self.attractors(), strict=True)
        others = [kind for kind in self.kinds if kind != "random"]
        counted = starts - len(others)
        notes = [f"counted: the {counted} random starts, not those that follow {' and '.join(others)}"]
        rows = [(f"{value:.6g}", found) for value, found in pairs]
        return Table(title, rows, notes if counted and others else [])

    def _data(self) -> Data:
        run, unit = ("value", "start"), self.state_labels.time_unit
        by_exponent = {name: getattr(self, name) for name in ("exponents", "stderr", "finite_exponents", "losses")}
        by_run = {name: getattr(self, name) for name in ("time", "status", "labels", "lifetimes")}
        variables: dict[str, Any] = {name: ((*run, "exponent"), values) for name, values in by_exponent.items()}
        variables |= {name: None if values is None else (run, values) for name, values in by_run.items()}
        for name in ("exponents", "stderr", "finite_exponents"):
            variables[name] += (per_time(unit),)
        variables["time"] += (in_time(unit),)
        variables |= {"points": ((*run, "sample", "state"), self.points)}
        coordinates = {
            self.parameter: ("value", self.values),
            "kind": ("start", list(self.kinds)),
            **exponents_along(self.exponents.shape[-1]),
            **states_along(self.state_labels, self.points.shape[-1]),
        }
        attributes = {name: getattr(self, name) for name in ("parameter", "angles", "transient", "t1")}
        return Data(variables, coordinates, attributes)


def _most_common(count):
    return sorted(count.items(), key=lambda item: (-item[1], item[0]))


def _order_of_before(name: str, positional: tuple, given: dict[str, Any]) -> tuple:
    """`over` came second, before x0."""
    if len(positional) > 1 and isinstance(positional[1], Mapping):
        renamed.warn(f"{name}(system, over, x0, args)", f"{name}(system, x0, args, over=…)")
        system, given["over"], *rest = positional
        return system, *rest
    return positional


@explains_keywords
@renamed.arguments(_order_of_before)
def bifurcation_diagram(
    system: Flow | Map | Hybrid | EventDriven,
    x0: Any,
    args: Any,
    *,
    over: Mapping[str, Any],
    period: Any = None,
    section: Any = None,
    starts: Any = 4,
    directions: Sequence[str] = START_KINDS,
    transient: int = 200,
    t1: int = 1000,
    samples: int = 64,
    angles: Sequence[int] = (),
    escape: bool = False,
    k: int | None = None,
    mode: str | int | None = None,
    method: Method | None = None,
    max_steps: int | None = None,
    key: Key = None,
    progress: Progress = None,
) -> BifurcationDiagram:
    """Attractors, their exponents and their points, against one parameter.

    For each value of the parameter there are runs from random starts, which find coexisting attractors, and two
    continuations, up and down, in which each run starts at the end of the run before: where these two differ there is
    hysteresis. Where the surface of a transition has moved over that end, the run starts where the continuation began.
    A point x_j is taken once a period; x_{j+p} = x_j is a motion of period p.

    Args:
        system: an `lh.Flow`, `lh.Map` or `lh.Hybrid`.
        x0: (2, n) corners of the box from which starts are drawn, differently for each value; the continuations
            begin with the first of them. Where `starts` are given, or nothing is drawn (`directions` without
            "random"): (n,), where the continuations begin.
        args: pytree of parameters.
        over: ``{"beta": values}``, the entry of args to change ("beta", "spring.rate", "rates[2]"; "args" where args
            is a number), and its values (values,) in order.
        period: of the forcing, a number or ``args -> number``; None for a map (1 iteration).
        section: for a system that is not forced: ``(t, x, args) -> scalar``; points are taken where the flow carries
            it through zero from above, as in `lh.poincare_section`, and lengths are in crossings.
        starts: number of random starts; or (m, n) points, the same for each value.
        directions: which of "random", "up" and "down".
        transient: length of each run before growth is counted, in periods. Other lengths compile anew.
        t1: length after it, in periods.
        samples: number of last points that are kept, and that must repeat for a periodic motion; at most t1.
        angles: components modulo 2π, in which the system must be periodic.
        escape: transient chaos: record after how many periods each run settles on a periodic attractor.
        k: number of exponents; None: n.
        mode: mode at the start, where there are several and the system does not determine it.
        method: `lh.RungeKutta` (default) or `lh.Diffrax`.
        max_steps: most attempts of a step in one run; None: no limit, but a section must be crossed within 100 000, or
            the run ends as `no_more_jumps`.
        key: a `jax.random.key` for the starts; None: ``jax.random.key(0)``.
        progress: True for a bar, or a function of the fraction done.

    Returns:
        A `BifurcationDiagram`; ``.plot()`` draws it. A run that fails has its status, its name as label, and nan;
        nothing is raised for it.

    Raises:
        ValueError: on arguments that do not fit, before any computing.

    Source:
        T. Tél & Y.-C. Lai, Chaotic transients in spatially extended systems, Phys. Rep. 460 (2008) 245,
        doi:10.1016/j.physrep.2008.01.001 (escape); for hysteresis and coexisting attractors under dry friction
        R. I. Leine & H. Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (Springer 2004),
        doi:10.1007/978-3-540-44398-8.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.bifurcation_diagram(logistic, [[0.1], [0.9]], {"r": 0.0}, over={"r": [2.8, 3.2, 3.5, 4.0]})
        >>> found.attractors()
        ['P1w0:4', 'P2w0:4', 'P4w0:4', 'chaos:4']
    """
    name, values = only_parameter(over)
    for word, length in (("transient", transient), ("t1", t1), ("samples", samples)):
        whole(f"{word}, a number of periods,", length, least=1)
    transient, t1, samples = int(transient), int(t1), int(samples)  # sums of NumPy's short integers overflow
    require(samples <= t1, f"samples must be at most t1 = {t1}; got {samples}.")
    attempts(max_steps)
    flag("escape", escape)
    random_key("key", key)
    kinds = tuple(directions) if isinstance(directions, Sequence) and not isinstance(directions, str) else ()
    good = len(kinds) > 0 and all(is_one_of(kind, START_KINDS) for kind in kinds) and len(set(kinds)) == len(kinds)
    require(good, f"directions must be some of {START_KINDS}; got {directions!r}.")
    period = _unit(system, period, section)
    system = system if section is None else with_section(system, section, -1)
    given, first = _starts(x0, starts, len(values), key, "random" in kinds)
    problem, given, t0, mode = preparation.prepare(system, given, args, 0.0, method, mode, "x0")
    require(
        len(problem.shape) == 1,
        f"bifurcation_diagram needs states of shape (n,); got {problem.shape}. For many bodies use lh.sweep.",
    )
    require_values("bifurcation_diagram", problem, given, values)
    _check_parameter(problem, name, values.astype(given.dtype), period, given[0], transient)
    n = problem.shape[0]
    angles = integers("angles, which are components,", angles, 0, n - 1)
    how = schedule(number_of(problem.args, name), angles, transient, t1, samples)
    random = np.asarray(given, given.dtype).reshape(len(values), -1, problem.shape[0])
    shared = _shared(problem, how, period, t0, mode, k, max_steps, random[0, 0])
    follow_from = random[:, 0] if first is None else np.broadcast_to(first.astype(given.dtype), random[:, 0].shape)
    sequences = _sequences(values.astype(given.dtype), random, follow_from, kinds)
    results, done = lanes.run_sequences(run, shared, [sequence for _, sequence in sequences], progress=progress)
    columns, kinds = _columns([kind for kind, _ in sequences], results, done, random.shape[:2])
    found = _assembled(name, values, kinds, columns, angles, transient, t1, escape)
    return dataclasses.replace(found, state_labels=labels_of(system, problem.shape))


def only_parameter(over) -> tuple[str, np.ndarray]:
    """The parameter's name and values."""
    good = isinstance(over, Mapping) and len(over) == 1 and isinstance(next(iter(over)), str)
    require(good, f"over must be a dictionary with one parameter, {{'beta': values}}; got {over!r}.")
    ((name, values),) = over.items()
    values = numbers(f"over: the values of {name!r}", values)
    good = values.ndim == 1 and len(values) > 0 and values.dtype.kind in "iuf" and bool(np.all(np.isfinite(values)))
    require(good, f"over: the values of {name!r} must be finite numbers (values,); got {values!r}.")
    return name, values.astype(float)


def _unit(system, period, section):
    """The period; None where points are crossings of a section."""
    period = int(period) if isinstance(period, np.integer) else period  # in 8 bits 200 periods are none
    if iterates(system):
        require(section is None, "A map has no section, for it does not flow: leave section=None.")
        period = 1.0 if period is None else period
        if not callable(period):
            positive("period", period)
        require(callable(period) or float(period).is_integer(), f"The period of a map must be whole; got {period!r}.")
        return period
    require(
        (period is None) != (section is None),
        f"Give exactly one of period (of the forcing) and section (a function); got {period=} and {section=}.",
    )
    return period


def _starts(x0, starts, values: int, key, draws: bool):
    """Starts (values · m, n), and where continuations begin (None: with the first of them)."""
    x0 = numbers("x0", x0)
    if x0.ndim == 1 and not draws and isinstance(starts, int):
        starts = x0[None]
    if isinstance(starts, int) and not isinstance(starts, bool):
        whole("starts", starts, least=1)
        box = x0.ndim == 2 and x0.shape[0] == 2 and x0.shape[1] > 0 and x0.dtype.kind in "iuf"
        require(
            box,
            f"x0 must be the two corners of a box of starts, (2, n); got shape {x0.shape}. For starts of your own give "
            "starts=[[…], …] and one of them as x0; directions=('up', 'down') alone begin at one x0.",
        )
        key = jax.random.key(0) if key is None else key
        drawn = np.asarray(jax.random.uniform(key, (values, starts, x0.shape[1])))
        return (x0[0] + drawn * (x0[1] - x0[0])).reshape(-1, x0.shape[1]), None
    points = numbers("starts", starts)
    fits = points.ndim == 2 and len(points) > 0 and x0.ndim == 1 and points.shape[1] == x0.shape[0]
    require(
        fits and points.dtype.kind in "iuf",
        f"starts must be their number, or points (m, n) beside x0 (n,); got {starts!r} beside x0 of shape {x0.shape}.",
    )
    return np.tile(points, (values, 1)), x0.astype(float)


def _check_parameter(problem, name, values, period, x, transient) -> None:
    entry = number_of(problem.args, name)
    for value in () if period is None else values[[0, -1]]:
        args = entry.placed(problem.args, value)
        own = period(args) if callable(period) else period
        positive("period", own)
        check_period(problem.system, own, x, args, transient * own, where=f" at {name} = {value:.6g}", strobe=True)


def _shared(problem, how, period, t0, mode, k, max_steps, start):
    """The inputs that all lanes share."""
    if k is not None:
        whole("k", k, least=1)
    frame, _ = initial_frame(problem, t0, jnp.asarray(start), None, k)
    dtype, (qr_schedule, interval) = frame.dtype, qr_schedule_for(problem, None)
    crosses = period is None
    jumps_too = crosses and len(problem.system.transitions) > 1  # then crossings are told from other jumps by a log
    plan = problems.RunPlan(qr_schedule=qr_schedule, count_jumps=crosses, log=MOST_AT_ONCE if jumps_too else 0)
    how = how._replace(most=ATTEMPTS_OF_CROSSING if crosses and max_steps is None else None)
    limit = np.int32(driver.FOREVER if max_steps is None else min(max_steps, driver.FOREVER))
    # Numbers as arrays, so that other values compile nothing new.
    period = period if period is None or callable(period) else array(period, dtype)
    return problem, plan, how, period, t0, frame, array(interval, dtype), mode, limit


def _sequences(values, random, follow_from, kinds) -> list:
    """All (kind, sequence); the two continuations come first because they are long."""
    blank = RunEnd(np.zeros_like(values[0]), np.zeros_like(follow_from[0]), np.int32(0), np.asarray(False))
    sequences = []
    for kind, step in (("up", 1), ("down", -1)):
        if kind in kinds:
            lane = StrobeRun(values[::step], follow_from[::step], np.full(len(values), True))
            sequences.append((kind, (blank, lane)))
    if "random" in kinds:
        count = random.shape[1]
        lane = StrobeRun(
            np.repeat(values, count), random.reshape(-1, random.shape[2]), np.full(len(values) * count, False)
        )
        sequences += [("random", sequence) for sequence in lanes.short_sequences(blank, lane)]
    return sequences


def _columns(kinds, results, done, shape) -> tuple[StrobeResults, tuple[str, ...]]:
    """The results of all sequences as columns (values, starts, …) in the order random, up, down."""
    parts = []
    for result, ready in zip(results, done, strict=True):
        status = np.where(ready, result.status, MISSING)
        parts.append(result._replace(status=status))
    columns, names = [], []
    for kind, order in (("random", None), ("up", 1), ("down", -1)):
        own = [part for part, name in zip(parts, kinds, strict=True) if name == kind]
        if not own:
            continue
        joined = jax.tree.map(lambda *rows: np.concatenate(rows), *own)
        if order is None:
            joined = jax.tree.map(lambda rows: rows.reshape(*shape, *rows.shape[1:]), joined)
            names += ["random"] * shape[1]
        else:
            joined = jax.tree.map(lambda rows, order=order: rows[::order, None], joined)
            names.append(kind)
        columns.append(joined)
    return jax.tree.map(lambda *rows: np.concatenate(rows, axis=1), *columns), tuple(names)


def _assembled(name, values, kinds, found: StrobeResults, angles, transient, t1, escape) -> BifurcationDiagram:
    missing = found.status == MISSING
    found = jax.tree.map(
        lambda leaf: (
            np.where(missing.reshape(missing.shape + (1,) * (leaf.ndim - 2)), np.nan, leaf)
            if leaf.dtype.kind == "f"
            else leaf
        ),
        found,
    )
    leading = found.exponents[..., 0]
    marks = attractors.labels(found.points, angles, found.status, leading, found.stderr[..., 0], found.time)
    marks[found.beyond & (found.status == OK)] = BEYOND_GUARD
    return BifurcationDiagram(
        name,
        values,
        kinds,
        found.exponents,
        found.stderr,
        found.finite,
        found.losses,
        found.time,
        found.status,
        found.points,
        marks,
        found.lifetime if escape else None,
        angles,
        transient,
        t1,
    )
