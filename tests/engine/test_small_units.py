"""Where all of a state is as small as the absolute tolerance, nothing is controlled: users are told."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh


def charge(u):
    """A neuron in units u whose current and threshold do not depend on its state: only events have errors."""
    return lh.Hybrid(
        lambda t, q, args: u * jnp.stack([1 + 0.9 * jnp.cos(20 * t) + 0.5 * jnp.cos(7.3 * t)]),
        lh.Transition(
            lambda t, q, args: u * (1 + 0.3 * jnp.sin(1.7 * t)) - q[0],
            lambda t, q, args: jnp.stack([0.2 * u * jnp.sin(2.3 * t)]),
        ),
    )


@pytest.mark.parametrize("verb", [lh.lyapunov_spectrum, lh.trajectory, lh.tangent_map])
def test_a_start_below_the_tolerance_is_told(verb):
    with pytest.warns(UserWarning, match=r"at most 1.0e-13 large.*such as lh.RungeKutta\(atol=1e-25\)"):
        verb(charge(1e-12), [1e-13], t1=2.0)


def test_what_is_told_helps():
    ours = [
        lh.lyapunov_spectrum(charge(u), [0.1 * u], t1=60.0, method=lh.RungeKutta(atol=1e-12 * u)).exponents
        for u in (1.0, 1e-13)
    ]
    np.testing.assert_allclose(*ours, rtol=1e-6)


def test_zero_and_usual_starts_are_not_told():
    for start in (0.0, 1e-8, 1.0):
        lh.lyapunov_spectrum(charge(1.0), [start], t1=2.0)


def test_a_check_blames_no_function_where_nothing_is_resolved():
    report = lh.check(charge(1e-13), [1e-14])
    assert report.ok
    assert any("atol allows errors" in note.text for note in report.notes)
