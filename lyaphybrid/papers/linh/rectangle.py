"""The quadrature of the continuous algorithm that explains the errors of Table 8 of Linh, Truong & Tuyen."""

import jax.numpy as jnp

from ...integrators import ContinuousQR
from ...integrators.base import Method
from ...integrators.implicit.linearised import linearised

__all__ = ["RightRectangle"]


class RightRectangle(ContinuousQR):
    """Algorithm 3.3 with φ(t + h) = φ(t) + h w(t + h), whose error is not controlled."""

    def __init__(self, method: Method):
        super().__init__(method)

    def frame_ratio(self, errors, frame, new):
        """The error ratio of Q alone."""
        return self.method.frame_ratio(errors[:, :-1], frame, new)

    def tangent(self, field, t, x, h, frame, stage_points=()):
        """Q after the step, and the growth of φ."""
        done = super().tangent(field, t, x, h, frame, stage_points)
        end = self.method.points_on(field, t, h, stage_points)[-1] if stage_points else done.x
        turning = linearised(field, t + h, end).derivative(done.frame)
        return done._replace(growth=h * jnp.sum(done.frame * turning, axis=0))
