"""
Spikes of a network over its exponents
======================================

Forty leaky neurons inhibit each other through random synapses. The raster looks irregular, yet no exponent is
above zero: the first is 0 within its error, a shift in time, and all other disturbances die away.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

n = 40
random = np.random.default_rng(1)
coupling = np.where(random.random((n, n)) < 0.3, -0.06, 0.0) * (1 - np.eye(n))
network = lh.zoo.integrate_and_fire(n=n, current=2.0, coupling=coupling, form="event_driven")
x0 = random.random(n)
spikes = network.trajectory(x0=x0, t1=12.0, n=2).events
run = network.spectrum(x0=x0, clock="time", t1=200.0, transient=0.0)
print("λ₁, λ₂ =", *(f"{run.exponents[i]:.4f} ± {run.stderr[i]:.4f}" for i in (0, 1)), "per unit of time")

_, (top, bottom) = pyplot.subplots(2, 1, figsize=(7.0, 4.2), layout="constrained", height_ratios=(1.6, 1))
top.plot(spikes.t, np.asarray(spikes.which) + 1, "|", ms=4, color="black")
top.set(xlabel="time (of the membrane)", ylabel="neuron", xlim=(0, 12), ylim=(0, n + 1))
bottom.axhline(0, color="0.6", lw=0.8)
bottom.plot(np.arange(1, n + 1), run.exponents, ".", color="#0072B2")
bottom.set(xlabel="$i$", ylabel="$λ_i$ per unit of time", xlim=(0, n + 1))
pyplot.show()
