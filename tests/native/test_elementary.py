"""Sine, cosine, exp and log that the compiler writes out itself: against 60 digits, and where they have no digits."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from lyaphybrid import native
from lyaphybrid.native.lowering.costs import Options

WAYS = {
    "loop": dict(plan=Options(1, 2)),
    "entries": dict(plan=Options(64, 1)),
    "checked": dict(plan=Options(1, 0), checked=True),
}
UNITS = 0.9  # in the last place
RNG = np.random.default_rng(0)


def around(numbers):
    return np.concatenate([numbers, np.nextafter(numbers, -np.inf), np.nextafter(numbers, np.inf)])


ANGLES = np.concatenate([
    RNG.uniform(-10, 10, 400), RNG.uniform(-1e6, 1e6, 300), RNG.uniform(-1e12, 1e12, 200),
    2.0**50 * RNG.uniform(0.5, 2, 60),
    around(np.arange(-60, 60) * np.pi / 2), around(np.arange(-60, 60) * np.pi / 4), 10.0 ** RNG.uniform(-320, 300, 200),
])  # fmt: skip
POWERS = np.concatenate([
    RNG.uniform(-745, 709, 600), RNG.uniform(-1, 1, 400), RNG.uniform(-745, -708, 200),
    around(np.arange(-40, 40) * np.log(2) / 2),
])  # fmt: skip
POSITIVE = np.concatenate([
    10.0 ** RNG.uniform(-323, 308, 600), RNG.uniform(0.5, 2, 600), 1 + RNG.uniform(-1e-6, 1e-6, 200),
    around(2.0 ** np.arange(-1070, 1020, 30)), [1.0, 5e-324],
])  # fmt: skip
CASES = {
    "sin": (jnp.sin, mpmath.sin, ANGLES),
    "cos": (jnp.cos, mpmath.cos, ANGLES),
    "exp": (jnp.exp, mpmath.exp, POWERS),
    "log": (jnp.log, mpmath.log, POSITIVE),
}


def units_off(found, function, x):
    """By how many units in the last place each result is off."""
    with mpmath.workdps(400):  # the largest angles have 300 digits before the point
        exact = [function(mpmath.mpf(float(each))) for each in x]
        place = np.spacing(np.abs(np.array([float(e) for e in exact])))
        return np.array(
            [float(abs(mpmath.mpf(float(y)) - e) / float(p)) for y, e, p in zip(found, exact, place, strict=True)]
        )


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", CASES)
def test_to_the_last_digit(name, way):
    function, exact, x = CASES[name]
    x = x[:60] if way == "entries" else x
    found = native.compile(function, x, **WAYS[way])(x)
    assert np.max(units_off(found, exact, x)) < UNITS


@pytest.mark.parametrize("name", CASES)
def test_lanes_are_what_single_numbers_are_to_the_last_digit(name):
    function, exact, x = CASES[name]
    x = x[: len(x) // 4 * 4].reshape(-1, 4)
    found = native.compile(function, x[:, 0], lanes=4, wide=(True,), plan=Options(1, 2))(x)
    assert np.max(units_off(found.ravel(), exact, x.ravel())) < UNITS


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", CASES)
def test_where_there_are_no_digits(name, way):
    x = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 710.0, -746.0, -1.0, 1e300, -5e-324])
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(x)
    found = native.compile(CASES[name][0], x, **WAYS[way])(x)
    odd = ~np.isfinite(expected) | (expected == 0)
    np.testing.assert_array_equal(found[odd], expected[odd])
    np.testing.assert_array_equal(np.signbit(found[x == 0]), np.signbit(expected[x == 0]))


@pytest.mark.parametrize("name", CASES)
def test_short_numbers_are_rounded_once_more(name):
    function, _, x = CASES[name]
    x = x[(np.abs(x) < 80) & (np.abs(x) > 1e-30)].astype(np.float32)
    found = native.compile(function, x, plan=Options(1, 2))(x)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, getattr(np, name)(x.astype(float)).astype(np.float32))


def test_derivatives():
    x = jnp.linspace(-3, 3, 20)
    found = native.compile(jax.vmap(jax.grad(lambda x: jnp.sin(x) * jnp.exp(-x))), x)(x)
    np.testing.assert_allclose(found, np.exp(-x) * (np.cos(x) - np.sin(x)), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("level", [0, 2])
def test_a_large_angle_changes_no_other_sine(level):
    def both(x):
        return jnp.sin(x), jnp.cos(x)

    x = ANGLES[np.abs(ANGLES) < 2.0**50]
    alone = native.compile(both, x, plan=Options(1, level))(x)
    more = np.append(x, 1e22)
    beside = native.compile(both, more, plan=Options(1, level))(more)
    for found, other, exact in zip(alone, beside, (mpmath.sin, mpmath.cos), strict=True):
        assert np.max(units_off(found, exact, x)) < UNITS
        assert np.array_equal(found, other[:-1])
        assert units_off(other[-1:], exact, more[-1:]) < UNITS
