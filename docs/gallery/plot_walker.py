"""
A walker without motors, and its multipliers
============================================

Two legs walk down a slope by gravity alone. The multipliers of a step lie inside the unit circle but for one, 1, of a
shift in time: what disturbs the gait dies away. One is 0, for a heel strike forgets how fast the swinging leg was.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

walker = lh.zoo.simplest_walker(slope=0.009)
gait = walker.floquet()
orbit = walker.trajectory(t1=4 * gait.period, n=2000)
print(gait)

_, (left, right) = pyplot.subplots(1, 2, figsize=(7.0, 2.8), layout="constrained", width_ratios=(1.6, 1))
for number, (name, colour) in enumerate((("leg on the ground", "#0072B2"), ("between the legs", "#D55E00"))):
    left.plot(orbit.t, np.rad2deg(orbit.x[:, number]), color=colour, lw=1.2, label=name)
for strike in np.unique(np.asarray(orbit.events.t)):
    left.axvline(strike, color="0.7", lw=0.8, ls=":")
left.set(xlabel=r"time ($\sqrt{\ell/g}$)", ylabel="angle (°)", xlim=(0, 4 * gait.period))
left.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
lh.plots.multipliers(gait, ax=right)
pyplot.show()
