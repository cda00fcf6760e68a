"""
A pendulum with dry friction: 100 000 strobe points
===================================================

One point a period of the drive, always at the same phase. On the short orange line, the stick set, the drive and the
weight together are weaker than the friction: a pendulum that comes to rest there sticks.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

pendulum = lh.zoo.friction_pendulum(beta=0.052, alpha=0.01)
args = pendulum.args
period, phase = 2 * np.pi / args["omega"], 0.8 * np.pi
t0 = phase / args["omega"]
section = lh.poincare_section(pendulum.system, pendulum.x0, args, t0=t0, period=period, n=100_000, transient=100)
angle, rate = (np.asarray(section.x)[:, 0] + np.pi) % (2 * np.pi) - np.pi, np.asarray(section.x)[:, 1]
ends = np.arcsin((args["amplitude"] * np.sin(phase) + args["alpha"] * np.array([-1, 1])) / args["gravity"])
middle = ends.mean()
print(f"{len(rate)} points; stick set from θ = {ends[0]:.4f} to {ends[1]:.4f}; {np.sum(rate == 0)} points stick")

_, (left, right) = pyplot.subplots(1, 2, figsize=(7.0, 3.2), layout="constrained", width_ratios=(1.6, 1))
for ax, size in ((left, 0.4), (right, 1.5)):
    ax.plot(angle, rate, ".", ms=size, mew=0, color="black", rasterized=True)
    ax.plot(ends, [0, 0], color="#D55E00", lw=2.5)
    ax.set(xlabel=r"angle $\theta$ (rad)", ylabel=r"rate $\dot\theta$ (rad per unit of time)")
left.set(xlim=(-np.pi, np.pi))
right.set(xlim=(middle - 0.15, middle + 0.15), ylim=(-0.15, 0.15), title="in the frame, larger")
left.add_patch(pyplot.Rectangle((middle - 0.15, -0.15), 0.3, 0.3, fc="none", ec="#0072B2", zorder=3))
pyplot.show()
