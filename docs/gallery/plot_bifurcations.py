"""
Bifurcations, the exponent beneath, unstable branches dashed
============================================================

Attractors of Hénon's map. Where a periodic orbit doubles its period, the largest exponent touches zero; the old orbit
goes on, unstable (dashed), within the chaos that follows.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

henon = lh.Map(lambda n, x, args: jnp.stack([1 - args["a"] * x[0] ** 2 + x[1], 0.3 * x[0]]))
a, start = np.linspace(0.2, 1.4, 600), {"a": 0.25}
found = lh.bifurcation_diagram(
    henon, [0.1, 0.1], start, over={"a": a}, starts=[[0.1, 0.1]], directions=("up",), transient=500, t1=2000
)
_, (top, bottom) = pyplot.subplots(2, 1, figsize=(7.0, 4.4), sharex=True, layout="constrained", height_ratios=(1.6, 1))
top.plot(np.repeat(a, 64), found.points[:, 0, :, 0].ravel(), ",", color="0.3", rasterized=True)
begin = [0.6, 0.2]
for turns, colour in ((1, "#0072B2"), (2, "#D55E00"), (4, "#009E73")):
    branch = lh.continuation(henon, begin, start, over={"a": (0.2, 1.4)}, period=1)
    begin = next(one for one in branch.specials if one.kind == "period doubling")
    print(f"period {turns} doubles at a = {begin.parameter:.6f}")
    stable = np.max(np.abs(branch.multipliers), axis=1) < 1
    x = np.array([orbit.x0 for orbit in branch.orbits])
    for _ in range(turns):
        for where, style in ((stable, "-"), (~stable, "--")):
            top.plot(branch.values, np.where(where, x[:, 0], np.nan), style, color=colour, lw=1)
        x = np.stack([1 - branch.values * x[:, 0] ** 2 + x[:, 1], 0.3 * x[:, 0]], axis=1)
top.set(ylabel="$x$")
bottom.axhline(0, color="0.6", lw=0.8)
bottom.plot(a, found.exponents[:, 0, 0], color="#0072B2", lw=0.8)
bottom.set(xlabel="parameter $a$", ylabel="$λ_1$ per iteration", xlim=(0.2, 1.4), ylim=(-1, 0.6))
pyplot.show()
