"""The saltation matrix: how a perturbation crosses an event.

A neighbour at x + dx meets the guard later by δτ = -∇h·dx / (∂ₜh + ∇h·f⁻). Move it to its own instant, push
it through the reset, and come back along the new flow:

    dx⁺ = Dg (dx + f⁻ δτ) + ∂ₜg δτ - f⁺ δτ   =   S dx,
    S   = Dg + (f⁺ - Dg f⁻ - ∂ₜg) ∇h / (∂ₜh + ∇h·f⁻)        (with the sign of δτ absorbed)

M. di Bernardo, C. Budd, A. Champneys & P. Kowalczyk, Piecewise-smooth Dynamical Systems (Springer 2008),
section 2.5, doi:10.1007/978-1-84628-708-4. In a cascade the instant belongs to the first guard: only the push
is repeated. Nothing here forms an n×n matrix: columns are carried by `jax.jvp`.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

__all__ = ["advance_to_instant", "instant", "push", "return_along"]


def instant(guard, t, x, f):
    """The guard's derivatives at (t, x): ∇h (n,), and the rate ḣ = ∂ₜh + ∇h·f along the flow f."""
    rate_of_time, gradient = jax.grad(guard, argnums=(0, 1))(t, x)
    return gradient, rate_of_time, rate_of_time + jnp.sum(gradient * f)


def advance_to_instant(frame: Float[Array, "n k"], gradient, rate, f) -> tuple[Float[Array, "n k"], Float[Array, " k"]]:
    """Each column moved to its own instant, dx + f⁻ δτ; and δτ (k,)."""
    shift = -(gradient @ frame) / jnp.where(rate == 0, 1.0, rate)
    return frame + f[:, None] * shift[None, :], shift


def push(reset, t, x, columns: Float[Array, "n k"], shift: Float[Array, " k"]):
    """x⁺ = reset(t, x), and the columns through Dg dx + ∂ₜg δτ."""

    def column(dx, dt):
        return jax.jvp(reset, (t, x), (dt, dx))[1]

    return reset(t, x), jax.vmap(column, in_axes=(-1, 0), out_axes=-1)(columns, shift)


def return_along(columns: Float[Array, "n k"], f, shift: Float[Array, " k"]) -> Float[Array, "n k"]:
    """Back from the instants of the neighbours to that of the orbit, along the new flow: dx - f⁺ δτ."""
    return columns - f[:, None] * shift[None, :]
