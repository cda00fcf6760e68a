"""
The motion on the boundary between two basins
=============================================

A damped, driven particle in a double well, with a wall at x = 1.25. Each start leads to one of the wells. What stays on
the boundary is followed by pairs of motions that are brought together again and again: here an unstable cycle, seen
once in each period.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)


def field(t, x, args):
    return jnp.stack([x[1], x[0] - x[0] ** 3 - 0.15 * x[1] + 0.05 * jnp.cos(1.2 * t)])


wall = lh.Transition(lambda t, x, args: 1.25 - x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]]))
system = lh.Hybrid(field, wall, names=("x", "v"))
turn = 2 * np.pi / 1.2
method = lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9)
found = lh.basins(system, [[-2.0, -2.0], [1.25, 2.0]], shape=(180, 180), t1=40 * turn, period=turn, method=method)
print(found)
edge = lh.edge_state(system, found, t1=40 * turn, settle=80 * turn, period=turn)
print(edge)
cycle = lh.floquet(system, edge.x[-1], period=turn)
print(f"multipliers of the cycle: {np.asarray(cycle.multipliers).round(3)}")

_, ax = pyplot.subplots(figsize=(7.0, 4.8), layout="constrained")
found.plot(ax=ax)
ax.plot(*cycle.x0, "o", color="white", markersize=8, markeredgecolor="black", label="on the boundary")
ax.legend(loc="upper right")
pyplot.show()
