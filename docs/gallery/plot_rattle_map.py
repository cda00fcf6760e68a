"""
Rattling gears over frequency and amplitude
===========================================

A gear tooth between two flanks. The largest exponent over frequency and amplitude of the drive: regular and chaotic
rattling lie in bands beside each other. White, lower right: the tooth no longer hits. Hatched: impacts come faster and
faster, and the run ends.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

gears = lh.zoo.gear_rattle()


def run(args):
    return lh.lyapunov_spectrum(gears.system, gears.x0, args, t1=200.0, transient=200.0, k=1, throw=False)


over = {"omega": np.linspace(1.0, 4.0, 81), "amplitude": np.linspace(0.5, 3.0, 51)}
found = lh.sweep(run, over, args=gears.args, progress=False)
print(f"{float(np.mean(found.exponents[..., 0] > 0.02)):.0%} of the points have λ₁ above 0.02 per unit of time")

_, ax = pyplot.subplots(figsize=(7.0, 3.6), layout="constrained")
lh.plots.sweep_map(found, ax=ax).figure.axes[-1].set_ylabel("$λ_1$ per unit of time")
ax.set(xlabel=r"frequency $\omega$ of the drive", ylabel="amplitude of the drive")
pyplot.show()
