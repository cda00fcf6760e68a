"""
Chaos or a cycle?
=================

A particle in a double well, driven, that strikes a wall at x = 1.25. One half of the starts end on a cycle in the left
well, the others in chaos at the wall. The boundary between the two basins is a fractal: its dimension is measured from
the shares of pairs of starts, at several distances, that are of both kinds.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)


def field(t, x, args):
    return jnp.stack([x[1], x[0] - x[0] ** 3 - 0.15 * x[1] + 0.15 * jnp.cos(1.2 * t)])


wall = lh.Transition(lambda t, x, args: 1.25 - x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]]))
system = lh.Hybrid(field, wall, names=("x", "v"))
turn = 2 * np.pi / 1.2
found = lh.basins(
    system, [[-2.0, -2.0], [1.25, 2.0]], shape=(160, 160), t1=40 * turn, period=turn,
    method=lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9),
)  # fmt: skip
boundary = found.boundary_dimension()
print(found)
print(f"dimension of the boundary {boundary.dimension:.2f} ± {boundary.stderr:.2f}")

_, ax = pyplot.subplots(figsize=(7.0, 4.6), layout="constrained")
found.plot(ax=ax)
pyplot.show()
