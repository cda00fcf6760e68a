"""
Where stable and unstable directions touch
==========================================

A ball that bounces without loss on a plate that vibrates; height and speed are relative to the plate. The colour is the
angle between the stable and the unstable direction at each start, through all impacts of its past and its future. On
dark curves stable and unstable manifolds are nearly tangent. White: starts whose directions have not converged in this
time, among them those of regular motion, which have none.
"""

import jax
import jax.numpy as jnp
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)


def ball(sign):
    """Forwards, and with sign = −1 backwards, on the clock −t."""
    return lh.Hybrid(
        lambda t, x, a: sign * jnp.stack([x[1], a * jnp.cos(t) - 1.0]),
        lh.Transition(lambda t, x, a: x[0], lambda t, x, a: jnp.stack([x[0], -x[1]])),
        names=("height", "speed"),
    )


method = lh.RungeKutta("dop853", rtol=1e-11, atol=1e-13)
how = {"shape": (200, 150), "transient": 80.0, "inverse": ball(-1), "method": method}
found = lh.angle_field(ball(1), [[0.0, -1.6], [2.8, 1.6]], 0.8, **how)
print(found)

_, ax = pyplot.subplots(figsize=(7.0, 4.6), layout="constrained")
found.plot(ax=ax, within=0.01)
pyplot.show()
