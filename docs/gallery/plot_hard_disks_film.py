"""
Hard disks and their most unstable perturbation
===============================================

Sixteen disks in a periodic box. The deeper the colour, the larger a disk's share of the perturbation that grows
fastest. Most of it sits on a few disks that collide, and jumps to others.
"""

import jax
from matplotlib import pyplot

import lyaphybrid as lh
from lyaphybrid.zoo import pictures

jax.config.update("jax_enable_x64", True)

gas = lh.zoo.hard_disks(n=16, density=0.6)
run = gas.spectrum(t1=100.0, k=1)
print(run)

followed = pictures.follow(gas, run.x, run.frame[:, 0], t1=2.0, frames=60)
_, ax = pyplot.subplots(figsize=(3.4, 4.2), layout="constrained")
film = pictures.animate(gas, followed, ax=ax)
