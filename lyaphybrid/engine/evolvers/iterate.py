"""The evolver of maps: every attempt is one iteration."""

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import jax
import jax.numpy as jnp

from ..._jax.columns import each_column
from ..._linalg import frames
from ...statuses import STATUS
from ..evolver import AbstractEvolver
from ..states import Clock, Settings, StepState, added, stop

__all__ = ["Iterating"]


@dataclasses.dataclass(frozen=True)
class Iterating(AbstractEvolver):
    """The evolver of maps and of hybrid systems without a flow. The time is the number of iterations."""

    rule: Callable  # (t, x) -> x

    always_regular: ClassVar[bool] = True
    spread_wanted: ClassVar[float] = 6.5  # costs three of sixteen digits; an iteration may cost less than a QR step

    def init(self, t, x, mode, h):
        """A map has no solver state."""
        del t, x, mode, h

    def onto_mode(self, mode, t, x):
        """There are no modes, and no constraints."""
        del mode, t, x

    def rebase(self, solver, s):
        """No time is stored."""
        del s
        return solver

    def which_shape(self, t, x):
        """What an event log stores as `which`."""
        del t, x
        return jax.ShapeDtypeStruct((), jnp.int32)

    def propose_step(self, carry: StepState, clock: Clock):
        """A map needs no proposal."""
        del carry, clock
        return ()

    def is_regular(self, ahead):
        """Every iteration is regular."""
        del ahead
        return True

    def locate_events(self, settings: Settings, clock: Clock, within, carry: StepState, ahead):
        """A map has no events to locate."""
        del settings, clock, within
        return carry, ahead

    def step(self, settings: Settings, clock: Clock, carry: StepState, ahead) -> StepState:
        """One iteration of the map and of its tangent."""
        del ahead
        t = clock.base + carry.s
        if carry.frame.shape[1] or carry.log_volume is not None:
            x, linear = jax.linearize(lambda x: self.rule(t, x), carry.x)
            frame = each_column(linear, carry.frame)
        else:  # the motion alone, also of a rule that has no derivative
            x, frame, linear = self.rule(t, carry.x), carry.frame, None
        since = carry.since + (0.0 if settings.qr_schedule.unit == "never" else 1.0)
        log_volume = None
        if linear and carry.log_volume is not None:
            log_volume = frames.log_abs_det(each_column(linear, jnp.eye(x.shape[0], dtype=x.dtype)))
        carry = added(
            carry._replace(x=x, frame=frame, since=since, jumps=carry.jumps + 1), s=1.0, log_volume=log_volume
        )
        return stop(carry, STATUS.nonfinite, ~jnp.all(jnp.isfinite(x)))

    def tangent(self, clock: Clock, carry: StepState, ahead) -> Callable:
        """The derivative dx (n,) -> (n,) of one iteration."""
        del ahead
        t, x = clock.base + carry.s, carry.x
        return lambda dx: jax.jvp(lambda x: self.rule(t, x), (x,), (dx,))[1]
