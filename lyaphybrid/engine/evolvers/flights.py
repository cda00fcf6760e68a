"""The evolver for methods that locate events themselves (diffrax): a trial is a flight that ends at or before an event.

What follows an event is inherited from `Stepping`: landing on the guard, the cascade, and arming the guards.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp

from ..._jax.precision import nonzero
from ...events.compiled_hybrid import by_mode
from ...events.roots import rates
from ...integrators.diffrax_events import DiffraxEvents, MotionToEvent
from ..states import Clock, StepState
from .stepping import Stepping
from .trials import ADVANCE, FAIL, LAND, RootBracket, SolverState, Trial, firing, pending

__all__ = ["Flights"]

# Approximate number of steps of a flight; after it frames can be orthonormalised and the host can act.
STEPS_PER_FLIGHT = 20.0


@dataclasses.dataclass(frozen=True)
class Flights(Stepping):
    """The evolver of flows and hybrid systems for `lh.DiffraxEvents`; `SolverState.h` is the mean step of a flight."""

    method: DiffraxEvents

    longest_interval: ClassVar[float] = 1.0  # counted in flights

    def enter(self, carry: StepState, clock: Clock):
        """As in `Stepping`; `stage_points` holds the mean step of the flight."""
        trial = super().enter(carry, clock)
        return trial._replace(stage_points=(jnp.zeros_like(carry.s),)) if isinstance(trial, Trial) else trial

    def propose_step(self, carry: StepState, clock: Clock, bracket: RootBracket | None = None) -> Trial:
        """A flight until a guard changes its sign, a clock ticks, the block ends, or `STEPS_PER_FLIGHT` steps."""
        del bracket  # the flight locates the event itself
        solver, t, hybrid = carry.solver_state, clock.base + carry.s, self.hybrid
        longest, final, tick = self._length(
            carry._replace(solver_state=solver._replace(h=STEPS_PER_FLIGHT * solver.h)), clock, None
        )

        trials = [self._flight_in(q, solver) for q in range(hybrid.modes)]
        flight, x, f, g, rate, reached = by_mode(solver.mode, trials, t, carry.x, longest)
        h, found = _duration(flight, longest), flight.found
        lands, miss = jnp.asarray(False), None
        if g is not None:
            # The guard that was reached has just passed zero: it fires, or it is armed now if it came from beyond zero.
            here = found & (jnp.arange(hybrid.slots) == reached)
            beyond = 2 * solver.guard_sign * jnp.maximum(solver.guard_tolerance, nonzero(1e-300, g))
            g, lands = jnp.where(here, -beyond, g), jnp.any(here & firing(self, solver))
            miss = jnp.zeros_like(g)
        if tick is not None:
            tick = jnp.where(found, -1, tick)
            lands = lands | (tick >= 0)
        case = jnp.where(flight.failed, FAIL, jnp.where(lands, LAND, ADVANCE))
        if self.may_not_flow:
            case = jnp.where(pending(solver) > 0, LAND, case)
        zero, hidden = jnp.zeros_like(h), jnp.zeros(hybrid.slots, bool) if self.has_events else None
        return Trial(case.astype(jnp.int32), h, x, f, zero, final & ~found, g, rate, miss, tick, (flight.step,), hidden)

    def _flight_in(self, q: int, solver: SolverState):
        """(t, x, h) -> a flight in mode q, the state and vector field at its end, and the guards there if any."""
        method, field = self.method, self.hybrid.fields[q]
        if not self.has_events:

            def to_the_end(t, x, h):
                flight = method.flight(field, t, x, h)
                return flight, flight.x, field(t + h, flight.x), None, None, None

            return to_the_end
        guards = self.hybrid.guards[q]

        def to_an_event(t, x, h):
            def distances(s, x):
                return jnp.where(solver.guard_sign == 0, jnp.inf, solver.guard_sign * guards(t + s, x))

            def least(s, x):  # at s = 0 each guard is on its own side by definition
                return jnp.where(s > 0, jnp.min(distances(s, x)), 1.0)

            flight = method.flight(field, t, x, h, least)
            end = _duration(flight, h)
            step = method.step(field, t, x, solver.f, end)  # avoids the interpolation error of dense output
            reached = jnp.argmin(distances(flight.h, flight.x))
            return flight, step.x, step.f, *rates(guards, t + end, step.x, step.f), reached

        return to_an_event

    def _next_h(self, solver: SolverState, trial: Trial, ratio, passed):
        """The mean step of a full flight; a flight that was cut short can only raise the present value."""
        del ratio, passed
        (step,) = trial.stage_points
        h = jnp.where(trial.h >= 0.99 * STEPS_PER_FLIGHT * solver.h, step, jnp.maximum(solver.h, step))
        return jax.lax.stop_gradient(h), solver.log_ratio


def _duration(flight: MotionToEvent, longest):
    """How long a flight takes; to the end of a block or to a tick with the derivatives of these times.

    The time of a located event has none here: the polishing of the root gives it.
    """
    return jnp.where(flight.found, jax.lax.stop_gradient(flight.h), longest)
