"""The history of a run in the order of its exponents, also where columns of the frame change places."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

LOST_AT = 5


def _step(n, x, args):
    """Times 3 along the first axis and 2 along the second; iteration 5 destroys the first one."""
    first = jnp.where(n == LOST_AT, 0.0, 3.0)
    return jnp.stack([first * x[0], 2.0 * x[1]])


STRETCHES = lh.Map(_step)


def check(spectrum, before):
    """λ₁ = ln 2 in every block; the lost direction, which stood first, grew by ln 3 except in one."""
    assert_allclose(spectrum.exponents, [np.log(2), -np.inf])
    assert list(spectrum.losses) == [0, before]
    history, time = spectrum.history, np.arange(1.0, 21.0)
    assert_allclose(history.growth[:, 0], np.log(2), rtol=1e-14)
    assert_allclose(history.exponents[:, 0], np.log(2), rtol=1e-14)
    counted = np.where(np.arange(20) == LOST_AT, 0.0, np.log(3))
    assert_allclose(history.growth[:, 1], counted, rtol=1e-14, atol=1e-15)
    running = np.where(time <= LOST_AT, np.cumsum(counted) / time, -np.inf)
    assert_allclose(history.exponents[:, 1], running, rtol=1e-13)
    assert [spectrum.upper[1], spectrum.lower[1]] == [-np.inf, -np.inf]
    assert_allclose(history.losses[:, 1], np.arange(20) == LOST_AT)
    assert not np.any(history.losses[:, 0])
    assert_allclose([spectrum.upper[0], spectrum.lower[0]], np.log(2), rtol=1e-14)
    assert float(spectrum.stderr[0]) < 1e-14


@pytest.mark.slow
def test_a_history_keeps_to_its_exponent_across_a_loss():
    check(lh.lyapunov_spectrum(STRETCHES, [1.0, 1.0], t1=20, blocks=20, every=1), 1)


def test_bounds_of_the_second_half_see_a_loss_within_it():
    """Of 8 iterations the sixth loses a direction: until then its running exponent was ln 3."""
    spectrum = lh.lyapunov_spectrum(STRETCHES, [1.0, 1.0], t1=8, blocks=8, every=1)
    assert_allclose([spectrum.upper[1], spectrum.lower[1]], [np.log(3), -np.inf], rtol=1e-14)


@pytest.mark.slow
def test_what_is_lost_before_growth_is_counted_is_lost_in_every_block():
    """A flow on a surface, entered in the transient: its frame has an empty column."""
    stuck = lh.filippov(
        lambda t, x, args: jnp.array([-1.0, 0.5]) * x + jnp.array([0.0, -1.0]),
        lambda t, x, args: jnp.array([-1.0, 0.5]) * x + jnp.array([0.0, 1.0]),
        lambda t, x, args: x[1],
    )
    spectrum = lh.lyapunov_spectrum(stuck, [1.0, 0.1], t1=4.0, transient=2.0, blocks=4)
    assert_allclose(spectrum.history.exponents, [[-1.0, -np.inf]] * 4, rtol=1e-7)
    assert_allclose(spectrum.exponents, [-1.0, -np.inf], rtol=1e-7)


@pytest.mark.parametrize("averaging", ["birkhoff"])
def test_weights_too(averaging):
    """With unequal weights the growth of one direction must not be counted for the other."""
    found = lh.lyapunov_spectrum(STRETCHES, [1.0, 1.0], t1=20, blocks=20, every=1, averaging=averaging)
    assert_allclose(found.exponents[0], np.log(2), rtol=1e-13)


@pytest.mark.slow
def test_of_several_runs_and_traced():
    several = lh.lyapunov_spectrum(STRETCHES, np.ones((2, 2)), t1=20, blocks=20, every=1)
    check(several, 2)
    history = jax.jit(lambda x: lh.lyapunov_spectrum(STRETCHES, x, t1=20, blocks=20, every=1).history)(jnp.ones(2))
    assert_allclose(history.exponents[:, 0], np.log(2), rtol=1e-14)


def test_a_spectrum_is_what_its_constructor_makes():
    problem = lh.zoo.henon_map()
    found = lh.lyapunov_spectrum(problem.system, problem.x0, problem.args, t1=100)
    fields = {one.name: getattr(found, one.name) for one in dataclasses.fields(found)}
    built = type(found)(**fields)._resumed_by(found._go_on)
    assert vars(found).keys() == vars(built).keys()
    assert vars(found.history).keys() == {one.name for one in dataclasses.fields(found.history)}
    assert jax.tree.structure(found) == jax.tree.structure(built)
    jax.tree.map(np.testing.assert_array_equal, found, built)
