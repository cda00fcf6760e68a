"""
When to kick an oscillator that hits a wall
===========================================

A van der Pol oscillator that strikes a wall once a turn. Left: the cycle, whose velocity jumps. Right: by how much time
a push is ahead for good, per unit of it: lines are the infinitesimal response from the tangent maps of the cycle with
the saltation matrix of the impact, dots are pushes of 0.05 to whole motions. At the impact the response jumps, too.
"""

import jax
import jax.numpy as jnp
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)


def field(t, x, args):
    return jnp.stack([x[1], 0.8 * (1 - x[0] ** 2) * x[1] - x[0]])


wall = lh.Transition(lambda t, x, args: x[0] + 1.2, lambda t, x, args: jnp.stack([x[0], -0.7 * x[1]]))
system = lh.Hybrid(field, wall, names=("x", "v"))
found = lh.phase_response(system, [1.0, 0.5], phases=200, transient=60.0)
print(found)

_, (cycle, ax) = pyplot.subplots(1, 2, figsize=(7.0, 3.2), layout="constrained", width_ratios=(1, 1.5))
cycle.plot(*found.x.T, ".", ms=2)
cycle.axvline(-1.2, color="gray", lw=2)
cycle.set(xlabel="x", ylabel="v")
found.plot(ax=ax)
some = range(0, 200, 8)
for i, kick in enumerate(([0.05, 0.0], [0.0, 0.05])):
    ax.plot(found.t[::8], found.finite(kick, at=some) / 0.05, "o", ms=3, color=lh.plots.COLOURS[i])
pyplot.show()
