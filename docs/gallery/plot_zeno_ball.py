"""
A ball that bounces infinitely often in a finite time
=====================================================

Each bounce takes a fixed part of the one before, so all of them together take a finite time. The run ends as "zeno" and
says when: the time left before that instant falls geometrically.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

ball = lh.zoo.bouncing_ball(restitution=0.7)
run = ball.spectrum(t1=20.0, clock="time", transient=0.0, throw=False)
end = float(run.accumulation_time)
print(str(run.status).split(":")[0], f"at t = {end:.6f}")
orbit = ball.trajectory(t1=0.9999 * end, n=2000)
bounce = np.asarray(orbit.events.t)

_, (left, right) = pyplot.subplots(1, 2, figsize=(7.0, 2.6), layout="constrained")
left.plot(orbit.t, orbit.x[:, 0], color="#0072B2", lw=1)
left.axvline(end, color="#D55E00", ls="--", lw=1)
left.set(xlabel="time", ylabel="height")
right.semilogy(np.arange(1, len(bounce) + 1), end - bounce, "o", ms=4, color="#D55E00")
right.set(xlabel="bounce", ylabel=r"time left, $t_\infty - t$")
pyplot.show()
