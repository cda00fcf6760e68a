"""
Stick and slip on a belt
========================

A block on a moving belt, held by a spring. From many starts the orbits come to the line of equal velocities; there the
block sticks (orange) until the spring pulls it off, and all orbits have become one.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

belt = lh.zoo.stick_slip_belt()
spectrum = belt.spectrum(t1=2000.0)
print(spectrum)
_, ax = pyplot.subplots(figsize=(3.4, 3.2), layout="constrained")
for x in np.linspace(-2.0, 2.0, 7):
    for v in (-1.5, 1.2):
        orbit = lh.trajectory(belt.system, [x, v], belt.args, t1=12.0, n=3000)
        states, mode = np.asarray(orbit.x), np.asarray(orbit.mode)
        stuck = (mode == orbit.mode_names.index("sliding"))[:, None]
        ax.plot(*np.where(stuck, np.nan, states).T, color="#0072B2", lw=0.6)
        ax.plot(*np.where(stuck, states, np.nan).T, color="#E69F00", lw=2.5, zorder=3)
        ax.plot(x, v, ".", ms=4, color="black")
ax.set(xlabel="place $x$", ylabel="velocity $v$")
pyplot.show()
