"""A ball that falls onto the floor and bounces without loss, x = (height, velocity): its field, guard and reset."""

import jax.numpy as jnp


def falling(t, x, args):
    return jnp.stack([x[1], 0 * x[1] - 1.0])


def height(t, x, args):
    return x[0]


def bounce(t, x, args):
    return jnp.stack([x[0], -x[1]])
