"""
Noise destroys a bifurcation
============================

x' = a x − x³ has a pitchfork at a = 0, where its exponent (dashed) touches zero. With additive white noise, however
weak, the exponent is negative for all a: all starts come together on one random motion. The lines are from the
stationary density, the dots from runs along one Brownian path.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

flow = lh.Flow(lambda t, x, args: args["a"] * x - x**3)
noisy = lh.white_noise(flow, lambda t, x, args: args["s"] + 0 * x, step=0.02, until=900.0)


def run(args):
    return lh.lyapunov_spectrum(noisy, [0.3], args, t1=850.0, transient=50.0)


a, x = np.linspace(-1.0, 1.5, 101), np.linspace(-4.0, 4.0, 4001)
found = lh.sweep(
    run, {"a": np.linspace(-1.0, 1.5, 14), "s": [0.2, 0.5, 1.0]}, args={"a": 0.0, "s": 0.5}, progress=False
)
_, ax = pyplot.subplots(figsize=(7.0, 3.8), layout="constrained")
ax.plot(a, np.where(a < 0, a, -2 * a), "--", color="0.5", label="no noise")
for i, (s, colour) in enumerate(zip(found.s.values, lh.plots.COLOURS, strict=False)):
    density = np.exp((a[:, None] * x**2 - x**4 / 2) / s**2)
    exact = np.sum((a[:, None] - 3 * x**2) * density, axis=1) / np.sum(density, axis=1)
    ax.plot(a, exact, color=colour, label=f"σ = {s}")
    ax.errorbar(found.a, found.exponents[:, i, 0], found.stderr[:, i, 0], fmt="o", markersize=3, color=colour)
    print(f"σ = {s}: largest exponent {float(found.exponents[:, i, 0].max()):.3f}")
ax.set(xlabel="a", ylabel="λ per unit of time")
ax.legend()
pyplot.show()
