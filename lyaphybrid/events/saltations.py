"""The saltation matrix: how a perturbation crosses an event.

A neighbour at x + dx meets the guard later by δτ = -∇h·dx / (∂ₜh + ∇h·f⁻). Move it to its own event time, apply
the reset, and move it back in time along the new flow:

    dx⁺ = Dg (dx + f⁻ δτ) + ∂ₜg δτ - f⁺ δτ   =   S dx,
    S   = Dg + (f⁺ - Dg f⁻ - ∂ₜg) ∇h / (∂ₜh + ∇h·f⁻)        (with the sign of δτ absorbed)

M. di Bernardo, C. Budd, A. Champneys & P. Kowalczyk, Piecewise-smooth Dynamical Systems (Springer 2008),
section 2.5, doi:10.1007/978-1-84628-708-4. All neighbours are moved along the same direction f⁻, which the reset
maps to Dg f⁻ + ∂ₜg; direction and columns are pushed forward separately. In a cascade the event time is that of the
first guard, and only the pushforward is repeated. No n×n matrix is formed: columns are mapped by `jax.jvp`.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._jax.columns import each_column
from .._jax.magnitudes import absolute

__all__ = [
    "Sizes",
    "event_time",
    "event_time_shifts",
    "instant",
    "pushforward",
    "to_reference_time",
    "sizes_at",
    "sizes_pushed",
    "sizes_returned",
]


class Sizes(NamedTuple):
    """Magnitudes of the terms that add up to columns, direction and event-time shifts, see `_jax.magnitudes`."""

    columns: Array  # (n, k)
    direction: Array  # (n,)
    event_time_shift: Array  # (k,)


def instant(guard, t, x, f):
    """The guard's derivatives at (t, x): ∇h (n,), ∂ₜh, and the rate ḣ = ∂ₜh + ∇h·f along the flow f."""
    rate_of_time, gradient = jax.grad(guard, argnums=(0, 1))(t, x)
    return gradient, rate_of_time, rate_of_time + jnp.sum(gradient * f)


def event_time_shifts(slopes: Float[Array, " k"], rate) -> Float[Array, " k"]:
    """How much later each column meets the guard, δτ (k,), from ∇h·dx (k,) and the guard's rate."""
    return -slopes / jnp.where(rate == 0, 1.0, rate)


@eqx.filter_custom_jvp
def event_time(t, in_time, guard, operands):
    """The time t of an event with the derivatives that its guard gives, for however it was found.

    Args:
        t: the time.
        in_time: whether guard(t, operands) = 0 holds there; where not, t keeps its own derivatives.
        guard: (t, operands) -> number, which closes over nothing that is traced.
        operands: a pytree.
    """
    del in_time, guard, operands
    return t


@event_time.def_jvp
def _(primals, tangents):
    t, in_time, guard, operands = primals
    own, _, _, changes = tangents
    own = jnp.zeros_like(t) if own is None else own
    t = event_time(t, in_time, guard, operands)  # for derivatives of this derivative
    if not jax.tree.leaves(changes):
        return t, own
    slope = eqx.filter_jvp(lambda operands: guard(t, operands), (operands,), (changes,))[1]
    slope = jnp.zeros_like(t) if slope is None else slope  # the guard depends on nothing that changes
    rate = jax.jvp(lambda t: guard(t, operands), (t,), (jnp.ones_like(t),))[1]
    return t, jnp.where(in_time, event_time_shifts(slope, rate), own)


def pushforward(reset, t, x, columns: Float[Array, "n k"], direction: Float[Array, " n"]):
    """x⁺ = reset(t, x) (n,), the columns Dg dx (n, k), and the direction Dg f + ∂ₜg (n,)."""

    def column(dx):
        return jax.jvp(lambda x: reset(t, x), (x,), (dx,))[1]

    new, direction = jax.jvp(reset, (t, x), (jnp.ones_like(t), direction))
    return new, each_column(column, columns), direction


def to_reference_time(
    columns: Float[Array, "n k"], direction, f, event_time_shift: Float[Array, " k"]
) -> Float[Array, "n k"]:
    """From the neighbours' event times, dx + direction δτ, to the orbit's along the new flow: - f⁺ δτ."""
    return columns + (direction - f)[:, None] * event_time_shift[None, :]


def sizes_at(columns: Float[Array, "n k"], f, gradient, moving, rate) -> Sizes:
    """`Sizes` of columns on a guard with the derivatives ∇h, ∂ₜh and ḣ; a cancelling ḣ makes the shifts uncertain."""
    columns, f, gradient = (jax.lax.stop_gradient(jnp.abs(one)) for one in (columns, f, gradient))
    moving, rate = (jax.lax.stop_gradient(jnp.abs(one)) for one in (moving, jnp.where(rate == 0, 1.0, rate)))
    return Sizes(columns, f, gradient @ columns / rate * ((gradient @ f + moving) / rate))


def sizes_pushed(reset, t, x, sizes: Sizes, direction: Float[Array, " n"]) -> Sizes:
    """`Sizes` after `pushforward`, whose new direction is given."""

    def through(dx):
        return jax.jvp(lambda x: reset(t, x), (x,), (dx,))[1]

    both = each_column(absolute(through), jnp.concatenate([sizes.columns, sizes.direction[:, None]], axis=1))
    columns, moved = jax.lax.stop_gradient((both[:, :-1], both[:, -1] + jnp.abs(direction)))
    return Sizes(columns, moved, sizes.event_time_shift)


def sizes_returned(sizes: Sizes, f) -> Float[Array, "n k"]:
    """(n, k) magnitudes of the terms of the columns that `to_reference_time` returns."""
    return (
        sizes.columns + (sizes.direction + jax.lax.stop_gradient(jnp.abs(f)))[:, None] * sizes.event_time_shift[None, :]
    )
