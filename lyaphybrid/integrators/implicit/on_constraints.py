"""Base class of the Runge–Kutta methods for E(t) x' = f(t, x): error control and dense output."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..._arguments import is_one_of, positive, require
from ..._jax.precision import nonzero
from ...systems.daes.points import PointTolerance
from ..base import Controller, Field, Method
from ..runge_kutta import hermite

__all__ = ["ConstrainedMethod", "check_control"]


class ConstrainedMethod(Method):
    """A method that integrates the differential part E₁ x and satisfies the constraints in all of its stages."""

    rtol: eqx.AbstractVar[Any]
    atol: eqx.AbstractVar[Any]
    control: eqx.AbstractVar[str]

    controller: ClassVar[Controller] = Controller(safety=0.9, shrink=0.2, grow=5.0, now=1.0, last=0.0)  # (13), (14)
    keeps_constraints: ClassVar[bool] = True
    takes_slope: ClassVar[bool] = False
    each_step: ClassVar[bool] = True  # keeps columns well conditioned: R is then known to the tolerance

    @property
    def point_tolerance(self) -> PointTolerance:
        """How well the equations of stages are solved."""
        return PointTolerance(self.rtol, self.atol)

    @property
    def fixed_step(self) -> Any:
        """None: the error estimate controls h."""
        return None

    def solves(self, field: Field) -> bool:
        """True: the stages solve for the constraints."""
        del field
        return True

    def blank_stage_points(self, x):
        """Zeros with the shape of the stage points, or of their differential parts."""
        return (jnp.zeros((self.stage_count, *x.shape), x.dtype),)

    def inside(self, dense, theta):
        """The cubic Hermite interpolant of the step at the fraction theta."""
        x0, f0, x1, f1, h = dense
        return hermite(theta, x0, h * f0, x1, h * f1)

    def frame_ratio(self, errors, frame, new):
        """The error over the tolerance for the columns, each in units of its length at the start of the step."""
        length = jnp.sqrt(jnp.sum(frame**2, axis=0) + nonzero(1e-40, frame))
        return jnp.max(jnp.abs(errors[0]) / (self.rtol * (length[None, :] + jnp.abs(new))))


def check_control(rtol, atol, control) -> None:
    """Raise a ValueError on a tolerance or a control that does not fit."""
    require(
        is_one_of(control, ("x", "xY")),
        f"control must be 'xY' (state and frame) or 'x' (state alone); got {control!r}.",
    )
    positive("rtol", rtol)
    positive("atol", atol)
