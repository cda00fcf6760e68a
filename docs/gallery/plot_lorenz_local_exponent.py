"""
Lorenz's attractor, coloured by the local exponent
==================================================

How fast a small perturbation grows just now differs along the orbit: it shrinks on one part of each wing and grows on
another. The mean of the colour over a long time is the largest exponent.
"""

import jax
import numpy as np
from matplotlib import pyplot
from matplotlib.collections import LineCollection

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

lorenz = lh.zoo.lorenz63()
settled = lorenz.spectrum(t1=50.0)
run = lorenz.spectrum(x0=settled.x, frame=settled.frame, t1=50.0, transient=0.0, blocks=5000)
orbit = lorenz.trajectory(x0=settled.x, t1=50.0, n=5000)
local = np.asarray(run.history.growth)[:, 0] / (50.0 / 5000)
x = np.asarray(orbit.x)[-5001:]
print(f"mean {local.mean():.3f}, from {local.min():.1f} to {local.max():.1f} per unit of time")

figure, ax = pyplot.subplots(figsize=(3.4, 3.0), layout="constrained")
points = x[:, [0, 2]]
pieces = np.stack([points[:-1], points[1:]], axis=1)
lines = LineCollection(pieces, array=local[: len(pieces)], cmap="PuOr_r", clim=(-10, 10), linewidths=0.6)
ax.add_collection(lines)
ax.set(xlabel="$x$", ylabel="$z$", xlim=(-20, 20), ylim=(0, 50), facecolor="0.93")
figure.colorbar(lines, label="local exponent per unit of time", extend="both")
pyplot.show()
