"""Flow from event to event by diffrax, with diffrax's own event location: an independent check of ours."""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix
from jaxtyping import Array

from .._arguments import positive, require
from .._jax.columns import each_column
from ..systems.daes.semi_linear import is_constrained
from .base import Field, Step, Tangent
from .diffrax_solver import ByDiffrax, with_tolerances
from .divergences import trace

__all__ = ["DiffraxEvents"]

MOST_DIFFRAX_STEPS = 100_000  # steps of one call of diffrax


class MotionToEvent(NamedTuple):
    """The motion up to the next event, or to the end of the interval if there is none."""

    h: Array  # its duration
    step: Array  # mean length of diffrax's steps
    found: Array  # whether an event ended it
    failed: Array  # whether diffrax failed
    x: Array  # (n,) at the end, by diffrax's dense output where there was an event


class DiffraxEvents(ByDiffrax):
    """Flow and events both by diffrax: `diffrax.diffeqsolve` with a `diffrax.Event` and a root finder of optimistix.

    It is there to check the default method, with which it shares only what follows a located event: the reset, the
    saltation matrix, the arming of guards, and two Newton steps that put the state onto the guard. Perturbations
    solve the variational equation Y' = Df Y together with the state.

    diffrax compares the signs of guards at the ends of its steps, so a guard that is crossed twice within one step, or
    only touched, is missed. An `lh.DAE` is refused. Results have forward-mode derivatives only. It compiles and runs
    more slowly than the default method.

    Args:
        solver: a diffrax solver with an error estimate, for example ``diffrax.Dopri8()``.
        rtol: relative tolerance of the local error of state and perturbations together.
        atol: absolute tolerance of the local error, in units of x.
        root_finder: of optimistix, for the time of an event; None: bisection, to 1e-12 units of time.

    Raises:
        ValueError: if ``solver`` is no diffrax solver with an error estimate or ``root_finder`` none of optimistix; on
            tolerances that are not positive; in a run, where a mode has constraints.

    Source:
        P. Kidger, On Neural Differential Equations, thesis (Oxford 2021), arXiv:2202.02435; J. Rader, T. Lyons &
        P. Kidger, Optimistix: modular optimisation in JAX and Equinox (2024), arXiv:2402.09983.

    Example:
        >>> import diffrax, lyaphybrid as lh
        >>> ball = lh.zoo.bouncing_ball()
        >>> other = lh.DiffraxEvents(diffrax.Dopri8())
        >>> run = lh.trajectory(ball.system, ball.x0, ball.args, t1=3.25, n=1, method=other)
        >>> [round(float(t), 6) for t in run.events.t]
        [2.0, 3.0]
    """

    solver: diffrax.AbstractSolver
    rtol: Any
    atol: Any
    root_finder: optimistix.AbstractRootFinder
    control: str = eqx.field(static=True)

    def __init__(
        self,
        solver: diffrax.AbstractSolver,
        rtol: Any = 1e-9,
        atol: Any = 1e-12,
        root_finder: optimistix.AbstractRootFinder | None = None,
    ):
        positive("rtol", rtol)
        positive("atol", atol)
        if root_finder is None:  # conditions fall through zero: with flip=True bisection need not find out the signs
            root_finder = optimistix.Bisection(1e-12, 1e-12, flip=True)
        known = isinstance(root_finder, optimistix.AbstractRootFinder)
        require(known, f"root_finder must be one of optimistix, such as optimistix.Bisection; got {root_finder!r}.")
        self.solver, self.rtol, self.atol, self.root_finder = (
            with_tolerances(solver, rtol, atol),
            rtol,
            atol,
            root_finder,
        )
        self.control = "x"  # diffrax controls the errors of the frame

    def require(self, field: Field, t, x) -> None:
        """Raise a ValueError for an `lh.DAE`: diffrax does not handle constraints."""
        del t, x
        require(
            not is_constrained(field),
            "lh.DiffraxEvents integrates ordinary differential equations, and this is an lh.DAE: leave method=None for "
            "lh.HalfExplicit, or take lh.ESDIRK.",
        )

    def flight(self, field: Field, t, x, h, condition: Callable | None = None) -> MotionToEvent:
        """From (t, x) until condition(s, x) falls through zero, at most over h; s is the time since t."""
        solution = self._solve(field, t, x, h, condition)
        end, x = _last(solution)
        steps = solution.stats["num_accepted_steps"]
        found = jnp.asarray(False) if solution.event_mask is None else solution.event_mask
        failed = ~found & (solution.result != diffrax.RESULTS.successful)
        step = end / jnp.maximum(steps, 1).astype(end.dtype)
        return MotionToEvent(end, step, found, failed, x)

    def step(self, field: Field, t, x, f, h) -> Step:
        """The state over h."""
        del f
        new = self.flight(field, t, x, h).x
        return Step(new, field(t + h, new), jnp.zeros((1, *x.shape), x.dtype), None, None)

    def inside(self, dense, theta):
        """Not available: the evolver that uses this method asks for no dense output."""
        raise NotImplementedError

    def tangent(self, field: Field, t, x, h, frame, stage_points=()) -> Tangent:
        """State, frame and ∫ tr Df dt, integrated together by diffrax."""
        del stage_points

        def variational(t, y):
            x, columns, _ = y
            f, linear = jax.linearize(lambda x: field(t, x), x)
            return f, each_column(linear, columns), trace(field, t, x)

        _, (new, moved, flux) = _last(self._solve(variational, t, (x, frame, jnp.zeros_like(h)), h))
        return Tangent(new, moved, jnp.zeros((1, *frame.shape), frame.dtype), flux)

    def divergence(self, field: Field, nodes, h):
        """∫ tr Df dt, which `tangent` has integrated already: the nodes are its value."""
        del field, h
        return nodes

    def _solve(self, field, t, y, h, condition: Callable | None = None) -> diffrax.Solution:
        """A solution in the time s since t: the root finder then keeps its tolerance at large t."""
        event = None
        if condition is not None:
            event = diffrax.Event(lambda t, y, args, **_: condition(t, y), self.root_finder, direction=False)
        return diffrax.diffeqsolve(
            diffrax.ODETerm(lambda s, y, args: field(t + s, y)),
            self.solver,
            jnp.zeros_like(h),
            h,
            None,
            y,
            stepsize_controller=diffrax.PIDController(rtol=self.rtol, atol=self.atol),
            event=event,
            adjoint=diffrax.ForwardMode(),
            max_steps=MOST_DIFFRAX_STEPS,
            throw=False,
        )


def _last(solution: diffrax.Solution) -> Any:
    """Time and state at the end."""
    return jax.tree.map(lambda leaf: leaf[-1], (solution.ts, solution.ys))
