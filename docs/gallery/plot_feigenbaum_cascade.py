r"""
Feigenbaum's cascade on a logarithmic axis
==========================================

Against the distance to the accumulation point :math:`r_\infty` every doubling of the logistic map looks like the one
before it: the intervals between them have equal lengths on a logarithmic axis, :math:`\ln 4.669\ldots`
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

distance = np.logspace(0, -4, 600)
r = 3.569945671870945 - distance
found = lh.bifurcation_diagram(
    lh.zoo.logistic_map().system, [0.3], {"r": 3.0}, over={"r": r}, starts=[[0.3]], directions=("random",),
    transient=20_000, t1=2000, samples=64,
)  # fmt: skip
largest = found.exponents[:, 0, 0]
peaks = distance[1:-1][(largest[1:-1] > largest[:-2]) & (largest[1:-1] > largest[2:]) & (largest[1:-1] > -0.05)]
print("doublings at r∞ − r =", *(f"{peak:.3g}" for peak in peaks))
print("ratios", *(f"{ratio:.2f}" for ratio in peaks[:-1] / peaks[1:]))

_, (top, bottom) = pyplot.subplots(2, 1, figsize=(7.0, 4.2), sharex=True, layout="constrained")
top.plot(np.repeat(distance, 64), found.points[:, 0, :, 0].ravel(), ",", color="black", rasterized=True)
top.set(ylabel="$x$")
bottom.axhline(0, color="0.6", lw=0.8)
bottom.plot(distance, largest, color="#0072B2", lw=1)
bottom.set(xscale="log", xlim=(1, 1e-4), ylim=(-1.5, 0.2), xlabel=r"$r_\infty - r$", ylabel="$λ_1$ per iteration")
pyplot.show()
