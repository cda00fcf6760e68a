"""The evolver of systems whose flow and next event time are known in closed form."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._arguments import require
from ..._jax.columns import each_column
from ..._jax.precision import digits
from ..._jax.reverse_mode import checkpointed
from ..._jax.tracing import traced
from ..._linalg import frames
from ...events.saltations import event_time, event_time_shifts, pushforward, to_reference_time
from ...statuses import STATUS
from ...systems.event_driven import EventDriven
from ..evolver import AbstractEvolver
from ..states import Clock, EventLog, Settings, StepState, added, log_event, most_at_once, stop
from .accumulations import accumulated, brought_about, hidden_below, named

__all__ = ["Exact", "integers", "is_event", "since_after"]

STORED = 5  # of the solver state, before the label of the last event


class Instant(NamedTuple):
    """The events of one instant: after the first, those whose guards the jump before has brought beyond zero."""

    x: Array  # (n,)
    columns: Array  # (n, m) of neighbours, at the event's time
    direction: Array  # (n,) along which they are moved to their own event times
    which: Any  # label of the next event
    due: Array  # whether that follows at once
    jumps: Array  # so far
    log: EventLog | None


class NextEvent(NamedTuple):
    """The flight to the next event."""

    dt: Array  # time to the event
    which: Any  # label of the event
    lands: Array  # whether the event comes before the block's end


@dataclasses.dataclass(frozen=True)
class Exact(AbstractEvolver):
    """The evolver of event-driven systems: flow to the next event and through it, or to the end of the block."""

    system: EventDriven
    args: Any

    flies_by_schedule: ClassVar[bool] = True

    @property
    def may_lose_rank(self) -> bool:
        """Canonical maps conserve dq∧dp and so destroy no direction; of others the user may say so."""
        return not (self.system.canonical or self.system.invertible)

    def init(self, t, x, mode, h):
        """(5 + size of `which`,) what `_store_event` needs; predictions are not stored, each is made from the state."""
        del mode, h
        names = sum(math.prod(leaf.shape) for leaf in jax.tree.leaves(self.which_shape(t, x)))
        return jnp.zeros(STORED + names, x.dtype).at[STORED:].set(-1.0) + 0 * t

    def onto_mode(self, mode, t, x):
        """There are no modes, and no constraints."""
        del mode, t, x

    def rebase(self, solver, s):
        """Make the time of the last event local to the new block."""
        return solver.at[0].add(-s)

    def which_shape(self, t, x):
        """Shape and type of the label `which` that the user's `next_event` returns."""
        return jax.eval_shape(lambda t, x: integers(self.system.next_event(t, x, self.args)[1]), t, x)

    def propose_step(self, carry: StepState, clock: Clock) -> NextEvent:
        """Predict the next event."""
        dt, which = self._predicted(clock.base + carry.s, carry.x)
        # A nan counts as an event, so that `step` stops the run with a status.
        return NextEvent(dt, which, ~((dt > clock.limit(clock.afresh(carry)) - carry.s) | jnp.isposinf(dt)))

    def _predicted(self, t, x) -> tuple[Array, Any]:
        """Time to the next event, and its label, both without derivatives: `_interval` takes those from the guard."""
        system, t, x, args = jax.tree.map(
            lambda leaf: jax.lax.stop_gradient(leaf) if eqx.is_inexact_array(leaf) else leaf,
            (self.system, t, x, self.args),
        )
        dt, which = system.next_event(t, x, args)
        return jnp.asarray(dt, x.dtype), integers(which)

    def is_regular(self, ahead: NextEvent):
        """Regular if an event comes first; `locate_events` does the flight to the end of the block."""
        return ahead.lands

    def _carried(self, carry: StepState, clock: Clock, dt):
        """The state (n,) and the frame (n, k) after the closed-form flow over dt."""
        t = clock.base + carry.s
        x, linear = jax.linearize(lambda x: self.system.flow(dt, t, x, self.args), carry.x)
        return x, each_column(linear, carry.frame)

    def locate_events(
        self, settings: Settings, clock: Clock, within, carry: StepState, ahead: NextEvent
    ) -> tuple[StepState, NextEvent]:
        """Flow to the end of the block, or to a scheduled orthonormalisation, if no event comes before.

        Where an event has come at the very end, the flow from its time to that of the end has no length, but
        derivatives: the event's time depends on parameters, that of the end does not.
        """

        def fly(carry):
            carry = self._flow_over(settings, clock, carry, ahead)
            return carry, ahead if clock.interval is None else self.propose_step(carry, clock)

        return jax.lax.cond(
            (within(carry) & ~ahead.lands) | clock.over(carry), fly, lambda carry: (carry, ahead), carry
        )

    def _flow_over(self, settings: Settings, clock: Clock, carry: StepState, ahead: NextEvent) -> StepState:
        end = clock.limit(carry)
        if settings.count_jumps:  # only jumps end the block, and no jump follows
            never = jnp.isinf(clock.length) & jnp.isposinf(ahead.dt)
            carry, end = stop(carry, STATUS.no_more_jumps, never), jnp.where(never, carry.s, end)
        dt = end - carry.s
        x, frame = self._carried(carry, clock, dt)
        carry = (
            carry if carry.log_volume is None else added(carry, log_volume=self._log_volume_change(carry, clock, dt))
        )
        return carry._replace(
            s=end, x=x, frame=frame, since=carry.since if clock.interval is None else clock.flown(carry, end)
        )

    def _log_volume_change(self, carry: StepState, clock: Clock, dt):
        """ln|det Dφ| of the flow φ over dt, which is ∫ tr Df dt."""
        matrix = jax.jacfwd(lambda x: self.system.flow(dt, clock.base + carry.s, x, self.args))(carry.x)
        return frames.log_abs_det(matrix)

    def velocity(self, t, x, solver=None):
        """The vector field (n,) whose flow is given in closed form."""
        del solver
        return self.system.velocity(t, x, self.args)

    def step(self, settings: Settings, clock: Clock, carry: StepState, flight: NextEvent) -> StepState:
        """Flow to the event and through it."""
        which, timed = flight.which, jnp.isfinite(flight.dt)  # if not, the run ends here
        real = is_event(which) & timed
        dt, in_time = self._interval(carry, clock, flight)
        x, frame = self._carried(carry, clock, dt)
        s = carry.s + dt
        t, n, k = clock.base + s, x.shape[0], frame.shape[1]
        columns = jnp.concatenate([frame, jnp.eye(n, dtype=x.dtype)], axis=1) if settings.sum_rule else frame
        before = self.velocity(t, x)
        event_time_shift = self._event_time_shifts(in_time, t, x, which, columns, before)
        begun = Instant(x, columns, before, which, real, jnp.asarray(0, jnp.int32), carry.log)
        instant = self._events_at(settings, t, begun, real, jnp.maximum(carry.solver_state[2], dt))
        new, columns, direction = instant.x, instant.columns, instant.direction
        columns = to_reference_time(columns, direction, self.velocity(t, new), event_time_shift)
        if carry.log_volume is not None:
            carry = added(
                added(carry, log_volume=self._log_volume_change(carry, clock, dt)),
                log_volume=frames.log_abs_det(columns[:, k:]),
            )
        landed = added(carry, s=dt)._replace(
            x=jnp.where(timed, new, x),
            frame=columns[:, :k],
            since=since_after(settings, clock, carry, dt, real, self.may_lose_rank),
            jumps=carry.jumps + jnp.where(real, instant.jumps, 0),
            log=instant.log,
        )
        landed = stop(landed, STATUS.zeno, instant.due)
        hides = None
        if settings.count_jumps:
            hides = hidden_below(functools.partial(self._guard, which), t, x, before)
        # Orthonormalisations by time interrupt flights: take the time between events from the last event.
        if clock.interval is not None:
            between = jnp.where(flight.dt < 0, flight.dt, jnp.maximum(flight.dt, landed.s - carry.solver_state[0]))
            flight = flight._replace(dt=between)
        return self._store_event(landed, flight._replace(lands=real), instant.jumps > 1, hides)

    def _interval(self, carry: StepState, clock: Clock, flight: NextEvent):
        """The time to the next event, and whether its guard falls through zero then: it gives the time's derivatives.

        One that is due at the start beyond its guard is at the time of the start; a refreshed prediction, whenever it
        comes, changes nothing.
        """
        t, x, which = clock.base + carry.s, carry.x, flight.which

        def at_start():
            return self._brought_about(t, x, which, self.velocity(t, x), carry.solver_state[2])

        late = jax.lax.cond(flight.dt <= 0, at_start, lambda: jnp.asarray(False))
        in_time = is_event(which) & jnp.isfinite(flight.dt) & ~late
        dt = jnp.where(jnp.isfinite(flight.dt), flight.dt, 0.0)
        return event_time(dt, in_time, _guard_after, (self.system, t, x, self.args, which)), in_time

    def _brought_about(self, t, x, which, velocity, longest, before=None):
        guard = functools.partial(self._guard, which)
        return brought_about(guard, t, x, velocity, longest, before)

    def _guard(self, which, t, x):
        return self.system.guard(t, x, self.args, which)

    def _events_at(self, settings: Settings, t, begun: Instant, real, longest) -> Instant:
        """The event and all that follow at its instant; perturbations have the event time of the first."""
        most = most_at_once(begun.x, begun.log)

        def goes_on(state: Instant):
            return (state.jumps == 0) | (state.due & (state.jumps < most))

        def one(state: Instant) -> Instant:
            new, columns, direction = pushforward(
                lambda t, x: self.system.jump(t, x, self.args, state.which), t, state.x, state.columns, state.direction
            )
            zero = jnp.asarray(0, jnp.int32)
            entry = EventLog(None, t, zero, state.which, zero, zero, state.x, new)
            log = log_event(state.log, entry, real | (state.jumps > 0))
            dt, which = self._predicted(t, new)
            due = jax.lax.cond(
                real & is_event(which) & (dt <= 0),
                lambda: self._brought_about(t, new, which, self.velocity(t, new), longest, begun.x),
                lambda: jnp.asarray(False),
            )
            return Instant(new, columns, direction, which, due, state.jumps + 1, log)

        if not settings.reverse:
            return jax.lax.while_loop(goes_on, one, begun)
        first = one(begun)
        return jax.lax.cond(first.due, lambda: checkpointed(goes_on, one, first), lambda: first)

    def tells_whole_step(self, carry: StepState):
        """`tangent` is that of one event."""
        return carry.solver_state[STORED - 1] == 0

    def once(self, settings: Settings, clock: Clock, carry: StepState, flight: NextEvent) -> StepState:
        """Flow to the event and through it, or to the end of the block."""
        return jax.lax.cond(
            flight.lands,
            lambda carry: self.step(settings, clock, carry, flight),
            lambda carry: self._flow_over(settings, clock, carry, flight),
            carry,
        )

    def tangent(self, clock: Clock, carry: StepState, flight: NextEvent) -> Callable:
        """The derivative dx (n,) -> (n,) of `once`."""
        t, which = clock.base + carry.s, flight.which
        interval, in_time = self._interval(carry, clock, flight)
        dt = jnp.where(flight.lands, interval, clock.limit(carry) - carry.s)
        dt = jnp.where(jnp.isfinite(dt), dt, 0.0)

        def flow(x):
            return self.system.flow(dt, t, x, self.args)

        def jump(t, x):
            return self.system.jump(t, x, self.args, which)

        guard = functools.partial(self._guard, which)
        end, x, one = t + dt, flow(carry.x), jnp.ones_like(t)
        before = self.velocity(end, x)
        rate = jax.jvp(guard, (end, x), (one, before))[1]
        new, direction = jax.jvp(jump, (end, x), (one, before))
        after = self.velocity(end, new)

        def linear(dx):
            moved = jax.jvp(flow, (carry.x,), (dx,))[1]
            late = event_time_shifts(jax.jvp(lambda x: guard(end, x), (x,), (moved,))[1], rate)
            late = jnp.where(in_time, late, 0.0)
            pushed = jax.jvp(lambda x: jump(end, x), (x,), (moved,))[1]
            return jnp.where(flight.lands, pushed + direction * late - after * late, moved)

        return linear

    def _event_time_shifts(self, real, t, x, which, columns, velocity):
        """Event-time shifts (columns,); zero where the prediction was only refreshed.

        The `cond` makes XLA compute them once instead of once per row.
        """
        guard = functools.partial(self._guard, which)

        def late(columns):
            slopes = each_column(lambda dx: jax.jvp(lambda x: guard(t, x), (x,), (dx,))[1], columns)
            return event_time_shifts(slopes, jax.jvp(guard, (t, x), (jnp.ones_like(t), velocity))[1])

        return jax.lax.cond(real, late, lambda columns: jnp.zeros_like(columns[0]), columns)

    def _store_event(self, carry: StepState, flight: NextEvent, several, hides=None) -> StepState:
        """Store (event time, interval, longest, count of short ones, whether there were several events, label).

        Stop at Zeno or where not finite.
        """
        dt, (_, _, longest, streak) = flight.dt, carry.solver_state[:4]
        name = named(flight.which, carry.x.dtype)
        again = flight.lands & jnp.all(name == carry.solver_state[STORED:])
        nothing = digits(1e-9, dt) * jnp.maximum(longest, dt)
        longest, streak, over = accumulated(dt, longest, streak, again=again, hides=hides)
        numbers = jnp.stack([carry.s, dt, longest, streak, several.astype(carry.x.dtype)])
        solver = jax.lax.stop_gradient(jnp.concatenate([numbers, name]))
        carry = stop(carry._replace(solver_state=solver), STATUS.zeno, over)
        finite = jnp.all(jnp.isfinite(carry.x)) & jnp.all(jnp.isfinite(carry.frame))
        return stop(carry, STATUS.nonfinite, ~(finite & (dt >= -nothing)))


