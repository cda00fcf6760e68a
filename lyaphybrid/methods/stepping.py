"""How a tangent moves under a field and its guards: reject, advance, locate, land.

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

SAFETY, SHRINK, GROW = 0.85, 0.2, 10.0  # of the PI controller
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
    target: Array | None  # (3,) length of the next trial, where the guard is known to be beyond, relocations
    pending: Array | None  # the slot whose root the next trial aims at; -1: none
    ticks: Array | None  # (clocks,) number of the next tick
    memory: Array | None


class Trial(NamedTuple):
    """One trial step of the state, and what it says about the guards."""

    h: Array
    x: Array
    f: Array
    dense: Any
    ratio: Any
    final: Any  # ends the block
    g: Any = None
    rate: Any = None
    crossed: Any = None
    turn: Any = None  # (slots,) a guard turns towards zero and may be beyond it there
    theta: Any = None  # where
    tick: Any = None  # the clock that ticks at the end of the step; -1: none
    lands: Any = None  # (slots,) guards whose root is here


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
        return self.guarded or bool(self.wiring.clocks)

    @property
    def loses_rank_between_events(self) -> bool:
        """A flow never does."""
        return False

    @property
    def guarded(self) -> bool:
        """Whether there are transitions at all (a plain flow has none)."""
        return bool(self.wiring.resets)

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
        trial = self.guarded or self.rejects
        if not trial:
            return Stepper(*(None,) * 11)
        w, mode = self.wiring, jnp.asarray(mode, jnp.int32)
        f = by_mode(mode, w.fields, t, x)
        h = self._first_step(x, f) if h is None else h
        state = Stepper(f, h, jnp.zeros_like(h), mode if w.modes > 1 else None, *(None,) * 7)
        if not self.guarded:
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
            jnp.stack([one * jnp.inf, one * jnp.inf, zero]),
            jnp.asarray(-1, jnp.int32),
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

    # --- one attempt -----------------------------------------------------------------------------------------

    def branches(self, settings: Settings, clock: Clock):
        """The cases of an attempt; a plain flow with a fixed step has only one."""
        if not (self.guarded or self.rejects):
            return [lambda c, _: self._march(settings, clock, c)]
        cases = [
            lambda c, tr: self._reject(clock, c, tr),
            lambda c, tr: self._advance(settings, clock, c, tr),
        ]
        if self.guarded:
            cases += [
                lambda c, tr: self._locate(c, tr),
                lambda c, tr: self._land(settings, clock, c, tr),
            ]
        return cases

    def attempt(self, c: Carry, clock: Clock):
        """A trial step of the state, and the case that it makes."""
        own, t = c.own, clock.base + c.s
        h, final, tick = self._length(c, clock)
        w = self.wiring

        def trial(q):
            def of_mode(t, x, f, h):
                step = self.method.step(w.fields[q], t, x, f, h)
                ratio = self.method.state_ratio(step, x) if self.rejects else jnp.zeros_like(h)
                if not self.guarded:
                    return step, ratio, None, None, None
                g, rate = rates(w.guards[q], t + h, step.x, step.f)
                probe = self.method.inside(step.dense, PROBE)
                at = t + PROBE * h
                _, slope = rates(w.guards[q], at, probe, w.fields[q](at, probe))
                return step, ratio, g, rate, slope

            return of_mode

        step, ratio, g, rate, slope = by_mode(
            own.mode, [trial(q) for q in range(w.modes)], t, c.x, own.f, h
        )
        ratio = jax.lax.stop_gradient(ratio)
        tr = Trial(h, step.x, step.f, step.dense, ratio, final)
        if not self.guarded:
            return jnp.where(ratio <= 1.0, 1, 0), tr
        return self._inspect(own, tr._replace(g=g, rate=rate, tick=tick), slope)

    def _length(self, c: Carry, clock: Clock):
        """How long the next trial is: the controller's step, cut at the block's end, a root, a tick."""
        own, rest = c.own, clock.length - c.s
        h = jax.lax.stop_gradient(own.h)
        tick = jnp.asarray(-1, jnp.int32) if self.guarded else None
        final = rest <= h * (1 + 1e-9)
        h = jnp.where(final, rest, h)
        if own.ticks is not None:
            until = self._until_ticks(own, c.s, clock)
            first = jnp.argmin(until)
            ticks = until[first] <= h * (1 + 1e-9)
            h, tick = jnp.where(ticks, until[first], h), jnp.where(ticks, first.astype(jnp.int32), tick)
            final = final & ~ticks
        if self.guarded:
            cut = own.target[0] < h
            h, tick, final = jnp.where(cut, own.target[0], h), jnp.where(cut, -1, tick), final & ~cut
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

    def _inspect(self, own: Stepper, tr: Trial, slope):
        """What the guards did during the trial, and the case that follows."""
        h = tr.h
        directed = self._table(own.mode, self.wiring.directed)
        fires = (own.side > 0) | (~directed & (own.side != 0))
        crossed = fires & (own.side * tr.g <= 0)
        d0, d1 = h * own.rate, h * tr.rate
        # The cubic errs like θ²(1-θ)²; its slope errs most at the probe, 3.08 times its error in the middle.
        miss = jnp.abs(h * slope - cubic(PROBE, own.g, d0, tr.g, d1)[1]) / 3.0792
        size = jnp.abs(own.g) + jnp.abs(tr.g) + 0.25 * (jnp.abs(d0) + jnp.abs(d1))
        ratio = tr.ratio
        if self.rejects:
            floor = 1e3 * self.method.atol
            ratio = jnp.maximum(ratio, jnp.max(miss / (GUARD_RESOLUTION * size + floor)))
        # A guard that turns back inside the step: cut the step there if it may have been beyond zero.
        turns = (d0 * d1 < 0) & (own.side * d0 < 0) & (own.side * tr.g > 0)
        theta = turning_point(own.g, d0, tr.g, d1)
        extreme, _ = cubic(theta, own.g, d0, tr.g, d1)
        drop = jnp.minimum(jnp.abs(own.g - extreme), jnp.abs(tr.g - extreme))
        doubt = 0.2 * drop + 64.0 * (theta * (1 - theta)) ** 2 * miss
        turn = turns & (own.side * extreme <= doubt) & (theta > 1e-9) & (theta < 1 - 1e-9)
        # Where the next root is, counted from the end of the trial, for guards that cross or are about to.
        ahead = -tr.g / jnp.where(tr.rate == 0, 1e-300, tr.rate)
        near = NEAR * own.h
        aimed = jnp.arange(self.wiring.slots) == own.pending
        close = fires & (own.side * tr.rate < 0) & (jnp.abs(ahead) <= near)
        far = (crossed & ~close) | turn
        given_up = own.target[2] > PATIENCE
        aiming = own.pending >= 0
        lands = jnp.where(aiming | jnp.any(crossed), close, False) | (given_up & (crossed | aimed))
        event = jnp.any(crossed) | aiming | jnp.any(turn)
        land = jnp.any(lands) & (~jnp.any(far) | given_up)
        ticking = (tr.tick >= 0) & ~event
        finite = jnp.all(jnp.isfinite(tr.x)) & jnp.all(jnp.isfinite(tr.g))
        passed = (ratio <= 1.0) | (aiming & finite)
        passed = passed & finite if not self.rejects else passed
        case = jnp.where(land | ticking, 3, jnp.where(event & ~(given_up & ~jnp.any(crossed)), 2, 1))
        case = jnp.where(passed, case, 0)
        return case, tr._replace(ratio=ratio, crossed=crossed, turn=turn, theta=theta, lands=lands)

    def _table(self, mode, table: np.ndarray):
        return jnp.asarray(table[0]) if mode is None else jnp.asarray(table)[mode]

    # --- reject ----------------------------------------------------------------------------------------------

    def _reject(self, clock: Clock, c: Carry, tr: Trial) -> Carry:
        """Too large an error: the same step again, smaller."""
        finite = jnp.isfinite(tr.ratio) & jnp.all(jnp.isfinite(tr.x))
        factor = jnp.clip(SAFETY * jnp.where(finite, tr.ratio, 1e9) ** (-1.0 / self._order), SHRINK, SAFETY)
        h = jax.lax.stop_gradient(tr.h) * factor if self.rejects else c.own.h
        c = _with(c, h=h, **self._no_target(c.own))
        # A step below the resolution of time goes nowhere; 1e-300 is the limit for an autonomous system at t=0.
        t = jnp.abs(clock.base + c.s)
        under = (h <= 4 * EPS * t * 1e-3) | (h < 1e-200) if self.rejects else jnp.asarray(True)
        under = under | (~finite & (h <= 1e-14 * (1 + t)))
        return stop(c, jnp.where(finite & self.rejects, STATUS.step_underflow, STATUS.nonfinite), under)

    @property
    def _order(self) -> int:
        return self.method.error_order

    def _no_target(self, own: Stepper):
        """Aim at nothing."""
        if own.target is None:
            return {}
        clear = jnp.asarray([np.inf, np.inf, 0.0], own.target.dtype)
        return {"target": clear, "pending": jnp.full_like(own.pending, -1)}

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

    def _march(self, settings: Settings, clock: Clock, c: Carry) -> Carry:
        """A fixed step of a plain flow: no trial, no guard."""
        rest, dt = clock.length - c.s, self.method.dt
        final = rest <= dt * (1 + 1e-9)
        h = jnp.where(final, rest, dt)
        new, frame, _, flux = self._carried(c, clock, h, None)
        c = self._commit(settings, c, jnp.where(final, clock.length, c.s + h), h, new, frame, flux)
        return c

    def _commit(self, settings: Settings, c: Carry, s, h, x, frame, flux) -> Carry:
        since = c.since + {"steps": 1.0, "time": h, "jumps": 0.0, "never": 0.0}[settings.cadence.unit]
        volume = c.volume if flux is None else c.volume + flux
        return c._replace(s=s, x=x, frame=frame, since=since, volume=volume)

    def _advance(self, settings: Settings, clock: Clock, c: Carry, tr: Trial) -> Carry:
        """No guard was crossed: keep the step, carry the frame, choose the next h."""
        own, ratio, frame, flux = c.own, tr.ratio, c.frame, None
        if frame.shape[1]:
            _, frame, frame_ratio, flux = self._carried(c, clock, tr.h, own.mode)
            ratio = jnp.maximum(ratio, frame_ratio)
        moved = _with(c, f=tr.f, **self._no_target(own))
        if self.rejects:
            h, log_ratio = self._next_h(own, tr, ratio)
            moved = _with(moved, h=h, log_ratio=log_ratio)
        moved = self._commit(settings, moved, jnp.where(tr.final, clock.length, c.s + tr.h), tr.h, tr.x, frame, flux)
        if self.guarded:
            side = jnp.where(tr.g == 0, own.side, jnp.sign(tr.g))
            moved = _with(moved, g=tr.g, rate=tr.rate, side=side)
        if not self.rejects:
            return moved
        # The frame's error may still fail the step.
        failed = self._reject(clock, c, tr._replace(ratio=ratio))
        return jax.lax.cond(ratio <= 1.0, lambda a, b: a, lambda a, b: b, moved, failed)

    def _next_h(self, own: Stepper, tr: Trial, ratio):
        """PI control (Gustafsson; Hairer & Wanner, Solving ODEs II, section IV.2): 0.7/p and 0.4/p."""
        log_ratio = jnp.log(jnp.maximum(ratio, 1e-10))
        exponent = -(0.7 / self._order) * log_ratio + (0.4 / self._order) * own.log_ratio
        factor = jnp.clip(SAFETY * jnp.exp(exponent), SHRINK, GROW)
        whole = tr.h >= 0.99 * own.h
        # A step that was cut at an event, a tick or the block's end says nothing against the controller's h.
        h = jnp.where(whole, tr.h * factor, jnp.maximum(own.h, tr.h * factor))
        return jax.lax.stop_gradient(h), jnp.where(whole, log_ratio, own.log_ratio)

    # --- locate ----------------------------------------------------------------------------------------------

    def _locate(self, c: Carry, tr: Trial) -> Carry:
        """A guard was crossed, or may have been: the next trial ends at the earliest root or turning point."""
        own, h = c.own, tr.h
        d0, d1 = h * own.rate, h * tr.rate
        # A guard that starts at zero first leaves it: its root lies beyond the extremum between.
        leaves = own.g == 0
        lo = jnp.where(leaves & (d0 * d1 < 0), turning_point(own.g, d0, tr.g, d1), 0.0)
        roots = jnp.where(tr.crossed, h * hermite_root(lo, own.g, d0, tr.g, d1), jnp.inf)
        slot = jnp.argmin(roots)
        cut = jnp.min(jnp.where(tr.turn, h * tr.theta, jnp.inf))
        # An undershoot of the slot aimed at: one Newton step, kept below where the guard is known to be beyond.
        aimed = jnp.maximum(own.pending, 0)
        ahead = h - tr.g[aimed] / jnp.where(tr.rate[aimed] == 0, 1e-300, tr.rate[aimed])
        inside = (ahead > h) & (ahead < own.target[1])
        ahead = jnp.where(inside, ahead, 0.5 * (h + own.target[1]))
        undershot = (own.pending >= 0) & ~jnp.any(tr.crossed)
        root = jnp.where(undershot, ahead, roots[slot])
        slot = jnp.where(undershot, aimed, slot).astype(jnp.int32)
        beyond = jnp.where(undershot, own.target[1], h)
        # Newton's method from the end of the step may be closer than the cubic, but bisect when it stagnates.
        root = jnp.where((own.target[2] > 10) & ~undershot, 0.5 * (root + h), root)
        target = jnp.stack([jnp.minimum(root, cut), beyond, own.target[2] + 1])
        return _with(c, target=jax.lax.stop_gradient(target), pending=jnp.where(cut < root, -1, slot))

    # --- land ------------------------------------------------------------------------------------------------

    def _land(self, settings: Settings, clock: Clock, c: Carry, tr: Trial) -> Carry:
        """The trial ends at an event: polish, cross, orthonormalise at once, re-arm the guards."""
        own, w = c.own, self.wiring
        mode = jnp.asarray(0, jnp.int32) if own.mode is None else own.mode
        frame, flux = c.frame, None
        if frame.shape[1]:
            _, frame, _, flux = self._carried(c, clock, tr.h, own.mode)
        c = self._commit(settings, c, c.s + tr.h, tr.h, tr.x, frame, flux)
        ticking = ~jnp.any(tr.lands)
        ahead = jnp.where(tr.lands, -tr.g / jnp.where(tr.rate == 0, 1e-300, tr.rate), jnp.inf)
        slot = jnp.argmin(ahead).astype(jnp.int32)
        c = self._polish(clock, c, slot, ticking)
        t = clock.base + c.s
        c = harvest(settings, c, lambda v: v, t, 0.0) if self._orthonormalises(settings, c) else c
        # Which transition: the first of those at this instant whose `when` says yes.
        together = tr.lands & (ahead <= ahead[slot] + SAME * (own.h + jnp.abs(t)))
        allowed = together & by_mode(mode, w.whens, t, c.x) if w.shared else together
        blocked = ~ticking & ~jnp.any(allowed)
        slot = jnp.argmax(allowed).astype(jnp.int32)
        transition = self._table(own.mode, w.transition)[slot]
        which = self._table(own.mode, w.component)[slot]
        if w.clocks:
            clocks = jnp.asarray(w.clocks, jnp.int32)
            transition = jnp.where(ticking, clocks[jnp.maximum(tr.tick, 0)], transition)
            which = jnp.where(ticking, 0, which)
        crossed = self._cross(settings, clock, c, mode, transition, which, jnp.where(ticking, -1, slot), allowed)
        crossed = self._keep_clocks(clock, crossed, tr, ticking)
        return _choose(blocked, stop(c, STATUS.deadlock), crossed)

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
        columns = c.frame
        if settings.sum_rule:  # n more columns, the identity: they come out as the saltation matrix
            columns = jnp.concatenate([columns, jnp.eye(c.x.shape[0], dtype=c.x.dtype)], axis=1)
        landing = self._cascade(t, h, c.x, columns, mode, transition, which, slot, together, c.log)
        if self.wiring.slots > 1:
            landing = self._compare_orders(t, h, c, columns, mode, transition, slot, together, landing)
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
        c = _with(c, mode=None if c.own.mode is None else landing.mode, **arrival, **self._no_target(c.own))
        if self._orthonormalises(settings, c):
            c = harvest(settings, c, self._projection(landing.mode, t, landing.x), t, frames.LOST)
        c = self._remember(c, landing, clock)
        c = stop(c, STATUS.terminated, landing.terminal)
        c = stop(c, STATUS.deadlock, landing.stuck)
        finite = jnp.all(jnp.isfinite(c.x)) & jnp.all(jnp.isfinite(c.frame))
        c = stop(c, STATUS.nonfinite, ~finite)
        return stop(c, STATUS.zeno, landing.count > self.max_cascade)

    def _projection(self, mode, t, x):
        projections = [lambda dx, p=p: p(t, x, dx) for p in self.wiring.projections]
        return lambda dx: by_mode(mode, projections, dx)

    def _cascade(self, t, h, x, columns, mode, transition, which, slot, together, log) -> "Landing":
        """The reset of the located event, and of every guard on whose fired side it ends."""
        w, n = self.wiring, x.shape[0]
        f = by_mode(mode, w.fields, t, x)
        gradient, moving, rate = self._instant(mode, t, x, f, slot)
        columns, shift = advance_to_instant(columns, gradient, rate, f)
        shift = jnp.where(slot < 0, 0.0, shift)
        size = jnp.sqrt(jnp.sum(gradient**2) * jnp.sum(f**2) + 1e-300) + jnp.abs(moving)
        transverse = jnp.where(slot < 0, jnp.inf, jnp.abs(rate) / size)
        slots = jnp.zeros(w.slots, x.dtype)
        no = jnp.asarray(False)
        landing = Landing(
            x, columns, shift, mode, f, slots, slots, slots, transition, which, slot, jnp.asarray(0, jnp.int32),
            jnp.asarray(True), no, no, transverse, together, log,
        )

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
        del n
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

    def _compare_orders(self, t, h, c, columns, mode, transition, slot, together, landing: "Landing"):
        """Several guards at one instant: take them in the other order too; different results are a note."""
        other = jnp.argmax(together & (jnp.arange(self.wiring.slots) != slot)).astype(jnp.int32)
        second = self._table(c.own.mode, self.wiring.transition)[other]
        which = self._table(c.own.mode, self.wiring.component)[other]
        several = (jnp.sum(together) > 1) & (slot >= 0)

        def compare():
            swapped = self._cascade(t, h, c.x, columns, mode, second, which, other, together, None)
            gap = jnp.max(jnp.abs(swapped.columns - landing.columns), initial=0.0)
            gap = gap / (1.0 + jnp.max(jnp.abs(landing.columns), initial=0.0))
            apart = jnp.max(jnp.abs(swapped.x - landing.x)) / (1.0 + jnp.max(jnp.abs(landing.x)))
            return (gap > 1e-9) | (apart > 1e-9) | (swapped.mode != landing.mode)

        differs = jax.lax.cond(several, compare, lambda: jnp.asarray(False))
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
        note = landing.together if landing.together.ndim == 0 else jnp.asarray(False)
        memory = Memory(
            c.s,
            interval,
            longest,
            streak,
            jnp.minimum(m.transversality, landing.transversality),
            jnp.maximum(m.grazing, landing.transversality < GRAZING),
            jnp.maximum(m.simultaneous, note),
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


def _pusher(reset):
    def pushed(t, x, columns, shift, which):
        return push(lambda t, x: reset(t, x, which), t, x, columns, shift)

    return pushed


def _jets_of(w: Wiring, q: int):
    return lambda t, x: jets(w.guards[q], w.fields[q], t, x)


def _arrival(w: Wiring, q: int):
    return lambda t, x: (w.fields[q](t, x), *jets(w.guards[q], w.fields[q], t, x))


def _with(c: Carry, **changes) -> Carry:
    """The carry with changes in the mover's part."""
    return c._replace(own=c.own._replace(**changes))


def _choose(condition, yes, no):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


