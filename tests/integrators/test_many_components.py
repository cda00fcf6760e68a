"""Implicit methods with many components, where an inverse serves several stages, against SciPy and exponentials."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import lyaphybrid as lh
from lyaphybrid._linalg.linear_systems import factored, inverse
from lyaphybrid._linalg.roots import root

N = 20
RATE = 50.0
METHODS = {"RadauIIA": lh.RadauIIA(1e-9), "ESDIRK": lh.ESDIRK(rtol=1e-9), "kvaerno3": lh.ESDIRK("kvaerno3", rtol=1e-7)}
TOLERANCE = {"RadauIIA": 1e-7, "ESDIRK": 1e-7, "kvaerno3": 1e-5}
START = np.sin(np.arange(N) + 1.0)


def reacting(t, x, rate):
    """A chain with diffusion: x' = rate · (second difference) + x − x³ + cos t."""
    return rate * (jnp.roll(x, 1) - 2 * x + jnp.roll(x, -1)) + x - x**3 + jnp.cos(t)


def _second_difference(n: int) -> np.ndarray:
    return np.roll(np.eye(n), 1, 0) - 2 * np.eye(n) + np.roll(np.eye(n), -1, 0)


@pytest.mark.parametrize("method", METHODS)
def test_a_stiff_chain_against_scipy(method):
    def rhs(t, x):
        return RATE * (np.roll(x, 1) - 2 * x + np.roll(x, -1)) + x - x**3 + np.cos(t)

    exact = solve_ivp(rhs, (0, 1.5), START, method="Radau", rtol=1e-12, atol=1e-13).y[:, -1]
    found = lh.trajectory(lh.Flow(reacting), START, RATE, t1=1.5, n=1, method=METHODS[method])
    assert_allclose(found.x[-1], exact, atol=TOLERANCE[method])


@pytest.mark.parametrize("method", METHODS)
def test_tangents_of_a_linear_chain(method):
    matrix = RATE * _second_difference(N) + 0.3 * np.eye(N)
    found = lh.tangent_map(lh.Flow(lambda t, x, args: jnp.asarray(matrix) @ x), START, t1=0.2, method=METHODS[method])
    assert_allclose(found.matrix, expm(0.2 * matrix), atol=TOLERANCE[method])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_derivatives_with_respect_to_a_parameter(method):
    def end(rate):
        return lh.trajectory(lh.Flow(reacting), START, rate, t1=0.5, n=1, method=METHODS[method]).x[-1]

    differences = (end(RATE + 1e-3) - end(RATE - 1e-3)) / 2e-3
    assert_allclose(jax.jacfwd(end)(RATE), differences, atol=100 * TOLERANCE[method])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_chain_with_as_many_constraints(method):
    """Beside the chain y = (1 + 0.1 sin y_left) x, solved in each stage, takes the place of x in the reaction."""
    n = 14

    def residual(t, z, args):
        x, y = z[:n], z[n:]
        chain = RATE * (jnp.roll(x, 1) - 2 * x + jnp.roll(x, -1)) + y - y**3
        return jnp.concatenate([chain, y - (1 + 0.1 * jnp.sin(jnp.roll(y, 1))) * x])

    def algebraic(x):
        y = x.copy()
        for _ in range(60):
            y = (1 + 0.1 * np.sin(np.roll(y, 1))) * x
        return y

    def rhs(t, x):
        y = algebraic(x)
        return RATE * (np.roll(x, 1) - 2 * x + np.roll(x, -1)) + y - y**3

    leading = np.diag([1.0] * n + [0.0] * n)
    dae = lh.DAE(lambda t, args: jnp.asarray(leading), residual, n)
    start = START[:n]
    exact = solve_ivp(rhs, (0, 0.5), start, method="Radau", rtol=1e-11, atol=1e-12).y[:, -1]
    found = lh.trajectory(dae, np.concatenate([start, algebraic(start)]), t1=0.5, n=1, method=METHODS[method]).x[-1]
    assert_allclose(found, np.concatenate([exact, algebraic(exact)]), atol=TOLERANCE[method])


def test_inverses_by_factors():
    matrix = np.random.default_rng(1).normal(size=(N, N))
    for sign in (1.0, -1.0):
        own = matrix.copy()
        own[0] *= sign
        factors, of_determinant = factored(jnp.asarray(own))
        assert factors.shape == (N, N)
        assert of_determinant == np.sign(np.linalg.det(own))
        assert_allclose(factors @ jnp.asarray(own[:, 0]), np.eye(N)[:, 0], atol=1e-12)
        assert_allclose(factors @ jnp.asarray(own[:, :3]), np.eye(N)[:, :3], atol=1e-12)
        back, same = inverse(jnp.asarray(own))
        assert_allclose(back @ own, np.eye(N), atol=1e-12)
        assert same == of_determinant
    assert not np.all(np.isfinite(factored(jnp.zeros((N, N)))[0] @ jnp.ones(N)))


@pytest.mark.parametrize("guess", [0.71, 0.9, 1.5, 5.0])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-10])
def test_a_root_with_an_inverse_from_nearby(guess, tolerance):
    """cos x = x: with the slope at 0.6 the root is as good as the tolerance, and the derivative is the exact one."""

    def found(a):
        def negative(x):
            return jnp.cos(a * x) - x

        def inverse_slope(x):
            return 1 / (1 + a * jnp.sin(a * x))

        x, _ = root(
            negative,
            inverse_slope,
            lambda turned, off: turned * off,
            jnp.array([guess]),
            tolerance,
            known=1 / (1 + jnp.sin(jnp.array([0.6]))),
        )
        return x[0]

    x, exact = found(1.0), 0.7390851332151607
    assert abs(x - exact) <= tolerance * (1 + exact)
    slope = -exact * np.sin(exact) / (1 + np.sin(exact))
    assert abs(jax.jacfwd(found)(1.0) - slope) <= 10 * tolerance + 1e-12
