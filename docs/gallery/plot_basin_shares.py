"""
How basins change with a parameter
==================================

A driven particle in a double well with a wall at x = 1.25. The shares of random starts that each attractor draws, over
the strength of the drive, with error bars. Attractors are matched from value to value: colours go with them.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)


def field(t, x, args):
    return jnp.stack([x[1], x[0] - x[0] ** 3 - 0.15 * x[1] + args["drive"] * jnp.cos(1.2 * t)])


wall = lh.Transition(lambda t, x, args: 1.25 - x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]]))
system = lh.Hybrid(field, wall, names=("x", "v"))
turn = 2 * np.pi / 1.2
found = lh.basin_shares(
    system,
    [[-2.0, -2.0], [1.25, 2.0]],
    {"drive": 0.0},
    over={"drive": np.linspace(0.02, 0.3, 22)},
    t1=60 * turn,
    starts=800,
    key=jax.random.key(0),
    period=turn,
    method=lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9),
)
print(found)
found.plot(ax=pyplot.subplots(figsize=(7.0, 3.8), layout="constrained")[1])
pyplot.show()
