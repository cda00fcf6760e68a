"""Forward derivatives through what is computed of short and regular motion, jumps included."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

pytestmark = pytest.mark.unoptimised

TIGHT = lh.RungeKutta("dopri5", rtol=1e-10, atol=1e-12)


def falling(t, x, args):
    return jnp.stack([x[1], -args["gravity"] - args["drag"] * x[1]])


def floor_of(t, x, args):
    return x[0] - args["height"] - 0.1 * jnp.sin(t)


def struck(t, x, args):
    speed = 0.1 * jnp.cos(t)
    return jnp.stack([x[0], speed - args["restitution"] * (x[1] - speed)])


BALL = lh.Hybrid(falling, lh.Transition(guard=floor_of, reset=struck))
ARGS = {"gravity": 1.0, "drag": 0.1, "height": 0.2, "restitution": 0.7}
START = jnp.array([1.0, 0.3])


def ends(args, x0):
    """The state and its derivative after two impacts on a floor that moves."""
    found = lh.tangent_map(BALL, x0, args, t1=4.0, method=TIGHT)
    return found.x, found.matrix


def with_one(name, value):
    return ARGS | {name: value}


@pytest.mark.parametrize("name", list(ARGS))
def test_motion_and_tangents_with_respect_to_parameters(name):
    """Of guards and resets too; against central differences."""
    assert int(lh.tangent_map(BALL, START, ARGS, t1=4.0, method=TIGHT).jumps) == 2
    value, step = jnp.asarray(ARGS[name]), 1e-5
    of_one = jax.jit(lambda value: ends(with_one(name, value), START))
    slopes = jax.jvp(of_one, (value,), (jnp.ones(()),))[1]
    for slope, high, low in zip(slopes, of_one(value + step), of_one(value - step), strict=True):
        assert_allclose(slope, (high - low) / (2 * step), rtol=1e-6, atol=1e-6)


def test_the_derivative_of_a_trajectory_is_the_tangent_map():
    def end(x0):
        return lh.trajectory(BALL, x0, ARGS, t1=4.0, n=1, method=TIGHT).x[-1]

    assert_allclose(jax.jacfwd(end)(START), ends(ARGS, START)[1], rtol=1e-9)


def test_the_derivative_of_a_saltation_matrix():
    """Of a ball that meets a floor at rest at speed v, S₂₁ = (1 + r) g/v."""

    def entry(gravity):
        still = lh.Transition(guard=lambda t, x, g: x[0], reset=lambda t, x, g: jnp.stack([x[0], -0.7 * x[1]]))
        ball = lh.Hybrid(lambda t, x, g: jnp.stack([x[1], -g]), still)
        return lh.saltation_matrix(ball, 0.0, jnp.array([0.0, -2.0]), gravity)[1, 0]

    value, slope = jax.jvp(entry, (jnp.asarray(9.0),), (jnp.ones(()),))
    assert_allclose(value, slope * 9.0, rtol=1e-12)
    assert_allclose(abs(slope), 1.7 / 2.0, rtol=1e-12)


def test_the_derivative_of_exponents_of_regular_motion():
    """Rates of a linear system in sheared coordinates; its columns align at a rate that has a derivative too."""
    shear = np.array([[1.0, 0.5], [0.2, 1.3]])

    def exponents(rate):
        def field(t, x, args):
            return shear @ (jnp.stack([args, -args]) * jnp.linalg.solve(shear, x))

        found = lh.lyapunov_spectrum(
            lh.Flow(field), jnp.zeros(2), rate, t1=20.0, transient=40.0, method=TIGHT, blocks=2, throw=False
        )
        return found.exponents

    assert_allclose(jax.jit(functools.partial(jax.jacfwd(exponents)))(jnp.asarray(0.7)), [1, -1], rtol=1e-6)
