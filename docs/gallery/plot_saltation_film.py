"""
Saltation: what an impact does to neighbours
============================================

A ball falls on a floor, and a circle of neighbours with it. They hit the floor at other instants. The derivative of the
reset alone (orange) forgets that, and misses them ever after; with the saltation matrix (blue) the ellipse is theirs.
"""

import jax
import numpy as np
from matplotlib import animation, pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)
ball = lh.zoo.bouncing_ball(restitution=0.8)
start, times, turn = np.array([1.0, 0.0]), np.linspace(0.02, 2.4, 60), np.linspace(0, 2 * np.pi, 49)
circle = 0.1 * np.stack([np.cos(turn), np.sin(turn)])
paths = np.stack([ball.trajectory(x0=start + shift, t1=2.4, times=times).x for shift in circle[:, :-1].T])
orbit = ball.trajectory(x0=start, t1=2.4, times=times)
impact, before = float(orbit.events.t[0]), np.asarray(orbit.events.x_before[0])
reset = lh.jacobians(ball.system, impact, before, ball.args).Dg[0]
saltation = lh.saltation_matrix(ball.system, impact, before, ball.args)
print(f"derivative of the reset\n{reset}\nsaltation matrix\n{saltation}")
figure, ax = pyplot.subplots(figsize=(3.4, 3.4), layout="constrained")
ax.set(xlabel="height", ylabel="velocity", xlim=(-0.2, 1.2), ylim=(-1.7, 1.7))
looks = ((".", "black", "neighbours"), ("-", "#0072B2", "with saltation"), ("--", "#D55E00", "reset alone"))
artists = [ax.plot([], [], look, color=colour, ms=3, label=label)[0] for look, colour, label in looks]
ax.legend(frameon=False, loc="upper right", fontsize="small")


def show(number):
    fall, after = (np.array([[1, t], [0, 1]]) for t in (min(times[number], impact), times[number] - impact))
    maps = [after @ jump @ fall if after[0, 1] > 0 else fall for jump in (saltation, reset)]
    artists[0].set_data(*paths[:, number].T)
    for artist, matrix in zip(artists[1:], maps, strict=True):
        artist.set_data(*(orbit.x[number][:, None] + matrix @ circle))


film = animation.FuncAnimation(figure, show, frames=60, interval=80)
