"""
Sections of Hénon and Heiles over a map of SALI
===============================================

The colour is the smaller alignment index of the orbit that starts at each point of the section: near zero in the
chaotic sea, near one on islands. The dots are sections of a few orbits, computed on their own: they agree.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

problem = lh.zoo.henon_heiles(energy=0.125)
y, py = np.meshgrid(np.linspace(-0.45, 0.7, 70), np.linspace(-0.5, 0.5, 60))
left = 2 * 0.125 - py**2 - y**2 + 2 * y**3 / 3  # px² at x = 0
inside = left > 0
starts = np.stack([0 * y, y, np.sqrt(np.where(inside, left, 0)), py], axis=-1)[inside]


def run(args, x0):
    return lh.sali(problem.system, x0, args, t1=400.0, blocks=4, throw=False).log_values[-1]


found = lh.sweep(run, points={"x0": starts}, args=problem.args, progress=False)
sali = np.full(y.shape, np.nan)
sali[inside] = np.asarray(next(iter(found.data_vars.values()))) / np.log(10)
print(f"{np.mean(sali[inside] < -4):.0%} of the points are in the chaotic sea (SALI < 1e-4)")

figure, ax = pyplot.subplots(figsize=(7.0, 4.4), layout="constrained")
mesh = ax.pcolormesh(y, py, sali, cmap="cividis", vmin=-8, vmax=0, rasterized=True)
for x0 in starts[:: len(starts) // 24]:
    points = lh.poincare_section(problem.system, x0, section=lambda t, x, args: x[0], direction=1, n=300).x
    ax.plot(points[:, 1], points[:, 3], ".", ms=1.8, color="#D55E00", mew=0)
ax.set(xlabel="$y$", ylabel="$p_y$")
figure.colorbar(mesh, label=r"$\log_{10}$ SALI at $t = 400$", extend="min")
pyplot.show()
