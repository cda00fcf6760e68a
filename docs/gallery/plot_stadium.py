"""
Two orbits in a stadium
=======================

Two particles start 1e-10 apart. Their distance after each bounce grows like the length of a tangent vector, until it is
as large as the stadium itself.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

stadium = lh.zoo.stadium()
orbits = [stadium.trajectory(x0=stadium.x0.at[0].add(shift), t1=80.0, n=2) for shift in (0.0, 1e-10)]
first, second = (np.asarray(orbit.events.x_after) for orbit in orbits)
number = min(len(first), len(second))
bounces = np.arange(1, number + 1)
apart = np.linalg.norm(first[:number] - second[:number], axis=1)
frame = [[1.0], [0.0], [0.0], [0.0]]
tangent = stadium.spectrum(t1=number, clock="jumps", transient=0, k=1, frame=frame, blocks=number)
grown = np.log(1e-10) + np.cumsum(np.asarray(tangent.history.growth)[:, 0])
print(f"λ₁ = {stadium.spectrum(clock='jumps', t1=20_000, k=1).exponents[0]:.3f} per bounce")

_, (left, right) = pyplot.subplots(1, 2, figsize=(7.0, 2.8), layout="constrained")
turn = np.linspace(-np.pi / 2, 1.5 * np.pi, 200)
left.fill(np.cos(turn) + np.where(np.cos(turn) >= 0, 0.5, -0.5), np.sin(turn), fc="0.95", ec="black")
for points, colour in ((first, "#0072B2"), (second, "#D55E00")):
    left.plot(*np.vstack([stadium.x0[:2], points[:number, :2]]).T, color=colour, lw=0.7, alpha=0.8)
left.set(aspect="equal", xlabel="$q_x$", ylabel="$q_y$", title=f"{number} bounces of both")
right.plot(bounces, grown, color="0.6", label="tangent vector")
right.plot(bounces, np.log(apart), ".", color="#D55E00", label="two particles")
right.set(xlabel="bounces", ylabel=r"$\ln d$", ylim=(-26, 4))
right.legend(frameon=False)
pyplot.show()
