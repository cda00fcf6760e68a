"""The evolver of flows and hybrid systems: advance or reject a step, locate an event and land on it.

A trial step of the state alone decides what happens; the tangent is computed only for accepted steps. While an event is
being located the state does not advance: each trial starts from the same point and ends at the estimated root, so the
event is a root along the numerical flow itself, up to rounding.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from ..._jax.jaxprs import is_affine, is_timeless
from ..._jax.precision import GUARD_ROUNDING, digits
from ..._jax.reverse_mode import checkpointed
from ...events.compiled_hybrid import CompiledHybrid, by_mode
from ...events.roots import arm, to_arm
from ...integrators.base import Field, Method, Step
from ...statuses import STATUS
from ..states import Clock, ErrorObserver, Settings, StepState, added, stop
from ..waiting import EVER, LONGEST_STEP
from .constraints import OnConstraints
from .grazing import nearly_crosses
from .landing import apply_event
from .step_sizes import cut_at_end, first_of, first_step, goes_nowhere, next_step, soonest_root, unresolved, until_ticks
from .trials import (
    ADVANCE,
    FAIL,
    FIRST,
    LAND,
    LOCATE,
    NONE,
    REJECT,
    Memory,
    RootBracket,
    SolverState,
    Trial,
    changed,
    finds,
    firing,
    hides,
    is_beyond,
    next_bracket,
    no_bracket,
    pending,
    resolve,
    stays,
    suspects,
    table,
    trial_in,
    waiting_at_start,
)

__all__ = ["Stepping", "are_nonlinear", "are_timeless"]

NEARLY_STILL = 100.0  # a state is at rest if it moves by less than this times the tolerance


class Carried(NamedTuple):
    """The frame after a step, and what else the tangent of the step gives."""

    x: Any = None  # (n,) the end of the step; None where a trial has computed it
    frame: Any = None  # (n, k)
    ratio: Any = None  # the frame's error over tolerance
    log_volume_change: Any = None  # ∫ tr Df dt
    growth: Any = None  # (k,) `Tangent.growth`
    errors: Any = None  # (estimates, n, k) `Tangent.errors`, for an `ErrorObserver`


@dataclasses.dataclass(frozen=True)
class Stepping(OnConstraints):
    """The evolver of flows and hybrid systems."""

    hybrid: CompiledHybrid
    method: Method
    clock_times: tuple[tuple[Any, Any], ...]  # (period, phase)
    terminal: tuple[bool, ...]
    max_cascade: int
    nonlinear: Callable[[], bool]  # whether Df depends on x in some mode
    just_fired: int | None = None  # the transition whose reset produced the initial state
    whole_instant: bool = False  # a terminal transition ends the run after the jumps that follow it at once
    per_jump: bool = False  # a number of jumps may end a block: jumps count even if no time passes
    timeless: bool = False  # fields and guards provably do not depend on the time; used where jumps end blocks

    longest_interval: ClassVar[float] = 20.0

    @property
    def may_lose_rank(self) -> bool:
        """Resets can destroy directions."""
        return self.has_events or bool(self.hybrid.clocks)

    @property
    def jumps_uncontrolled(self) -> bool:
        """False: every event is followed by an orthonormalisation of its own."""
        return False

    @property
    def has_events(self) -> bool:
        """Whether there are transitions (a plain flow has none)."""
        return bool(self.hybrid.resets)

    @property
    def may_not_flow(self) -> bool:
        """Whether the next jump may come without a flow before it, see `Memory.pending`."""
        return self.has_events and (self.per_jump or self.hybrid.borders is not None)

    @property
    def always_regular(self) -> bool:
        """Whether this is a plain flow with a fixed step: no events, no rejected steps."""
        return not self.has_events and not self.rejects

    @property
    def rejects(self) -> bool:
        """Whether a trial can be rejected."""
        return self.method.adaptive

    @property
    def revisits(self) -> bool:
        """Whether the tangent reuses the stage points of its trial instead of recomputing them."""
        solved = any(self.method.solves(field) for field in self.hybrid.fields)
        return not self.always_regular and self.method.stage_count > 0 and (solved or self.nonlinear())

    def in_each_mode(self) -> tuple["Stepping", ...]:
        """The evolvers for the innermost loop, one per mode: only events, handled further out, change the mode.

        So no step has to branch on the mode. On a GPU, where lanes run together, the loops would run one after another.
        """
        if self.hybrid.modes == 1 or jax.default_backend() != "cpu":
            return (self,)
        return tuple(dataclasses.replace(self, hybrid=self.hybrid.of_mode(q)) for q in range(self.hybrid.modes))

    def which_shape(self, t, x):
        """The label of an event is one integer, the component of a vector guard."""
        del t, x
        return jax.ShapeDtypeStruct((), jnp.int32)

    # --- the beginning ---------------------------------------------------------------------------------------

    def initial_mode(self, t, x):
        """The mode to which a state belongs; negative if it belongs to none (deadlock)."""
        of_state = self.hybrid.initial_mode
        assert of_state is not None, "preparation.prepare asks for a mode where the system knows none"
        return jnp.asarray(of_state(t, x)).astype(jnp.int32)

    def velocity(self, t, x, solver: SolverState):
        """The vector field (n,) of the present mode."""
        return by_mode(solver.mode, self.hybrid.fields, t, x)

    def init(self, t, x, mode, h) -> SolverState:
        """The solver state at (t, x)."""
        if self.always_regular:
            return SolverState(*(None,) * 10)
        hybrid, mode = self.hybrid, jnp.asarray(mode, jnp.int32)
        f = by_mode(mode, hybrid.fields, t, x)
        given, h = h, first_step(self.method, x, f) if h is None else h
        state = SolverState(f, h, jnp.zeros_like(h), mode if hybrid.modes > 1 else None, *(None,) * 6)
        if not self.has_events:
            return state
        both = zip(hybrid.guards, hybrid.fields, strict=True)
        modes = [hybrid.calls.once(functools.partial(to_arm, *own), "to_arm", *own) for own in both]
        if given is None:  # guards are armed on the scale of the step
            h = first_step(self.method, x, f, soonest_root(*by_mode(mode, modes, t, x, h)[:4]))
        g, rate, second, guard_tolerance, step_rounding = by_mode(mode, modes, t, x, h)
        fired = jnp.zeros(hybrid.slots, bool)
        if self.just_fired is not None:
            fired = table(self, state.mode, hybrid.transition == self.just_fired)
        guard_sign, g, rate, _ = arm(g, rate, second, guard_tolerance, step_rounding, h, t, fired)
        # The start is on a guard and about to cross it: it has not fired yet, so it fires at once.
        guard_sign = jnp.where(
            table(self, state.mode, hybrid.directed) & (g == 0) & (guard_sign < 0) & ~fired, 1.0, guard_sign
        )
        ticks = [jnp.floor((t - phase) / period + digits(1e-9, t)) + 1 for period, phase in self.clock_times]
        memory = Memory.at_start(t, waiting_at_start(self, state.mode, g, guard_sign))
        if hybrid.borders is not None:
            outside = jnp.any(table(self, state.mode, hybrid.borders) & (guard_sign < 0))
            memory = memory._replace(pending=jnp.where(outside, FIRST, memory.pending))
        return SolverState(
            f,
            h,
            state.log_ratio,
            state.mode,
            g,
            rate,
            guard_sign,
            guard_tolerance,
            jnp.stack(ticks) if ticks else None,
            jnp.stack(memory),
        )

    @property
    def by_fixed_steps(self) -> bool:
        """Whether all steps have the same length."""
        return not self.rejects

    def rests(self, carry: StepState, clock: Clock, x):
        """Whether the state stays at x, off all guards, and whether it escapes: its steps grow without bound."""
        solver, no = carry.solver_state, jnp.asarray(False)
        if not self.timeless:
            return no, no
        allowed = digits(GUARD_ROUNDING, x) * jnp.abs(x)
        apart = solver.guard_tolerance
        if self.rejects:  # near an attracting equilibrium the state moves within the tolerances
            atol, rtol = self.method.atol, self.method.rtol
            allowed = NEARLY_STILL * (atol + rtol * jnp.abs(x))
            apart = NEARLY_STILL * (atol + rtol * solver.guard_tolerance / digits(GUARD_ROUNDING, x))
        still = jnp.all(jnp.abs(carry.x - x) <= allowed)
        off = jnp.all(~firing(self, solver) | (jnp.abs(solver.g) > NEARLY_STILL * apart))
        longest = solver.memory[Memory._fields.index("longest")]
        leaves = solver.h > jnp.where(longest > 0, LONGEST_STEP * longest, EVER)
        return still & off, leaves if self.rejects else no

    def rebase(self, solver: SolverState, s) -> SolverState:
        """Make the time of the last event local to a block that starts s later."""
        return solver if solver.memory is None else solver._replace(memory=solver.memory.at[0].add(-s))

    # --- looking ahead ---------------------------------------------------------------------------------------

    def enter(self, carry: StepState, clock: Clock):
        """At the start of a block: with events an empty trial (`NONE`), so that `locate_events` makes the first."""
        if not self.has_events:
            return self.propose_step(carry, clock)
        h, zeros = jnp.zeros_like(carry.s), jnp.zeros(self.hybrid.slots, carry.x.dtype)
        tick = None if carry.solver_state.ticks is None else jnp.asarray(-1, jnp.int32)
        none, no = jnp.asarray(NONE, jnp.int32), jnp.asarray(False)
        ratio, miss = (h, zeros) if self.rejects else (None, None)
        stage_points = self.method.blank_stage_points(carry.x) if self.revisits and carry.frame.shape[1] else ()
        x, f = carry.x, carry.solver_state.f
        return Trial(none, h, x, f, ratio, no, zeros, zeros, miss, tick, stage_points, zeros > 0)

    def propose_step(self, carry: StepState, clock: Clock, bracket: RootBracket | None = None):
        """A trial step of the state, and its case; () for a plain flow with a fixed step, which needs no trial."""
        solver, t, hybrid = carry.solver_state, clock.base + carry.s, self.hybrid
        if self.always_regular:
            return ()
        h, final, tick = self._length(carry, clock, bracket)

        step, ratio, g, rate, inside = by_mode(
            solver.mode, [trial_in(self, q) for q in range(hybrid.modes)], t, carry.x, solver.f, h
        )
        stage_points = step.stage_points if self.revisits and carry.frame.shape[1] else ()
        f = step.f if self.has_events or self.method.takes_slope else solver.f  # so that an unused step.f is dropped
        trial = Trial(None, h, step.x, f, ratio, final, g, rate, None, tick, stage_points)
        return self._judge(carry, clock, trial, inside, bracket)

    def alike(self, step: Step, x) -> Step:
        """Pad the stage points, so that they have the same shape in all modes."""
        if not (self.has_events and self.revisits):
            return step

        def fit(given, room):
            return jnp.pad(given, [(0, wide - narrow) for narrow, wide in zip(given.shape, room.shape, strict=True)])

        return step._replace(stage_points=jax.tree.map(fit, step.stage_points, self.method.blank_stage_points(x)))

    def is_regular(self, ahead):
        """Rejected and advancing steps are regular."""
        return True if self.always_regular else ahead.case <= ADVANCE

    def _length(self, carry: StepState, clock: Clock, bracket: RootBracket | None):
        """The next h: the controller's, cut at the block's end, a tick or a root; if it is final; its clock or -1."""
        solver, rest = carry.solver_state, clock.length - carry.s
        h, _ = cut_at_end(rest, jax.lax.stop_gradient(solver.h))
        tick: Any = None
        final = rest <= h
        if solver.ticks is not None:
            until = until_ticks(self, carry, clock)
            first = first_of(until, carry, clock)
            ticks = until[first] <= jnp.maximum(h * (1 + digits(1e-9, h)), unresolved(carry, clock))
            h, tick = jnp.where(ticks, until[first], h), jnp.where(ticks, first.astype(jnp.int32), -1)
            final = final & ~ticks
        if bracket is not None:
            cut = bracket.h < h
            h, final = jnp.where(cut, bracket.h, h), final & ~cut
            tick = None if tick is None else jnp.where(cut, -1, tick)
        if self.may_not_flow:
            at_once = pending(solver) > 0
            h, final = jnp.where(at_once, 0.0, h), final & ~at_once
            tick = None if tick is None else jnp.where(at_once, -1, tick)
        return h, final, tick

    def ticks_now(self, carry: StepState, clock: Clock):
        """Whether the next tick of a clock cannot be told from the present time."""
        if carry.solver_state.ticks is None:
            return False
        return jnp.min(until_ticks(self, carry, clock)) <= unresolved(carry, clock)

    def _judge(self, carry: StepState, clock: Clock, trial: Trial, inside, bracket: RootBracket | None) -> Trial:
        """Set the case of a trial: REJECT, ADVANCE, LOCATE, LAND or FAIL."""
        solver, ratio = carry.solver_state, trial.ratio
        event, lands = jnp.asarray(False), jnp.asarray(False)
        if self.has_events:
            inside = jax.lax.stop_gradient(inside)
            trial = resolve(self, solver, trial, inside)
            ratio = trial.ratio
            if bracket is None:
                event = suspects(self, solver, trial, inside)
                trial = trial._replace(hidden=jnp.zeros(trial.g.shape, bool))
            else:
                trial = trial._replace(hidden=hides(self, solver, trial, inside, clock.base + carry.s, carry.x))
                event, lands = finds(self, solver, trial, bracket)
                if trial.tick is not None:  # a guard that was crossed before the tick comes first
                    crossed = jnp.any(firing(self, solver) & is_beyond(solver, trial))
                    trial = trial._replace(tick=jnp.where(lands & crossed, -1, trial.tick))
                if self.rejects:  # a part of an accepted step is accepted too
                    ratio = jnp.where((bracket.guard_index >= 0) & jnp.isfinite(ratio), 0.0, ratio)
            if trial.tick is not None:
                lands = lands | ((trial.tick >= 0) & ~event)
        case = jnp.where(lands, LAND, jnp.where(event, LOCATE, ADVANCE))
        # A state that is not finite makes the error estimate so; without an estimate check the state itself.
        passed = ratio <= 1.0 if self.rejects else jnp.all(jnp.isfinite(trial.x))
        failed = True
        if self.rejects:
            failed = (trial.h > 0) & goes_nowhere(carry, clock, trial.h, ratio, self.hybrid.constrained)
        case = jnp.where(passed, case, jnp.where(failed, FAIL, REJECT))
        if self.may_not_flow:
            case = jnp.where(pending(solver) > 0, LAND, case)
        return trial._replace(case=case.astype(jnp.int32), ratio=ratio)

    # --- advance ---------------------------------------------------------------------------------------------

    def landed(self, carry: StepState, clock: Clock, trial: Trial) -> Carried:
        """The frame after a trial that ends at an event."""
        if not carry.frame.shape[1]:
            return Carried(frame=carry.frame)
        tangent = self.method.rare_tangent if trial.stage_points else self.method.tangent  # traced anyway
        return self.carried(carry, clock, trial.h, carry.solver_state.mode, trial.stage_points, tangent)

    def carried(
        self, carry: StepState, clock: Clock, h, mode, stage_points=(), of_method=None, with_errors: bool = False
    ) -> Carried:
        """The frame after a step of length h."""
        of_method = of_method or self.method.tangent
        t, hybrid = clock.base + carry.s, self.hybrid

        def tangent(q):
            def of_mode(t, x, frame, h, stage_points):
                field = hybrid.fields[q]
                new, moved, errors, nodes, growth = of_method(field, t, x, h, frame, stage_points)
                if self.rejects and self.method.control == "xY":
                    ratio = jax.lax.stop_gradient(self.method.frame_ratio(errors, frame, moved))
                else:
                    ratio = jnp.zeros_like(h)
                log_volume_change = self.method.divergence(field, nodes, h) if carry.log_volume is not None else None
                return Carried(new, moved, ratio, log_volume_change, growth, errors if with_errors else None)

            return hybrid.calls.once(of_mode, "carried", of_method.__name__, self.method, with_errors, hybrid.fields[q])

        return by_mode(mode, [tangent(q) for q in range(hybrid.modes)], t, carry.x, carry.frame, h, stage_points)

    def commit(self, settings: Settings, carry: StepState, h, x, kept: Carried) -> StepState:
        """The carry after an accepted step."""
        since = carry.since + {"steps": 1.0, "time": h, "jumps": 0.0, "never": 0.0}[settings.qr_schedule.unit]
        carry = carry._replace(x=x, frame=kept.frame, since=since)
        if kept.errors is not None:
            carry = carry._replace(observer=settings.observer.stepped(carry.observer, kept.errors))
        return added(carry, s=h, log_volume=kept.log_volume_change, growth=kept.growth)

    @staticmethod
    def _ended(carry: StepState, clock: Clock, final) -> StepState:
        """After the last step of a block, set the time to the block's end exactly."""
        return carry._replace(s=jnp.where(final, clock.length, carry.s))

    def step(self, settings: Settings, clock: Clock, carry: StepState, trial) -> StepState:
        """Accept the trial and propagate the frame; or, if an error is too large, only make h smaller."""
        if self.always_regular:
            return self._march(settings, clock, carry)
        solver, ratio, along = carry.solver_state, trial.ratio, Carried(frame=carry.frame)
        if carry.frame.shape[1]:
            looks = self.rejects and isinstance(settings.observer, ErrorObserver)
            along = self.carried(carry, clock, trial.h, solver.mode, trial.stage_points, with_errors=looks)
            ratio = jnp.maximum(ratio, along.ratio) if self.rejects else None
        kept = self._ended(self.commit(settings, carry, trial.h, trial.x, along), clock, trial.final)
        kept = changed(kept, f=trial.f)
        if self.has_events:
            guard_sign, g = stays(self, solver, trial)
            kept = changed(kept, g=g, rate=trial.rate, guard_sign=guard_sign)
        if not self.rejects:
            return kept
        # The frame's error may reject a step that the state's error has accepted.
        passed = jnp.asarray(ratio) <= 1.0
        kept = jax.tree.map(lambda a, b: a if a is b else jnp.where(passed, a, b), kept, carry)
        h, log_ratio = next_step(self.method, solver, trial, ratio, passed)
        kept = changed(kept, h=h, log_ratio=log_ratio)
        hopeless = ~passed & goes_nowhere(carry, clock, trial.h, jnp.asarray(ratio), self.hybrid.constrained)
        underflow = jnp.where(jnp.isfinite(jnp.asarray(ratio)), STATUS.step_underflow, STATUS.nonfinite)
        return stop(kept, underflow, hopeless)

    def _march(self, settings: Settings, clock: Clock, carry: StepState) -> StepState:
        """A fixed step of a plain flow, without trial and guards."""
        rest, step = clock.length - carry.s, self.method.fixed_step
        h, last = cut_at_end(rest, step)
        along = self.carried(carry, clock, h, None)
        return self._ended(self.commit(settings, carry, h, along.x, along), clock, last)

    # --- events and failures ---------------------------------------------------------------------------------

    def locate_events(self, settings: Settings, clock: Clock, within, carry: StepState, trial) -> tuple[StepState, Any]:
        """Locate events and apply them, until a trial is regular again or the run has ended: state and trial."""

        def landed(carry, trial, bracket):
            return apply_event(self, settings, clock, carry, trial), no_bracket(trial.h)

        def narrow(carry, trial, bracket):
            return carry, next_bracket(self, carry.solver_state, trial, bracket)

        def neither(carry, trial, bracket):
            return self._fail(carry, trial), no_bracket(trial.h)

        def again(state):
            carry, trial, bracket = state
            # The budget must not interrupt the location of an event, but it may after the event.
            carry = carry._replace(budget=jnp.maximum(carry.budget - 1, jnp.where(trial.case == LAND, 0, 1)))
            which = jnp.where(trial.case == LOCATE, 0, jnp.where(trial.case == LAND, 1, 2))
            carry, bracket = jax.lax.switch(which, [narrow, landed, neither], carry, trial, bracket)
            trial = self.propose_step(carry, clock, bracket)
            assert isinstance(trial, Trial), "a plain flow does not come here"
            seen = Memory._fields.index("grazing")
            close = nearly_crosses(self, carry, clock, trial, bracket)
            memory = carry.solver_state.memory.at[seen].max(close.astype(carry.x.dtype))
            return changed(carry, memory=memory), trial, bracket

        if self.always_regular:
            return carry, trial
        if not self.has_events:
            return jax.lax.cond(trial.case == FAIL, self._fail, lambda carry, trial: carry, carry, trial), trial
        loop = checkpointed if settings.reverse else jax.lax.while_loop

        def unfinished(state):
            return within(state[0]) & ~self.is_regular(state[1])

        return loop(unfinished, again, (carry, trial, no_bracket(trial.h)))[:2]

    def _fail(self, carry: StepState, trial: Trial) -> StepState:
        """No step is possible: the state is not finite, or the step would be too small."""
        finite = jnp.all(jnp.isfinite(trial.x)) & (True if trial.ratio is None else jnp.isfinite(trial.ratio))
        return stop(carry, jnp.where(finite, STATUS.step_underflow, STATUS.nonfinite), trial.case == FAIL)


def are_nonlinear(fields: Iterable[Field], t, x) -> bool:
    """Whether Df depends on x for one of the fields; True where it cannot be excluded."""
    return not all(is_affine(functools.partial(field, t), x) for field in fields)


def are_timeless(hybrid: CompiledHybrid, t, x) -> bool:
    """Whether fields, guards and event times provably do not depend on the time explicitly."""
    return not hybrid.clocks and all(is_timeless(one, t, x) for one in (*hybrid.fields, *hybrid.guards))
