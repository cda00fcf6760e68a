"""Sines and cosines in vector registers, against 40 digits."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from lyaphybrid.methods.circular import LARGEST, cosine, sine
from lyaphybrid.methods.conditionals import in_lanes

HALF_TURNS = np.arange(-200, 200) * (np.pi / 4)
RANDOM = np.random.default_rng(0).uniform(-1, 1, 4000)
NUMBERS = {
    "small": RANDOM * 10.0 ** np.linspace(-300, 0, RANDOM.size),
    "some turns": RANDOM * 100,
    "many turns": RANDOM * LARGEST * 0.999,
    "at quarters and eighths": np.concatenate(
        [HALF_TURNS, np.nextafter(HALF_TURNS, 9e9), np.nextafter(HALF_TURNS, -9e9)]
    ),
    "at far quarters": (np.pi / 2) * np.arange(2**20 - 3000, 2**20 - 1500),
}
KINDS = {"sin": (sine, mpmath.sin, jnp.sin), "cos": (cosine, mpmath.cos, jnp.cos)}


def errors(ours, exact, x):
    """|ours - exact|, and the same over |exact|."""
    with mpmath.workdps(40):
        true = [exact(mpmath.mpf(float(one))) for one in x]
        gone = [abs(mpmath.mpf(float(one)) - two) for one, two in zip(ours, true, strict=True)]
        parts = [float(one / abs(two)) if two else 0.0 for one, two in zip(gone, true, strict=True)]
        return max(map(float, gone)), max(parts)


@pytest.mark.parametrize("numbers", NUMBERS)
@pytest.mark.parametrize("kind", KINDS)
def test_all_digits_are_right(kind, numbers):
    function, exact, _ = KINDS[kind]
    x = NUMBERS[numbers]
    for run in (function, jax.jit(function)):
        absolute, relative = errors(np.asarray(run(jnp.asarray(x))), exact, x)
        assert absolute < 2.3e-16
        assert relative < 4e-16 or numbers in ("at quarters and eighths", "at far quarters")


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_too_large_goes_to_xla(kind):
    plain = KINDS[kind][2]
    for x in ([0.3, 2e6, -1e300], [0.3, np.inf, np.nan]):
        np.testing.assert_array_equal(jax.jit(in_lanes(plain))(jnp.array(x)), jax.jit(plain)(jnp.array(x)))


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_and_lanes(kind):
    function, _, plain = KINDS[kind]
    x = jnp.linspace(-9.0, 9.0, 8)
    for derivative in (jax.jacfwd, jax.jacrev, lambda f: jax.jacfwd(jax.jacrev(f))):
        np.testing.assert_allclose(derivative(function)(x), derivative(plain)(x), atol=1e-15)
    np.testing.assert_allclose(jax.vmap(function)(x), plain(x), atol=1e-15)


def test_in_lanes_takes_ours_for_float64_alone():
    @jax.jit
    def inner(t):
        return jnp.sin(2.0 * t), jnp.cos(t.astype(jnp.float32))

    def function(t):
        return [*inner(t), jnp.exp(jnp.cos(t))]

    t = jnp.linspace(0.0, 3.0, 4)
    conditional = jax.make_jaxpr(in_lanes(function))(t).eqns[-1]
    assert conditional.primitive.name == "cond"
    as_it_is, with_ours = ([eqn.primitive.name for eqn in one.jaxpr.eqns] for one in conditional.params["branches"])
    assert as_it_is.count("custom_jvp_call") == 0
    assert with_ours.count("custom_jvp_call") == 2
    assert with_ours.count("cos") == 1, "that of float32"
    for ours, plain in zip(in_lanes(function)(t), function(t), strict=True):
        np.testing.assert_allclose(ours, plain, rtol=1e-15)
