"""Long runs at the limit of stability are noted as stiff; others are not; steps that lose volumes are noted, too."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

VAN_DER_POL = lh.Flow(lambda t, x, args: jnp.stack([x[1], args * (1 - x[0] ** 2) * x[1] - x[0]]))


def spectrum(**options):
    return lh.lyapunov_spectrum(VAN_DER_POL, [2.0, 0.0], 1000.0, t1=200.0, **options)


@pytest.mark.slow
def test_a_stiff_flow_is_noted_with_what_to_do():
    explicit, implicit = spectrum(k=1), spectrum(k=1, method=lh.RadauIIA())
    assert "stiff" in explicit.notes
    assert "lh.RadauIIA()" in str(explicit)
    assert implicit.notes == frozenset()
    np.testing.assert_allclose(explicit.exponents, implicit.exponents, rtol=1e-4)


@pytest.mark.slow
def test_a_stiff_flow_with_all_exponents_is_noted():
    """Steps resolve the decay of the last column, below the limit of stability."""
    explicit, continuous = spectrum(), spectrum(method=lh.ContinuousQR(lh.RadauIIA()))
    assert "stiff" in explicit.notes
    assert "lh.ContinuousQR(lh.RadauIIA())" in str(explicit)
    assert continuous.notes == frozenset()
    np.testing.assert_allclose(explicit.exponents, continuous.exponents, rtol=1e-4)


@pytest.mark.slow
def test_long_steps_that_nothing_limits_are_not_stiff():
    """A rotor moves evenly between kicks: its steps would be as long as one likes, and nothing decays."""
    rotor = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], jnp.zeros_like(t)]),
        lh.Transition(
            every=1.0,
            reset=lambda t, x, args: jnp.mod(jnp.stack([x[0], x[1] + args * jnp.sin(x[0])]), 2 * jnp.pi),
        ),
    )
    assert lh.lyapunov_spectrum(rotor, [1.0, 2.0], 6.9115, t1=100_000.0).notes == frozenset()
    block = lh.Hybrid(lambda t, x, args: -x, lh.Transition(every=1.0, reset=lambda t, x, args: x + 1.0))
    assert lh.lyapunov_spectrum(block, [1.0], t1=100_000.0).notes == frozenset()


@pytest.mark.slow
def test_long_runs_that_are_not_stiff():
    assert "stiff" not in lh.zoo.lorenz63().spectrum(t1=5000.0).notes
    assert "stiff" not in lh.zoo.impact_oscillator().spectrum(t1=20_000.0).notes
    relaxing = lh.lyapunov_spectrum(VAN_DER_POL, [2.0, 0.0], 5.0, t1=20_000.0)
    assert "stiff" not in relaxing.notes


@pytest.mark.slow
def test_perturbations_that_the_steps_do_not_follow_are_noted():
    """Steps that follow the state alone were far off here, without a word."""
    blind, right = spectrum(method=lh.RungeKutta(control="x")), spectrum()
    assert "step_too_long" in blind.notes
    assert "control='xY'" in str(blind)
    assert "step_too_long" not in right.notes
    assert blind.exponents[1] > 0.5 * right.exponents[1]
    assert right.sum_rule_residual < 1e-6
