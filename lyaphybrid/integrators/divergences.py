"""The divergence tr Df of a field: the rate of growth of the phase-space volume, independent of the frame."""

import weakref
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array

from .._jax.jaxprs import by_component, needed, written_out
from .base import Field

__all__ = ["quadrature", "trace"]

LONG_TRACE = 100  # a trace with more equations in its jaxpr is evaluated in a loop over the nodes (sliding: 170 to 220)
MOST_ENTRIES_ALONE = 4  # up to so many components the diagonal of Df is differentiated entry by entry


def quadrature(field: Field, weights, times, points) -> Array:
    """The sum Σ w tr Df over the nodes (t, x) of a step; the weights w are constants.

    A long trace, such as that of a sliding field, is a loop over the nodes: unrolled it would be most of the code.
    """
    of_field, is_long = _traced_once(field, times[0], points[0])
    nodes = [(float(w), *node) for w, *node in zip(weights, times, points, strict=True) if w != 0]
    if not is_long:
        first, *others = [weight * of_field(t, x) for weight, t, x in nodes]
        return sum(others, first)
    weights, times, points = zip(*nodes, strict=True)
    kind = points[0].dtype
    columns = jnp.asarray(weights, kind), jnp.stack([jnp.asarray(t, kind) for t in times]), jnp.stack(points)

    def add(total, node):
        weight, t, x = node
        return total + weight * of_field(t, x), None

    return jax.lax.scan(add, jnp.zeros((), kind), columns)[0]


# Of each field, while it exists: steps, landings and blocks of a program all ask for the trace of the same one.
_known: weakref.WeakKeyDictionary[Field, dict[tuple, tuple[Callable, bool]]] = weakref.WeakKeyDictionary()


def _traced_once(field: Field, t, x) -> tuple[Callable, bool]:
    """The trace of a field as a jitted function (t, x) ↦ tr Df, for a time and a state of these types; if it is long.

    It must not close over the field, which would then exist as long as this module.
    """
    known, types = _known.setdefault(field, {}), (jax.typeof(t), jax.typeof(x))
    if types not in known:
        closed = written_out(lambda t, x: trace(field, t, x), t, x)
        known[types] = jax.jit(lambda t, x: jaxpr_as_fun(closed)(t, x)[0]), _is_long(closed)
    return known[types]


def _is_long(closed: ClosedJaxpr) -> bool:
    wanted = needed(closed)
    return sum(bool(wanted.intersection(eqn.outvars)) for eqn in closed.jaxpr.eqns) > LONG_TRACE


def trace(field: Field, t, x) -> Array:
    """The divergence tr Df at (t, x)."""
    n = x.shape[0]
    if n > MOST_ENTRIES_ALONE:
        return jnp.trace(jax.jacfwd(lambda y: field(t, y))(x))
    of_components = by_component(field, t, x)

    def entry(i: int):
        def component(value):
            return of_components([value if j == i else x[j] for j in range(n)])[i]

        return jax.jvp(component, (x[i],), (jnp.ones_like(x[i]),))[1]

    return jnp.sum(jnp.stack([entry(i) for i in range(n)]))
