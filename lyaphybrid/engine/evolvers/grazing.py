"""Events that the error of the motion decides: whether a guard that is hardly crossed is crossed, and how fast."""

import functools

import jax
import jax.numpy as jnp

from ..._jax.precision import nonzero
from ...events.compiled_hybrid import by_mode
from ...events.roots import errors_by
from ..states import Clock, StepState
from .trials import ADVANCE, LAND, RootBracket, Trial, firing, interpolation_errors, trial_in

__all__ = ["hardly_crosses", "nearly_crosses"]

TURNED = 0.1  # a guard has turned if its rate falls below this part, or its extremum is within this part of a step
NEARLY = 10.0  # it grazes if its extremum is within so many errors of zero
UNSURE = 0.5  # relative error of the distance from there to its extremum, by the mean bend of a long step
UNKNOWN_PART = 3e-3  # a guard is hardly crossed if its error may change its rate by more than this part of it
STEPS_TO_TURN = 3.0  # guards are examined if they would turn back within so many steps
CUBIC = 384.0  # the error of a cubic in the middle of a step is g⁗ h⁴/384
GLOBAL = 40.0  # the error of the motion by fixed steps of order p is taken as A (ωh)ᵖ/40, for motions A cos ωt


def hardly_crosses(evolver, carry: StepState, clock: Clock, trial: Trial):
    """(slots,) the guards whose rate at the end of a trial is known to less than two digits, and those that turn soon.

    An error δ of the guard moves its root by δ/ġ, and changes the rate there by g̈ δ/ġ. The saltation matrix has 1/ġ.
    """
    bend = _bend(carry, trial)
    slow = (trial.h > 0) & (jnp.abs(trial.rate) < STEPS_TO_TURN * carry.solver_state.h * jnp.abs(bend))
    wanted = jnp.any(firing(evolver, carry.solver_state) & slow)
    errors = _errors_of_guards(evolver, carry, clock, bend, wanted)
    return (trial.h > 0) & (jnp.abs(bend) * errors > UNKNOWN_PART * trial.rate**2), slow


def nearly_crosses(evolver, carry: StepState, clock: Clock, trial: Trial, bracket: RootBracket):
    """Whether a trial ends at an extremum of a guard that misses zero by less than the error of the motion.

    It was cut there, or ends there by itself; also if it ends a block, or at an event of another guard or of a clock.
    """
    solver, bend = carry.solver_state, _bend(carry, trial)
    rest = 0.5 * trial.rate**2 / jnp.where(bend == 0, nonzero(1e-300, bend), bend)  # from the end to the extremum
    near = TURNED * jnp.maximum(jnp.abs(solver.rate), jnp.abs(bend) * solver.h)
    turned = (solver.guard_sign * solver.rate < 0) & (jnp.abs(trial.rate) <= near)
    aimed = jnp.arange(evolver.hybrid.slots, dtype=jnp.int32) == bracket.guard_index
    turned = turned & firing(evolver, solver) & ~aimed & (trial.h > 0)
    ends = (trial.case == ADVANCE) | (trial.case == LAND)
    errors = _errors_of_guards(evolver, carry, clock, bend, ends & jnp.any(turned))
    return ends & jnp.any(turned & (jnp.abs(trial.g - rest) <= NEARLY * errors + UNSURE * jnp.abs(rest)))


def _bend(carry: StepState, trial: Trial):
    """(slots,) second time derivatives of the guards, the mean over the trial."""
    return (trial.rate - carry.solver_state.rate) / jnp.where(trial.h > 0, trial.h, 1.0)


def _errors_of_guards(evolver, carry: StepState, clock: Clock, bend, wanted):
    """(slots,) how far the guards may be off, where `wanted`: by the tolerances; of fixed steps by an estimate too.

    A fixed step of order p has no error estimate, but the guard's cubic over the step has, and shows g⁗. A guard that
    moves as A cos ωt has g⁗ = Aω⁴ and |g̈| = Aω² where it turns, so both A and ω follow.
    """
    hybrid, solver, method, t = evolver.hybrid, carry.solver_state, evolver.method, clock.base + carry.s

    def estimated():
        errors = method.atol + method.rtol * jnp.abs(carry.x)
        by_state = [functools.partial(errors_by, guards) for guards in hybrid.guards]
        given = by_mode(solver.mode, by_state, t, carry.x, errors) + solver.guard_tolerance
        if evolver.rejects or not method.sample_fractions:  # a map from point to point says nothing of g⁗
            return given
        trials = [trial_in(evolver, q) for q in range(hybrid.modes)]
        _, _, g, rate, inside = by_mode(solver.mode, trials, t, carry.x, solver.f, solver.h)
        largest = CUBIC * interpolation_errors(evolver, solver, g, rate, solver.h, inside)  # g⁗ h⁴
        squared = jnp.minimum(largest / jnp.maximum(jnp.abs(bend) * solver.h**2, nonzero(1e-300, bend)), 1.0)  # (ωh)²
        return jnp.maximum(given, largest * squared ** (0.5 * max(method.error_order - 4, 0)) / GLOBAL)

    return jax.lax.cond(wanted, lambda: jax.lax.stop_gradient(estimated()), lambda: jnp.zeros_like(bend))
