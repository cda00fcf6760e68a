"""
A buck converter, its switch as colour
======================================

Voltage and current of a converter in chaos. The switch connects the source (orange) or not (blue); it is set anew by
a ramp, every 400 µs.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

buck = lh.zoo.buck_converter(voltage=33.0)
run = buck.spectrum(t1=0.4)
orbit = lh.trajectory(buck.system, run.x, buck.args, t0=run.t, t1=0.02, n=20_000, mode=int(run.mode))
x, mode = np.asarray(orbit.x), np.asarray(orbit.mode)
print(run)
print("modes:", *orbit.mode_names)

_, (left, right) = pyplot.subplots(1, 2, figsize=(7.0, 3.0), layout="constrained", width_ratios=(1, 1.3))
for word, colour in (("off", "#0072B2"), ("on", "#D55E00")):
    numbers = [number for number, name in enumerate(orbit.mode_names) if name.startswith(word)]
    here = np.where(np.isin(mode, numbers)[:, None], x, np.nan)
    left.plot(here[:, 0], here[:, 1], color=colour, lw=0.5, label=f"switch {word}")
    right.plot(1e3 * (np.asarray(orbit.t) - float(orbit.t[0])), here[:, 0], color=colour, lw=1)
left.set(xlabel="voltage (V)", ylabel="current (A)")
left.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
right.set(xlabel="time (ms)", ylabel="voltage (V)", xlim=(0, 8))
pyplot.show()
