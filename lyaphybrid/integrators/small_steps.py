"""Steps so small that a Taylor polynomial of the second degree is exact: from the end of a step onto a guard."""

import functools

import jax
import jax.numpy as jnp

from .._jax.columns import each_column
from .divergences import trace

__all__ = ["flown", "moved_on", "rates_of_flow"]


def rates_of_flow(field, t, x):
    """The first and second time derivatives (n,) of the state along the flow."""
    return jax.jvp(field, (t, x), (jnp.ones_like(t), field(t, x)))


def flown(field, step, rates_of_flow, t, x, frame, log_volume):
    """A tiny step of the state, to second order, and of the frame and ∫ tr Df dt, to first."""
    f, second = rates_of_flow

    def slope(dx):
        return jax.jvp(lambda y: field(t, y), (x,), (dx,))[1]

    log_volume = None if log_volume is None else log_volume + step * trace(field, t, x)
    return x + step * (f + 0.5 * step * second), frame + step * each_column(slope, frame), log_volume


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def moved_on(field, numbers, step, t, x, frame, log_volume):
    """The state (n,), frame (n, k) and ∫ tr Df dt after a step along the flow whose length is 0, but has derivatives.

    First and second derivatives are exact. The field is a function (numbers, t, x) -> dx/dt that closes over nothing
    that is traced; t, x, frame and log_volume (or None) are those before the step.
    """
    del field, numbers, step, t
    return x, frame, log_volume


@moved_on.defjvp
def _(field, primals, tangents):
    numbers, step, t, x, frame, log_volume = primals
    of_numbers, of_step, of_t, *own = tangents

    def rates(numbers, t, x, frame):
        f, linear = jax.linearize(lambda x: field(numbers, t, x), x)
        divergence = None if log_volume is None else trace(lambda t, x: field(numbers, t, x), t, x)
        return f, each_column(linear, frame), divergence

    # z' = 𝓕(z) of all of this: the perturbations dz grow by step D𝓕 dz, and the end moves by 𝓕(z) d(step).
    after = moved_on(field, *primals)
    growing = jax.jvp(rates, (numbers, t, x, frame), (of_numbers, of_t, *own[:2]))[1]
    along = rates(numbers, t + step, *after[:2])
    return after, jax.tree.map(lambda dz, growth, rate: dz + step * growth + of_step * rate, tuple(own), growing, along)
