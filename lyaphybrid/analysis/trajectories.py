"""Trajectories with their events, and the tangent map along a trajectory."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from .. import plots
from .._arguments import Real, State, attempts, flag, positive, whole
from .._jax.tracing import array, as_jax, numpy_for, traced
from .._keywords import explains_keywords
from .._text import Table, with_unit
from ..engine import preparation, problems
from ..engine.blocks import check_counts, ends_of_blocks
from ..engine.host import driver
from ..engine.host.places import account, place_of
from ..errors import RunFailedError
from ..integrators.base import Method
from ..results.events import Events
from ..results.result import Data, RunResult, in_time, states_along
from ..results.spectrum import NOTE_TEXTS
from ..results.time_domains import TimeDomain, time_domain
from ..statuses import STATUS, nan_if_failed
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import System, iterates
from ..systems.labels import Labels, labels_of
from ..systems.smooth import Flow, Map

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation

__all__ = ["TangentMap", "Trajectory", "place_after", "tangent_map", "trajectory"]

# Events that one compiled call can record; when the log is full it is emptied and the run goes on.
EVENT_LOG_ROWS = 1024


class Trajectory(RunResult, eqx.Module):
    """A trajectory at n times, and its events.

    Attributes:
        t: (n,) instants after t0, the last is t0 + t1; nan where the run ended before.
        x: (n, dim) states; of many bodies (n, N, d).
        mode: (n,) indices of modes; j: (n,) number of jumps made so far.
        events: an `Events` log.
        status: how the run ended, an `lh.STATUS`.
        begun, ended: times of the start and of the end.
        iterated: whether these are numbers of iterations.
        notes: "beyond_guard", where the start is beyond a guard, which does not fire then, and the motion did not come
            back; "simultaneous", where several events were due at one instant and another order leads elsewhere.
        beyond_guard, simultaneous: () the same as numbers, also under a transformation.
        domain: the hybrid time domain, an `lh.TimeDomain`; not under a transformation.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        ...     names=("height", "speed"),
        ... )
        >>> found = lh.trajectory(ball, [0.5, 0.0], t1=4.0, n=8)
        >>> found.x.shape, found.j.tolist(), found.status.name
        ((8, 2), [0, 0, 1, 1, 1, 1, 2, 2], 'ok')
        >>> found.events.t.round(6).tolist()
        [1.0, 3.0]
    """

    t: Array
    x: Array
    mode: Array
    j: Array
    events: Events
    status_code: Array
    mode_names: tuple[str, ...] = eqx.field(static=True)
    begun: Array | float = 0.0  # times of the start and the end; for a map iteration numbers
    ended: Array | float = np.nan
    iterated: bool = eqx.field(static=True, default=False)
    state_labels: Labels = eqx.field(static=True, default=Labels())
    beyond_guard: Any = 0.0
    simultaneous: Any = 0.0

    @property
    def notes(self) -> frozenset[str]:
        """Names of observations that come with every status, as those of a `Spectrum`."""
        return frozenset(name for name in ("beyond_guard", "simultaneous") if np.any(getattr(self, name)))

    @property
    def domain(self) -> TimeDomain:
        """The hybrid time domain: the intervals I^j, sup t, sup j, and which of Dinius' cases it looks like."""
        if traced((self.begun, self.ended, self.events, self.j)):
            raise ValueError("Trajectory.domain is for results on the host, not under jit, vmap or grad.")
        start, end, jumps = float(self.begun), float(self.ended), np.asarray(self.events.t)
        if self.iterated:
            jumps, end = np.full(int(np.max(self.j)), start), start
        return time_domain(start, jumps, end, STATUS(int(self.status_code)), self.state_labels.time_unit)

    @property
    def plot(self) -> plots.TrajectoryPlots:
        """Figures: ``plot()`` of the components against time, ``plot.phase()`` of one against another."""
        return plots.TrajectoryPlots(self)

    def animate(self, ax: plots.Axes | None = None, i: int = 0, j: int = 1, **options: Any) -> "FuncAnimation":
        """A film of component j against component i, by `plots.animation`, which takes the other options."""
        return plots.animation(self, ax, i, j, **options)

    def _table(self) -> Table:
        t, x = np.asarray(self.t), np.asarray(self.x)
        reached = np.flatnonzero(np.isfinite(t))
        span = ""
        if len(reached):
            end = with_unit(f"{t[reached[-1]]:.6g}", self.state_labels.time_unit)
            span = f"t = {t[reached[0]]:.6g} to {end}, "
        jumps = int(np.max(self.j, initial=0))
        title = f"Trajectory of {x.shape[-1]} components ({span}{len(reached)} of {len(t)} samples, {jumps} jumps)"
        ends = [x[reached[i]].ravel() for i in (0, -1)] if len(reached) else []
        rows = [
            (self.state_labels.name(i), *(f"{end[i]:.6g}" for end in ends)) for i in range(len(ends[0]) if ends else 0)
        ]
        said = [f"status {self.status}", *(f"{note}: {NOTE_TEXTS[note]}" for note in sorted(self.notes))]
        return Table(title, rows, said, ("", "first", "last") if ends else ())

    def _data(self) -> Data:
        state = ("body", "state") if self.x.ndim == 3 else ("state",)
        labels, timed = self.state_labels, in_time(self.state_labels.time_unit)
        of_events: dict[str, Any] = {
            f"event_{name}": (("event", *(state if name.startswith("x") else ())), getattr(self.events, name))
            for name in ("t", "transition", "mode_before", "mode_after", "x_before", "x_after")
        }
        of_events["event_t"] += (timed,)
        which = self.events.which  # of an `lh.EventDriven` any tree
        of_events["event_which"] = ("event", which) if np.ndim(which) == 1 else None
        variables = {"x": (("sample", *state), self.x), "mode": ("sample", self.mode), "j": ("sample", self.j)}
        coordinates = {"t": ("sample", np.asarray(self.t), timed), **states_along(labels, self.x.shape[-1])}
        return Data(variables | of_events, coordinates, {"mode_names": self.mode_names, "notes": self.notes})


