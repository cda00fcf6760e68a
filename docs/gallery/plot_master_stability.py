"""
Which networks of chaotic converters synchronise?
=================================================

Equal buck converters whose outputs are linked by resistors. The largest exponent across their common motion depends on
the network only through α = strength × eigenvalue (Pecora & Carroll 1998): below zero perturbations along that
eigenvector die out. Marks at the foot are the α of a ring of four at two strengths: it synchronises if all of them lie
where the curve is below zero. The coupling sees the voltage, which switching leaves continuous.
"""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)


def voltage(t, x, args):
    """The coupling: a current into the capacitor in proportion to the voltage."""
    return jnp.stack([x[0], 0 * x[1]])


buck = lh.zoo.buck_converter()
at = np.linspace(-6000.0, 500.0, 53)
how = {"mode": "on_even", "t1": 1.0, "transient": buck.transient}
found = lh.master_stability(buck.system, voltage, buck.x0, buck.args, at=at, **how)
print(found)

_, ax = pyplot.subplots(figsize=(7.0, 3.4), layout="constrained")
found.plot(ax=ax)
for strength, colour in ((700.0, "C1"), (1400.0, "C2")):
    alpha = strength * np.array([-2.0, -4.0])  # the eigenvalues of a ring of four are 0, −2, −2, −4
    ax.plot(alpha, [-2200.0] * 2, "|", color=colour, ms=14, mew=2, label=f"ring of four, strength {strength:g}/s")
ax.set(xlabel="α = strength × eigenvalue (1/s)", ylabel="largest exponent (1/s)", xlim=(-6100, 600))
ax.legend(frameon=False)
pyplot.show()
