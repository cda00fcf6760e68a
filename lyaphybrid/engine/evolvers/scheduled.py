"""The evolver of many-body systems whose predicted events are kept in a schedule.

Between two rebasings state and frame are in comoving coordinates: a flight changes nothing and an event changes a few
rows. In these coordinates f = 0, so the saltation matrix of the touched rows is S = Dg - ∂ₜg ∇h / ∂ₜh. At the end of a
span, where frames are orthonormalised, the state and the frame are transformed back to ordinary coordinates (rebasing).
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._jax.columns import each_column
from ..._jax.precision import share
from ..._linalg import frames, lost_directions
from ...events.saltations import event_time, event_time_shifts
from ...native import seldom
from ...statuses import STATUS
from ...systems.event_driven import EventDriven
from ..evolver import AbstractEvolver
from ..states import STRETCHED, Clock, EventLog, Settings, StepState, added, log_event, stop
from .accumulations import accumulated, brought_about, hidden_below, named
from .exact import integers, is_event, since_after

__all__ = ["Scheduled", "predicting_anew"]

MOST_EVENTS_BETWEEN = 4096  # most events between two rebasings, where there are fewer components than this
FEW_ROWS = 16  # up to so many touched components the matrix of an event costs less than what else is done for it


class ScheduledState(NamedTuple):
    """The solver state."""

    cache: Any  # the schedule's predictions; times count from the last rebasing
    start: Array  # time of the last rebasing, local to the block
    now: Array  # time of the last event since the rebasing
    events: Array  # number of events since the rebasing
    stretch: Array  # sum of `_stretch` since the rebasing
    longest: Array  # longest interval between two events
    streak: Array  # count of short intervals in a row
    name: Array | None  # label of the last event; None where jumps are not counted
    destroys: Array | None  # whether an event since the last orthonormalisation destroyed a direction; None: none can


class ScheduledEvent(NamedTuple):
    """The flight to the next event."""

    t: Array  # time of the event, counted from the rebasing
    which: Any  # label of the event
    lands: Array  # whether the event comes before the block's end
    full: Array  # whether the span has reached its largest number of events


class UserFunctions(NamedTuple):
    """The user's functions for flat states (n,): reshapes to the user's shape, (n,) or (N, d), and back."""

    system: EventDriven
    args: Any
    shape: tuple[int, ...]  # of the state

    def flow(self, dt, y):
        """From comoving (n,) to ordinary (n,) coordinates."""
        return self.system.flow(dt, y.reshape(self.shape), self.args).reshape(y.shape)

    def components(self, which) -> Array:
        """The indices (m,) of the components that the event touches."""
        rows = jnp.asarray(self.system.schedule.touch(which)).astype(jnp.int32)
        if self.system.schedule.flat:
            return rows
        width = jnp.arange(self.shape[1], dtype=jnp.int32)
        return (rows[:, None] * self.shape[1] + width[None, :]).ravel()

    def _touched(self, rows):
        return rows if self.system.schedule.flat else rows.reshape(-1, self.shape[1])

    def jump(self, t, rows, which):
        """The touched components after the event."""
        return self.system.jump(t, self._touched(rows), self.args, which).ravel()

    def guard(self, t, rows, which):
        """The guard of the event, from the touched components."""
        return self.system.guard(t, self._touched(rows), self.args, which)


@dataclasses.dataclass(frozen=True)
class Scheduled(AbstractEvolver):
    """The evolver of event-driven systems with a schedule; each event touches a few rows of the state."""

    system: EventDriven
    args: Any
    shape: tuple[int, ...]
    per_jump: bool = False  # jumps may end a block

    flies_by_schedule: ClassVar[bool] = True
    by_rows: ClassVar[bool] = True

    @property
    def most_events(self) -> int:
        """Most events between two rebasings, which cost in proportion to n."""
        return max(MOST_EVENTS_BETWEEN, math.prod(self.shape))

    @property
    def longest_interval(self) -> float:
        """Most events between two orthonormalisations; after each there is a rebasing."""
        return float(self.most_events)

    @property
    def may_lose_rank(self) -> bool:
        """Canonical maps conserve dq∧dp and so destroy no direction; of others the user may say so."""
        return not (self.system.canonical or self.system.invertible)

    @property
    def rows(self) -> UserFunctions:
        """The user's functions for flat states."""
        return UserFunctions(self.system, self.args, self.shape)

    def init(self, t, x, mode, h) -> ScheduledState:
        """The solver state with all predictions made."""
        del mode, h
        zero = jnp.zeros_like(t)
        cache = self.system.schedule.init(zero, x.reshape(self.shape), self.args)
        cache = jax.tree.map(jnp.asarray, cache)
        name = jnp.zeros_like(named(self.system.schedule.next(cache)[1], x.dtype)) - 1 if self.per_jump else None
        destroys = jnp.asarray(False) if self.may_lose_rank else None
        return ScheduledState(cache, zero, zero, jnp.asarray(0, jnp.int32), zero, zero, zero, name, destroys)

    def least_length(self, carry: StepState, jumps):
        """`LOST` after an event that destroys a direction; lengths alone only where double-double checks them."""
        closely = carry.x.shape[0] <= lost_directions.MOST_COMPONENTS
        return jnp.where(
            carry.solver_state.destroys, frames.LOST, super().least_length(carry, jumps) if closely else -jnp.inf
        )

    def onto_mode(self, mode, t, x):
        """There are no modes, and no constraints."""
        del mode, t, x

    def rebase(self, solver: ScheduledState, s) -> ScheduledState:
        """Make the time of the last rebasing local to the new block."""
        return solver._replace(start=solver.start - s)

    def which_shape(self, t, x):
        """Shape and type of the label `which` that the user's schedule returns."""
        del t
        return jax.eval_shape(lambda x: integers(self.system.schedule.next(self.init(x[0], x, 0, 0).cache)[1]), x)

    def propose_step(self, carry: StepState, clock: Clock) -> ScheduledEvent:
        """Read the next event from the schedule."""
        t, which = self.system.schedule.next(carry.solver_state.cache)
        # A nan counts as an event, so that `step` stops the run with a status.
        lands = ~((t > clock.limit(clock.afresh(carry)) - carry.solver_state.start) | jnp.isposinf(t))
        return ScheduledEvent(t, integers(which), lands, carry.solver_state.events >= self.most_events)

    def is_regular(self, ahead: ScheduledEvent):
        """Regular if an event comes first; `locate_events` does the flight to the end of the block."""
        return ahead.lands & ~ahead.full

    def stretched(self, carry: StepState):
        """Whether the events since the rebasing stretched perturbations so much that an orthonormalisation is due."""
        return carry.solver_state.stretch > share(carry.x) * math.log(STRETCHED)

    def step(self, settings: Settings, clock: Clock, carry: StepState, flight: ScheduledEvent) -> StepState:
        """Apply the next event to the rows that it touches and to their predictions."""
        t, which, solver = flight.t, flight.which, carry.solver_state
        index = self.rows.components(which)
        rows, real = carry.x[index], is_event(which)
        beyond = self._is_beyond(carry, t, rows, which) & real
        t = event_time(t, real & ~beyond, _guard_at, (self.rows, rows, which))
        linear = functools.partial(self._linear, t, rows, which, ~beyond)
        new = self.rows.jump(t, rows, which)
        x, frame, growth = _with_rows(carry.x, index, new), carry.frame, None
        if frame.shape[1] > 0:
            before, after = frame[index], _pushed(real, frame, index, linear)
            frame, growth = _with_rows(frame, index, after), functools.partial(_growth, before, after)
        matrix = functools.cache(lambda: each_column(linear, jnp.eye(len(index), dtype=x.dtype)))  # S, (m, m)
        s = jnp.where(solver.start + t > carry.s, solver.start + t, carry.s)  # a nan leaves the time unchanged
        now = jnp.where(t > solver.now, t, solver.now)
        dt = now - solver.now  # times since the rebasing are small, so dt is accurate
        entry = None if carry.log is None else self._entry(clock, s, t, which, carry.x, x)
        stretch, destroys = solver.stretch, solver.destroys
        if destroys is not None:
            destroys = (destroys & (carry.since > 0)) | (real & self._destroys(t, rows, which, matrix()))
        if settings.qr_schedule.automatic and growth is not None:
            grows = _largest(matrix()) if len(index) <= FEW_ROWS else growth()
            stretch = stretch + _stretch(grows, len(index) / x.shape[0])
            stretch = stretch if destroys is None else jnp.where(destroys, jnp.inf, stretch)
        # Many predictions may be refreshed at one instant: that is no accumulation, so each counts only 1/n.
        more = jnp.where(real, 1.0, 1 / x.shape[0])
        name, again, hides = solver.name, None, None
        if solver.name is not None:
            name = named(which, x.dtype)
            again, hides = real & jnp.all(name == solver.name), self._longest_hidden_flight(t, rows, which)
        longest, streak, over = accumulated(dt, solver.longest, solver.streak, more, again, hides)
        cache = self.system.schedule.update(solver.cache, t, x.reshape(self.shape), self.args, which)
        solver = ScheduledState(cache, solver.start, now, solver.events + 1, stretch, longest, streak, name, destroys)
        carry = carry._replace(
            s=s,
            x=x,
            frame=frame,
            since=since_after(settings, clock, carry, dt, real, self.may_lose_rank),
            jumps=carry.jumps + real.astype(jnp.int32),
            solver_state=solver,
            log=carry.log if entry is None else log_event(carry.log, entry, real),
        )
        carry = carry if carry.log_volume is None else added(carry, log_volume=frames.log_abs_det(matrix()))
        carry = stop(carry, STATUS.zeno, over)
        unknown = beyond & (longest > 0) if frame.shape[1] > 0 else False  # perturbations that the event before moved
        return stop(carry, STATUS.nonfinite, ~jnp.isfinite(jnp.sum(new) + t) | unknown)

    def once(self, settings: Settings, clock: Clock, carry: StepState, flight: ScheduledEvent) -> StepState:
        """Through the event, or to the end of the block; then rebase."""
        carry = jax.lax.cond(
            flight.lands, lambda carry: self.step(settings, clock, carry, flight), lambda carry: carry, carry
        )
        return self.locate_events(settings, clock, lambda carry: ~flight.lands, carry, flight)[0]

    def tangent(self, clock: Clock, carry: StepState, flight: ScheduledEvent) -> Callable:
        """The derivative dx (n,) -> (n,) of `once`, started at a rebasing."""
        t, which, n = flight.t, flight.which, carry.x.shape[0]
        index = self.rows.components(which)
        place = (index[:, None] == jnp.arange(n, dtype=index.dtype)[None, :]).astype(carry.x.dtype)
        crosses = flight.lands & is_event(which)
        rest = 1 - jnp.where(crosses, jnp.sum(place, axis=0), 0.0)
        rows = carry.x[index]
        in_time = ~self._is_beyond(carry, t, rows, which)
        after = _with_rows(carry.x, index, self.rows.jump(t, rows, which))
        dt = jnp.where(flight.lands, t, clock.limit(carry) - carry.solver_state.start)
        x, dt = jnp.where(crosses, after, carry.x), jnp.where(jnp.isfinite(dt), dt, 0.0)

        def linear(dx):
            pushed = self._linear(t, rows, which, in_time, place @ dx)
            moved = rest * dx + jnp.where(crosses, pushed @ place, 0.0)
            return jax.jvp(lambda y: self.rows.flow(dt, y), (x,), (moved,))[1]

        return linear

    def _longest_hidden_flight(self, t, rows, which):
        """The longest flight that rounding can hide; the velocity is 0 in comoving coordinates."""
        return hidden_below(lambda t, rows: self.rows.guard(t, rows, which), t, rows, jnp.zeros_like(rows))

    def _destroys(self, t, rows, which, matrix):
        """Whether the event destroys a direction of the touched rows, and so of the state.

        If the m directions are dependent up to rounding, double-double arithmetic decides whether one is lost or short.
        """
        m = rows.shape[0]
        lengths = jnp.sqrt(jnp.sum(matrix * matrix, axis=1))
        size = jnp.sum(jnp.log(jnp.where(lengths > 0, lengths, 1.0)))
        dependent = frames.log_abs_det(matrix) <= size + math.log(frames.DEPENDENT)

        linear = functools.partial(self._linear, t, rows, which, jnp.asarray(True))
        if not lost_directions.is_precise(linear, rows):
            return dependent
        closely = seldom(lambda: jnp.isneginf(lost_directions.log_volume(linear, m, rows.dtype)))
        return jax.lax.cond(dependent, closely, lambda: jnp.asarray(False))

    def _is_beyond(self, carry: StepState, t, rows, which):
        """Whether an event at the instant of the one before, or of the start, did not come by the flow."""
        solver = carry.solver_state

        def beyond():
            return brought_about(
                lambda t, rows: self.rows.guard(t, rows, which), t, rows, jnp.zeros_like(rows), solver.longest
            )

        return jax.lax.cond(t <= solver.now, beyond, lambda: jnp.asarray(False))

    def _linear(self, t, rows, which, in_time, dy):
        """S dy (m,) of the touched rows, linear in dy; Dg dy of an event whose time is that of the start."""

        def guard(t, rows):
            return self.rows.guard(t, rows, which)

        def jump(t, rows):
            return self.rows.jump(t, rows, which)

        moving, still = jnp.ones_like(t), jnp.zeros_like(rows)
        of_slope = event_time_shifts(moving, jax.jvp(guard, (t, rows), (moving, still))[1])
        of_slope = jnp.where(in_time, of_slope, 0.0)
        event_time_shift = of_slope * jax.jvp(lambda rows: guard(t, rows), (rows,), (dy,))[1]
        return jax.jvp(jump, (t, rows), (event_time_shift, dy))[1]

    def _entry(self, clock: Clock, s, t, which, before, after) -> EventLog:
        zero = jnp.asarray(0, jnp.int32)
        before, after = self.rows.flow(t, before), self.rows.flow(t, after)
        return EventLog(None, clock.base + s, zero, which, zero, zero, before, after)

    def locate_events(
        self, settings: Settings, clock: Clock, within, carry: StepState, ahead: ScheduledEvent
    ) -> tuple[StepState, ScheduledEvent]:
        """Flow to the block's end or a scheduled orthonormalisation, if no event comes before; then rebase."""
        flies = within(carry) & ~ahead.lands
        # An event at the very end: its time depends on parameters, that of the end does not.
        end = jnp.where(flies, clock.limit(carry), jnp.where(clock.over(carry), clock.length, carry.s))
        if settings.count_jumps:  # only jumps end the block, and no jump follows
            never = flies & jnp.isinf(clock.length) & jnp.isposinf(ahead.t)
            carry, end = stop(carry, STATUS.no_more_jumps, never), jnp.where(never, carry.s, end)
        # After an event use its time since the rebasing, which resolves flights too short for the block's time.
        dt = jnp.where(end > carry.s, end - carry.solver_state.start, carry.solver_state.now + (end - carry.s))
        x, linear = jax.linearize(lambda y: self.rows.flow(dt, y), carry.x)
        zero = jnp.zeros_like(end)
        cache = self.system.schedule.shift(carry.solver_state.cache, dt)
        solver = carry.solver_state._replace(
            cache=cache, start=end, now=zero, events=jnp.zeros_like(carry.solver_state.events), stretch=zero
        )
        if carry.log_volume is not None:
            carry = added(carry, log_volume=frames.log_abs_det(each_column(linear, jnp.eye(x.shape[0], dtype=x.dtype))))
        since = carry.since if clock.interval is None else jnp.where(flies, clock.flown(carry, end), carry.since)
        carry = carry._replace(s=end, x=x, frame=each_column(linear, carry.frame), solver_state=solver, since=since)
        if clock.interval is not None:
            return carry, self.propose_step(carry, clock)
        return carry, ahead._replace(t=ahead.t - dt, full=jnp.asarray(False))


