"""Formulas as JAX takes them."""

import jax.numpy as jnp


def stacked(formula):
    """``field(t, x, args)`` that returns an array."""
    components = formula(jnp)

    def field(t, x, args):
        return jnp.stack(components(t, x, args))

    return field
