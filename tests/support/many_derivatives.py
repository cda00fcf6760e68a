"""Derivatives of random programs: `python tests/support/many_derivatives.py 2000` looks at many.

A derivative is a linear function of dx. The package reads off its jaxpr how all columns of a frame go through it, how
large the terms are that it adds, and on which entries of dx each result can depend.
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np

from lyaphybrid._jax.columns import each_column
from lyaphybrid._jax.dependence import reach
from lyaphybrid._jax.magnitudes import absolute
from many_programs import each_seed, of_seed

FLOATS = 6  # of the operands of a random program are floating-point arrays, the first ones


def wrong_linear(program, operands) -> list[str]:
    """What is wrong about the derivative of a program's floating-point results."""
    run, numbers = jax.extend.core.jaxpr_as_fun(program), np.random.default_rng(0)
    floats, others = tuple(map(jnp.asarray, operands[:FLOATS])), list(map(jnp.asarray, operands[FLOATS:]))
    directions = [numbers.normal(size=one.shape) for one in floats]
    real = [i for i, aval in enumerate(program.out_avals) if aval.dtype == np.float64]
    if not real:
        return []

    def results(*floats):
        found = run(*floats, *others)
        return jnp.concatenate([jnp.ravel(found[i]) for i in real])

    def along(*state):
        *floats, dx = state
        return jax.jvp(results, tuple(floats), tuple(d * one for d, one in zip(dx, directions, strict=True)))[1]

    def linear(dx):
        return along(*floats, dx)

    frame = jnp.asarray(numbers.normal(size=(FLOATS, 4)))
    each = np.stack([jax.jit(linear)(column) for column in frame.T], axis=-1)
    together = np.asarray(jax.jit(lambda frame: each_column(linear, frame))(frame))
    wrong = [] if np.allclose(together, each, 1e-8, 1e-8, equal_nan=True) else ["columns"]
    terms = np.asarray(jax.jit(absolute(linear))(jnp.abs(frame[:, 0])))
    if np.any(np.isfinite(each[:, 0]) & ~(np.abs(each[:, 0]) <= terms * (1 + 1e-9) + 1e-12)):
        wrong.append("terms")
    lowest = np.arange(float(FLOATS))
    if reached := reach(along, floats, lowest, lowest):
        matrix = np.asarray(jax.jit(lambda frame: each_column(linear, frame))(jnp.eye(FLOATS)))
        outside = (lowest < np.asarray(reached[0])[:, None]) | (lowest > np.asarray(reached[1])[:, None])
        if np.any(np.isfinite(matrix) & (matrix != 0) & outside):
            wrong.append("reach")
    return wrong


if __name__ == "__main__":
    sys.exit(bool(each_seed(lambda seed: wrong_linear(*of_seed(seed)), *map(int, sys.argv[1:]))))
