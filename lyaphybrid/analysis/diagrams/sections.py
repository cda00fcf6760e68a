"""Poincaré sections: the states where a guard is crossed, or once a period of the forcing."""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ... import plots
from ..._arguments import Real, State, attempts, flag, positive, require, require_one_start, require_values, whole
from ..._jax.tracing import array
from ..._keywords import explains_keywords
from ..._text import Table
from ...engine import preparation, problems
from ...engine.host import driver
from ...engine.host.places import account, place_of
from ...errors import RunFailedError
from ...integrators.base import Method
from ...results.result import Data, RunResult, in_time, states_along
from ...statuses import STATUS
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid, Transition
from ...systems.kinds import iterates
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from ..orbits.periods import check_period
from ..trajectories import EVENT_LOG_ROWS

__all__ = ["PoincareSection", "poincare_section", "with_section"]

MOST_JUMPS = 2.0**31 - 2.0**16  # jumps in one run, counted in 32 bits


class PoincareSection(RunResult, eqx.Module):
    """The points of a Poincaré section, in order.

    Attributes:
        t: (n,) instants; nan where the run ended before.
        x: (n, dim) states; of a crossing where the flow meets the section, before any jump there.
        mode: (n,) indices of the modes.
        status: how the run ended, an `lh.STATUS`.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        ...     names=("height", "speed"),
        ... )
        >>> found = lh.poincare_section(ball, [0.5, 0.0], section=lambda t, x, args: x[0] - 0.375, n=4)
        >>> found.t.round(6).tolist(), found.x[1].round(6).tolist()  # it falls through: direction=-1
        ([0.5, 2.5, 4.5, 6.5], [0.375, -0.5])
    """

    t: Array
    x: Array
    mode: Array
    status_code: Array
    mode_names: tuple[str, ...] = eqx.field(static=True)
    state_labels: Labels = eqx.field(static=True, default=Labels())

    def plot(self, ax: plots.Axes | None = None, i: int = 0, j: int = 1, **style: Any) -> plots.Axes:
        """Component j of the points against component i. `style` goes to what it draws."""
        return plots.section(self, ax, i, j, **style)

    def _table(self) -> Table:
        t, x = np.asarray(self.t), np.reshape(self.x, (len(self.t), math.prod(self.x.shape[1:])))  # of no points too
        reached = np.isfinite(t)
        names = [self.state_labels.name(i) for i in range(x.shape[1])]
        ends = [x[reached].min(axis=0), x[reached].max(axis=0)] if np.any(reached) else []
        rows = [(name, *(f"{end[i]:.6g}" for end in ends)) for i, name in enumerate(names)] if ends else []
        title = f"Poincaré section of {int(np.sum(reached))} points"
        return Table(title, rows, [f"status {self.status}"], ("", "least", "greatest") if ends else ())

    def _data(self) -> Data:
        state = ("body", "state") if self.x.ndim == 3 else ("state",)
        variables = {"x": (("sample", *state), self.x), "mode": ("sample", self.mode)}
        labels = self.state_labels
        t = ("sample", np.asarray(self.t), in_time(labels.time_unit))
        coordinates = {"t": t, **states_along(labels, self.x.shape[-1])}
        return Data(variables, coordinates, {"mode_names": self.mode_names})


@explains_keywords
def poincare_section(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    section: Any = None,
    period: Any = None,
    n: int = 1000,
    transient: int = 0,
    direction: int = -1,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    max_steps: int | None = None,
    throw: bool = True,
) -> PoincareSection:
    """A Poincaré section: the states where the motion crosses a surface, or its states once a period.

    Either h(t, x) = 0, crossed by the flow in one direction; or t = t0 + k T (stroboscopic).

    Args:
        system: an `lh.Flow` or an `lh.Hybrid` with fields; with `period` any system.
        x0: (dim,) start.
        args: pytree of parameters.
        section: ``(t, x, args) -> h``, a scalar, continuously differentiable. A jump that carries the state across
            is no crossing. Where a guard of the system is zero at the same instant the point is that before the jump.
        period: T instead: a number, or ``args -> number``; whole for a map. Of a forced system a multiple of its own;
            with several frequencies and no common period any is allowed.
        n: number of points.
        transient: number of points that are dropped before them.
        direction: of the crossing: −1, h falls; +1, h rises; 0, both.
        t0: time at the start; a start on the section from which h goes on in that direction is a crossing.
        mode: mode at the start, where there are several.
        method: `lh.RungeKutta` (default) or `lh.Diffrax`.
        max_steps: most attempts of a step; None: no limit. After a million without a crossing, or where the
            motion comes to rest, the run ends as no_more_jumps, and the points until then are kept.
        throw: raise where the run failed.

    Returns:
        A `PoincareSection` with `.t` (n,), `.x` (n, dim), `.mode` (n,) and `.plot()`.

    Raises:
        ValueError: on arguments that do not fit, before any computing.
        RunFailedError: where the run failed and `throw`.

    Source:
        M. Hénon, On the numerical computation of Poincaré maps, Physica D 5 (1982) 412,
        doi:10.1016/0167-2789(82)90034-3: the step is ended on the surface itself.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> circle = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0]]))
        >>> crossings = lh.poincare_section(circle, [1.0, 0.0], section=lambda t, x, args: x[0], n=3)
        >>> [round(float(t / jnp.pi), 6) for t in crossings.t]
        [0.5, 2.5, 4.5]
    """
    flag("throw", throw)
    require(
        (section is None) != (period is None),
        f"Give exactly one of section (a function) and period; got {section=} and {period=}.",
    )
    whole("n, the number of points,", n, least=1, each=1)
    whole("transient, a number of points,", transient, least=0)
    attempts(max_steps)
    system = system if section is None else with_section(system, section, direction)
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    require_one_start("poincare_section", x0)
    require_values("poincare_section", x0, problem, t0)
    if section is None:
        length = _period(system, period, problem.args)
        check_period(system, length, x0, problem.args, float(t0) + transient * length, strobe=True)
        found = _stroboscopic(problem, x0, t0, mode, length, n, transient, max_steps)
    else:
        found = _crossings(problem, x0, t0, mode, n, transient, max_steps)
    t, x, modes, status, last = found
    labels = labels_of(system, problem.shape)
    result = PoincareSection(t, x, modes, jnp.asarray(status), problems.mode_names(system), labels)
    if throw and result.status.failed:
        place = place_of(last.loop_state, problem.system)
        raise RunFailedError(result.status, account(status, place, why=last.why), result)
    return result


