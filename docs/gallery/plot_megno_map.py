"""
The web of resonances in Froeschlé's map
========================================

MEGNO of orbits of two coupled standard maps, over the two momenta at the start. It tends to 2 on regular orbits and
grows where the motion is chaotic: along resonances, which form a web of lines.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

problem = lh.zoo.froeschle_map(K1=0.5, K2=0.4, coupling=0.01)
p1, p2 = np.meshgrid(np.linspace(0, np.pi, 160), np.linspace(0, np.pi, 160))
starts = np.stack([0.5 + 0 * p1, 0.5 + 0 * p1, p1, p2], axis=-1).reshape(-1, 4)


def run(args, x0):
    return lh.megno(problem.system, x0, args, t1=1000, blocks=2, throw=False).mean[-1]


found = lh.sweep(run, points={"x0": starts}, args=problem.args, progress=False)
megno = np.asarray(next(iter(found.data_vars.values()))).reshape(p1.shape)
print(f"{np.mean(megno > 2.2):.0%} of the orbits have a mean MEGNO above 2.2")

figure, ax = pyplot.subplots(figsize=(3.4, 3.0), layout="constrained")
mesh = ax.pcolormesh(p1, p2, megno, cmap="cividis", vmin=1.5, vmax=4, rasterized=True)
ax.set_xticks([0, np.pi / 2, np.pi], labels=["0", "π/2", "π"])
ax.set_yticks([0, np.pi / 2, np.pi], labels=["0", "π/2", "π"])
ax.set(aspect="equal", xlabel="momentum $p_1$", ylabel="momentum $p_2$")
figure.colorbar(mesh, label="mean MEGNO after 1000 iterations", extend="both")
pyplot.show()
