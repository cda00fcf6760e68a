"""How a tangent moves under a field and its guards: advance or reject; locate and land.

A trial step of the state alone decides what happens; the tangent is carried for steps that are kept. To locate
an event nothing is advanced: the next trial starts from the same base and ends at the estimated root, so the
event found is a root along the numerical flow itself, to rounding.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .. import frames
from ..events import EPS, Wiring, arm, by_mode, cubic, hermite_root, jets, rates, turning_point
from ..propagation import Carry, Clock, Events, Settings, harvest, log_event, stop
from ..saltations import advance_to_instant, instant, push, return_along
from ..statuses import STATUS
from .base import Method

__all__ = ["Memory", "Stepping"]

REJECT, ADVANCE, LOCATE, LAND, FAIL, NONE = range(6)  # what a trial says; NONE: there is none yet

SAFETY, SHRINK, GROW = 0.8, 0.2, 10.0  # of the PI controller
NEAR = 1e-6  # a trial lands when the root is nearer than this, relative to the controller's step
SAME = 1e-13  # roots nearer than this, relative to the controller's step or the time, are simultaneous
PROBE = 0.21132486540518713  # (3 - √3)/6 of a step, where the slope of a cubic interpolant errs most
GUARD_RESOLUTION = 0.02  # how well the cubic of a guard must agree with the guard in the middle of a step
GRAZING = 1e-3  # sine of the angle between flow and guard below which a crossing is called grazing
PATIENCE = 30  # relocations of one event, and short intervals in a row, before drastic measures
SHORT = 1e-5  # an interval between events is short below this, relative to the step and the longest interval


class Memory(NamedTuple):
    """Numbers that only events need, in one vector of the carry."""

    last: Any  # time of the last event, local to the block
    interval: Any  # between the last two events
    longest: Any  # interval so far
    streak: Any  # short intervals in a row
    transversality: Any  # least so far
    grazing: Any  # seen? 0 or 1, as the next
    simultaneous: Any
    accumulation: Any  # estimated end of an accumulation of events


class Stepper(NamedTuple):
    """The mover's part of the carry."""

    f: Array | None  # the field at the start of the step
    h: Array | None  # the controller's step
    log_ratio: Array | None  # of the last accepted step, for the PI controller
    mode: Array | None
    g: Array | None  # (slots,) guards at the start of the step, and their rates
    rate: Array | None
    side: Array | None
    ticks: Array | None  # (clocks,) number of the next tick
    memory: Array | None


class Trial(NamedTuple):
    """One trial step of the state, and what it says about the guards."""

    case: Any  # REJECT, ADVANCE, LOCATE, LAND, FAIL or NONE
    h: Array
    x: Array
    f: Array
    ratio: Any  # error over tolerance
    final: Any  # ends the block
    g: Any = None
    rate: Any = None
    miss: Any = None  # (slots,) by how much the cubic of a guard is off
    tick: Any = None  # the clock that ticks at the end of the step; -1: none


class Aim(NamedTuple):
    """What a trial aims at while an event is located."""

    h: Any  # length of the trial
    beyond: Any  # where the guard is known to be beyond its root
    slot: Any  # whose root; -1: a turning point, or nothing
    tries: Any


class Signs(NamedTuple):
    """What the guards did during a trial: (slots,) each."""

    crossed: Array
    turn: Array  # turns towards zero inside the step, and may be beyond it there
    theta: Array  # where it turns
    lands: Array  # has its root at the end of the trial
    ahead: Array  # time from there to its root


