"""Runs that begin in a mode of fewer dimensions: what its projection takes away is lost, whatever comes later."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

LEAVES = lh.Hybrid(
    {
        "stuck": lambda t, x, args: jnp.stack([0.3 * x[0], 0 * x[1]]),
        "free": lambda t, x, args: jnp.stack([0.3 * x[0], -0.1 * x[1]]),
    },
    lh.Transition(every=100.0, phase=0.5, source="stuck", target="free"),
    tangent={"stuck": lambda t, x, args, dx: jnp.stack([dx[0], 0 * dx[1]])},
)
EXACT = [0.3, -np.inf]  # the derivative of the motion by its start is diag(e^(0.3 T), 0) at any T


@pytest.mark.parametrize("t1", [0.4, 1.0, 20.0])
def test_the_direction_stays_lost_when_the_motion_leaves_the_mode(t1):
    """The spectrum forgot the loss then, and singular values were all zero."""
    spectrum = lh.lyapunov_spectrum(LEAVES, [1.0, 0.0], t1=t1, mode="stuck")
    assert_allclose(spectrum.exponents, EXACT, rtol=1e-12)
    assert spectrum.losses.tolist() == [0, 0]  # none in the run
    assert_allclose(spectrum.first_loss, [np.nan, 0.0])
    assert "rank_lost" in spectrum.notes
    assert_allclose(lh.svd_spectrum(LEAVES, [1.0, 0.0], t1=t1, mode="stuck").exponents, EXACT, rtol=1e-12)
    assert_allclose(lh.tangent_map(LEAVES, [1.0, 0.0], t1=t1, mode="stuck").matrix, np.diag([np.exp(0.3 * t1), 0.0]))


@pytest.mark.parametrize("verb", [lh.lyapunov_spectrum, lh.svd_spectrum])
def test_a_transient_that_ends_in_the_mode(verb):
    found = verb(LEAVES, [1.0, 0.0], transient=0.25, t1=4.0, mode="stuck")
    assert_allclose(found.exponents, EXACT, rtol=1e-12)


def test_one_generic_direction_is_that_of_the_mode():
    found = lh.svd_spectrum(LEAVES, [1.0, 0.0], t1=2.0, mode="stuck", k=1)
    assert_allclose(found.exponents, [0.3], rtol=1e-12)


def test_several_runs_with_a_transient():
    starts = [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]
    found = lh.lyapunov_spectrum(LEAVES, starts, transient=0.25, t1=4.0, mode="stuck")
    assert_allclose(found.replicates, [EXACT] * 3, rtol=1e-12)
    assert found.losses.tolist() == [0, 0]
    found = lh.lyapunov_spectrum(LEAVES, starts, transient=0.75, t1=4.0, mode="stuck")  # free by then
    assert found.losses.tolist() == [0, 0]
    assert_allclose(found.exponents, [0.3, -0.1], rtol=1e-9)


def test_windows_that_begin_after_the_start_know_the_new_direction():
    found = lh.spectral_intervals(LEAVES, [1.0, 0.0], t1=20.0, window=2.0, tau=5.0, mode="stuck")
    assert_allclose(found.sacker_sell[0], [0.3, 0.3], rtol=1e-9)
    assert found.sacker_sell[1, 0] == -np.inf
    assert_allclose(found.sacker_sell[1, 1], -0.1, rtol=1e-6)
