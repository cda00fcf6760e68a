"""What `lh.covariant_vectors` says of vectors that have not converged: closed forms of linear systems."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

PRECISE = lh.RungeKutta("dop853", rtol=1e-12, atol=1e-14)
ANGLE = np.pi / 6
VECTORS = np.array([[1.0, np.cos(ANGLE)], [0.0, np.sin(ANGLE)]])  # 30 degrees apart
HENON = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
NOTE = "not converged"


def linear(exponents, vectors=VECTORS):
    matrix = jnp.asarray(vectors @ np.diag(exponents) @ np.linalg.inv(vectors))
    return lh.Flow(lambda t, x, args: matrix @ x)


def found_for(system, **how):
    x0 = how.pop("x0", [0.1, 0.2])
    return lh.covariant_vectors(system, x0, **{"t1": 20.0, "blocks": 40, "method": PRECISE} | how)


def off(found, i, vectors=VECTORS):
    """The angle between vector i and the eigenvector, at each time."""
    a, b = np.asarray(found.vectors)[:, :, i], vectors[:, i] / np.linalg.norm(vectors[:, i])
    along = a @ b
    return np.arctan2(np.linalg.norm(a - along[:, None] * b, axis=1), np.abs(along))


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0.1, 0.4])
def test_what_remains_of_the_transient_is_the_error_of_the_first_vector(gap):
    """From a column at angle a = 100°, Q has sin(error) = sin a · sin(a − 30°)/sin 30° · exp(−gap), in the end."""
    start = np.deg2rad(100.0)
    frame = np.array([[np.cos(start), -np.sin(start)], [np.sin(start), np.cos(start)]])
    found = found_for(linear([gap, 0.0]), transient=30.0, settle=200.0 / gap, frame=frame)
    remains, error = np.asarray(found.remainders)[0, :, 0], off(found, 0)
    assert_allclose(error / remains, np.sin(start) * np.sin(start - ANGLE) / np.sin(ANGLE), rtol=0.2)
    assert np.all(error < remains / np.sin(ANGLE))
    assert np.max(found.remainders[1]) < 1e-12
    assert ("take a longer transient=; equal exponents" in str(found)) == (gap == 0.1)


@pytest.mark.parametrize("gap", [0.02, 0.1, 0.4])
def test_what_remains_of_settling_is_the_relative_error_of_the_cotangent(gap):
    """Backwards the second vector starts across the first: cot θ = cot 30° (1 − exp(−gap)), exactly."""
    found = found_for(linear([gap, 0.0]), transient=200.0 / gap, settle=8.0)
    remains = np.asarray(found.remainders)[1, :, 0]
    assert_allclose(remains, np.exp(-gap * (28.0 - np.asarray(found.time))), rtol=1e-7)
    assert_allclose(1 - np.tan(ANGLE) / np.tan(np.asarray(found.angles)[:, 0]), remains, rtol=1e-6)
    assert np.all(off(found, 1) < 2 * remains)
    assert np.max(found.remainders[0]) < 1e-12
    assert "take a longer settle=; equal exponents" in str(found)


@pytest.mark.slow
def test_the_error_of_an_angle_is_within_the_remainder():
    """Both ends short, as in the default lengths: half of t1 each."""
    for gap in (0.05, 0.1, 0.3, 0.6):
        found = found_for(linear([0.1, 0.1 - gap]))
        error = np.abs(np.asarray(found.angles)[:, 0] - ANGLE)
        left = np.asarray(found.remainder)[:, 0]
        assert np.all(error < 3 * left)
        assert np.max(error / left) > 0.05
        assert_allclose(left, np.max(np.asarray(found.remainders)[:, :, 0], axis=0))
        assert "take a longer transient= and a longer settle=" in str(found)


@pytest.mark.slow
def test_vectors_of_three_exponents_are_told_apart():
    """The first is far from the others, which are near each other: only those are named."""
    vectors = np.random.default_rng(1).standard_normal((3, 3))
    found = found_for(linear([1.0, -0.95, -1.0], vectors), x0=[0.1, 0.2, 0.3], transient=20.0, settle=20.0)
    assert np.max(found.remainder[:, 0]) < 1e-12 < 0.05 < np.min(found.remainder[:, 1])
    assert "not converged: vectors 2,3, remainder above 0.001" in str(found)
    assert np.max(off(found, 0, vectors)) < 1e-10


@pytest.mark.parametrize("frequency", [0.0, 2.0])
def test_equal_exponents_are_told_however_long_the_run(frequency):
    """A node of two equal exponents, and a focus."""
    matrix = jnp.array([[0.1, frequency], [-4.0 * frequency, 0.1]])
    found = found_for(lh.Flow(lambda t, x, args: matrix @ x), transient=300.0, settle=300.0)
    assert np.all(found.remainder > 0.05)
    assert "equal exponents have no covariant vectors of their own" in str(found)
    assert found.status == lh.STATUS.ok


@pytest.mark.slow
def test_converged_vectors_have_no_note():
    found = found_for(linear([0.5, -0.5]), transient=30.0, settle=30.0)
    assert NOTE not in str(found)
    assert np.max(found.remainder) < 1e-12
    assert_allclose(np.asarray(found.angles)[:, 0], ANGLE, rtol=0, atol=1e-9)
    assert "remainder to the next" in str(found)
    henon = lh.covariant_vectors(HENON, [0.1, 0.2], 1.4, t1=100, blocks=100)
    assert NOTE not in str(henon)
    assert np.max(henon.remainder) < 1e-12


@pytest.mark.slow
def test_one_vector_has_no_neighbour():
    found = found_for(linear([0.5, -0.5]), k=1)
    assert found.remainder.shape == (41, 0)
    assert NOTE not in str(found)
    assert found.to_xarray()["remainder"].shape == (41, 0)


def ticking(kept, matrix):
    """x' = A x, and at each tick some components are forgotten."""
    kept = jnp.asarray(kept)
    return lh.Hybrid(
        lambda t, x, args: jnp.asarray(matrix) @ x,
        lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: kept * x),
    )