@explains_keywords
def trajectory(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    t0: Real = 0.0,
    n: int = 1000,
    times: Any = None,
    method: Method | None = None,
    mode: str | int | None = None,
    max_steps: int | None = None,
    throw: bool = True,
) -> Trajectory:
    """The trajectory from x0 over a length t1, at n times, with all its events.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (dim,) start.
        args: pytree of parameters.
        t1: length in time (iterations for a map).
        t0: time at the start.
        n: number of samples, at t0 + i t1/n, i = 1…n.
        times: other times of samples, counted from t0: "log" for n of them from t1/1000 on, evenly on a logarithmic
            scale, or an increasing array that ends at t1.
        method: `lh.RungeKutta` (default) or `lh.Diffrax`.
        mode: mode at the start, where there are several.
        max_steps: most attempts of a step.
        throw: raise where the run failed.

    Returns:
        A `Trajectory`. Under a transformation the log has room for about 1000 events: rows beyond the last are
        zero, and a run with more of them ends as ``max_steps``. A sample at the very time of a tick is after it; one at
        the very time of another event is before or after it, as rounding has it, and its derivatives are of that side.

    Raises:
        ValueError: on arguments that do not fit, before any computing.
        RunFailedError: where the run failed and `throw`.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.array([x[1], -1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.array([x[0], -x[1]])),
        ... )
        >>> fall = lh.trajectory(ball, [0.5, 0.0], t1=2.5)
        >>> len(fall.events), round(float(fall.events.t[0]), 9)
        (1, 1.0)
        >>> ax = fall.plot(components=[0])  # .plot(): all components; .plot.phase(): one against another
    """
    flag("throw", throw)
    positive("t1, a length of time,", t1)
    whole("n, the number of samples,", n, least=1, each=1)
    attempts(max_steps)
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    _require_one(x0)
    preparation.warn_of_small_units(x0, problem.method)
    check_counts(system, t1=t1)
    discrete = iterates(system)
    ends = ends_of_blocks(t1, n, times, "t1")
    ends = array(numpy_for(ends).ceil(ends - 1e-9) if discrete else ends, x0.dtype)
    outcome = _followed(problem, system, t0, x0, mode, ends, max_steps)
    xp = numpy_for(outcome.records)
    (t, x, modes, jumps), valid = jax.tree.map(xp.asarray, (outcome.records.collected, outcome.records.valid))
    x = problems.in_rows(problem, xp.where(valid[:, None], x, xp.nan))
    t, x, modes, jumps = as_jax((xp.where(valid, t, xp.nan), x, modes, jumps))
    result = Trajectory(
        t,
        x,
        modes,
        jumps,
        _joined(outcome.logs, problem, x0, labels_of(system, problem.shape)),
        outcome.status,
        problems.mode_names(system),
        t0,
        problems.time_of(outcome.loop_state),
        discrete,
        labels_of(system, problem.shape),
        problems.beyond_guard(outcome.loop_state, numpy_for(outcome.loop_state.carry)),
        problems.summary_of(outcome.loop_state, numpy_for(outcome.loop_state.carry))[2],
    )
    return _deliver(result, throw, outcome, system)


