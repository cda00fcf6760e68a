"""How a tangent moves under a field and its guards: advance or reject; locate and land.

A trial step of the state alone decides what happens; the tangent is carried for steps that are kept. To locate
an event nothing is advanced: the next trial starts from the same base and ends at the estimated root, so the
event found is a root along the numerical flow itself, to rounding.
"""

import dataclasses
import functools
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from .._jaxprs import is_affine, is_timeless
from ..columns import each_column
from ..daes import is_constrained, landed
from ..events import BLUR, Wiring, arm, by_mode, jets, rates, rounding
from ..precision import digits, eps, nonzero
from ..propagation import Carry, Clock, ErrorWatch, Settings, added, stop
from ..reverse_mode import checkpointed
from ..statuses import STATUS
from ..waiting import EVER, FAR
from .base import Field, Method, Step
from .landing import land
from .trials import (
    ADVANCE,
    FAIL,
    FIRST,
    LAND,
    LOCATE,
    NONE,
    PROBE,
    REJECT,
    Aim,
    Memory,
    Stepper,
    Trial,
    changed,
    finds,
    firing,
    grazes,
    next_aim,
    no_aim,
    pending,
    resolve,
    stays,
    suspects,
    table,
)

__all__ = ["Stepping", "are_curved", "are_timeless", "landing_of"]

NEAR_CONSTRAINTS = 1e-6  # a start is consistent up to this, relative to 1 + |x|
DRIFT = 1e-5  # the same for the ends of blocks
NEARLY_STILL = 100.0  # tolerances within which a state does not move


class Carried(NamedTuple):
    """What a step does to the frame."""

    x: Any = None  # (n,) its end, where no trial has found it before
    frame: Any = None  # (n, k)
    ratio: Any = None  # the frame's error over what is allowed
    flux: Any = None  # ∫ tr Df
    growth: Any = None  # (k,) `Tangent.growth`
    errors: Any = None  # (estimates, n, k) `Tangent.errors`, for a watch that looks at them


