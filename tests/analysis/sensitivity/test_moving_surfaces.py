"""Derivatives of exponents where a surface to which the motion is bound moves with a parameter."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh


@pytest.mark.slow
@pytest.mark.parametrize("t0", [0.37, 5.0, 9.0])
def test_a_surface_that_moves_with_a_parameter_wherever_the_orbit_begins(t0):
    """A block that sticks to a belt of the velocity V sin ωt: exponents do not depend on where the period begins."""
    args = {"c": 0.1, "V": 0.4, "omega": 0.3, "stiction": 0.9, "kinetic": 0.7, "k": 1.7}

    def slips(sign):
        return lambda t, x, a: jnp.stack([x[1], -a["k"] * x[0] - a["c"] * x[1] - sign * a["kinetic"]])

    def sticks(t, x, a):
        needed = a["V"] * a["omega"] * jnp.cos(a["omega"] * t) + a["k"] * x[0] + a["c"] * x[1]
        return jnp.stack([a["stiction"] - needed, a["stiction"] + needed])

    belt = lh.filippov(slips(1), slips(-1), lambda t, x, a: x[1] - a["V"] * jnp.sin(a["omega"] * t), stick=sticks)
    turn, how = 2 * np.pi / 0.3, {"transient": 20 * np.pi / 0.3}
    found = lh.lyapunov_gradient(belt, [0.3, 0.5], args, over=("V",), t0=t0, t1=20 * turn, period=turn, **how)
    assert found.trust

    def exponent(v):
        return float(lh.floquet(belt, [0.3, 0.5], args | {"V": v}, t0=5.0, period=turn, **how).exponents[0])

    h = 1e-5
    by_differences = (exponent(0.4 + h) - exponent(0.4 - h)) / (2 * h)
    assert_allclose(found.gradient["V"][0], by_differences, rtol=1e-7)