def _followed(problem, system, t0, x0, mode, ends, max_steps) -> driver.Outcome:
    room = 0 if iterates(system) or isinstance(system, Flow) else EVENT_LOG_ROWS
    plan = problems.RunPlan(log=room, collect=problems.point)
    loop_state = driver.start(problem, plan, t0, x0, np.zeros((len(x0), 0), x0.dtype), mode, 1.0)
    return driver.drive(problem, plan, loop_state, ends, ends, max_steps)


def place_after(
    system: System, x0, args, *, attempts: int, t1: float, n: int, t0, mode, method: Method | None
) -> tuple[Any, Any, Any] | None:
    """Time, state and mode after so many attempts of a step; None if the motion ends before.

    The program is that of a `trajectory` with as many samples n, although none is returned; so few attempts must not
    reach t1.
    """
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    ends = array(ends_of_blocks(t1, n, None, "t1"), x0.dtype)
    outcome = _followed(problem, system, t0, x0, mode, ends, attempts)
    t, carry = problems.time_of(outcome.loop_state), outcome.loop_state.carry
    if int(outcome.status) != STATUS.max_steps or not t > t0:
        return None
    return np.asarray(t), np.asarray(problems.in_rows(problem, carry.x)), np.asarray(problems.mode_of(carry, np))


def _require_one(x0) -> None:
    if x0.ndim != 1:
        raise ValueError(f"x0 must have shape (n,) here; got {x0.shape}. Use jax.vmap for several starts.")


def _joined(logs, problem, x0, labels: Labels) -> Events:
    """The event logs of several compiled calls, joined into one."""
    if not logs:
        t, none, point = as_jax((np.zeros(0, x0.dtype), np.zeros(0, np.int32), np.zeros((0, *problem.shape), x0.dtype)))
        return Events(t, none, none, none, none, point, point, labels)
    if traced(logs):
        (log,) = logs
    else:
        # NumPy arrays: moving them to the device compiles nothing, whatever the number of events.
        log = jax.device_put(jax.tree.map(lambda *parts: np.concatenate(parts), *logs))
    _, t, transition, which, mode_before, mode_after, *states = log
    before, after = (problems.in_rows(problem, x) for x in states)
    return Events(t, transition, which, mode_before, mode_after, before, after, labels)


def _deliver(result, throw: bool, outcome: driver.Outcome, system):
    status = result.status
    if throw and isinstance(status, STATUS) and status.failed:
        raise RunFailedError(status, account(status, place_of(outcome.loop_state, system), why=outcome.why), result)
    return result


