"""
Running exponents of an impact oscillator
=========================================

A driven oscillator hits a wall. Its exponents against the length of the run: the mean over more and more blocks, with a
band of one standard error.
"""

import jax
from matplotlib import pyplot

import lyaphybrid as lh

jax.config.update("jax_enable_x64", True)

spectrum = lh.zoo.impact_oscillator().spectrum(t1=5000.0)
print(spectrum)

_, ax = pyplot.subplots(figsize=(7.0, 3.4), layout="constrained")
spectrum.plot.convergence(ax=ax)
pyplot.show()
