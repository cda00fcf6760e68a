"""
Covariant vectors of the standard map: where they nearly meet
=============================================================

Stable and unstable directions along one chaotic orbit. Dark points are where the two are almost parallel: there the
motion is close to islands, or to a tangency, and is not hyperbolic.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

problem = lh.zoo.standard_map(K=1.5)
found = lh.covariant_vectors(problem.system, [0.1, 0.0], problem.args, t1=30_000, blocks=30_000)
angle = np.rad2deg(np.asarray(found.angles)[:, 0])
x = np.asarray(found.x) % (2 * np.pi)
print(f"λ₁ = {found.exponents[0]:.3f} per iteration; {np.mean(angle < 5):.1%} of the angles are below 5°")

figure, ax = pyplot.subplots(figsize=(3.4, 3.0), layout="constrained")
points = ax.scatter(x[:, 0], x[:, 1], c=angle, s=0.4, lw=0, cmap="cividis", clim=(0, 90), rasterized=True)
ticks = {"ticks": [0, np.pi, 2 * np.pi], "labels": ["0", "π", "2π"]}
ax.set_xticks(**ticks)
ax.set_yticks(**ticks)
ax.set(aspect="equal", xlabel="angle $θ$", ylabel="momentum $p$", xlim=(0, 2 * np.pi), ylim=(0, 2 * np.pi))
figure.colorbar(points, label="angle between the vectors (°)", ticks=[0, 30, 60, 90])
pyplot.show()