class TangentMap(RunResult, eqx.Module):
    """The end point of a trajectory and its derivative with respect to the start.

    Attributes:
        x: (n,) the end; matrix: (n, n) its derivative by the start, jumps included; mode: index at the end.
        jumps: () how many there were.
        status: how the run ended, an `lh.STATUS`.
        notes: "grazing", where an event met its guard nearly tangentially, or its guard's rate there is known to less
            than two digits: the matrix, which has its inverse, is no better; "simultaneous", where several events were
            due at one instant and their order matters: the matrix is that of one order.
        grazing, simultaneous: () the same as numbers, also under a transformation.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        ...     names=("height", "speed"),
        ... )
        >>> found = lh.tangent_map(ball, [0.5, 0.0], t1=1.5)
        >>> found.x.round(6).tolist(), int(found.jumps)
        ([0.375, 0.5], 1)
        >>> found.matrix.round(6).tolist()
        [[-0.0, -0.5], [2.0, 1.0]]
    """

    x: Array
    matrix: Array
    mode: Array
    jumps: Array
    status_code: Array
    state_labels: Labels = eqx.field(static=True, default=Labels())
    grazing: Any = 0.0
    simultaneous: Any = 0.0

    @property
    def notes(self) -> frozenset[str]:
        """Names of observations that come with every status, as those of a `Spectrum`."""
        seen = {"grazing": self.grazing, "simultaneous": self.simultaneous}
        return frozenset(name for name, count in seen.items() if np.any(count))

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The matrix, entry by entry. `style` goes to what it draws."""
        return plots.matrix(np.asarray(self.matrix), self.state_labels, ax, **style)

    def _table(self) -> Table:
        matrix, x = np.asarray(self.matrix), np.asarray(self.x).ravel()
        names = [self.state_labels.name(i) for i in range(len(x))]
        rows = [
            (name, f"{end:.6g}", *(f"{entry:.6g}" for entry in row))
            for name, end, row in zip(names, x, matrix, strict=True)
        ]
        title = f"Tangent map of {len(x)} components ({int(self.jumps)} jumps)"
        said = [f"status {self.status}"]
        if self.status is STATUS.terminated:
            said.append("the derivatives are those of this end, whose time may move with the start")
        said += [f"{note}: {NOTE_TEXTS[note]}" for note in sorted(self.notes)]
        return Table(title, rows, said, ("", "end", *(f"d/d {name}" for name in names)))

    def _data(self) -> Data:
        labels = [self.state_labels.name(i) for i in range(self.matrix.shape[0])]
        variables = {"x": ("state", np.ravel(self.x)), "matrix": (("state", "start"), self.matrix)}
        variables["mode"] = ((), self.mode)
        attributes = {"jumps": int(self.jumps), "notes": self.notes}
        return Data(variables, {"state": labels, "start": labels}, attributes)


@explains_keywords
def tangent_map(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    max_steps: int | None = None,
    throw: bool = True,
) -> TangentMap:
    """dx(t0 + t1)/dx(t0), the fundamental matrix with the saltation matrices of the jumps on the way.

    M(t) = Φ S_m Φ … S_1 Φ, carried as n columns that are not orthonormalised; t0 is held fixed. Where a terminal
    transition ends the run it is the derivative of that end, whose time tₑ moves with the start:
    Dg (I − f ∇h / (∂ₜh + ∇h·f)) Φ, and − ∂ₜg ∇h Φ / (∂ₜh + ∇h·f) where the reset depends on the time.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (n,) start.
        args: pytree of parameters.
        t1: length in time (iterations for a map).
        t0: time at the start.
        mode: mode at the start, where there are several.
        method: as for `lh.lyapunov_spectrum`, except `lh.ContinuousQR`.
        max_steps: most attempts of a step.
        throw: raise where the run failed; under a transformation x and matrix are nan instead.

    Returns:
        A `TangentMap` with `.x` (n,) and `.matrix` (n, n).

    Raises:
        ValueError: on arguments that do not fit, before any computing.
        RunFailedError: where the run failed and `throw`.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> decay = lh.Flow(lambda t, x, args: -x)
        >>> print(jnp.round(lh.tangent_map(decay, [1.0, 2.0], t1=1.0).matrix, 6))
        [[0.367879 0.      ]
         [0.       0.367879]]
    """
    flag("throw", throw)
    positive("t1, a length of time,", t1)
    attempts(max_steps)
    preparation.grown_columns("tangent_map", method)
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    _require_one(x0)
    preparation.warn_of_small_units(x0, problem.method)
    check_counts(system, t1=t1)
    plan = problems.RunPlan(moving_end=isinstance(system, Hybrid) and any(one.terminal for one in system.transitions))
    loop_state = driver.start(problem, plan, t0, x0, np.eye(len(x0), dtype=x0.dtype), mode, 1.0)
    ends = array(t1, x0.dtype).reshape(1)
    outcome = driver.drive(problem, plan, loop_state, ends, ends, max_steps)
    carry = outcome.loop_state.carry
    x = problems.in_rows(problem, carry.x)
    found = TangentMap(
        x,
        carry.frame,
        as_jax(problems.mode_of(carry, numpy_for(carry))),
        carry.jumps,
        outcome.status,
        labels_of(system, problem.shape),
        *problems.summary_of(outcome.loop_state)[1:3],
    )
    if throw and traced(outcome.status):
        return nan_if_failed(outcome.status, found, "x", "matrix")
    return _deliver(found, throw, outcome, system)
