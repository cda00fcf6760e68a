"""The interface of integration methods: one step, its error estimate, its tangent, and values inside the step."""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jax.columns import each_column
from .._jax.precision import nonzero
from .._jax.tracing import numpy_for

Field = Callable[[Any, Array], Array]  # (t, x) -> dx/dt, args bound
PROBE = 0.21132486540518713  # (3 - √3)/6 of a step, where the error of the cubic interpolant's slope is largest


class Controller(NamedTuple):
    """Step-size controller: h ← h · safety · r^(-now/p) · r_last^(last/p), r the error over the tolerance, p its order.

    The default is a PI controller (Gustafsson; Hairer & Wanner, Solving ODEs II, section IV.2).
    """

    safety: float = 0.8
    shrink: float = 0.2  # smallest factor from one step to the next
    grow: float = 10.0  # largest factor
    now: float = 0.7
    last: float = 0.4


class Step(NamedTuple):
    """One step of a method from (t, x) over h."""

    x: Array  # (n,) at t + h
    f: Array  # (n,) the field there
    error: Array  # (estimates, n), linear in the stages: its tangents are the frame's errors
    dense: Any  # what `Method.inside` needs
    nodes: Any  # what `Method.divergence` needs
    stage_points: tuple[
        Array, ...
    ] = ()  # stage points (or their differential parts), so that `Method.tangent` need not compute the step again
    stage_slopes: tuple[Array, ...] = ()  # the field there, where `Method.samples` needs it


class Tangent(NamedTuple):
    """The derivative of a step, applied to a frame (n, k)."""

    x: Any  # (n,) the end of the step; None if the caller passed stage points, and so has it
    frame: Array  # (n, k) at t + h
    errors: Array  # (estimates, n, k)
    nodes: Any  # what `Method.divergence` needs
    growth: Any = None  # (k,) logarithmic growth that the method itself has divided out of the columns