@dataclasses.dataclass(frozen=True)
class Stepping:
    """The mover of flows and hybrid systems."""

    wiring: Wiring
    method: Method
    clock_times: tuple[tuple[Any, Any], ...]  # (period, phase)
    terminal: tuple[bool, ...]
    max_cascade: int
    curved: bool  # Df depends on x in some mode
    just_fired: int | None = None  # the transition that has brought the state to where it starts
    per_jump: bool = False  # jumps may end a block: they are counted where time stands still, too
    timeless: bool = False  # fields and guards are seen not to depend on the time; asked where jumps end blocks

    by_rows: ClassVar[bool] = False
    longest_interval: ClassVar[float] = 20.0
    spread_wanted: ClassVar[float] = 4.0

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
    def may_not_flow(self) -> bool:
        """Whether a jump may come next without a flow: see `Memory.pending`."""
        return self.has_events and (self.per_jump or self.wiring.borders is not None)

    @property
    def always_common(self) -> bool:
        """Whether nothing rare can happen: a plain flow with a fixed step."""
        return not self.has_events and not self.rejects

    @property
    def rejects(self) -> bool:
        """Whether a trial can fail."""
        return self.method.adaptive

    @property
    def revisits(self) -> bool:
        """Whether a tangent is taken at the points that its trial went through, instead of going there again."""
        solved = any(self.method.solves(field) for field in self.wiring.fields)
        return (solved or self.curved) and not self.always_common and self.method.way_points > 0

    def in_each_mode(self) -> tuple["Stepping", ...]:
        """The movers of the innermost loop, one for each mode: only events change it, and they come further out.

        No step then asks for the mode. Where lanes go together, on a GPU, the loops would run one after the other.
        """
        if self.wiring.modes == 1 or jax.default_backend() != "cpu":
            return (self,)
        return tuple(dataclasses.replace(self, wiring=self.wiring.of_mode(q)) for q in range(self.wiring.modes))

    def which_shape(self, t, x):
        """What an event log stores as `which`."""
        del t, x
        return jax.ShapeDtypeStruct((), jnp.int32)

    # --- the beginning ---------------------------------------------------------------------------------------

    def initial_mode(self, t, x):
        """The mode to which a state belongs; negative where none can go on from it."""
        of_state = self.wiring.initial_mode
        assert of_state is not None, "runs.prepare asks for a mode where the system knows none"
        return jnp.asarray(of_state(t, x)).astype(jnp.int32)

    def velocity(self, t, x, own: Stepper):
        """The field (n,) of the present mode."""
        return by_mode(own.mode, self.wiring.fields, t, x)

    def onto_mode(self, mode, t, x):
        """The projection onto the tangent space of a mode; None where no mode has one."""
        w = self.wiring
        if all(project is None for project in w.projections):
            return None
        given = [project or (lambda t, x, dx: dx) for project in w.projections]
        return lambda dx: by_mode(mode, [lambda dx, p=p: p(t, x, dx) for p in given], dx)

    def kept_to_constraints(self, c: Carry, clock: Clock) -> Carry:
        """The frame, where the method lets it leave the tangent space of the constraints: there it would not decay."""
        if self.method.keeps_constraints or not self.wiring.constrained:
            return c
        project = self.onto_mode(c.own.mode, clock.base + c.s, c.x)
        assert project is not None, "constraints have a projection"
        return c._replace(frame=each_column(project, c.frame))

    def onto_constraints(self, mode, t, x):
        """The point with the same content that lies on the constraints of a mode."""
        return by_mode(mode, [landing_of(field) for field in self.wiring.fields], t, x)

    def admitted(self, t, x, mode):
        """A start, put onto the constraints of its mode; and whether it was too far from them."""
        if not self.wiring.constrained:
            return x, False
        new = self.onto_constraints(mode, t, x)
        wrong = ~(jnp.max(jnp.abs(new - x) / (1 + jnp.abs(x))) <= NEAR_CONSTRAINTS)
        return jnp.where(wrong, x, new), wrong

    def inspected(self, c: Carry, clock: Clock) -> Carry:
        """At the end of a block: whether the motion has left the constraints, or run into a singular point."""
        if not self.wiring.constrained:
            return c

        def of_mode(field):
            if not is_constrained(field):
                return lambda t, x: (jnp.zeros_like(t), jnp.asarray(False))
            dae, args = field.field, field.args
            return lambda t, x: (dae.distance(t, x, args), dae.is_singular(t, x, args))

        mode = None if self.wiring.modes == 1 else c.own.mode
        off, singular = by_mode(mode, [of_mode(field) for field in self.wiring.fields], clock.base + c.s, c.x)
        # What ended for want of a step did so because of the singular point.
        ended = (c.status == STATUS.step_underflow) | (c.status == STATUS.nonfinite)
        singular = singular & jnp.all(jnp.isfinite(c.x))
        c = c._replace(status=jnp.where(ended & singular, jnp.asarray(STATUS.singular_dae, jnp.int32), c.status))
        c = stop(c, STATUS.singular_dae, singular)
        return stop(c, STATUS.constraint_drift, off > DRIFT)

    def begin(self, t, x, mode, h) -> Stepper:
        """The mover's part of the carry at (t, x)."""
        if self.always_common:
            return Stepper(*(None,) * 10)
        w, mode = self.wiring, jnp.asarray(mode, jnp.int32)
        f = by_mode(mode, w.fields, t, x)
        h = self._first_step(x, f) if h is None else h
        state = Stepper(f, h, jnp.zeros_like(h), mode if w.modes > 1 else None, *(None,) * 6)
        if not self.has_events:
            return state
        g, rate, second, blur = by_mode(mode, [_jets_of(w, q) for q in range(w.modes)], t, x)
        fired = jnp.zeros(w.slots, bool)
        if self.just_fired is not None:
            fired = table(self, state.mode, w.transition == self.just_fired)
        side, g, rate, _ = arm(g, rate, second, blur, h, t, fired)
        # On a guard and about to go through it: it has not fired yet, and does so at once.
        side = jnp.where(table(self, state.mode, w.directed) & (g == 0) & (side < 0) & ~fired, 1.0, side)
        ticks = [jnp.floor((t - phase) / period + digits(1e-9, t)) + 1 for period, phase in self.clock_times]
        zero, one = jnp.zeros_like(t), jnp.ones_like(t)
        memory = Memory(zero, zero, zero, zero, one * jnp.inf, zero, zero, one * jnp.nan, -one, zero, zero)
        if w.borders is not None:
            outside = jnp.any(table(self, state.mode, w.borders) & (side < 0))
            memory = memory._replace(pending=jnp.where(outside, FIRST, zero))
        return Stepper(
            f,
            h,
            state.log_ratio,
            state.mode,
            g,
            rate,
            side,
            blur,
            jnp.stack(ticks) if ticks else None,
            jnp.stack(memory),
        )

    def _first_step(self, x, f):
        if not self.method.adaptive:
            return jnp.asarray(self.method.fixed_step, x.dtype)
        scale = self.method.atol + self.method.rtol * jnp.abs(x)
        size, speed = jnp.sqrt(jnp.mean((x / scale) ** 2)), jnp.sqrt(jnp.mean((f / scale) ** 2))
        # A state at rest is moved by rounding alone: that says nothing, and guards are judged on the scale of a step.
        usual = jnp.minimum(0.01 * size / jnp.maximum(speed, nonzero(1e-300, x)), 1.0)
        return self._bounded(jax.lax.stop_gradient(jnp.where((size > 1e-5) & (speed > 1e-5), usual, 1e-6)))

    def _bounded(self, h):
        """No step is longer than the method allows."""
        longest = self.method.longest_step
        return h if longest is None else jnp.minimum(h, longest)

    @property
    def by_fixed_steps(self) -> bool:
        """Whether all steps are of one length."""
        return not self.rejects

    def rests(self, c: Carry, clock: Clock, x):
        """Whether the state has stayed at x, off all guards; and whether it leaves for ever, in steps without bound."""
        own, no = c.own, jnp.asarray(False)
        if not self.timeless:
            return no, no
        allowed = digits(BLUR, x) * jnp.abs(x)
        apart = own.blur
        if self.rejects:  # near an attracting equilibrium steps are as long as the tolerances allow
            atol, rtol = self.method.atol, self.method.rtol
            allowed = NEARLY_STILL * (atol + rtol * jnp.abs(x))
            apart = NEARLY_STILL * (atol + rtol * own.blur / digits(BLUR, x))
        still = jnp.all(jnp.abs(c.x - x) <= allowed)
        off = jnp.all(~firing(self, own) | (jnp.abs(own.g) > NEARLY_STILL * apart))
        longest = own.memory[Memory._fields.index("longest")]
        leaves = own.h > jnp.where(longest > 0, FAR * longest, EVER)
        return still & off, leaves if self.rejects else no

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
        way = self.method.blank_way(c.x) if self.revisits and c.frame.shape[1] else ()
        return Trial(none, h, c.x, c.own.f, ratio, jnp.asarray(False), zeros, zeros, miss, tick, way)

    def look(self, c: Carry, clock: Clock, aim: Aim | None = None):
        """A trial step of the state, and the case that it makes; a plain fixed-step flow needs none."""
        own, t, w = c.own, clock.base + c.s, self.wiring
        if self.always_common:
            return ()
        h, final, tick = self._length(c, clock, aim)

        def trial(q):
            def of_mode(t, x, f, h):
                step = self._alike(self.method.step(w.fields[q], t, x, f, h), x)
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
        way = step.way if self.revisits and c.frame.shape[1] else ()
        f = step.f if self.has_events or self.method.takes_slope else own.f  # what nobody needs is not computed
        tr = Trial(None, h, step.x, f, ratio, final, g, rate, None, tick, way)
        return self._judge(c, clock, tr, slope, aim)

    def _alike(self, step: Step, x) -> Step:
        """What is kept of the way takes the same room in all modes."""
        if not (self.has_events and self.revisits):
            return step

        def fit(given, room):
            return jnp.pad(given, [(0, wide - narrow) for narrow, wide in zip(given.shape, room.shape, strict=True)])

        return step._replace(way=jax.tree.map(fit, step.way, self.method.blank_way(x)))

    def common(self, ahead):
        """Rejecting and advancing are common."""
        return True if self.always_common else ahead.case <= ADVANCE

    def _length(self, c: Carry, clock: Clock, aim: Aim | None):
        """How long the next trial is: the controller's step, cut at the block's end, a tick, a root."""
        own, rest = c.own, clock.length - c.s
        h, _ = self._cut(rest, jax.lax.stop_gradient(own.h))
        tick: Any = None
        final = rest <= h
        if own.ticks is not None:
            until = self._until_ticks(own, c.s, clock)
            first = jnp.argmin(until)
            ticks = until[first] <= h * (1 + digits(1e-9, h))
            h, tick = jnp.where(ticks, until[first], h), jnp.where(ticks, first.astype(jnp.int32), -1)
            final = final & ~ticks
        if aim is not None:
            cut = aim.h < h
            h, final = jnp.where(cut, aim.h, h), final & ~cut
            tick = None if tick is None else jnp.where(cut, -1, tick)
        if self.may_not_flow:
            at_once = pending(own) > 0
            h, final = jnp.where(at_once, 0.0, h), final & ~at_once
            tick = None if tick is None else jnp.where(at_once, -1, tick)
        return h, final, tick

    @staticmethod
    def _cut(rest, h):
        """A step of h, or all that is left where this is hardly more (h alone, times a constant, would be hoisted)."""
        last = rest * (1 - digits(1e-9, rest)) <= h
        return jnp.where(last, rest, h), last

    def _until_ticks(self, own: Stepper, s, clock: Clock):
        """Time to the next tick of each clock; inf where the mode does not listen to it."""
        times = [
            (phase + period * own.ticks[i] - clock.base) - clock.rest - s
            for i, (period, phase) in enumerate(self.clock_times)
        ]
        return jnp.where(table(self, own.mode, self.wiring.armed), jnp.maximum(jnp.stack(times), 0.0), jnp.inf)

    def _judge(self, c: Carry, clock: Clock, tr: Trial, slope, aim: Aim | None) -> Trial:
        """The case that a trial makes."""
        own, ratio = c.own, tr.ratio
        event, lands = jnp.asarray(False), jnp.asarray(False)
        if self.has_events:
            tr = resolve(self, own, tr, slope)
            ratio = tr.ratio
            if aim is None:
                event = suspects(self, own, tr)
            else:
                event, lands = finds(self, own, tr, aim)
                if self.rejects:  # a shorter piece of a step that has passed passes too
                    ratio = jnp.where((aim.slot >= 0) & jnp.isfinite(ratio), 0.0, ratio)
            if tr.tick is not None:
                lands = lands | ((tr.tick >= 0) & ~event)
        case = jnp.where(lands, LAND, jnp.where(event, LOCATE, ADVANCE))
        # An infinite or undefined state spoils the estimate; without an estimate the state itself is asked.
        passed = ratio <= 1.0 if self.rejects else jnp.all(jnp.isfinite(tr.x))
        failed = (tr.h > 0) & (tr.h <= self._least_step(c, clock)) if self.rejects else True
        case = jnp.where(passed, case, jnp.where(failed, FAIL, REJECT))
        if self.may_not_flow:
            case = jnp.where(pending(own) > 0, LAND, case)
        return tr._replace(case=case.astype(jnp.int32), ratio=ratio)

    def _least_step(self, c: Carry, clock: Clock):
        """A step below the resolution of time goes nowhere."""
        length = jnp.where(jnp.isfinite(clock.length), clock.length, 0.0)
        return 1e-3 * eps(length) * jnp.maximum(jnp.abs(clock.base + c.s), length) + nonzero(1e-150, length)

    # --- advance ---------------------------------------------------------------------------------------------

    def landed(self, c: Carry, clock: Clock, tr: Trial) -> Carried:
        """What a trial that ends at an event does to the frame."""
        if not c.frame.shape[1]:
            return Carried(frame=c.frame)
        return self.carried(c, clock, tr.h, c.own.mode, tr.way, self.method.rare_tangent)

    def carried(self, c: Carry, clock: Clock, h, mode, way=(), of_method=None, with_errors: bool = False) -> Carried:
        """What a step over h does to the frame."""
        of_method = of_method or self.method.tangent
        t, w = clock.base + c.s, self.wiring

        def tangent(q):
            def of_mode(t, x, frame, h, way):
                field = w.fields[q]
                new, moved, errors, nodes, growth = of_method(field, t, x, h, frame, way)
                if self.rejects and self.method.control == "xY":
                    ratio = jax.lax.stop_gradient(self.method.frame_ratio(errors, frame, moved))
                else:
                    ratio = jnp.zeros_like(h)
                flux = self.method.divergence(field, nodes, h) if c.volume is not None else None
                return Carried(new, moved, ratio, flux, growth, errors if with_errors else None)

            return of_mode

        return by_mode(mode, [tangent(q) for q in range(w.modes)], t, c.x, c.frame, h, way)

    def commit(self, settings: Settings, c: Carry, h, x, kept: Carried) -> Carry:
        """The carry after a step that is kept."""
        since = c.since + {"steps": 1.0, "time": h, "jumps": 0.0, "never": 0.0}[settings.cadence.unit]
        c = c._replace(x=x, frame=kept.frame, since=since)
        if kept.errors is not None:
            c = c._replace(watch=settings.watch.stepped(c.watch, kept.errors))
        return added(c, s=h, volume=kept.flux, growth=kept.growth)

    @staticmethod
    def _ended(c: Carry, clock: Clock, final) -> Carry:
        """At the end of the block, where a step was the last: not beside it by rounding."""
        return c._replace(s=jnp.where(final, clock.length, c.s))

    def step(self, settings: Settings, clock: Clock, c: Carry, tr) -> Carry:
        """Keep the trial and carry the frame; or, where an error is too large, only make h smaller."""
        if self.always_common:
            return self._march(settings, clock, c)
        own, ratio, along = c.own, tr.ratio, Carried(frame=c.frame)
        if c.frame.shape[1]:
            looks = self.rejects and isinstance(settings.watch, ErrorWatch)
            along = self.carried(c, clock, tr.h, own.mode, tr.way, with_errors=looks)
            ratio = jnp.maximum(ratio, along.ratio) if self.rejects else None
        kept = self._ended(self.commit(settings, c, tr.h, tr.x, along), clock, tr.final)
        kept = changed(kept, f=tr.f)
        if self.has_events:
            side, g = stays(self, own, tr)
            kept = changed(kept, g=g, rate=tr.rate, side=side)
        if not self.rejects:
            return kept
        # The frame's error may fail a step that the state's has passed.
        passed = jnp.asarray(ratio) <= 1.0
        kept = jax.tree.map(lambda a, b: a if a is b else jnp.where(passed, a, b), kept, c)
        h, log_ratio = self._next_h(own, tr, ratio, passed)
        kept = changed(kept, h=h, log_ratio=log_ratio)
        hopeless = ~passed & (tr.h <= self._least_step(c, clock))
        underflow = jnp.where(jnp.isfinite(jnp.asarray(ratio)), STATUS.step_underflow, STATUS.nonfinite)
        return stop(kept, underflow, hopeless)

    def _march(self, settings: Settings, clock: Clock, c: Carry) -> Carry:
        """A fixed step of a plain flow: no trial, no guard."""
        rest, step = clock.length - c.s, self.method.fixed_step
        h, last = self._cut(rest, step)
        along = self.carried(c, clock, h, None)
        return self._ended(self.commit(settings, c, h, along.x, along), clock, last)

    def _next_h(self, own: Stepper, tr: Trial, ratio, passed):
        """What the method's controller asks for, in the order in which its error estimate falls."""
        order, by = self.method.error_order, self.method.controller
        log_ratio = jnp.log(jnp.clip(ratio, 1e-10, 1e10))  # nan, from a state out of bounds, stays nan
        exponent = -(by.now / order) * log_ratio + (by.last / order) * own.log_ratio
        factor = jnp.clip(by.safety * jnp.exp(exponent), by.shrink, by.grow)
        smaller = jnp.maximum(by.safety * jnp.exp(-log_ratio / order), by.shrink)
        smaller = jnp.where(jnp.isfinite(ratio), jnp.minimum(smaller, by.safety), by.shrink)
        whole = tr.h >= 0.99 * own.h
        # A step that was cut at an event, a tick or the block's end says nothing against the controller's h.
        h = jnp.where(whole, tr.h * factor, jnp.maximum(own.h, tr.h * factor))
        h = self._bounded(jnp.where(passed, h, tr.h * smaller))
        return jax.lax.stop_gradient(h), jnp.where(whole & passed, log_ratio, own.log_ratio)

    # --- what is rare ----------------------------------------------------------------------------------------

    def settle(self, settings: Settings, clock: Clock, within, c: Carry, tr) -> tuple[Carry, Trial]:
        """Trials that are aimed at events and land on them, until a common one comes out; or the run's end."""

        def landed(c, tr, aim):
            return land(self, settings, clock, c, tr), no_aim(tr.h)

        def aim_at(c, tr, aim):
            return c, next_aim(self, c.own, tr, aim)

        def neither(c, tr, aim):
            return self._fail(c, tr), no_aim(tr.h)

        def again(state):
            c, tr, aim = state
            # An event is not left half located; after a landing the host may have a look.
            c = c._replace(budget=jnp.maximum(c.budget - 1, jnp.where(tr.case == LAND, 0, 1)))
            which = jnp.where(tr.case == LOCATE, 0, jnp.where(tr.case == LAND, 1, 2))
            c, aim = jax.lax.switch(which, [aim_at, landed, neither], c, tr, aim)
            tr = self.look(c, clock, aim)
            assert isinstance(tr, Trial), "a plain flow does not come here"
            seen = Memory._fields.index("grazing")
            memory = c.own.memory.at[seen].max(grazes(self, c.own, tr, aim).astype(c.x.dtype))
            return changed(c, memory=memory), tr, aim

        if self.always_common:
            return c, tr
        if not self.has_events:
            return jax.lax.cond(tr.case == FAIL, self._fail, lambda c, tr: c, c, tr), tr
        loop = checkpointed if settings.reverse else jax.lax.while_loop
        c, tr, _ = loop(lambda state: within(state[0]) & ~self.common(state[1]), again, (c, tr, no_aim(tr.h)))
        return c, tr

    def _fail(self, c: Carry, tr: Trial) -> Carry:
        """No step can be made: because the state is not finite, or because it would be too small."""
        status = jnp.where(self._finite(tr), STATUS.step_underflow, STATUS.nonfinite)
        return stop(c, status, tr.case == FAIL)

    def _finite(self, tr: Trial):
        finite = jnp.all(jnp.isfinite(tr.x))
        return finite if tr.ratio is None else finite & jnp.isfinite(tr.ratio)


def landing_of(field: Field):
    """(t, x) -> the point with the same content on the constraints of a field; x where it has none."""
    if not is_constrained(field):
        return lambda t, x: x
    return lambda t, x: landed(field.field, field.args, t, x)


def are_curved(fields: Iterable[Field], t, x) -> bool:
    """Whether Df depends on x for one of the fields; where that is not seen, it is taken to."""
    return not all(is_affine(functools.partial(field, t), x) for field in fields)


def are_timeless(w: Wiring, t, x) -> bool:
    """Whether time plays no part in the fields, the guards and the instants of jumps."""
    return not w.clocks and all(is_timeless(one, t, x) for one in (*w.fields, *w.guards))


def _jets_of(w: Wiring, q: int):
    return lambda t, x: (*jets(w.guards[q], w.fields[q], t, x), rounding(w.guards[q], t, x))