def with_section(system: Any, section: Any, direction: int) -> Hybrid:
    """The system with one more transition, which changes nothing and records the crossings."""
    flows = isinstance(system, Flow) or (isinstance(system, Hybrid) and system.fields is not None)
    require(flows, f"A section is crossed by a flow: use an lh.Flow or lh.Hybrid with fields; got {system!r}.")
    crossing = Transition(section, None, direction=direction)
    labels = {"names": system.names, "units": system.units, "time_unit": system.time_unit}
    if isinstance(system, Flow):
        return Hybrid(system.field, crossing, **labels)
    # It comes first: the jump of another guard at the same event time would hide the crossing.
    return Hybrid(
        dict(zip(system.mode_names, system.fields or (), strict=True)),
        (crossing, *system.transitions),
        {name: project for name, project in zip(system.mode_names, system.tangent, strict=True) if project is not None},
        system.max_cascade,
        initial_mode=system.initial_mode,
        flow_set={name: inside for name, inside in zip(system.mode_names, system.flow_sets, strict=True) if inside},
        **labels,
    )


def _period(system, period: Any, args) -> float:
    """The period as a number."""
    value: Any = period(args) if callable(period) else period
    positive("period", value)
    value = float(value)
    require(not iterates(system) or value == int(value), f"The period of a map must be a whole number; got {value}.")
    return value


def _begin(problem, plan, t0, x0, mode):
    return driver.start(problem, plan, t0, x0, np.zeros((len(x0), 0), x0.dtype), mode, 1.0)


def _stroboscopic(problem, x0, t0, mode, period, n, transient, max_steps):
    """The points at t0 + k T."""
    plan = problems.RunPlan(collect=problems.point)
    ends = array(period * np.arange(1, transient + n + 1), x0.dtype)
    outcome = driver.drive(problem, plan, _begin(problem, plan, t0, x0, mode), ends, ends, max_steps)
    t, x, modes, _ = outcome.records.collected
    valid = outcome.records.valid[transient:]
    x = problems.in_rows(problem, jnp.where(valid[:, None], x[transient:], jnp.nan))
    return jnp.where(valid, t[transient:], jnp.nan), x, modes[transient:], outcome.status, outcome


def _crossings(problem, x0, t0, mode, n, transient, max_steps):
    """The points on the section: run until enough jumps are crossings."""
    plan = problems.RunPlan(log=EVENT_LOG_ROWS, count_jumps=True, awaited=0)
    wanted, found, seen, jumps, previous = transient + n, [], 0, 0, -np.inf
    loop_state, ends = _begin(problem, plan, t0, x0, mode), array([np.inf], x0.dtype)
    while True:
        # At least the missing crossings; with other jumps in between, as many more jumps as there were so far.
        more = min(np.ceil((wanted - seen) * max(1.0, jumps / max(seen, 1))), MOST_JUMPS)
        outcome = driver.drive(problem, plan, driver.restart(loop_state), ends, array([more], x0.dtype), max_steps)
        for log in outcome.logs:
            # A crossing at the time of the previous event was caused by that event's jump.
            by_flow = np.diff(log.t, prepend=previous) > 0
            previous = log.t[-1] if len(log.t) else previous
            crossed = by_flow & (log.transition == 0)
            found.append((log.t[crossed], log.x_before[crossed], log.mode_before[crossed]))
            seen, jumps = seen + int(np.sum(crossed)), jumps + len(log.t)
        loop_state = outcome.loop_state
        if seen >= wanted or outcome.interrupted or int(outcome.status) != STATUS.ok:
            break
    t, x, modes = (np.concatenate(parts)[transient:wanted] for parts in zip(*found, strict=True))
    missing = n - len(t)
    t = np.concatenate([t, np.full(missing, np.nan)])
    x = np.concatenate([x, np.full((missing, x.shape[1]), np.nan)])
    modes = np.concatenate([modes, np.zeros(missing, modes.dtype)])
    status = outcome.status if missing else STATUS.ok
    return jnp.asarray(t, x0.dtype), jnp.asarray(x), jnp.asarray(modes), status, outcome
