"""The interface between the loop and an evolver, which advances one class of systems by a step, iteration or event.

The loop itself does not depend on vector fields, guards or maps. Eight methods are abstract; the others have defaults
for evolvers without modes, algebraic equations or adaptive steps.
"""

import abc
from typing import Any, ClassVar, Self

import jax.numpy as jnp

from .._linalg.frames import LOST
from .states import LONGEST_BLIND, Clock, Settings, StepState, stretched

__all__ = ["AbstractEvolver"]


class AbstractEvolver(abc.ABC):
    """An evolver; its fields are static or traced, its methods are called while the loop is traced.

    Shapes: t scalar, x (n,), frame (n, k). `ahead` is the result of `propose_step`, a tuple of arrays that depends on
    the evolver; `solver` is the evolver's state within the loop's state, `StepState.solver_state`.

    Attributes:
        may_lose_rank: whether an event may destroy directions, so that lost columns must be counted.
        jumps_uncontrolled: whether an event may stretch or shrink columns without bound before the next
            orthonormalisation, so that the frame must be checked after each event.
        always_regular: whether steps are never rejected and no event must ever be located.
        flies_by_schedule: whether a proposal that is not regular is a flight, which ends where an orthonormalisation is
            scheduled by time.
        by_rows: whether the rows of the frame are contiguous in memory, for systems of many bodies.
        by_fixed_steps: whether all steps have the same length.
        longest_interval: most steps (or jumps) between two orthonormalisations if the interval is adapted.
        spread_wanted: the ln(R_11 / R_kk) that the adapted interval aims at.
    """

    always_regular: bool = False
    by_fixed_steps: bool = False
    flies_by_schedule: ClassVar[bool] = False
    by_rows: ClassVar[bool] = False
    jumps_uncontrolled: bool = True
    may_lose_rank: bool = True
    longest_interval: ClassVar[float] = LONGEST_BLIND
    spread_wanted: ClassVar[float] = 4.0

    # --- one step: propose it, then accept it or locate an event -----------------------------------------------

    @abc.abstractmethod
    def init(self, t, x, mode, h) -> Any:
        """The solver state at the start of a run; h: the first step, None: estimate it."""

    @abc.abstractmethod
    def rebase(self, solver, s) -> Any:
        """The solver state for a new block that starts s later: its times are local to the block."""

    @abc.abstractmethod
    def propose_step(self, carry: StepState, clock: Clock) -> Any:
        """Propose the next step; returns `ahead`."""

    @abc.abstractmethod
    def is_regular(self, ahead) -> Any:
        """Whether `step` can handle the proposal (True, or a scalar bool); otherwise `locate_events` does."""

    @abc.abstractmethod
    def step(self, settings: Settings, clock: Clock, carry: StepState, ahead, /) -> StepState:
        """Accept the step and propagate the frame; or reject it and make the next step smaller."""

    @abc.abstractmethod
    def locate_events(
        self, settings: Settings, clock: Clock, within, carry: StepState, ahead: Any, /
    ) -> tuple[StepState, Any]:
        """Do what `step` does not, until a step is regular again or the run has ended; within(c): the block goes on."""

    @abc.abstractmethod
    def which_shape(self, t, x) -> Any:
        """Shape and type of an event's label `which` in the event log: a tree of `jax.ShapeDtypeStruct`."""

    @abc.abstractmethod
    def onto_mode(self, mode, t, x) -> Any:
        """The projection dx -> dx (n,) onto the tangent space of a mode; None where no mode has constraints."""

    # --- defaults -------------------------------------------------------------------------------

    def enter(self, carry: StepState, clock: Clock) -> Any:
        """`ahead` at the start of a block."""
        return self.propose_step(carry, clock)

    def once(self, settings: Settings, clock: Clock, carry: StepState, ahead, /) -> StepState:
        """One step with at most one event, also where `step` handles several."""
        return self.step(settings, clock, carry, ahead)

    def tangent(self, clock: Clock, carry: StepState, ahead, /) -> Any:
        """The step's derivative dx (n,) -> (n,), for double-double arithmetic; needed where jumps are uncontrolled."""
        raise NotImplementedError(f"{type(self).__name__} has no step that is a function of the state alone")

    def velocity(self, t, x, solver) -> Any:
        """The vector field (n,) at a point, for systems that have one."""
        raise NotImplementedError(f"{type(self).__name__} has no field")

    def initial_mode(self, t, x) -> Any:
        """The index of the mode to which a state belongs; negative if it belongs to none (deadlock)."""
        return jnp.asarray(0, jnp.int32)

    def admitted(self, t, x, mode) -> tuple[Any, Any]:
        """The initial state moved onto the constraints of its mode, and whether it was too far from them."""
        return x, False

    def kept_to_constraints(self, carry: StepState, clock: Clock) -> StepState:
        """The carry with its frame projected onto the tangent space of its mode: of constraints, of a sliding mode."""
        return carry

    def inspected(self, carry: StepState, clock: Clock) -> StepState:
        """Checks at the end of a block: the run ends if the state has left the constraints."""
        return carry

    def stretched(self, carry: StepState) -> Any:
        """Whether the frame must be orthonormalised now."""
        return stretched(carry)

    def rests(self, carry: StepState, clock: Clock, x) -> tuple[Any, Any]:
        """Whether the state stays at x, and whether it escapes; used where only a number of jumps ends a block."""
        return jnp.asarray(False), jnp.asarray(False)

    def ticks_now(self, carry: StepState, clock: Clock) -> Any:
        """Whether a clock ticks at this very time; a block ends after all ticks at its end."""
        return False

    def least_length(self, carry: StepState, jumps) -> Any:
        """The length at or below which a column counts as lost after this number of jumps.

        After many jumps rounding alone makes columns linearly dependent; such a column is unresolved, not lost.
        """
        return jnp.where(jumps <= 1, LOST, jnp.where(jumps <= LONGEST_BLIND, 0.0, -jnp.inf))

    def tells_whole_step(self, carry: StepState) -> Any:
        """Whether `tangent` was that of the whole last step; of several jumps at once it may be that of the first."""
        del carry
        return True

    def in_each_mode(self) -> tuple[Self, ...]:
        """The evolvers for the innermost loop, one per mode."""
        return (self,)
