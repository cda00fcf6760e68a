"""What the loop asks of an evolver: how one class of systems goes from one event, iteration or step to the next.

The loop knows nothing of fields, guards or maps. Eight methods are abstract; the rest have answers that suit an evolver
without modes, without algebraic equations and without steps of its own choice.
"""

import abc
from typing import Any, ClassVar, Self

import jax.numpy as jnp

from .._linalg.frames import LOST
from .states import LONGEST_BLIND, Clock, Settings, StepState, stretched

__all__ = ["AbstractEvolver"]


class AbstractEvolver(abc.ABC):
    """An evolver; its fields are static or traced, its methods are called while the loop is traced.

    Shapes: t scalar, x (n,), a frame (n, k). `ahead` is what `propose_step` has found out about the next step, a tuple
    of arrays of its own kind; `solver` is its part of the loop's state, `StepState.solver_state`.

    Attributes:
        may_lose_rank: an event may destroy directions: columns are counted as lost.
        jumps_uncontrolled: an event may stretch or shrink columns without bound: frames are looked at after each.
        always_regular: nothing rare can happen: a step is never rejected, and no event must be located.
        by_rows: the frame is held so that rows lie together in memory, for systems of many bodies.
        by_fixed_steps: all steps are of one length.
        longest_interval: most steps (or jumps) between two orthonormalisations that are timed automatically.
        spread_wanted: ln(R_11 / R_kk) that such an interval aims at.
    """

    always_regular: bool = False
    by_fixed_steps: bool = False
    by_rows: ClassVar[bool] = False
    jumps_uncontrolled: bool = True
    may_lose_rank: bool = True
    longest_interval: ClassVar[float] = LONGEST_BLIND
    spread_wanted: ClassVar[float] = 4.0

    # --- one step: propose, then keep or locate ----------------------------------------------------------------

    @abc.abstractmethod
    def init(self, t, x, mode, h) -> Any:
        """The solver state at the start; h: the first step, None where it is to be guessed."""

    @abc.abstractmethod
    def rebase(self, solver, s) -> Any:
        """The solver state as a block sees it that starts s later: times are local to the block."""

    @abc.abstractmethod
    def propose_step(self, c: StepState, clock: Clock) -> Any:
        """What the next step would be: `ahead`."""

    @abc.abstractmethod
    def is_regular(self, ahead) -> Any:
        """Whether `step` may take it (True, or a scalar bool); else `locate_events` does."""

    @abc.abstractmethod
    def step(self, settings: Settings, clock: Clock, c: StepState, ahead) -> StepState:
        """Take the step, and carry the frame along; or only make the next one smaller."""

    @abc.abstractmethod
    def locate_events(
        self, settings: Settings, clock: Clock, within, c: StepState, ahead: Any
    ) -> tuple[StepState, Any]:
        """All that is rare, until the next step is regular again or the run has ended; within(c): the block goes on."""

    @abc.abstractmethod
    def which_shape(self, t, x) -> Any:
        """A tree of `jax.ShapeDtypeStruct`: what a log of events stores as `which`."""

    @abc.abstractmethod
    def onto_mode(self, mode, t, x) -> Any:
        """The projection dx -> dx (n,) onto the tangent space of a mode; None where no mode has constraints."""

    # --- answers that suit most -------------------------------------------------------------------------------

    def enter(self, c: StepState, clock: Clock) -> Any:
        """`ahead` at the start of a block."""
        return self.propose_step(c, clock)

    def once(self, settings: Settings, clock: Clock, c: StepState, ahead) -> StepState:
        """One event and no more, where a step is several."""
        return self.step(settings, clock, c, ahead)

    def tangent(self, clock: Clock, c: StepState, ahead) -> Any:
        """The step as a function of x (n,), for a second look in twice the digits; where jumps are uncontrolled."""
        raise NotImplementedError(f"{type(self).__name__} has no step that is a function of the state alone")

    def velocity(self, t, x, solver) -> Any:
        """The field (n,) at a point; where there is one."""
        raise NotImplementedError(f"{type(self).__name__} has no field")

    def initial_mode(self, t, x) -> Any:
        """The index of the mode to which a state belongs; negative where none can go on from it."""
        return jnp.asarray(0, jnp.int32)

    def admitted(self, t, x, mode) -> tuple[Any, Any]:
        """A start, put onto the constraints of its mode; and whether it was too far from them."""
        return x, False

    def kept_to_constraints(self, c: StepState, clock: Clock) -> StepState:
        """With a frame in the tangent space of the constraints."""
        return c

    def inspected(self, c: StepState, clock: Clock) -> StepState:
        """At the end of a block: the run ends where the motion has left its constraints."""
        return c

    def stretched(self, c: StepState) -> Any:
        """Whether the frame must be orthonormalised at once."""
        return stretched(c)

    def rests(self, c: StepState, clock: Clock, x) -> tuple[Any, Any]:
        """Whether the motion has stayed at x; and whether it leaves for ever: asked where jumps alone end a block."""
        return jnp.asarray(False), jnp.asarray(False)

    def least_length(self, c: StepState, jumps) -> Any:
        """Columns that so many jumps have left with no more than this (and rounding) are lost.

        After many jumps rounding alone makes columns dependent: that is unresolved, not lost.
        """
        return jnp.where(jumps <= 1, LOST, jnp.where(jumps <= LONGEST_BLIND, 0.0, -jnp.inf))

    def in_each_mode(self) -> tuple[Self, ...]:
        """The evolvers of the innermost loop, one for each mode."""
        return (self,)
