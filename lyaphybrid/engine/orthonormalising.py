"""Orthonormalise the frame, accumulate ln R_ii, and replace the columns that are lost."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._linalg import foreign_shares, frames, lost_directions
from ..statuses import STATUS
from .states import Clock, Orthonormalisation, Settings, StepState, added, select, stop

__all__ = [
    "accumulate",
    "orthonormalise_and_accumulate",
    "needs_twice_the_digits",
    "orthonormalise",
    "step_with_twice_the_digits",
]


def needs_twice_the_digits(settings: Settings, clock: Clock, carry: StepState, ahead) -> bool:
    """Whether lost columns must be told from short ones in double-double arithmetic, and the tangent allows it."""
    evolver = settings.evolver
    if settings.qr_schedule.unit == "never" or carry.frame.shape[1] == 0 or settings.reverse:
        return False
    if not (evolver.jumps_uncontrolled and evolver.may_lose_rank):
        return False
    return lost_directions.is_precise(evolver.tangent(clock, carry, ahead), carry.x)


def step_with_twice_the_digits(settings: Settings, clock: Clock, carry: StepState, ahead, interval, spread):
    """One step whose tangent is orthonormalised in double-double arithmetic, to see which columns it loses."""
    evolver, t = settings.evolver, clock.base + carry.s

    def orthonormal(carry, spread):  # the frame may not be orthonormal where a span begins
        carry, gained = orthonormalise_and_accumulate(settings, carry, t, -jnp.inf, frames.DEPENDENT)
        return carry, jnp.maximum(spread, jnp.max(gained) - jnp.min(gained))

    carry, spread = jax.lax.cond(carry.since > 0, orthonormal, lambda *same: same, carry, spread)
    before, tangent = carry, evolver.tangent(clock, carry, ahead)
    carry = evolver.once(settings, clock, carry._replace(budget=carry.budget - 1), ahead)
    if carry.log_volume is not None:
        left = carry.left and before.left and carry.left._replace(log_volume=before.left.log_volume)
        carry = carry._replace(log_volume=before.log_volume, left=left)
        carry = added(carry, log_volume=lost_directions.log_volume(tangent, len(carry.x), carry.x.dtype))
    *found, sure = lost_directions.orthonormalised(tangent, before.frame)
    sane = jnp.all(jnp.isfinite(found[1]))
    found[1] = jnp.where(sane, found[1], 0.0)
    carry = stop(accumulate(settings, carry, clock.base + carry.s, found), STATUS.nonfinite, ~sane)
    interval = jnp.ones_like(interval) if settings.qr_schedule.automatic else interval
    spread = jnp.where(sure, _spread_with_losses(carry, spread), jnp.inf)
    carry = carry._replace(since=jnp.zeros_like(carry.since))
    return carry, evolver.propose_step(carry, clock), interval, spread


def orthonormalise(settings: Settings, clock: Clock, carry: StepState, ahead, interval, spread):
    """Orthonormalise the frame and adapt the interval; at the end of a block too, so that the sum rule holds."""
    before, carry = (carry.growth, carry.left), settings.evolver.kept_to_constraints(carry, clock)
    if settings.evolver.jumps_uncontrolled and settings.evolver.may_lose_rank:
        # In the unit "time" every jump that may destroy a direction makes an orthonormalisation due by itself.
        jumps = 1.0 if settings.qr_schedule.unit == "time" else carry.since
        absolute = settings.evolver.least_length(carry, jumps)
        carry, gained = orthonormalise_and_accumulate(settings, carry, clock.base + carry.s, absolute, frames.DEPENDENT)
    else:
        carry, gained = orthonormalise_and_accumulate(settings, carry, clock.base + carry.s)
    seen = jnp.maximum(jnp.max(gained), 0.0) - jnp.minimum(jnp.min(gained), 0.0)
    sane = jnp.isfinite(seen)
    growth, left = select(sane, (carry.growth, carry.left), before)
    carry = stop(carry._replace(growth=growth, left=left), STATUS.nonfinite, ~sane)
    spread = jnp.maximum(spread, jnp.where(sane, seen, 0.0))
    spread = _spread_with_losses(carry, spread)
    if settings.qr_schedule.automatic:
        # Growth varies, so intervals stay short: an iteration or a jump may stretch by any factor; for a step the error
        # control bounds it. Only with many bodies one jump changes little of the frame.
        longest, bracket = settings.evolver.longest_interval, settings.evolver.spread_wanted
        full = carry.since >= interval
        wanted = jnp.clip(bracket * interval / jnp.maximum(seen, 1e-3), 0.5 * interval, 2 * interval)
        wanted = jax.lax.stop_gradient(wanted)
        interval = jnp.where(full | (wanted < interval), jnp.clip(jnp.floor(wanted), 1.0, longest), interval)
    return carry._replace(since=jnp.zeros_like(carry.since)), ahead, interval, spread


def _spread_with_losses(carry: StepState, spread):
    """The spread; infinite where a column has become rounding along columns that replace lost ones."""
    return spread if carry.foreign is None else jnp.where(foreign_shares.is_foreign(carry.foreign), jnp.inf, spread)


def orthonormalise_and_accumulate(
    settings: Settings,
    carry: StepState,
    t,
    absolute: Any = 0.0,
    relative=0.0,
    project=None,
) -> tuple[StepState, Array]:
    """Orthonormalise the frame and add ln R_ii to the growth; also returns ln R_ii (k,), before columns are permuted.

    If a tolerance is given, lost columns are counted and replaced.

    Args:
        settings: static.
        carry: state with the frame (n, k).
        t: the time, for `first_loss` and the observer.
        absolute: tolerance, see `frames.orthonormalise`.
        relative: tolerance, see `frames.orthonormalise`.
        project: projection onto the tangent space of the mode; None: no constraint.
    """
    found = frames.orthonormalise(carry.frame, settings.kind, absolute, relative)
    return accumulate(settings, carry, t, found, frames.tracked(relative), project), found[1]


def accumulate(
    settings: Settings, carry: StepState, t, found, tracked=True, project=None, was_live: Any = True
) -> StepState:
    """Take over the result (columns, ln R_ii, lost) of an orthonormalisation; lost columns are counted and replaced.

    `was_live`: (k,) columns that were not empty before.
    """
    frame, log_r, lost = found
    if settings.observer is not None:
        seen = Orthonormalisation(
            t, carry.frame, frame, log_r, lost, lambda: settings.evolver.velocity(t, carry.x, carry.solver_state)
        )
        carry = carry._replace(observer=settings.observer.update(carry.observer, seen))
    carry = added(carry._replace(frame=frame), growth=log_r)
    if carry.foreign is not None:
        gained = jax.lax.stop_gradient(log_r)
        carry = carry._replace(foreign=foreign_shares.shares_after(carry.foreign, gained, lost))
    if not tracked:
        return carry
    live, lost = ~lost, lost & was_live

    def replace(carry, lost, live):
        frame, source = frames.refill(carry.frame, project or (lambda dx: dx), live)
        count = jnp.sum(live)
        places = jnp.arange(live.shape[0])
        now = (places >= count) & (places < count + jnp.sum(lost))
        first = carry.first_loss[source]
        first = jnp.where(jnp.isnan(first) & now, t, first)
        return carry._replace(
            frame=frame,
            growth=carry.growth[source],
            left=carry.left and carry.left._replace(growth=carry.left.growth[source]),
            losses=carry.losses[source] + now.astype(jnp.int32),
            first_loss=first,
            order=carry.order[source],
            foreign=foreign_shares.rearranged(carry.foreign, source, places >= count),
            observer=None if settings.observer is None else settings.observer.moved(carry.observer, source),
        )

    return jax.lax.cond(jnp.all(live), lambda c, *_: c, replace, carry, lost, live)