@dataclasses.dataclass(frozen=True)
class Stepping:
    """The mover of flows and hybrid systems."""

    wiring: Wiring
    method: Method
    clock_times: tuple[tuple[Any, Any], ...]  # (period, phase)
    terminal: tuple[bool, ...]
    max_cascade: int

    @property
    def may_lose_rank(self) -> bool:
        """Resets can destroy directions."""
        return self.has_events or bool(self.wiring.clocks)

    @property
    def jumps_uncontrolled(self) -> bool:
        """Every jump is followed by an orthonormalisation of its own: nothing is lost between."""
        return False

    @property
    def has_events(self) -> bool:
        """Whether there are transitions at all (a plain flow has none)."""
        return bool(self.wiring.resets)

    @property
    def always_common(self) -> bool:
        """Whether nothing rare can happen: a plain flow with a fixed step."""
        return not self.has_events and not self.rejects

    @property
    def rejects(self) -> bool:
        """Whether a trial can fail."""
        return self.method.adaptive

    def which_shape(self, t, x):
        """What an event log stores as `which`."""
        del t, x
        return jax.ShapeDtypeStruct((), jnp.int32)

    # --- the beginning ---------------------------------------------------------------------------------------

    def begin(self, t, x, mode, h) -> Stepper:
        """The mover's part of the carry at (t, x)."""
        if self.always_common:
            return Stepper(*(None,) * 9)
        w, mode = self.wiring, jnp.asarray(mode, jnp.int32)
        f = by_mode(mode, w.fields, t, x)
        h = self._first_step(x, f) if h is None else h
        state = Stepper(f, h, jnp.zeros_like(h), mode if w.modes > 1 else None, *(None,) * 5)
        if not self.has_events:
            return state
        g, rate, second = by_mode(mode, [_jets_of(w, q) for q in range(w.modes)], t, x)
        side, g, _ = arm(g, rate, second, h, t, jnp.zeros(w.slots, bool))
        ticks = [jnp.floor((t - phase) / period + 1e-9) + 1 for period, phase in self.clock_times]
        zero, one = jnp.zeros_like(t), jnp.ones_like(t)
        memory = Memory(zero, zero, zero, zero, one * jnp.inf, zero, zero, one * jnp.nan)
        return Stepper(
            f,
            h,
            state.log_ratio,
            state.mode,
            g,
            rate,
            side,
            jnp.stack(ticks) if ticks else None,
            jnp.stack(memory),
        )

    def _first_step(self, x, f):
        if not self.method.adaptive:
            return jnp.asarray(self.method.dt, x.dtype)
        scale = self.method.atol + self.method.rtol * jnp.abs(x)
        size, speed = jnp.sqrt(jnp.mean((x / scale) ** 2)), jnp.sqrt(jnp.mean((f / scale) ** 2))
        usual = 0.01 * size / jnp.maximum(speed, 1e-300)
        return jax.lax.stop_gradient(jnp.where((size > 1e-5) & (speed > 1e-5), usual, 1e-6))

    def rebase(self, own: Stepper, s) -> Stepper:
        """Carry local times over to a block that starts s later."""
        return own if own.memory is None else own._replace(memory=own.memory.at[0].add(-s))

    # --- looking ahead ---------------------------------------------------------------------------------------

    def enter(self, c: Carry, clock: Clock):
        """At the start of a block a system with events has no trial yet: `settle` makes the first."""
        if not self.has_events:
            return self.look(c, clock)
        h, zeros = jnp.zeros_like(c.s), jnp.zeros(self.wiring.slots, c.x.dtype)
        tick = None if c.own.ticks is None else jnp.asarray(-1, jnp.int32)
        none = jnp.asarray(NONE, jnp.int32)
        ratio, miss = (h, zeros) if self.rejects else (None, None)
        return Trial(none, h, c.x, c.own.f, ratio, jnp.asarray(False), zeros, zeros, miss, tick)

    def look(self, c: Carry, clock: Clock, aim: Aim | None = None):
        """A trial step of the state, and the case that it makes; a plain fixed-step flow needs no trial."""
        own, t, w = c.own, clock.base + c.s, self.wiring
        if own.f is None:
            return ()
        h, final, tick = self._length(c, clock, aim)

        def trial(q):
            def of_mode(t, x, f, h):
                step = self.method.step(w.fields[q], t, x, f, h)
                ratio = jax.lax.stop_gradient(self.method.state_ratio(step, x)) if self.rejects else None
                if not self.has_events:
                    return step, ratio, None, None, None
                g, rate = rates(w.guards[q], t + h, step.x, step.f)
                if not self.rejects:
                    return step, ratio, g, rate, None
                at, probe = t + PROBE * h, self.method.inside(step.dense, PROBE)
                _, slope = rates(w.guards[q], at, probe, w.fields[q](at, probe))
                return step, ratio, g, rate, slope

            return of_mode

        step, ratio, g, rate, slope = by_mode(own.mode, [trial(q) for q in range(w.modes)], t, c.x, own.f, h)
        tr = Trial(None, h, step.x, step.f, ratio, final, g, rate, None, tick)
        return self._judge(c, clock, tr, slope, aim)

    def common(self, ahead):
        """Rejecting and advancing are common."""
        return True if ahead == () else ahead.case <= ADVANCE

    def _length(self, c: Carry, clock: Clock, aim: Aim | None):
        """How long the next trial is: the controller's step, cut at the block's end, a tick, a root."""
        own, rest = c.own, clock.length - c.s
        h = jax.lax.stop_gradient(own.h)
        tick = jnp.asarray(-1, jnp.int32) if own.ticks is not None else None
        final = rest <= h * (1 + 1e-9)
        h = jnp.where(final, rest, h)
        if own.ticks is not None:
            until = self._until_ticks(own, c.s, clock)
            first = jnp.argmin(until)
            ticks = until[first] <= h * (1 + 1e-9)
            h, tick = jnp.where(ticks, until[first], h), jnp.where(ticks, first.astype(jnp.int32), tick)
            final = final & ~ticks
        if aim is not None:
            cut = aim.h < h
            h, final = jnp.where(cut, aim.h, h), final & ~cut
            tick = None if tick is None else jnp.where(cut, -1, tick)
        return h, final, tick

    def _until_ticks(self, own: Stepper, s, clock: Clock):
        """Time to the next tick of each clock; inf where the mode does not listen to it."""
        times = [
            (phase + period * own.ticks[i] - clock.base) - clock.rest - s
            for i, (period, phase) in enumerate(self.clock_times)
        ]
        armed = self.wiring.armed
        listening = jnp.asarray(armed[0]) if own.mode is None else jnp.asarray(armed)[own.mode]
        return jnp.where(listening, jnp.maximum(jnp.stack(times), 0.0), jnp.inf)

    def _judge(self, c: Carry, clock: Clock, tr: Trial, slope, aim: Aim | None) -> Trial:
        """The case that a trial makes."""
        own, ratio = c.own, tr.ratio
        event, lands = jnp.asarray(False), jnp.asarray(False)
        if self.has_events:
            tr = self._resolve(own, tr, slope)
            ratio = tr.ratio
            if aim is None:
                event = self._suspects(own, tr)
            else:
                event, lands = self._finds(own, tr, aim)
                if self.rejects:  # a shorter piece of a step that has passed passes too
                    ratio = jnp.where((aim.slot >= 0) & jnp.isfinite(ratio), 0.0, ratio)
            if tr.tick is not None:
                lands = lands | ((tr.tick >= 0) & ~event)
        case = jnp.where(lands, LAND, jnp.where(event, LOCATE, ADVANCE))
        # An infinite or undefined state spoils the estimate; without an estimate the state itself is asked.
        passed = ratio <= 1.0 if self.rejects else jnp.all(jnp.isfinite(tr.x))
        failed = tr.h <= self._least_step(c, clock) if self.rejects else True
        case = jnp.where(passed, case, jnp.where(failed & (tr.h > 0), FAIL, REJECT))
        return tr._replace(case=case.astype(jnp.int32), ratio=ratio)

    def _resolve(self, own: Stepper, tr: Trial, slope) -> Trial:
        """How well the cubic of each guard follows the guard; it must, for events to be seen."""
        if slope is None:
            return tr
        # The cubic errs like θ²(1-θ)²; its slope errs most at the probe, 3.08 times its error in the middle.
        d0, d1 = tr.h * own.rate, tr.h * tr.rate
        miss = jnp.abs(tr.h * slope - cubic(PROBE, own.g, d0, tr.g, d1)[1]) / 3.0792
        size = jnp.abs(own.g) + jnp.abs(tr.g) + 0.25 * (jnp.abs(d0) + jnp.abs(d1))
        allowed = GUARD_RESOLUTION * size + 1e3 * self.method.atol
        return tr._replace(miss=miss, ratio=jnp.maximum(tr.ratio, jax.lax.stop_gradient(jnp.max(miss / allowed))))

    def _fires(self, own: Stepper):
        """The slots that a change of sign would fire."""
        directed = self._table(own.mode, self.wiring.directed)
        return (own.side > 0) | (~directed & (own.side != 0))

    def _suspects(self, own: Stepper, tr: Trial):
        """Whether a guard may have been crossed: cheap, and never wrong in saying no."""
        crossed = self._fires(own) & (own.side * tr.g <= 0)
        turns = (own.rate * tr.rate < 0) & (own.side * own.rate < 0) & (own.side * tr.g > 0)
        reach = tr.h * jnp.maximum(jnp.abs(own.rate), jnp.abs(tr.rate)) + 4.0 * _miss(tr)
        near = jnp.minimum(jnp.abs(own.g), jnp.abs(tr.g)) <= reach
        return jnp.any(crossed | (turns & near))

    def _finds(self, own: Stepper, tr: Trial, aim: Aim):
        """Whether there is an event to be located still, and whether the trial ends at one."""
        signs, given_up = self._signs(own, tr, aim), aim.tries > PATIENCE
        found = jnp.any(signs.crossed | signs.turn)
        event = (found | (aim.slot >= 0)) & ~(given_up & ~jnp.any(signs.crossed))
        far = jnp.any((signs.crossed & ~signs.lands) | signs.turn)
        return event, jnp.any(signs.lands) & (~far | given_up)

    def _least_step(self, c: Carry, clock: Clock):
        """A step below the resolution of time goes nowhere."""
        return 1e-3 * EPS * jnp.abs(clock.base + c.s) + 1e-150

    def _signs(self, own: Stepper, tr: Trial, aim: Aim) -> Signs:
        """Which guards crossed zero during a trial, turned towards it, or have their root at its end."""
        fires = self._fires(own)
        crossed = fires & (own.side * tr.g <= 0)
        # A guard that turns back inside the step: the step is cut there if it may have been beyond zero.
        d0, d1 = tr.h * own.rate, tr.h * tr.rate
        turns = (d0 * d1 < 0) & (own.side * d0 < 0) & (own.side * tr.g > 0)
        theta = turning_point(own.g, d0, tr.g, d1)
        extreme, _ = cubic(theta, own.g, d0, tr.g, d1)
        drop = jnp.minimum(jnp.abs(own.g - extreme), jnp.abs(tr.g - extreme))
        doubt = 0.2 * drop + 64.0 * (theta * (1 - theta)) ** 2 * _miss(tr)
        turn = turns & (own.side * extreme <= doubt) & (theta > 1e-9) & (theta < 1 - 1e-9)
        ahead = -tr.g / jnp.where(tr.rate == 0, 1e-300, tr.rate)
        close = fires & (own.side * tr.rate < 0) & (jnp.abs(ahead) <= NEAR * own.h)
        aimed = jnp.arange(self.wiring.slots) == aim.slot
        lands = close & ((aim.slot >= 0) | jnp.any(crossed))
        lands = lands | ((aim.tries > PATIENCE) & (crossed | aimed))
        return Signs(crossed, turn, theta, lands, ahead)

    def _table(self, mode, table: np.ndarray):
        return jnp.asarray(table[0]) if mode is None else jnp.asarray(table)[mode]

    # --- advance ---------------------------------------------------------------------------------------------

    def _carried(self, c: Carry, clock: Clock, h, mode):
        """The step's tangent: the frame at its end, the frame's error ratio, ∫ tr Df over it."""
        t, w = clock.base + c.s, self.wiring

        def tangent(q):
            def of_mode(t, x, frame, h):
                field = w.fields[q]

                def step(x):
                    done = self.method.step(field, t, x, field(t, x), h)
                    return done.x, done.error

                (new, _), linear = jax.linearize(step, x)
                moved, errors = jax.vmap(linear, in_axes=-1, out_axes=-1)(frame)
                if self.rejects and self.method.control == "xY":
                    ratio = jax.lax.stop_gradient(self.method.frame_ratio(errors, frame, moved))
                else:
                    ratio = jnp.zeros_like(h)
                flux = self.method.divergence(field, t, x, h) if c.volume is not None else None
                return new, moved, ratio, flux

            return of_mode

        return by_mode(mode, [tangent(q) for q in range(w.modes)], t, c.x, c.frame, h)

    def _commit(self, settings: Settings, c: Carry, s, h, x, frame, flux) -> Carry:
        since = c.since + {"steps": 1.0, "time": h, "jumps": 0.0, "never": 0.0}[settings.cadence.unit]
        volume = c.volume if flux is None else c.volume + flux
        return c._replace(s=s, x=x, frame=frame, since=since, volume=volume)

    def step(self, settings: Settings, clock: Clock, c: Carry, tr) -> Carry:
        """Keep the trial and carry the frame; or, where an error is too large, only make h smaller."""
        if tr == ():
            return self._march(settings, clock, c)
        own, ratio, frame, flux = c.own, tr.ratio, c.frame, None
        if frame.shape[1]:
            _, frame, frame_ratio, flux = self._carried(c, clock, tr.h, own.mode)
            ratio = jnp.maximum(ratio, frame_ratio) if self.rejects else None
        kept = self._commit(settings, c, jnp.where(tr.final, clock.length, c.s + tr.h), tr.h, tr.x, frame, flux)
        kept = _with(kept, f=tr.f)
        if self.has_events:
            kept = _with(kept, g=tr.g, rate=tr.rate, side=jnp.where(tr.g == 0, own.side, jnp.sign(tr.g)))
        if not self.rejects:
            return kept
        # The frame's error may fail a step that the state's has passed.
        passed = ratio <= 1.0
        kept = jax.tree.map(lambda a, b: a if a is b else jnp.where(passed, a, b), kept, c)
        h, log_ratio = self._next_h(own, tr, ratio, passed)
        return _with(kept, h=h, log_ratio=log_ratio)

    def _march(self, settings: Settings, clock: Clock, c: Carry) -> Carry:
        """A fixed step of a plain flow: no trial, no guard."""
        rest, dt = clock.length - c.s, self.method.dt
        final = rest <= dt * (1 + 1e-9)
        h = jnp.where(final, rest, dt)
        new, frame, _, flux = self._carried(c, clock, h, None)
        return self._commit(settings, c, jnp.where(final, clock.length, c.s + h), h, new, frame, flux)

    def _next_h(self, own: Stepper, tr: Trial, ratio, passed):
        """PI control (Gustafsson; Hairer & Wanner, Solving ODEs II, section IV.2): 0.7/p and 0.4/p."""
        order = self.method.error_order
        log_ratio = jnp.log(jnp.clip(ratio, 1e-10, 1e10))  # nan, from a state out of bounds, stays nan
        exponent = -(0.7 / order) * log_ratio + (0.4 / order) * own.log_ratio
        factor = jnp.clip(SAFETY * jnp.exp(exponent), SHRINK, GROW)
        smaller = jnp.maximum(SAFETY * jnp.exp(-log_ratio / order), SHRINK)
        smaller = jnp.where(jnp.isfinite(ratio), jnp.minimum(smaller, SAFETY), SHRINK)
        whole = tr.h >= 0.99 * own.h
        # A step that was cut at an event, a tick or the block's end says nothing against the controller's h.
        h = jnp.where(whole, tr.h * factor, jnp.maximum(own.h, tr.h * factor))
        h = jnp.where(passed, h, tr.h * smaller)
        return jax.lax.stop_gradient(h), jnp.where(whole & passed, log_ratio, own.log_ratio)

    # --- what is rare ----------------------------------------------------------------------------------------

    def settle(self, settings: Settings, clock: Clock, within, c: Carry, tr) -> tuple[Carry, Trial]:
        """Trials that are aimed at events and land on them, until a common one comes out; or the run's end."""

        def land(c, tr, aim):
            return self._land(settings, clock, c, tr), _no_aim(tr.h)

        def aim_at(c, tr, aim):
            return c, self._aim(c.own, tr, aim)

        def neither(c, tr, aim):
            return self._fail(c, tr), _no_aim(tr.h)

        def again(state):
            c, tr, aim = state
            c = c._replace(budget=jnp.maximum(c.budget - 1, 1))
            which = jnp.where(tr.case == LOCATE, 0, jnp.where(tr.case == LAND, 1, 2))
            c, aim = jax.lax.switch(which, [aim_at, land, neither], c, tr, aim)
            return c, self.look(c, clock, aim), aim

        if self.always_common:
            return c, tr
        if not self.has_events:
            return jax.lax.cond(tr.case == FAIL, self._fail, lambda c, tr: c, c, tr), tr
        c, tr, _ = jax.lax.while_loop(
            lambda state: within(state[0]) & ~self.common(state[1]), again, (c, tr, _no_aim(tr.h))
        )
        return c, tr

    def _fail(self, c: Carry, tr: Trial) -> Carry:
        """No step can be made: because the state is not finite, or because it would be too small."""
        status = jnp.where(self._finite(tr), STATUS.step_underflow, STATUS.nonfinite)
        return stop(c, status, tr.case == FAIL)

    def _finite(self, tr: Trial):
        finite = jnp.all(jnp.isfinite(tr.x))
        return finite if tr.ratio is None else finite & jnp.isfinite(tr.ratio)

    def _aim(self, own: Stepper, tr: Trial, aim: Aim) -> Aim:
        """A guard was crossed, or may have been: aim at the earliest root or turning point.

        A first trial was only suspected: where a close look finds nothing the aim is the same step again.
        """
        signs, h = self._signs(own, tr, aim), tr.h
        d0, d1 = h * own.rate, h * tr.rate
        # A guard that starts at zero first leaves it: its root lies beyond the extremum between.
        lo = jnp.where((own.g == 0) & (d0 * d1 < 0), turning_point(own.g, d0, tr.g, d1), 0.0)
        roots = jnp.where(signs.crossed, h * hermite_root(lo, own.g, d0, tr.g, d1), jnp.inf)
        slot = jnp.argmin(roots)
        cut = jnp.min(jnp.where(signs.turn, h * signs.theta, jnp.inf))
        # An undershoot of the slot aimed at: one Newton step, kept below where the guard is known to be beyond.
        aimed = jnp.maximum(aim.slot, 0)
        newton = h + signs.ahead[aimed]
        newton = jnp.where((newton > h) & (newton < aim.beyond), newton, 0.5 * (h + aim.beyond))
        undershot = (aim.slot >= 0) & ~jnp.any(signs.crossed)
        root = jnp.where(undershot, newton, roots[slot])
        slot = jnp.where(undershot, aimed, jnp.where(jnp.any(signs.crossed), slot, -1))
        # The cubic's root may stagnate at one end where it is very flat: then bisect.
        root = jnp.where((aim.tries > 10) & ~undershot, 0.5 * root, root)
        target = jax.lax.stop_gradient(jnp.minimum(root, cut))
        beyond = jax.lax.stop_gradient(jnp.where(undershot, aim.beyond, h))
        return Aim(target, beyond, jnp.where(root <= cut, slot, -1).astype(jnp.int32), aim.tries + 1)

    # --- land ------------------------------------------------------------------------------------------------

    def _land(self, settings: Settings, clock: Clock, c: Carry, tr: Trial) -> Carry:
        """The trial ends at an event: polish, cross, orthonormalise at once, re-arm the guards."""
        own, w = c.own, self.wiring
        mode = jnp.asarray(0, jnp.int32) if own.mode is None else own.mode
        frame, flux = c.frame, None
        if frame.shape[1]:
            _, frame, _, flux = self._carried(c, clock, tr.h, own.mode)
        c = self._commit(settings, c, c.s + tr.h, tr.h, tr.x, frame, flux)
        ahead = -tr.g / jnp.where(tr.rate == 0, 1e-300, tr.rate)
        lands = self._at_root(own, tr, ahead)
        ticking = ~jnp.any(lands)
        ahead = jnp.where(lands, ahead, jnp.inf)
        slot = jnp.argmin(ahead).astype(jnp.int32)
        c = self._polish(clock, c, slot, ticking)
        t = clock.base + c.s
        c = harvest(settings, c, t) if self._orthonormalises(settings, c) else c
        # Which transition: the first of those at this instant whose `when` says yes.
        together = lands & (ahead <= ahead[slot] + SAME * (own.h + jnp.abs(t)))
        allowed = together & by_mode(mode, w.whens, t, c.x) if w.shared else together
        blocked = ~ticking & ~jnp.any(allowed)
        slot = jnp.argmax(allowed).astype(jnp.int32)
        transition = self._table(own.mode, w.transition)[slot]
        which = self._table(own.mode, w.component)[slot]
        if w.clocks:
            clocks = jnp.asarray(w.clocks, jnp.int32)
            transition = jnp.where(ticking, clocks[tr.tick], transition)
            which = jnp.where(ticking, 0, which)
        crossed = self._cross(settings, clock, c, mode, transition, which, jnp.where(ticking, -1, slot), allowed)
        crossed = self._keep_clocks(clock, crossed, tr, ticking)
        return _choose(blocked, stop(c, STATUS.deadlock), crossed)

    def _at_root(self, own: Stepper, tr: Trial, ahead):
        """The guards whose root is at the end of a trial that lands."""
        ticking = jnp.asarray(False) if tr.tick is None else tr.tick >= 0
        fires = self._fires(own)
        crossed = fires & (own.side * tr.g <= 0)
        close = fires & (own.side * tr.rate < 0) & (jnp.abs(ahead) <= NEAR * own.h)
        return jnp.where(ticking, False, jnp.where(jnp.any(close), close, crossed))

    def _orthonormalises(self, settings: Settings, c: Carry) -> bool:
        return settings.cadence.unit != "never" and c.frame.shape[1] > 0

    def _polish(self, clock: Clock, c: Carry, slot, ticking) -> Carry:
        """Two second-order steps onto the guard; they are differentiable, the location of the root was not."""
        w = self.wiring

        def of_mode(q):
            def polish(t, x, frame):
                def once(_, state):
                    t, x, frame, shift = state
                    f, second = jax.jvp(w.fields[q], (t, x), (jnp.ones_like(t), w.fields[q](t, x)))
                    g, rate = rates(w.guards[q], t, x, f)
                    step = -g[slot] / jnp.where(rate[slot] == 0, 1.0, rate[slot])
                    step = jnp.where(ticking | (rate[slot] == 0), 0.0, step)

                    def slope(dx):
                        return jax.jvp(lambda y: w.fields[q](t, y), (x,), (dx,))[1]

                    frame = frame + step * jax.vmap(slope, in_axes=-1, out_axes=-1)(frame)
                    return t + step, x + step * (f + 0.5 * step * second), frame, shift + step

                return jax.lax.fori_loop(0, 2, once, (t, x, frame, jnp.zeros_like(t)))

            return polish

        start = (clock.base + c.s, c.x, c.frame)
        _, x, frame, shift = by_mode(c.own.mode, [of_mode(q) for q in range(w.modes)], *start)
        return c._replace(s=c.s + shift, x=x, frame=frame)

    def _cross(self, settings, clock: Clock, c: Carry, mode, transition, which, slot, together) -> Carry:
        """Through the event and the cascade it sets off; then orthonormalise and arm the guards."""
        t, h, k = clock.base + c.s, c.own.h, c.frame.shape[1]
        columns, was_live = c.frame, jnp.sum(c.frame * c.frame, axis=0) > 0.5
        if settings.sum_rule:  # n more columns, the identity: they come out as the saltation matrix
            columns = jnp.concatenate([columns, jnp.eye(c.x.shape[0], dtype=c.x.dtype)], axis=1)
        landing = self._in_each_order(t, h, c, columns, mode, transition, which, slot, together)
        since = c.since + landing.count if settings.cadence.unit == "jumps" else c.since
        volume = frames.log_abs_det(landing.columns[:, k:]) if settings.sum_rule else None
        c = c._replace(
            x=landing.x,
            frame=landing.columns[:, :k],
            since=since,
            jumps=c.jumps + landing.count,
            volume=None if volume is None else c.volume + volume,
            log=landing.log,
        )
        arrival = {"f": landing.f, "g": landing.g, "rate": landing.rate, "side": landing.side}
        c = _with(c, mode=None if c.own.mode is None else landing.mode, **arrival)
        if self._orthonormalises(settings, c):
            project = self._projection(landing.mode, t, landing.x)
            c = harvest(settings, c, t, frames.LOST, frames.LOST, project, was_live)
        c = self._remember(c, landing, clock)
        c = stop(c, STATUS.terminated, landing.terminal)
        c = stop(c, STATUS.deadlock, landing.stuck)
        finite = jnp.all(jnp.isfinite(c.x)) & jnp.all(jnp.isfinite(c.frame))
        c = stop(c, STATUS.nonfinite, ~finite)
        return stop(c, STATUS.zeno, landing.count > self.max_cascade)

    def _projection(self, mode, t, x):
        projections = [lambda dx, p=p: p(t, x, dx) for p in self.wiring.projections]
        return lambda dx: by_mode(mode, projections, dx)

    def _start_cascade(self, t, c, columns, mode, transition, which, slot, together) -> "Landing":
        """On the guard, before the first jump: each column moved to its own instant."""
        w, x = self.wiring, c.x
        f = by_mode(mode, w.fields, t, x)
        gradient, moving, rate = self._instant(mode, t, x, f, slot)
        moved, shift = advance_to_instant(columns, gradient, rate, f)
        ticking = slot < 0  # the instant of a clock is everybody's
        size = jnp.sqrt(jnp.sum(gradient**2) * jnp.sum(f**2) + 1e-300) + jnp.abs(moving)
        slots, no = jnp.zeros(w.slots, x.dtype), jnp.asarray(False)
        return Landing(
            x=x, columns=jnp.where(ticking, columns, moved), shift=jnp.where(ticking, 0.0, shift), mode=mode, f=f,
            g=slots, rate=slots, side=slots, transition=transition, which=which, slot=slot,
            count=jnp.asarray(0, jnp.int32), again=jnp.asarray(True), terminal=no, stuck=no,
            transversality=jnp.where(ticking, jnp.inf, jnp.abs(rate) / size), together=together, log=c.log,
        )

    def _cascade(self, t, h, landing: "Landing") -> "Landing":
        """The reset of the located event, and of every guard on whose fired side it ends."""
        w = self.wiring

        def jump(state: Landing) -> Landing:
            x, columns = jax.lax.switch(
                state.transition, [_pusher(reset) for reset in w.resets], t, state.x, state.columns, state.shift, state.which
            )
            mode = jax.lax.switch(state.transition, w.targets, state.mode, t, state.x, state.which)
            f, g, rate, second = by_mode(mode, [_arrival(w, q) for q in range(w.modes)], t, x)
            fired = (jnp.arange(w.slots) == state.slot) & (mode == state.mode)
            side, g, flat = arm(g, rate, second, h, t, fired)
            entry = Events(None, t, state.transition, state.which, state.mode, mode, state.x, x)
            terminal = state.terminal | jnp.asarray(self.terminal)[state.transition]
            # A guard on its fired side fires now; the one that has just fired is exempt in its own mode.
            directed = self._table(mode if w.modes > 1 else None, w.directed)
            follows = directed & (side < 0) & ~fired
            follows = follows & by_mode(mode, w.whens, t, x) if w.shared else follows
            slot = jnp.argmax(follows).astype(jnp.int32)
            again = jnp.any(follows) & ~terminal & (state.count < self.max_cascade)
            stuck = jnp.any(fired & flat & (side < 0) & directed) & ~again
            # A guard that the flow itself brought to zero at this instant has an instant of its own.
            itself = again & state.together[slot] & (mode == state.mode)
            shift, columns = self._own_instant(itself, mode, t, x, f, slot, columns, state.shift)
            transition = jnp.where(again, self._table(mode if w.modes > 1 else None, w.transition)[slot], state.transition)
            which = self._table(mode if w.modes > 1 else None, w.component)[slot]
            return Landing(
                x, columns, shift, mode, f, g, rate, side, transition, which, slot, state.count + 1,
                again, terminal, stuck | state.stuck, state.transversality, state.together,
                log_event(state.log, entry),
            )

        landing = jax.lax.while_loop(lambda s: s.again, jump, landing)
        over = (landing.count >= self.max_cascade) & self._still_fires(landing)
        landing = landing._replace(
            columns=return_along(landing.columns, landing.f, landing.shift),
            count=landing.count + over,
        )
        return landing

    def _still_fires(self, landing: "Landing"):
        directed = self._table(landing.mode if self.wiring.modes > 1 else None, self.wiring.directed)
        fired = jnp.arange(self.wiring.slots) == landing.slot
        return jnp.any(directed & (landing.side < 0) & ~fired)

    def _instant(self, mode, t, x, f, slot):
        """∇h, ∂ₜh and ḣ of a slot of the present mode."""

        def of_mode(guards):
            return lambda t, x, f: _gradient(lambda t, x: guards(t, x)[slot], t, x, f)

        return by_mode(mode, [of_mode(g) for g in self.wiring.guards], t, x, f)

    def _own_instant(self, itself, mode, t, x, f, slot, columns, shift):
        gradient, _, rate = self._instant(mode, t, x, f, slot)
        moved, own = advance_to_instant(return_along(columns, f, shift), gradient, rate, f)
        return jnp.where(itself, own, shift), jnp.where(itself, moved, columns)

    def _in_each_order(self, t, h, c, columns, mode, transition, which, slot, together) -> "Landing":
        """Where several guards meet at one instant: take them in the other order too, and compare."""
        first = self._start_cascade(t, c, columns, mode, transition, which, slot, together)
        if self.wiring.slots == 1:
            return self._cascade(t, h, first)._replace(together=jnp.asarray(False))
        other = jnp.argmax(together & (jnp.arange(self.wiring.slots) != slot)).astype(jnp.int32)
        swapped = self._table(c.own.mode, self.wiring.transition)[other], self._table(c.own.mode, self.wiring.component)[other]
        several = (jnp.sum(together) > 1) & (slot >= 0)
        second = self._start_cascade(t, c, columns, mode, *swapped, other, together)

        def run(state):
            turn, kept, differs = state
            landing = self._cascade(t, h, _choose(turn == 0, first, second))
            differs = (turn == 1) & _apart(landing, kept)
            return turn + 1, _choose(turn == 0, landing, kept), differs

        start = (jnp.asarray(0), first, jnp.asarray(False))
        last = jnp.where(several, 2, 1)
        _, landing, differs = jax.lax.while_loop(lambda state: state[0] < last, run, start)
        return landing._replace(together=differs)

    def _keep_clocks(self, clock: Clock, c: Carry, tr: Trial, ticking) -> Carry:
        """The clock that has ticked goes on; clocks that were not listened to catch up."""
        if not self.wiring.clocks:
            return c
        t = clock.base + c.s
        ticked = ticking & (jnp.arange(len(self.clock_times)) == tr.tick)
        number = c.own.ticks + ticked
        now = jnp.stack([jnp.floor((t - phase) / period + 1e-9) for period, phase in self.clock_times])
        number = jnp.where(number < now - 1e-3, now + 1, number)
        return _with(c, ticks=number)

    def _remember(self, c: Carry, landing: "Landing", clock: Clock) -> Carry:
        """Intervals between events, for Zeno; transversality and notes."""
        m = Memory(*c.own.memory)
        interval = c.s - m.last
        longest = jnp.maximum(m.longest, interval)
        short = interval < SHORT * jnp.minimum(c.own.h, longest)
        streak = jnp.where(short, m.streak + 1, 0.0)
        shrink = jnp.clip(interval / jnp.where(m.interval > 0, m.interval, 1.0), 0.0, 1 - 1e-9)
        ahead = clock.base + c.s + interval * shrink / (1 - shrink)
        zeno = streak > PATIENCE
        memory = Memory(
            c.s,
            interval,
            longest,
            streak,
            jnp.minimum(m.transversality, landing.transversality),
            jnp.maximum(m.grazing, landing.transversality < GRAZING),
            jnp.maximum(m.simultaneous, landing.together),
            jnp.where(zeno, ahead, m.accumulation),
        )
        memory = jax.lax.stop_gradient(jnp.stack([jnp.asarray(v, c.x.dtype) for v in memory]))
        return stop(_with(c, memory=memory), STATUS.zeno, zeno)


