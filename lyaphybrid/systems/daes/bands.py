"""How far from the diagonal the constraints of a banded DAE can depend on algebraic components."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.dependence import reach
from ..._linalg.linear_systems import separated, split
from .semi_linear import RANK, Banded

__all__ = ["places_away"]

BAND_SAMPLES = 16  # random states, where the functions do not show what depends on what
NEAREST_SAMPLE, FARTHEST_SAMPLE = 0.1, 10.0  # their distances from a state (standard deviation), relative to 1 + |x|


def places_away(field: Banded, t, x, args) -> Any:
    """The largest |i − j| for which constraint i can depend on the algebraic component j, at any time and state.

    It is read off the functions, with these args. Where they do more than can be followed (loops, solvers), the largest
    one at the state, and at random ones around it.
    """
    rows = field.rows(t, args)
    if not isinstance(rows, np.ndarray) or not separated(rows):  # the equations are solved with full matrices
        return jnp.zeros(())
    _, kernel = split(rows)
    there = kernel != 0
    of_any, last = np.any(there, axis=1), there.shape[1] - 1
    lowest = np.where(of_any, np.argmax(there, axis=1), np.inf)
    highest = np.where(of_any, last - np.argmax(there[:, ::-1], axis=1), -np.inf)

    def along(t, x, dx):
        return jax.jvp(lambda x: field.constraint(t, x, args), (x,), (dx,))[1]

    found = reach(along, (t, x), lowest, highest)
    if found is None:
        return _places_seen(field, kernel, t, x, args)
    i = jnp.arange(last + 1.0)
    return jnp.max(jnp.maximum(i - found[0], found[1] - i), initial=0)


def _places_seen(field: Banded, kernel: np.ndarray, t, x, args) -> Any:
    """The same from the values at states."""
    draw = np.random.default_rng(20102)
    sizes = np.concatenate([[0.0], np.geomspace(NEAREST_SAMPLE, FARTHEST_SAMPLE, BAND_SAMPLES)])
    steps = sizes[:, None] * draw.standard_normal((len(sizes), x.shape[0]))
    times = t + jnp.asarray(sizes * draw.standard_normal(len(sizes)))
    i = np.arange(kernel.shape[1])
    distance = np.abs(np.subtract.outer(i, i)).astype(float)

    def farthest(place):
        t, step = place
        size = jnp.abs(jax.jacfwd(lambda x: field.constraint(t, x, args))(x + step * (1 + jnp.abs(x))) @ kernel)
        size = jnp.where(jnp.isfinite(size), size, 0.0)  # outside the domain of a function
        return jnp.max(jnp.where(size > RANK * jnp.max(size), distance, 0.0))

    return jnp.max(jax.lax.map(farthest, (times, jnp.asarray(steps))))