def _guard_at(t, operands):
    """The guard of an event that touches these rows, which is zero at its time."""
    functions, rows, which = operands
    return functions.guard(t, rows, which)


def _with_rows(array: Array, index: Array, rows: Array) -> Array:
    """The array with some rows replaced, one at a time: XLA would not fuse a scatter into the same kernel."""
    for i in range(len(rows)):
        array = jax.lax.dynamic_update_index_in_dim(array, rows[i], index[i], 0)
    return array


def _pushed(real, frame: Array, index: Array, linear: Callable) -> Array:
    """The touched rows (m, k) of the frame after the event: S times the rows before, by the function dy -> S dy.

    Computed in a `cond`, so that all rows are read before any is written; otherwise the frame would be copied.
    """
    return jax.lax.cond(real, lambda: each_column(linear, frame[index]), lambda: frame[index])


def _largest(entries):
    """The largest entry, of which no derivative is wanted."""
    return jax.lax.stop_gradient(jnp.max(jnp.abs(entries)))


def _growth(before, after):
    """How much the largest entry of the touched rows of a frame grows: a lower bound of that of the event's matrix."""
    largest = _largest(before)
    return jnp.where(largest > 0, _largest(after) / largest, 1.0)


def _stretch(grows, share: float):
    """The logarithm of an event's stretching, weighted by the share m/n of touched components; inf if grazing.

    The weight: with two bodies all events stretch the same perturbation, with many bodies they stretch different ones.
    """
    return jnp.where(grows > STRETCHED, jnp.inf, jnp.log(jnp.maximum(grows, 1.0)) * share)


@functools.cache
def predicting_anew(system: EventDriven, shape: tuple[int, ...]) -> EventDriven:
    """The same system without its schedule: functions of the whole state (n,) that make every prediction from scratch.

    At a rebasing, t = 0, comoving and ordinary coordinates are the same.
    """
    if system.schedule is None:
        return system

    def flow(dt, t, x, args):
        del t
        return UserFunctions(system, args, shape).flow(dt, x)

    def next_event(t, x, args):
        zero = jnp.zeros_like(t)
        return system.schedule.next(system.schedule.init(zero, x.reshape(shape), args))

    def jump(t, x, args, which):
        rows = UserFunctions(system, args, shape)
        index = rows.components(which)
        return _with_rows(x, index, rows.jump(jnp.zeros_like(t), x[index], which))

    def guard(t, x, args, which):
        rows = UserFunctions(system, args, shape)
        # A refreshed prediction has no guard: use one with the value 0 and the rate -1.
        standing = rows.guard(jnp.zeros_like(t), x[rows.components(which)], which)
        return jnp.where(is_event(which), standing, jax.lax.stop_gradient(t) - t)

    return EventDriven(flow, next_event, jump, guard, canonical=system.canonical, invertible=system.invertible)
