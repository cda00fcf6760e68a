"""
Rössler's attractor and its return map
======================================

Each turn of the band cuts a plane once. The next cut against this one is nearly a curve with one turning point: a
flow in three dimensions that behaves like the logistic map.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

problem = lh.zoo.rossler()
orbit = problem.trajectory(x0=problem.spectrum(t1=200.0).x, t1=200.0, n=8000)
cut = lh.poincare_section(
    problem.system, problem.x0, problem.args, section=lambda t, x, args: x[1], direction=-1, n=3000, transient=50
)
x = np.asarray(cut.x)[:, 0]
print(f"{len(x)} cuts, one in {float(cut.t[-1] - cut.t[0]) / (len(x) - 1):.4f}, x from {x.min():.3f} to {x.max():.3f}")

_, (left, right) = pyplot.subplots(1, 2, figsize=(7.0, 3.2), layout="constrained")
left.plot(orbit.x[:, 0], orbit.x[:, 1], color="0.6", lw=0.4)
left.plot(x, 0 * x, ".", ms=2, color="#D55E00", label="cuts")
left.set(xlabel="$x$", ylabel="$y$", aspect="equal")
left.legend(frameon=False, loc="lower right")
right.plot([x.min(), x.max()], [x.min(), x.max()], color="0.7", lw=0.8)
right.plot(x[:-1], x[1:], ".", ms=2, color="#D55E00")
right.set(xlabel="$x$ at a cut", ylabel="$x$ at the next cut", aspect="equal")
pyplot.show()
