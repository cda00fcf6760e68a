"""
A particle that falls in a wedge
================================

Points of impact on the right wall for three angles, many starts of the same energy each. At 45° the motion is
integrable and every orbit draws a curve; in a narrow wedge islands lie in chaos; in a wide one there are none.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

_, axes = pyplot.subplots(1, 3, figsize=(7.0, 2.8), sharex=True, sharey=True, layout="constrained")
for ax, degrees in zip(axes, (38, 45, 55), strict=True):
    wedge = lh.zoo.wedge(angle=np.deg2rad(degrees))
    wall = np.array([np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees))])
    turns, speed = np.linspace(-2.8, 0.2, 12), np.sqrt(2 * (1 - 0.4))
    starts = [[0.0, 0.4, speed * np.cos(turn), speed * np.sin(turn)] for turn in turns]
    for number, start in enumerate(starts):
        hits = wedge.trajectory(x0=start, t1=600.0, n=2).events
        right = np.asarray(hits.x_after)[np.asarray(hits.which) == 0]
        along, away = right[:, 2:] @ wall, right[:, 2:] @ np.array([-wall[1], wall[0]])
        ax.plot(along, away**2, ".", ms=1.6, mew=0, color=lh.plots.COLOURS[number % 6], rasterized=True)
    rates = [float(wedge.spectrum(x0=start, t1=2000.0, k=1).exponents[0]) for start in starts]
    print(f"{degrees}°: λ₁ from {min(rates):.4f} to {max(rates):.4f} per unit of time")
    ax.set(title=f"walls at {degrees}°", xlabel="speed along the wall")
axes[0].set_ylabel("square of the speed\naway from the wall")
pyplot.show()
