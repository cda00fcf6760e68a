"""
Lorenz 96: where a forecast is lost first
=========================================

Waves run round a circle of 40 sites. The perturbation that grows fastest lives on a few of them and moves along. To the
right all 40 exponents; their positive ones add up to the entropy.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

model = lh.zoo.lorenz96()
run = model.spectrum(t1=200.0)
found = lh.covariant_vectors(model.system, run.x, model.args, t1=15.0, k=1, blocks=300)
positive = int(np.sum(run.exponents > 0))
print(f"{positive} of 40 above 0; entropy {run.ks_entropy():.1f}, dimension {run.kaplan_yorke_dimension():.1f}")

figure, (left, middle, right) = pyplot.subplots(1, 3, figsize=(7.0, 3.2), layout="constrained")
extent = (0.5, 40.5, 0, 15)
waves = left.imshow(np.asarray(found.x), origin="lower", aspect="auto", extent=extent, cmap="PuOr", clim=(-13, 13))
share = np.log10(np.asarray(found.vectors)[:, :, 0] ** 2 + 1e-30)
where = middle.imshow(share, origin="lower", aspect="auto", extent=extent, cmap="cividis", clim=(-6, 0))
left.set(xlabel="site", ylabel="time")
middle.set(xlabel="site", yticks=[])
figure.colorbar(waves, ax=left, location="top", label="$x$")
figure.colorbar(where, ax=middle, location="top", label=r"$\log_{10}$ of the share in $\delta x$")
right.axhline(0, color="0.6", lw=0.8)
right.plot(np.arange(1, 41), run.exponents, ".", color="#0072B2")
right.set(xlabel="$i$", ylabel="$λ_i$ per unit of time")
pyplot.show()
