"""
A block that sticks: how an exponent becomes −∞
===============================================

A block on a shaking plate. While it sticks, its velocity is that of the plate, whatever it was before: all
perturbations of the velocity end there at once, and the second exponent is −∞ from the first stick on.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

block = lh.zoo.block_on_plate(alpha=0.7)
length = 4 * 2 * np.pi
orbit = block.trajectory(x0=[0.0, 1.5], t1=length, n=2000)
run = block.spectrum(x0=[0.0, 1.5], t1=length, transient=0.0, blocks=400)
t, second = np.asarray(run.history.time), np.cumsum(np.asarray(run.history.growth)[:, 1])
stick, lost = orbit.mode_names.index("sliding"), float(run.first_loss[1])
print(f"λ₂ = {run.exponents[1]}: lost {run.losses[1]} times, first at t = {lost:.3f}")

_, (top, bottom) = pyplot.subplots(2, 1, figsize=(7.0, 3.6), sharex=True, layout="constrained")
top.plot(orbit.t, orbit.x[:, 1], color="#0072B2", lw=1.2)
held = np.asarray(orbit.mode) == stick
across = top.get_xaxis_transform()
top.fill_between(orbit.t, 0, 1, where=held, transform=across, color="#E69F00", alpha=0.3, label="stuck")
top.set(ylabel="relative velocity")
top.legend(frameon=False, loc="upper right")
before = t < lost
bottom.plot(t[before], second[before], color="#D55E00", lw=1.2)
bottom.plot(t[~before], second[~before], color="0.6", lw=1, ls="--", label="finite part")
bottom.legend(frameon=False, loc="upper right")
bottom.annotate("−∞", (lost, -3.9), xytext=(lost + 0.3, -3.8), color="#D55E00")
bottom.plot([lost, lost], [second[before][-1], -4], color="#D55E00", lw=1.2)
bottom.set(xlabel="time", ylabel=r"$\ln|\delta v / \delta v_0|$", ylim=(-4, 0.5), xlim=(0, length))
pyplot.show()
