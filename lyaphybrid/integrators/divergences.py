"""The divergence of a field, tr Df: what the volume of a frame grows by, whatever its columns do."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jax.jaxprs import by_component, needed
from .base import Field

__all__ = ["quadrature", "trace"]

LONG = 100  # equations of a trace that is not to be written out for each node (sliding fields: 170 to 220)
FEW = 4  # up to so many components the diagonal of Df is written out, entry by entry


def quadrature(field: Field, weights, times, points) -> Array:
    """Σ w tr Df at the nodes (t, x) of a step, the numbers w known.

    Written out for each node the trace of a sliding field was nine tenths of the code of its mode.
    """
    nodes = [(float(w), *node) for w, *node in zip(weights, times, points, strict=True) if w != 0]
    if not _is_long(field, times[0], points[0]):
        first, *others = [weight * trace(field, t, x) for weight, t, x in nodes]
        return sum(others, first)
    weights, times, points = zip(*nodes, strict=True)
    kind = points[0].dtype
    columns = jnp.asarray(weights, kind), jnp.stack([jnp.asarray(t, kind) for t in times]), jnp.stack(points)

    def add(total, node):
        weight, t, x = node
        return total + weight * trace(field, t, x), None

    return jax.lax.scan(add, jnp.zeros((), kind), columns)[0]


def _is_long(field: Field, t, x) -> bool:
    closed = jax.make_jaxpr(lambda t, x: trace(field, t, x))(t, x)
    wanted = needed(closed)
    return sum(bool(wanted.intersection(eqn.outvars)) for eqn in closed.jaxpr.eqns) > LONG


def trace(field: Field, t, x) -> Array:
    """Tr Df at (t, x)."""
    n = x.shape[0]
    if n > FEW:
        return jnp.trace(jax.jacfwd(lambda y: field(t, y))(x))
    of_components = by_component(field, t, x)

    def entry(i: int):
        def component(value):
            return of_components([value if j == i else x[j] for j in range(n)])[i]

        return jax.jvp(component, (x[i],), (jnp.ones_like(x[i]),))[1]

    return jnp.sum(jnp.stack([entry(i) for i in range(n)]))
