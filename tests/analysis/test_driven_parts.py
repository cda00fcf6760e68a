"""Systems of which one part drives another that stands first: unit vectors of the driven part never leave it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh


def driven(n, x, args):
    """A leaky sum of the logistic map, which it does not act on: exponents ln 0.5 and that of the map."""
    return jnp.stack([0.5 * x[0] + x[1], args["r"] * x[1] * (1 - x[1])])


CHAOS = {"r": 4.0}


@pytest.mark.parametrize("k", [1, 2])
def test_the_largest_exponent_of_a_map_that_drives_another(k):
    found = lh.lyapunov_spectrum(lh.Map(driven), [0.0, 0.3], CHAOS, t1=20_000, transient=100, k=k)
    assert abs(found.exponents[0] - np.log(2)) < max(5 * found.stderr[0], 1e-3)


@pytest.mark.slow
def test_replicates_and_derivatives_have_it_too():
    several = lh.lyapunov_spectrum(
        lh.Map(driven), [0.0, 0.3], CHAOS, t1=5000, transient=100, k=1, replicates=3, key=jax.random.key(1)
    )
    assert np.all(np.abs(several.exponents - np.log(2)) < 0.05)
    diagram = lh.bifurcation_diagram(lh.Map(driven), [0.0, 0.3], CHAOS, over={"r": [3.9]}, directions=("up",), k=1)
    assert np.all(diagram.exponents > 0.4)


def leaky_and_lorenz(t, x, args):
    v, (p, q, r) = x[0], x[1:]
    return jnp.stack([0.01 * p - v, 10 * (q - p), p * (28 - r) - q, p * q - 8 / 3 * r])


def test_the_largest_exponent_of_a_membrane_that_hears_the_lorenz_system():
    found = lh.lyapunov_spectrum(lh.Flow(leaky_and_lorenz), [0.0, 1.0, 1.0, 20.0], t1=1000.0, transient=50.0, k=1)
    assert abs(found.exponents[0] - 0.9056) < 5 * found.stderr[0]


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 2])
def test_the_same_with_a_constraint(k):
    constrained = lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 1.0, 1.0, 0.0])),
        lambda t, x, args: jnp.append(leaky_and_lorenz(t, x[:4], args), x[4] - x[0] - x[1]),
        n_differential=4,
    )
    found = lh.lyapunov_spectrum(constrained, [0.0, 1.0, 1.0, 20.0, 1.0], t1=200.0, transient=20.0, k=k)
    assert abs(found.exponents[0] - 0.9056) < 0.15


def test_few_columns_of_many_components_take_no_square_of_memory():
    """A whole frame of these would be 320 GB."""
    found = lh.lyapunov_spectrum(lh.Map(lambda n, x, args: 0.5 * x), np.ones(200_000), t1=4, k=1, blocks=2)
    assert found.exponents[0] == pytest.approx(np.log(0.5))
