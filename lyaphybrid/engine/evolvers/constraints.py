"""The methods of an evolver that concern the algebraic equations (constraints) of its modes."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from ..._jax.columns import each_column
from ...events.compiled_hybrid import CompiledHybrid, by_mode
from ...integrators.base import Method
from ...statuses import RUNNING, STATUS
from ...systems.daes.points import landed
from ...systems.daes.semi_linear import is_constrained
from ..evolver import AbstractEvolver
from ..states import Clock, StepState, stop
from .step_sizes import unresolved

__all__ = ["OnConstraints", "landing_of"]

NEAR_CONSTRAINTS = 1e-6  # largest inconsistency of an initial state, relative to the terms that add up to it
DRIFT = 1e-5  # largest distance from the constraints at the end of a block, relative likewise


class OnConstraints(AbstractEvolver):
    """An evolver whose modes may have algebraic equations."""

    hybrid: CompiledHybrid
    method: Method

    def onto_mode(self, mode, t, x):
        """The projection dx -> dx (n,) onto the tangent space of a mode; None where no mode has one."""
        hybrid = self.hybrid
        if all(project is None for project in hybrid.projections):
            return None
        given = [project or (lambda t, x, dx: dx) for project in hybrid.projections]
        return lambda dx: by_mode(mode, [lambda dx, p=p: p(t, x, dx) for p in given], dx)

    def kept_to_constraints(self, carry: StepState, clock: Clock) -> StepState:
        """Project the frame onto the tangent space of its mode.

        Errors across it, in sliding too, do not decay: rounding would outgrow a direction in it that does. Methods that
        keep the constraints of a DAE need no projection there.
        """
        hybrid, t = self.hybrid, clock.base + carry.s
        pairs = zip(hybrid.projections, hybrid.fields, strict=True)
        kept = [None if is_constrained(field) and self.method.keeps_constraints else onto for onto, field in pairs]
        if all(onto is None for onto in kept):
            return carry
        ways = [_columns_onto(onto, t, carry.x) for onto in kept]
        return carry._replace(frame=by_mode(carry.solver_state.mode, ways, carry.frame))

    def onto_constraints(self, mode, t, x):
        """The point on the constraints of a mode with the same differential part E₁ x."""
        return by_mode(mode, [landing_of(field) for field in self.hybrid.fields], t, x)

    def admitted(self, t, x, mode):
        """The initial state moved onto the constraints of its mode, and whether it was too far from them."""
        if not self.hybrid.constrained:
            return x, False
        new = self.onto_constraints(mode, t, x)
        terms = by_mode(mode, [_terms_of(field) for field in self.hybrid.fields], t, new)
        wrong = ~jnp.all(jnp.abs(new - x) <= NEAR_CONSTRAINTS * terms + self.method.atol)
        return jnp.where(wrong, x, new), wrong

    def inspected(self, carry: StepState, clock: Clock) -> StepState:
        """At the end of a block: stop if the state has left the constraints or is at a singular point."""
        if not self.hybrid.constrained:
            return carry

        mode = None if self.hybrid.modes == 1 else carry.solver_state.mode
        # What passes through zero, as a function of time, does so with a velocity.
        solver = carry.solver_state
        least = jnp.abs(solver.h * solver.f) + self.method.atol / self.method.rtol
        off, nearly, singular = by_mode(
            mode, [_distance_of(field) for field in self.hybrid.fields], clock.base + carry.s, carry.x, least
        )
        # Steps that the time does not resolve, and a state that is not finite, are consequences of the singular point.
        ended = (carry.status == STATUS.step_underflow) | (carry.status == STATUS.nonfinite)
        ended = ended | ((carry.status == RUNNING) & (solver.h <= unresolved(carry, clock)))
        finite = jnp.all(jnp.isfinite(carry.x))
        nearly, singular = nearly & finite, singular & finite
        carry = carry._replace(
            status=jnp.where(ended & nearly, jnp.asarray(STATUS.singular_dae, jnp.int32), carry.status)
        )
        carry = stop(carry, STATUS.singular_dae, singular)
        return stop(carry, STATUS.constraint_drift, off > DRIFT)


def _distance_of(field: Any):
    """(t, x, least) -> the distance from a field's constraints, and whether the point is nearly, or is, singular."""
    if not is_constrained(field):
        return lambda t, x, least: (jnp.zeros_like(t), jnp.asarray(False), jnp.asarray(False))
    dae, args = field.field, field.args
    return lambda t, x, least: (dae.distance(t, x, args, least), *dae.singularities(t, x, args))


def _terms_of(field: Any):
    """(t, x) -> the size (n,) of the terms that add up to x."""
    if not is_constrained(field):
        return lambda t, x: jnp.abs(x)
    return lambda t, x: field.field.inverse_blocks(t, x, field.args).terms


def _columns_onto(onto: Callable | None, t, x) -> Callable:
    """A frame (n, k) -> its columns projected; None: as they are."""
    return (lambda frame: frame) if onto is None else (lambda frame: each_column(lambda dx: onto(t, x, dx), frame))


def landing_of(field: Any):
    """(t, x) -> the point on the field's constraints with the same E₁ x; x itself where there are no constraints."""
    if not is_constrained(field):
        return lambda t, x: x
    return lambda t, x: landed(field.field, field.args, t, x)
