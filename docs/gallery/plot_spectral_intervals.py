"""
Spectral intervals of a system with a constraint
================================================

A forced, damped pendulum on a rod, written with its constraint. To the left the mean growth since the start: where it
still moves, Lyapunov's intervals have a width. To the right that over windows of 20: the intervals of Sacker and Sell.
"""

import jax
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

pendulum = lh.zoo.pendulum_dae()
found = lh.spectral_intervals(pendulum.system, pendulum.x0, pendulum.args, t1=2000.0, window=20.0, tau=20.0)
print(found)

_, axes = pyplot.subplots(1, 2, figsize=(7.0, 3.2), layout="constrained", width_ratios=(1.6, 1))
lh.plots.intervals(found, axes=axes)
pyplot.show()