class Landing(NamedTuple):
    """The state on its way through the jumps of one instant."""

    x: Array
    columns: Array
    shift: Array  # (columns,) δτ of each
    mode: Array
    f: Array  # of the new mode
    g: Array
    rate: Array
    side: Array
    transition: Array
    which: Array
    slot: Array
    count: Array
    again: Array
    terminal: Array
    stuck: Array
    transversality: Array
    together: Array  # slots that the flow brought to zero at this instant; afterwards: does their order matter
    log: Events | None


def _gradient(guard, t, x, f):
    gradient, rate = instant(guard, t, x, f)[::2]
    return gradient, rate - jnp.sum(gradient * f), rate


def _apart(a: Landing, b: Landing):
    """Whether two orders of the same events end differently, in the state or in the tangent."""
    size = 1.0 + jnp.max(jnp.abs(b.columns), initial=0.0)
    columns = jnp.max(jnp.abs(a.columns - b.columns), initial=0.0) > 1e-9 * size
    states = jnp.max(jnp.abs(a.x - b.x)) > 1e-9 * (1.0 + jnp.max(jnp.abs(b.x)))
    return columns | states | (a.mode != b.mode)


def _pusher(reset):
    def pushed(t, x, columns, shift, which):
        return push(lambda t, x: reset(t, x, which), t, x, columns, shift)

    return pushed


def _jets_of(w: Wiring, q: int):
    return lambda t, x: jets(w.guards[q], w.fields[q], t, x)


def _arrival(w: Wiring, q: int):
    return lambda t, x: (w.fields[q](t, x), *jets(w.guards[q], w.fields[q], t, x))


def _miss(tr: Trial):
    """By how much the cubics of the guards are off; unknown, and taken as 0, where steps are fixed."""
    return jnp.zeros_like(tr.g) if tr.miss is None else tr.miss


def _no_aim(h) -> Aim:
    infinity = jnp.full_like(h, jnp.inf)
    return Aim(infinity, infinity, jnp.asarray(-1, jnp.int32), jnp.asarray(0, jnp.int32))


def _with(c: Carry, **changes) -> Carry:
    """The carry with changes in the mover's part."""
    return c._replace(own=c.own._replace(**changes))


def _choose(condition, yes, no):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


