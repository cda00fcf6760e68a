"""The divergence of a field, tr Df: what the volume of a frame grows by, whatever its columns do."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jaxprs import part_of
from .base import Field

__all__ = ["trace"]

FEW = 4  # up to so many components the diagonal of Df is written out, entry by entry


def trace(field: Field, t, x) -> Array:
    """Tr Df at (t, x)."""
    n = x.shape[0]
    if n > FEW:
        return jnp.trace(jax.jacfwd(lambda y: field(t, y))(x))
    by_component = _by_component(field, t, x)

    def entry(i: int):
        def component(value):
            return by_component([value if j == i else x[j] for j in range(n)])[i]

        return jax.jvp(component, (x[i],), (jnp.ones_like(x[i]),))[1]

    return jnp.sum(jnp.stack([entry(i) for i in range(n)]))


def _by_component(field: Field, t, x):
    """The field at t as a function of the list of components.

    Where the field itself reads x one component at a time, the list goes in as it is: a component that is held
    fixed then has no derivative at all, instead of one that is zero, which XLA goes on multiplying with.
    """
    closed = jax.make_jaxpr(field)(t, x)
    time, point = closed.jaxpr.invars
    reads = [eqn for eqn in closed.jaxpr.eqns if point in eqn.invars]
    rest = [eqn for eqn in closed.jaxpr.eqns if point not in eqn.invars]
    one_by_one = all(eqn.primitive.name == "slice" and eqn.outvars[0].aval.shape == (1,) for eqn in reads)
    if not one_by_one or point in closed.jaxpr.outvars:
        return lambda components: field(t, jnp.stack(components))
    of_reads = part_of(closed, rest, [time, *(eqn.outvars[0] for eqn in reads)], closed.jaxpr.outvars)
    which = [eqn.params["start_indices"][0] for eqn in reads]
    return lambda components: of_reads(t, *(components[i][None] for i in which))[0]
