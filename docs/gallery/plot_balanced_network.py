"""
Extensive chaos in a balanced network
=====================================

Sparse networks of quadratic neurons that inhibit each other (Monteforte & Wolf 2010). Left: the spikes of 200 of them
are irregular. Right: the exponents of networks of three sizes, against i/N, lie on one curve: the number of unstable
directions and the entropy grow with N.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)


def network(n):
    """N neurons, 20 synapses each; coupling −1/√20."""
    return lh.zoo.sparse_network(n=n, synapses=20)


_, (raster, ax) = pyplot.subplots(1, 2, figsize=(7.0, 3.2), layout="constrained")
one = network(200)
lh.trajectory(one.system, one.x0, one.args, t1=20.0, n=2).plot.raster(ax=raster)
raster.set(ylabel="neuron", xlabel="time (membrane time constants)")

for n in (100, 200, 400):
    found = network(n).spectrum(t1=60.0, transient=20.0, k=n)
    entropy = found.exponents[found.exponents > 0].sum()
    print(f"N = {n}: λ₁ = {found.exponents[0]:.3f}, entropy a neuron {entropy / n:.4f}, per time constant")
    ax.plot((np.arange(n) + 0.5) / n, found.exponents, label=f"N = {n}")
ax.axhline(0, color="gray", lw=0.8)
ax.set(xlabel="i/N", ylabel="λ$_i$ per time constant")
ax.legend(frameon=False)
pyplot.show()
