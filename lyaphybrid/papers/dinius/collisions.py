"""Perturbations of two disks at a collision: Dinius' rule, and four wrong ones to compare with.

With q, p, δq, δp differences of the second disk minus the first, δτ = −m δq·q/(p·q) and δq_c = δq + p δτ/m, the rule is

    δq₁⁺ = δq₁ + (q·δq) q/σ²                                    δq₂⁺ = δq₂ − …
    δp₁⁺ = δp₁ + [(δp·q + δq_c·p) q + (p·q) δq_c]/σ²            δp₂⁺ = δp₂ − …

The paper prints δq for the last q of the first line and leaves out the first δ of the second, which makes it
nonlinear. The four wrong rules here are linear and keep the sum of the exponents zero, so the sum rule detects none.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp

from ...systems.event_driven import EventDriven

__all__ = ["MISTAKES", "Mistake", "collide", "crossing_by"]


@dataclasses.dataclass(frozen=True)
class Mistake:
    """A wrong rule for perturbations at a collision.

    Attributes:
        name: what is wrong.
        jump: factor of the jump of δq: 1 is right, 0 omits it.
        shift: factor of δτ in δq_c: 1 is right, 0 omits it, −1 has the wrong sign.
        exponents: (16,) of the independent reference with this rule.

    Example:
        >>> from lyaphybrid.papers.dinius import collisions
        >>> [mistake.name for mistake in collisions.MISTAKES]
        ['no time shift at all', 'δq for δq_c', 'jump of δq forgotten', 'wrong sign of δτ']
    """

    name: str
    jump: float
    shift: float
    exponents: tuple[float, ...]


MISTAKES = (
    Mistake(
        "no time shift at all",
        0.0,
        0.0,
        (3.9561, 3.6378, 3.3592, 3.0909, 2.8004, 2.4408, 0.0001, 0.0001)
        + (-0.0001, -0.0001, -2.4333, -2.8096, -3.0986, -3.3862, -3.6679, -3.8896),
    ),
    Mistake(
        "δq for δq_c",
        1.0,
        0.0,
        (2.979, 2.3944, 1.872, 1.3816, 0.9034, 0.3738, 0.0001, 0.0001)
        + (-0.0001, -0.0001, -0.3724, -0.8995, -1.3872, -1.8751, -2.395, -2.975),
    ),
    Mistake(
        "jump of δq forgotten",
        0.0,
        1.0,
        (3.8348, 3.1221, 2.4074, 1.5679, 0.7431, 0.0001, 0.0001, -0.0)
        + (-0.0001, -0.0001, -0.498, -1.0891, -1.622, -2.2273, -2.801, -3.4378),
    ),
    Mistake(
        "wrong sign of δτ",
        1.0,
        -1.0,
        (4.3763, 3.9154, 3.487, 2.9919, 2.3235, 1.3954, 0.0001, 0.0001)
        + (-0.0001, -0.0001, -1.3967, -2.324, -2.9926, -3.4877, -3.9133, -4.3753),
    ),
)


def crossing_by(rule: Callable, system: EventDriven) -> EventDriven:
    """The same motion, with a given rule for perturbations at events in place of the saltation matrix.

    The engine moves each perturbation to its own event time, applies the derivative of `jump`, and moves it
    back along the new flow. Here `jump` gets a derivative that cancels both moves around the rule.

    Args:
        rule: ``(t, x, args, which, dx) -> dx⁺``, linear in dx (n,), x before the jump; as invertible as the system's.
        system: an `lh.EventDriven`.

    Returns:
        An `lh.EventDriven`.
    """

    def velocity(t, x, args):
        zero = jnp.zeros_like(t)
        return jax.jvp(lambda dt: system.flow(dt, t, x, args), (zero,), (jnp.ones_like(t),))[1]

    @jax.custom_jvp
    def jump(t, x, args, which):
        return system.jump(t, x, args, which)

    @jump.defjvp
    def _(primals, tangents):
        (t, x, args, which), (shift, dx, *_) = primals, tangents
        new = system.jump(t, x, args, which)
        dx = rule(t, x, args, which, dx - velocity(t, x, args) * shift)
        return new, dx + velocity(t, new, args) * shift

    keeps_volume = system.canonical or system.invertible
    return EventDriven(
        flow=system.flow, next_event=system.next_event, jump=jump, guard=system.guard, invertible=keeps_volume
    )


def collide(t, x, args, which, dx):
    """Dinius' rule for a pair of disks, with the factors args["jump"] and args["shift"]: 1 is right."""
    del t
    n = x.shape[0] // 4
    disk, size, pair = jnp.arange(n, dtype=which.dtype), jnp.asarray(n, which.dtype), jnp.maximum(which, 0)
    first, second = (disk == jax.lax.div(pair, size)), (disk == jax.lax.rem(pair, size))
    sign = second.astype(x.dtype) - first.astype(x.dtype)  # all 0 without a collision
    q, p = jnp.sum(sign[None, :, None] * x.reshape(2, n, 2), axis=1)
    dq, dp = jnp.sum(sign[None, :, None] * dx.reshape(2, n, 2), axis=1)
    box = jnp.stack([jnp.asarray(args["width"], x.dtype), jnp.asarray(args["height"], x.dtype)])
    q = q - box * jnp.round(q / box)
    approach = jnp.sum(p * q)
    behind = jnp.sum(dq * q) / jnp.where(approach == 0, 1.0, approach)  # −δτ/m
    synchronous = dq - args["shift"] * behind * p
    transfer = (jnp.sum(dp * q) + jnp.sum(synchronous * p)) * q + approach * synchronous
    jumps = jnp.stack([args["jump"] * jnp.sum(q * dq) * q, transfer]) / args["diameter"] ** 2
    return dx - (sign[None, :, None] * jumps[:, None, :]).reshape(dx.shape)
