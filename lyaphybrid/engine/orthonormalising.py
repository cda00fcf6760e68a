"""Orthonormalise the frame, add up the logarithms of its lengths, and replace the columns that are lost."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._linalg import frames, lost_directions
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
    """Whether columns are judged by their lengths alone, behind jumps that may do anything; and could be otherwise."""
    evolver = settings.evolver
    if settings.qr_schedule.unit == "never" or carry.frame.shape[1] == 0 or settings.reverse:
        return False
    if not (evolver.jumps_uncontrolled and evolver.may_lose_rank):
        return False
    return lost_directions.is_precise(evolver.tangent(clock, carry, ahead), carry.x)


def step_with_twice_the_digits(settings: Settings, clock: Clock, carry: StepState, ahead, interval, spread):
    """One step in twice the digits, and what it loses."""
    evolver, t = settings.evolver, clock.base + carry.s

    def orthonormal(carry, spread):  # the span goes on with a frame that the last one has left as it was
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
    spread = jnp.where(sure, spread, jnp.inf)
    return carry._replace(since=jnp.zeros_like(carry.since)), evolver.propose_step(carry, clock), interval, spread


def orthonormalise(settings: Settings, clock: Clock, carry: StepState, ahead, interval, spread):
    """Orthonormalise: where it is due, and at the end of a block so that the sum rule closes."""
    before, carry = (carry.growth, carry.left), settings.evolver.kept_to_constraints(carry, clock)
    if settings.evolver.jumps_uncontrolled and settings.evolver.may_lose_rank:
        # By time each jump that may destroy a direction is orthonormalised by itself.
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
    if settings.qr_schedule.automatic:
        # Growth varies, so an interval is never long: that of a map or a jump may do anything, that of a step is
        # bounded by its error control. Only where there are many bodies a jump does little to the whole.
        longest, bracket = settings.evolver.longest_interval, settings.evolver.spread_wanted
        full = carry.since >= interval
        wanted = jnp.clip(bracket * interval / jnp.maximum(seen, 1e-3), 0.5 * interval, 2 * interval)
        wanted = jax.lax.stop_gradient(wanted)
        interval = jnp.where(full | (wanted < interval), jnp.clip(jnp.floor(wanted), 1.0, longest), interval)
    return carry._replace(since=jnp.zeros_like(carry.since)), ahead, interval, spread


def orthonormalise_and_accumulate(
    settings: Settings,
    carry: StepState,
    t,
    absolute: Any = 0.0,
    relative=0.0,
    project=None,
    was_live: Any = True,
    sizes=None,
) -> tuple[StepState, Array]:
    """Orthonormalise the frame and add ln R_ii to the growth; also returns ln R_ii of the columns as they stood.

    Where a tolerance is given columns may be lost: they are counted, and replaced.

    Args:
        settings: static.
        carry: with the frame.
        t: the time, for the record.
        absolute: tolerance of `frames.orthonormalise`.
        relative: the same.
        project: onto the tangent space of the mode; None: there is no constraint.
        was_live: (k,), columns that were not empty before.
        sizes: of `frames.orthonormalise`.
    """
    found = frames.orthonormalise(carry.frame, settings.kind, absolute, relative, sizes)
    return accumulate(settings, carry, t, found, frames.tracked(relative), project, was_live), found[1]


def accumulate(
    settings: Settings, carry: StepState, t, found, tracked=True, project=None, was_live: Any = True
) -> StepState:
    """What an orthonormalisation of the frame has found: columns, ln R_ii, and which are lost."""
    frame, log_r, lost = found
    if settings.observer is not None:
        seen = Orthonormalisation(
            t, carry.frame, frame, log_r, lost, lambda: settings.evolver.velocity(t, carry.x, carry.solver_state)
        )
        carry = carry._replace(observer=settings.observer.update(carry.observer, seen))
    carry = added(carry._replace(frame=frame), growth=log_r)
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
            observer=None if settings.observer is None else settings.observer.moved(carry.observer, source),
        )

    return jax.lax.cond(jnp.all(live), lambda c, *_: c, replace, carry, lost, live)
