"""Cycles that contract by more than rounding within any piece: their exponents are finite all the same."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

TURNED = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]


def circle(t, y, args):
    """The unit circle, on which r − 1 decays at the rate 2a and z at the rate b, in turned coordinates."""
    x = TURNED.T @ y
    square = x[0] ** 2 + x[1] ** 2
    pull = args["a"] * (1 - square)
    return TURNED @ jnp.stack([pull * x[0] - x[1], pull * x[1] + x[0], -args["b"] * (x[2] - 0.1 * x[0])])


def oregonator(t, x, args):
    """R. J. Field & R. M. Noyes, J. Chem. Phys. 60 (1974) 1877, as stiff solvers are tested with it."""
    return jnp.stack(
        [
            77.27 * (x[1] + x[0] * (1 - 8.375e-6 * x[0] - x[1])),
            (x[2] - (1 + x[0]) * x[1]) / 77.27,
            0.161 * (x[0] - x[2]),
        ]
    )


@pytest.mark.parametrize(("a", "b"), [(2.0, 30.0), (2.0, 3e6), (200.0, 3e6)])
def test_exponents_in_closed_form(a, b):
    start = TURNED @ np.array([1.0, 0.0, 0.1])
    orbit = lh.floquet(lh.Flow(circle), start, {"a": a, "b": b}, transient=1.0, method=lh.ESDIRK(rtol=1e-10))
    assert orbit.stability == "stable"
    assert_allclose(orbit.exponents, [0.0, -2 * a, -b], rtol=1e-4, atol=1e-7)
    assert not orbit.notes


def test_what_takes_too_many_steps_is_unresolved():
    start = TURNED @ np.array([1.0, 0.0, 0.1])
    orbit = lh.floquet(lh.Flow(circle), start, {"a": 5e5, "b": 3e6}, transient=1.0, method=lh.ESDIRK(rtol=1e-10))
    assert orbit.notes == {"unresolved"}
    assert "unresolved" in str(orbit)
    assert np.all(np.isnan(orbit.exponents[1:]))


def sensed(t, x, args, sign=1.0):
    """A block that sticks, and a sensor that follows its place at the rate s."""
    return jnp.stack([x[1], 0.8 * jnp.cos(0.5 * t) - x[0] - 0.4 * sign, args["s"] * (x[0] - x[2])])


@pytest.mark.slow_cases("20.0")
@pytest.mark.parametrize("s", [2.0, 20.0])
def test_what_shrinks_between_losses(s):
    """Exponents −0.1257, −s, −∞; rounding along the direction that sticking destroys outgrows e^(−20 t)."""
    block = lh.filippov(sensed, lambda t, x, a: sensed(t, x, a, -1.0), surface=lambda t, x, args: x[1])
    orbit = lh.floquet(block, [0.0, 0.5, 0.0], {"s": s}, period=4 * np.pi, transient=100.0)
    assert ("unresolved" in orbit.notes) == (s == 20.0)
    if s == 2.0:
        assert_allclose(orbit.exponents[1], -s, rtol=1e-6)


def test_the_only_multiplier_of_a_neuron():
    """What has one component, and returns, attracts."""
    neuron = lh.Hybrid(
        lambda t, x, args: 1.5 - x, lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: 0.1 * x)
    )
    orbit = lh.floquet(neuron, [0.5])
    assert orbit.stable
    assert_allclose(orbit.period, np.log(1.4 / 0.5), rtol=1e-9)


ADAPTING = lh.Hybrid(
    lambda t, x, args: jnp.stack([1.5 - x[0] - x[1], -x[1] / args["tau"]]),
    lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: jnp.stack([0 * x[0], x[1] + args["gain"]])),
)


@pytest.mark.parametrize(
    ("tau", "exponent"),
    [
        pytest.param(100.0, -0.727478683925, marks=pytest.mark.slow),
        pytest.param(300.0, -0.888623139856),
        pytest.param(1000.0, -0.959922877753, marks=pytest.mark.slow),
    ],
)
def test_a_neuron_that_adapts_slowly(tau, exponent):
    """Multipliers 1 and 1.5e-6, 6.7e-22, 8.4e-77, of the closed form in many digits: its trace is 1 + μ."""
    orbit = lh.floquet(ADAPTING, [0.0, 0.6], {"tau": tau, "gain": 0.1}, transient=500.0)
    assert_allclose(orbit.exponents, [0.0, exponent], atol=1e-9)
    assert_allclose(orbit.multipliers.real, [1.0, np.exp(exponent * orbit.period)], rtol=1e-6)
    assert not orbit.notes


def test_a_start_just_after_an_event():
    """As a transient of whole periods leaves it: v is next to 0, and its first time is no time of the motion."""
    args, start = {"tau": 100.0, "gain": 0.1}, np.array([0.0, 0.59499999])
    period = 18.4003646060774
    for transient in (10 * period, 9.9999999 * period, 10.0000001 * period):
        assert lh.floquet(ADAPTING, start, args, transient=transient).period == pytest.approx(period, rel=1e-9)


def test_what_a_gradient_does_not_know_is_nan():
    args, start = {"tau": 300.0, "gain": 0.1}, [0.0, 0.599]
    found = lh.lyapunov_gradient(ADAPTING, start, args, t1=500.0, over="gain", algorithm="implicit")
    assert_allclose(found.value[1], -0.888623139856, atol=1e-9)
    assert np.isnan(found.gradient["gain"][1])
    assert not found.trust
    assert any("less than rounding" in reason for reason in found.reasons)


@pytest.mark.slow
def test_the_oregonator():
    """Against the second additive compound of Df along the orbit, by SciPy's BDF at rtol 1e-8: −0.5019975."""
    orbit = lh.floquet(lh.Flow(oregonator), [4.0, 1.1, 4.0], transient=700.0, method=lh.ESDIRK())
    assert_allclose(orbit.exponents[:2], [0.0, -0.5019975], atol=2e-7)
    assert_allclose(orbit.exponents[2], -24665.02, rtol=1e-5)