def _guard_after(dt, operands):
    """The guard of the next event after the time dt, which is zero at the event."""
    system, t, x, args, which = operands
    return system.guard(t + dt, system.flow(dt, t, x, args), args, which)


def since_after(settings: Settings, clock: Clock, carry: StepState, dt, real, may_lose_rank: bool):
    """`StepState.since` after an event; an event that may destroy a direction makes an orthonormalisation due."""
    if settings.qr_schedule.unit != "time":
        return carry.since + {"steps": 1.0, "jumps": 1.0, "never": 0.0}[settings.qr_schedule.unit]
    since = carry.since + dt
    return jnp.where(real, clock.interval, since) if may_lose_rank else since


def integers(which):
    """The label of an event with entries of type int32."""
    for leaf in jax.tree.leaves(which):
        alone = np.ndim(leaf) == 0
        require(alone, f"each number of a label, which, must stand alone, as in (i, j); got shape {np.shape(leaf)}.")
        if not traced(leaf):
            good = not isinstance(leaf, bool) and jnp.issubdtype(getattr(leaf, "dtype", type(leaf)), jnp.integer)
            require(good, f"which must be an integer, or a pytree of integers; got {which!r}.")
            fits = np.all(np.abs(np.asarray(leaf, object)) <= jnp.iinfo(jnp.int32).max)
            require(bool(fits), f"which must fit into 32 bits; got {which!r}.")
    return jax.tree.map(lambda leaf: jnp.asarray(leaf).astype(jnp.int32), which)


def is_event(which):
    """Whether this is an event; a negative `which` means that only the prediction has to be refreshed."""
    return jax.tree.leaves(which)[0] >= 0
