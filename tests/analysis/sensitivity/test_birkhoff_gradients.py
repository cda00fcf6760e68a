"""Derivatives of exponents of regular motion along one run, against exact values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special
from numpy.testing import assert_allclose

import lyaphybrid as lh
from known_gradients import BESSEL, TORUS, torus


def birkhoff(system, x0, args, **keywords):
    return lh.lyapunov_gradient(system, x0, args, **{"t1": 4000, "transient": 200, "algorithm": "birkhoff"} | keywords)


@pytest.mark.slow
def test_a_torus():
    """The mean of cos(φ + s sin φ) is −J₁(s); a derivative by the frequency grows with t along the orbit."""
    found = birkhoff(lh.Map(torus), [0.3, 0.1], TORUS)
    assert found.trust, found.reasons
    assert_allclose(found.value, [0, -0.4 - TORUS["depth"] * scipy.special.j1(TORUS["skew"])], atol=1e-12)
    for name, exact in BESSEL.items():
        assert_allclose(found.gradient[name], exact, atol=1e-8)
        assert np.all(found.stderr[name] < 1e-6)


@pytest.mark.slow
def test_many_parameters_in_reverse():
    """The mean of ln(1 + b cos mφ) is ln((1 + √(1 − b²))/2)."""
    many = jnp.linspace(0.1, 0.6, 24)

    def rule(n, x, depths):
        waves = 1 + depths * jnp.cos(jnp.arange(1.0, 25.0) * x[0])
        return jnp.stack([x[0] + 2.3, 0.5 * jnp.prod(waves) * x[1]])

    found = birkhoff(lh.Map(rule), [0.3, 1e-3], many, t1=16000)
    assert found.trust, found.reasons
    root = np.sqrt(1 - np.asarray(many) ** 2)
    assert_allclose(found.gradient[1], -np.asarray(many) / root / (1 + root), atol=1e-7)


@pytest.mark.slow
def test_a_complex_pair_where_equal_weights_do_not_converge():
    """Of a linear focus in sheared coordinates with rate θ and frequency 1 + θ."""
    shear = np.array([[1.0, 0.5], [0.2, 1.3]])

    def rule(n, x, theta):
        y, turn = jnp.linalg.solve(shear, x), 1 + theta
        y = jnp.stack([jnp.cos(turn) * y[0] - jnp.sin(turn) * y[1], jnp.sin(turn) * y[0] + jnp.cos(turn) * y[1]])
        return jnp.exp(-theta) * (shear @ y)

    def plain(theta):
        return lh.lyapunov_spectrum(lh.Map(rule), [0.1, 0.2], theta, t1=4000, transient=200).exponents

    found = birkhoff(lh.Map(rule), [0.1, 0.2], 0.2)
    assert found.trust, found.reasons
    assert_allclose(found.gradient, [-1, -1], atol=1e-6)
    assert np.max(np.abs(jax.jit(jax.jacfwd(plain))(jnp.asarray(0.2)) + 1)) > 1e-2


@pytest.mark.slow
def test_impacts_as_by_newtons_method():
    problem = lh.zoo.impact_oscillator(omega=2.3, zeta=0.02, restitution=0.8, gap=0.0)
    turn = 2 * np.pi / 2.3
    found = birkhoff(problem.system, problem.x0, problem.args, t1=10000.0, transient=500.0, over=("zeta", "omega"))
    assert found.trust, found.reasons
    assert_allclose(found.value, -0.02 + np.log(0.8) / turn, atol=1e-9)
    assert_allclose(found.gradient["zeta"], -1, atol=1e-5)
    assert_allclose(found.gradient["omega"], np.log(0.8) / (2 * np.pi), atol=1e-5)


@pytest.mark.slow
def test_auto_takes_it_where_there_is_no_isolated_orbit():
    found = lh.lyapunov_gradient(lh.Map(torus), [0.3, 0.1], TORUS, t1=4000)
    assert (found.method, found.trust) == ("birkhoff", True)
    assert any(reason.startswith("implicit") for reason in found.reasons)


@pytest.mark.slow
def test_a_locked_phase_is_not_trusted_where_the_run_is_too_short():
    """Close to a resonance the weights need longer than the run."""
    found = birkhoff(lh.Map(lambda n, x, k: x + 2.1 + k * jnp.sin(x)), [0.3], 0.3, t1=2000)
    assert not found.trust
    assert "first half" in found.reasons[0]


def test_chaos_is_refused():
    with pytest.raises(lh.NoDerivativeError, match="chaotic"):
        birkhoff(lh.Map(lambda n, x, r: r * x * (1 - x)), [0.3], 3.9)


@pytest.mark.slow
def test_few_jumps_are_not_trusted():
    """x' = 1 − c x, a clock x → m x + 0.3: λ = −c + ln|m|/T, dλ/dT = −ln|m|/T²; 33 and 133 ticks."""
    clock = lh.Transition(every=lambda args: args["T"], reset=lambda t, x, args: args["m"] * x + 0.3)
    kicked = lh.Hybrid(lambda t, x, args: 1 - args["c"] * x, clock)
    args = {"c": 0.4, "m": -0.7, "T": 1.5}
    with pytest.raises(lh.NoDerivativeError, match="33 jumps, fewer than 100"):
        lh.lyapunov_gradient(kicked, [0.1], args, t1=50.0, algorithm="birkhoff")
    found = lh.lyapunov_gradient(kicked, [0.1], args, t1=200.0, algorithm="birkhoff")
    assert found.trust
    assert_allclose(found.gradient["T"], [-np.log(0.7) / 1.5**2], rtol=1e-6)