MATRIX = np.array([[0.1, 0.4, 0.2], [0.0, -2.3, 0.5], [0.3, 0.1, -0.2]])


@pytest.mark.slow
@pytest.mark.parametrize("transient", [0.0, 20.0])
def test_a_destroyed_direction_is_told_from_those_that_go_on(transient):
    system = ticking([1.0, 1.0, 0.0], MATRIX)
    found = found_for(system, x0=[1.0, 0.5, 0.2], blocks=20, transient=transient, settle=20.0)
    assert np.isneginf(found.exponents[2])
    assert np.all(found.remainders[:, :-1, 1] == 0)
    if transient:
        assert np.max(found.remainder) < 1e-3
        assert NOTE not in str(found)
    else:
        assert "vectors 1,2, remainder" in str(found)
        assert "take a longer transient=; " in str(found)


@pytest.mark.slow
def test_two_directions_destroyed_together_are_not_determined():
    system = ticking([1.0, 0.0, 0.0], MATRIX)
    found = found_for(system, x0=[1.0, 0.5, 0.2], blocks=20, transient=20.0, settle=20.0)
    assert np.all(np.isneginf(found.exponents[1:]))
    assert np.all(found.remainder[:-1, 0] == 0)
    assert np.all(found.remainder[:, 1] > 0.1)
    assert "not converged: vectors 2,3, remainder" in str(found)


@pytest.mark.slow
def test_a_run_that_fails_prints():
    escapes = lh.Map(lambda n, x, args: jnp.stack([x[0] ** 2, 0.5 * x[1]]))
    found = lh.covariant_vectors(escapes, [2.0, 1.0], t1=40, blocks=40, transient=2, throw=False)
    assert found.status.failed
    assert "status nonfinite" in str(found)
    assert NOTE not in str(found)
    assert np.all(np.isnan(found.remainder))


@pytest.mark.slow
def test_under_a_transformation_it_is_the_same():
    def remainder(x0):
        return lh.covariant_vectors(HENON, x0, 1.4, t1=4, blocks=4, transient=6, throw=False).remainder

    one = remainder(jnp.array([0.1, 0.2]))
    assert_allclose(jax.jit(remainder)(jnp.array([0.1, 0.2])), one, rtol=1e-9)


@pytest.mark.parametrize("blocks", [10, 200])
def test_rates_that_differ_by_more_than_numbers_can(blocks):
    """In a piece of 2 the last direction shrinks by e^−2000 against the first: exponents and vectors are those of A."""
    rates = np.array([-0.1, -2.0, -50.0, -1000.0])
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    matrix = turned @ np.diag(rates) @ turned.T
    found = lh.covariant_vectors(lh.Flow(lambda t, x, args: matrix @ x), np.ones(4), t1=20.0, blocks=blocks)
    assert_allclose(found.exponents, rates, rtol=1e-6)
    assert_allclose(np.abs(np.einsum("ni,tni->ti", turned, found.vectors)), 1.0, rtol=1e-6)
