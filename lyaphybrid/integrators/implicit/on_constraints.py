"""Base class of the Runge–Kutta methods for E(t) x' = f(t, x): error control and dense output."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from ..._arguments import is_one_of, positive, require
from ..._jax.precision import nonzero
from ..base import Controller, Field, Method, Step
from ..runge_kutta import hermite

__all__ = ["ConstrainedMethod", "check_control"]


class ConstrainedMethod(Method):
    """A method that integrates the differential part E₁ x and satisfies the constraints in all of its stages."""

    rtol: eqx.AbstractVar[Any]
    control: eqx.AbstractVar[str]

    controller: ClassVar[Controller] = Controller(safety=0.9, shrink=0.2, grow=5.0, now=1.0, last=0.0)  # (13), (14)
    keeps_constraints: ClassVar[bool] = True
    takes_slope: ClassVar[bool] = False
    each_step: ClassVar[bool] = True  # keeps columns well conditioned: R is then known to the tolerance

    @property
    def atol(self) -> Any:
        """Equal to rtol: errors are compared with rtol (1 + |x|)."""
        return self.rtol

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

    def state_ratio(self, step: Step, x):
        """The largest error of a component, over rtol (1 + |x|) (13)."""
        del x
        return self.ratio(step.error, self.rtol * (1 + jnp.abs(step.x)))

    def frame_ratio(self, errors, frame, new):
        """The same for the columns, each in units of its length at the start of the step."""
        length = jnp.sqrt(jnp.sum(frame**2, axis=0) + nonzero(1e-40, frame))
        return jnp.max(jnp.abs(errors[0]) / (self.rtol * (length[None, :] + jnp.abs(new))))


def check_control(rtol, control) -> None:
    """Raise a ValueError on a tolerance or a control that does not fit."""
    require(
        is_one_of(control, ("x", "xY")),
        f"control must be 'xY' (state and frame) or 'x' (state alone); got {control!r}.",
    )
    positive("rtol", rtol)
