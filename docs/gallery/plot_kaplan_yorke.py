r"""
Kaplan and Yorke's map: dimension from exponents
================================================

The contraction :math:`\alpha` sets the second exponent, :math:`\ln\alpha`, and leaves the first, :math:`\ln 2`, as it
is. The dimension that follows from them grows with :math:`\alpha` until it reaches 2.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

alphas = np.linspace(0.05, 0.6, 23)
found = [lh.zoo.kaplan_yorke_map(alpha=alpha).spectrum(t1=20_000).kaplan_yorke_dimension() for alpha in alphas]
orbit = np.asarray(lh.zoo.kaplan_yorke_map().trajectory(t1=20_000, n=20_000).x)
exact = np.minimum(1 - np.log(2) / np.log(alphas), 2)
print(f"largest difference from the formula: {np.max(np.abs(np.array(found) - exact)):.1e}")

_, (left, right) = pyplot.subplots(1, 2, figsize=(7.0, 3.0), layout="constrained")
left.plot(orbit[100:, 0], orbit[100:, 1], ",", color="#0072B2", rasterized=True)
left.set(xlabel="$x$", ylabel="$y$", title=r"$\alpha = 0.2$")
right.plot(alphas, exact, color="0.6", label=r"$\min(1 - \ln 2\,/\ln\alpha,\ 2)$")
right.plot(alphas, found, "o", ms=4, color="#D55E00", label="from computed exponents")
right.set(xlabel=r"contraction $\alpha$", ylabel="Kaplan–Yorke dimension")
right.legend(frameon=False)
pyplot.show()
