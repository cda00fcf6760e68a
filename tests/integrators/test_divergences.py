"""tr Df of a field, however the field is written."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from lyaphybrid.integrators.divergences import trace

TABLE = jnp.asarray(np.random.default_rng(1).normal(size=(3, 3)))


def lorenz(t, x):
    return jnp.stack([10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]])


def unpacked(t, x):
    u, v, w = x
    return jnp.array([u * v * t, jnp.sin(v) ** 2, w**3 - u])


FIELDS = {
    "one component at a time": lorenz,
    "unpacked": unpacked,
    "jitted": jax.jit(unpacked),
    "as a whole": lambda t, x: jnp.sin(TABLE @ x) * t,
    "both": lambda t, x: jnp.roll(x, 1) * x[0] + x,
    "the identity": lambda t, x: x,
    "constant": lambda t, x: jnp.ones(3),
    "from the end": lambda t, x: x[::-1] * x[-1],
    "with branches": lambda t, x: jnp.where(x[0] > 0, x * x[1], -x),
}


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("copies", [1, 2], ids=["n=3", "n=6"])  # written out, and by the matrix
def test_the_divergence_is_the_trace_of_the_jacobian(name, copies):
    def twice(t, x):
        return jnp.concatenate([FIELDS[name](t, x[:3]), FIELDS[name](t, x[3:])])

    field = FIELDS[name] if copies == 1 else twice
    t, x = jnp.asarray(0.7), jnp.asarray([0.3, -1.2, 0.8, 1.1, 0.2, -0.4][: 3 * copies])
    expected = jnp.trace(jax.jacfwd(lambda x: field(t, x))(x))
    np.testing.assert_allclose(trace(field, t, x), expected, rtol=1e-14, atol=1e-14)


def test_components_that_are_held_fixed_leave_no_arithmetic():
    def compiled(field):
        return jax.jit(lambda x: trace(field, 0.0, x)).lower(jnp.ones(3)).compile().as_text()

    assert "multiply" not in compiled(lorenz)
    assert "multiply" not in compiled(jax.jit(lorenz))
    assert "multiply" in compiled(lambda t, x: lorenz(t, x[::-1][::-1]))  # or this test would see nothing
