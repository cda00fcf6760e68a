"""
Where motions part
==================

A particle in a double well, driven, that strikes a wall at x = 1.25. The colours are the largest finite-time exponent
of each start, jumps included. Its ridges (white) are close to the stable manifold of the saddle between the wells,
folded by the wall.
"""

import jax
import jax.numpy as jnp
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)


def field(t, x, args):
    return jnp.stack([x[1], x[0] - x[0] ** 3 - 0.1 * x[1] + 0.15 * jnp.cos(1.2 * t)])


wall = lh.Transition(lambda t, x, args: 1.25 - x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]]))
system = lh.Hybrid(field, wall, names=("x", "v"))
method = lh.RungeKutta("dopri5", rtol=1e-8, atol=1e-10)
found = lh.ftle_field(system, [[-2.0, -1.5], [1.2, 1.5]], t1=12.0, shape=(240, 180), method=method)
print(found)

_, ax = pyplot.subplots(figsize=(7.0, 4.6), layout="constrained")
found.plot(ax=ax, vmin=0.0)
x, v = found.ridges(width=1.5, sharpest=0.15).T
ax.plot(x, v, ".", color="white", markersize=1.2, markeredgewidth=0)
pyplot.show()
