"""
Where an orbit doubles, and where it begins to touch
====================================================

The largest exponent of an oscillator that hits a wall, over the frequency of the drive and the place of the wall. On
top, curves that are followed, not found by a grid: the orbit with one impact in each period doubles, and above the
dark line the orbit without impacts exists: there it touches the wall.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

oscillator = lh.zoo.impact_oscillator(omega=2.8, gap=-0.2)
system, args = oscillator.system, oscillator.args
omega, gap, turn = {"omega": (2.4, 4.2)}, {"gap": (-0.4, 0.4)}, lambda args: 2 * np.pi / args["omega"]


def run(args):
    return lh.lyapunov_spectrum(system, oscillator.x0, args, t1=200.0, transient=200.0, k=1, throw=False)


grid = {"omega": np.linspace(*omega["omega"], 71), "gap": np.linspace(*gap["gap"], 49)}
ax = pyplot.subplots(figsize=(7.0, 4.2), layout="constrained")[1]
lh.plots.sweep_map(lh.sweep(run, grid, args=args, progress=False), ax=ax)
beats = lh.continuation(system, oscillator.x0, args, over=omega, period=turn, transient=300.0)
still = lh.continuation(system, [-0.1, 0.0], args | {"gap": 0.3}, over=gap, period=turn, step=0.1)
curves = [
    lh.bifurcation_curve(system, beats.of_kind("period doubling")[0], args, over=omega | gap, period=turn, step=0.1),
    lh.bifurcation_curve(system, still.of_kind("grazing")[0], args, over=gap | omega, period=turn, step=0.1),
]
print(*curves, sep="\n")
lh.plots.curves(curves, ax)
pyplot.show()
