"""
The impact oscillator over frequency and restitution
====================================================

The largest exponent of an oscillator that hits a wall. Where impacts come faster and faster the run ends as
"zeno": these points are hatched and have no value.
"""

import jax
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

oscillator = lh.zoo.impact_oscillator()


def run(args):
    return lh.lyapunov_spectrum(oscillator.system, oscillator.x0, args, t1=200.0, transient=200.0, k=1, throw=False)


over = {"omega": np.linspace(1.6, 4.4, 113), "restitution": np.linspace(0.3, 0.95, 53)}
found = lh.sweep(run, over, args=oscillator.args, progress=False)
codes, counts = np.unique(found.status, return_counts=True)
for code, count in zip(codes, counts, strict=True):
    print(f"{count} points end as", str(lh.STATUS(int(code))).split(":")[0])

_, ax = pyplot.subplots(figsize=(7.0, 3.8), layout="constrained")
lh.plots.sweep_map(found, ax=ax).figure.axes[-1].set_ylabel("$λ_1$ per unit of time")
ax.set(xlabel=r"frequency $\omega$ of the drive (over its own)", ylabel="restitution $r$")
pyplot.show()