class Method(eqx.Module):
    """A one-step method. `step` is a pure function of x, so its derivative is the tangent of the step."""

    rtol: eqx.AbstractVar[Any]
    atol: eqx.AbstractVar[Any]
    control: eqx.AbstractVar[str]

    controller: ClassVar[Controller] = Controller()
    takes_slope: ClassVar[bool] = True  # `step` needs f, the field at its start: the loop hands it on from step to step
    keeps_constraints: ClassVar[bool] = False  # states and frames stay on the constraints of a DAE
    of_one_mode: ClassVar[bool] = False  # only for systems with one mode: it moves by functions of its own
    each_step: ClassVar[bool] = False  # by default frames are orthonormalised after each step

    @property
    @abc.abstractmethod
    def fixed_step(self) -> Any:
        """The fixed step; None where the error estimate controls h."""

    @property
    def adaptive(self) -> bool:
        """Whether the error estimate controls h."""
        return self.fixed_step is None

    @property
    def longest_step(self) -> Any:
        """Upper limit of adaptive steps; None: no limit."""
        return None

    @property
    def stage_count(self) -> int:
        """The number of points in `Step.stage_points`."""
        return 0

    def solves(self, field: Field) -> bool:
        """Whether the stages solve equations: their solutions are then kept for the tangent."""
        del field
        return False

    def blank_stage_points(self, x) -> tuple[Array, ...]:
        """Arrays with the shapes of `Step.stage_points`, as initial values of a loop."""
        return (x,) * self.stage_count

    @property
    @abc.abstractmethod
    def error_order(self) -> int:
        """The order p of the error estimate: it falls as h^p."""

    def loosened(self, least: float) -> "Method":
        """The same method with rtol at least `least`; atol is multiplied by the same factor as rtol."""
        names = {field.name for field in dataclasses.fields(self)} & {"rtol", "atol"}
        if not names:
            return self
        factor = numpy_for(self.rtol).maximum(1.0, least / self.rtol)
        return dataclasses.replace(self, **{name: factor * getattr(self, name) for name in names})

    def require(self, field: Field, t, x) -> None:
        """Raise a ValueError where the method cannot take this field; nothing is computed."""
        del field, t, x

    def require_at_start(self, field: Callable, t, x, args) -> None:
        """Raise a ValueError where the values at the start show that the method is not for this field (t, x, args)."""
        del field, t, x, args

    @abc.abstractmethod
    def step(self, field: Field, t, x, f, h) -> Step:
        """One step over h from (t, x), where f = field(t, x)."""

    @abc.abstractmethod
    def inside(self, dense, theta) -> Array:
        """The solution (n,) at the fraction theta of the step."""

    @property
    def sample_fractions(self) -> tuple[float, ...]:
        """Where in a step `samples` lie; by default at two points of an adaptive step."""
        return (PROBE, 1 - PROBE) if self.adaptive else ()

    def samples(self, field: Field, t, h, step: Step) -> list[tuple[Any, Array, Array]]:
        """Times, states (n,) and slopes (n,) inside the step, to see what guards do there."""
        times = [t + theta * h for theta in self.sample_fractions]
        points = [self.inside(step.dense, theta) for theta in self.sample_fractions]
        return [(time, point, field(time, point)) for time, point in zip(times, points, strict=True)]

    def tangent(self, field: Field, t, x, h, frame, stage_points: tuple[Array, ...] = ()) -> Tangent:
        """The derivative of the step over h from (t, x), applied to a frame (n, k).

        With the `stage_points` of that step it need not be computed again; () if they are not known.
        """
        del stage_points

        def step(x):
            done = self.step(field, t, x, field(t, x), h)
            return (done.x, done.error), done.nodes

        (new, _), linear, nodes = jax.linearize(step, x, has_aux=True)
        moved, errors = each_column(linear, frame)
        return Tangent(new, moved, errors, nodes)

    def rare_tangent(self, field: Field, t, x, h, frame, stage_points: tuple[Array, ...] = ()) -> Tangent:
        """`tangent`, for places that are executed rarely: short to compile rather than fast."""
        return self.tangent(field, t, x, h, frame, stage_points)

    @abc.abstractmethod
    def divergence(self, field: Field, nodes, h) -> Array:
        """∫ tr Df dt over the step, by a quadrature of the method's order."""

    def ratio(self, error, scale):
        """The error over the tolerance, in the maximum norm; a step is accepted below 1."""
        return jnp.max(jnp.abs(error[0]) / scale)

    def state_ratio(self, step: Step, x):
        """`ratio` of the state's error."""
        return self.ratio(step.error, self.atol + self.rtol * jnp.maximum(jnp.abs(x), jnp.abs(step.x)))

    def frame_ratio(self, errors, frame, new):
        """The largest `ratio` of the columns; the tolerance of a column is relative to its length."""

        def column(error, before, after):
            length = jnp.sqrt(jnp.mean(jnp.maximum(before**2, after**2)) + nonzero(1e-40, before))
            return self.ratio(error, jnp.full(before.shape, self.rtol * length + nonzero(1e-300, before)))

        return jnp.max(jax.vmap(column, in_axes=-1)(errors, frame, new))


class OfAnother(Method):
    """A method built on the steps of an inner method, from which it takes tolerances, order and step-size control."""

    @property
    @abc.abstractmethod
    def inner(self) -> Any:
        """The inner method, which makes the steps."""

    @property
    def rtol(self) -> Any:
        """That of the inner method."""
        return self.inner.rtol

    @property
    def atol(self) -> Any:
        """That of the inner method."""
        return self.inner.atol

    @property
    def fixed_step(self) -> Any:
        """That of the inner method."""
        return self.inner.fixed_step

    @property
    def longest_step(self) -> Any:
        """That of the inner method."""
        return self.inner.longest_step

    @property
    def error_order(self) -> int:
        """That of the inner method."""
        return self.inner.error_order

    @property
    def controller(self) -> Controller:
        """That of the inner method."""
        return self.inner.controller
