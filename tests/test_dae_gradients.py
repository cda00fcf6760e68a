"""Derivatives of exponents of constrained systems off equilibria, where they are known exactly."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh


def _residual(t, x, args):
    return jnp.stack(
        [
            (-args["a"] + jnp.cos(t)) * x[0] + x[2],
            (-args["c"] + jnp.sin(t)) * x[1] + jnp.cos(t),
            x[2] - x[1] * jnp.sin(t) - jnp.cos(t),
        ]
    )


# The constraint couples the second component to the first one and drives both; triangular, so that exponents are means.
FORCED = lh.DAE(lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])), _residual, 2)
ARGS = {"a": 0.3, "c": 1.1}
METHODS = {
    "birkhoff": {"t1": 200 * np.pi},
    "regression": {"t1": 20 * np.pi, "key": jax.random.key(0)},
}


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_exponents_that_are_means_of_the_diagonal(method):
    """λ = (−a, −c): the derivatives are −1 and 0, off the equilibrium that there is none of."""
    start = lh.consistent_start(FORCED, [0.1, 0.2, 1.0], ARGS)
    found = lh.lyapunov_gradient(FORCED, start, ARGS, transient=6 * np.pi, method=method, **METHODS[method])
    assert found.trust
    assert_allclose(found.value, [-0.3, -1.1], atol=1e-6)
    assert_allclose(found.gradient["a"], [-1.0, 0.0], atol=1e-6)
    assert_allclose(found.gradient["c"], [0.0, -1.0], atol=1e-6)


def test_linear_response_refuses_constraints():
    start = lh.consistent_start(FORCED, [0.1, 0.2, 1.0], ARGS)
    with pytest.raises(ValueError, match="cannot see how jumps or constraints move"):
        lh.lyapunov_gradient(FORCED, start, ARGS, t1=10.0, method="linear_response", key=jax.random.key(0))
