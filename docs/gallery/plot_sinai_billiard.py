"""
Sinai's billiard: exponents against the radius
==============================================

A small disk is rarely hit, so the exponent per unit of time goes to zero with the radius. Per reflection it grows
instead, for a long flight spreads neighbours more. The factor between the two is the mean free path, known exactly.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

radii = np.linspace(0.04, 0.48, 23)
billiards = [lh.zoo.sinai_billiard(radius=radius) for radius in radii]
found = [billiard.spectrum(t1=10_000.0, k=1) for billiard in billiards]
rate = np.array([run.exponents[0] for run in found])
paths = np.array([lh.zoo.mean_free_path(billiard) for billiard in billiards])
measured = np.array([run.time / run.jumps for run in found])
print(f"mean free paths: measured ones differ by up to {np.max(np.abs(measured / paths - 1)):.1%} from the exact ones")
orbit = lh.zoo.sinai_billiard(radius=0.3).trajectory(t1=6.0, n=3000)

_, (left, right) = pyplot.subplots(1, 2, figsize=(7.0, 3.0), layout="constrained", width_ratios=(1, 1.4))
place = (np.asarray(orbit.x)[:, :2] + 0.5) % 1.0
left.plot(place[:, 0], place[:, 1], ",", color="#0072B2", rasterized=True)
left.add_patch(pyplot.Circle((0.5, 0.5), 0.3, fc="0.9", ec="black"))
left.set(aspect="equal", xlabel="$q_x$", ylabel="$q_y$", xlim=(0, 1), ylim=(0, 1))
right.errorbar(radii, rate, [run.stderr[0] for run in found], fmt=".", color="#0072B2", label="per unit of time")
right.plot(radii, rate * paths, "x", ms=4, color="#D55E00", label="per reflection")
right.set(xlabel="radius of the disk", ylabel="$λ_1$")
right.legend(frameon=False)
pyplot.show()
