"""The state of the loop at the start of a run."""

import jax
import jax.numpy as jnp

from .._jax.columns import each_column
from .._jax.precision import is_short
from .._linalg import frames
from .._linalg.foreign_shares import shares_of_none
from ..statuses import RUNNING, STATUS
from . import waiting
from .orthonormalising import orthonormalise_and_accumulate
from .states import Compensation, EventLog, LoopState, Settings, StepState, stop, without_room

__all__ = ["initial_loop_state", "within_mode"]


def initial_loop_state(settings: Settings, t0, x, frame, mode, h, interval) -> LoopState:
    """The start of a run at (t0, x) with the given frame.

    Args:
        settings: static.
        t0: time.
        x: (n,) state.
        frame: (n, k); projected onto the tangent space of the mode.
        mode: index; None: the mode to which the state belongs. A negative index gives the status deadlock.
        h: the evolver's first step; None: estimated.
        interval: between orthonormalisations, in the unit of the QRSchedule.
    """
    k = frame.shape[1]
    mode = settings.evolver.initial_mode(t0, x) if mode is None else jnp.asarray(mode, jnp.int32)
    possible = mode >= 0
    mode = jnp.maximum(mode, 0)
    x, wrong = settings.evolver.admitted(t0, x, mode)
    zero, none = jnp.zeros_like(t0), jnp.zeros(k, x.dtype)
    tracks = settings.evolver.may_lose_rank and k > 0
    log_volume = zero if settings.sum_rule else None
    carry = StepState(
        s=zero,
        x=x,
        frame=frame,
        since=zero,
        budget=jnp.asarray(0, jnp.int32),
        status=jnp.asarray(RUNNING, jnp.int32),
        jumps=jnp.asarray(0, jnp.int32),
        growth=none,
        log_volume=log_volume,
        losses=jnp.zeros(k, jnp.int32) if tracks else None,
        first_loss=jnp.full(k, jnp.nan, x.dtype) if tracks else None,
        order=jnp.arange(k, dtype=jnp.int32) if tracks else None,
        foreign=shares_of_none(k, x) if tracks else None,
        solver_state=settings.evolver.init(t0, x, mode, h),
        log=_empty_log(settings, t0, x) if settings.log else None,
        left=Compensation(zero, none, log_volume) if is_short(x) else None,
        waiting=waiting.init(x, none, log_volume) if settings.count_jumps else None,
    )
    carry = stop(within_mode(settings, carry, t0, mode) if k else carry, STATUS.deadlock, ~possible)
    carry = stop(carry, STATUS.inconsistent_start, wrong)
    if settings.observer is not None:
        carry = carry._replace(observer=settings.observer.init(t0, carry.frame))
    return LoopState(carry, jnp.stack([t0, zero]), zero, jnp.asarray(0, jnp.int32), interval, zero)


def within_mode(settings: Settings, carry: StepState, t, mode) -> StepState:
    """Project the frame onto the tangent space of the mode; columns that this makes empty are lost before the run."""
    project = settings.evolver.onto_mode(mode, t, carry.x)
    if project is None:
        return carry
    carry = carry._replace(frame=each_column(project, carry.frame))
    if settings.qr_schedule.unit == "never":
        return carry
    kept = carry.growth, carry.order, carry.left, carry.losses
    unwatched = settings._replace(observer=None)
    least = 0.0 if carry.losses is None else frames.LOST
    carry, _ = orthonormalise_and_accumulate(unwatched, carry, t, least, least, project)
    carry = carry._replace(growth=kept[0], order=kept[1], left=kept[2], losses=kept[3])
    return carry if carry.losses is None else without_room(carry, t)


def _empty_log(settings: Settings, t, x) -> EventLog:
    room = settings.log
    integers = jnp.zeros(room, jnp.int32)
    which = jax.tree.map(lambda leaf: jnp.zeros(room, leaf.dtype), settings.evolver.which_shape(t, x))
    points = jnp.zeros((room, *x.shape), x.dtype)
    times = jnp.zeros(room, x.dtype)
    return EventLog(jnp.asarray(0, jnp.int32), times, integers, which, integers, integers, points, points)
