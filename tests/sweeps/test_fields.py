"""Finite-time exponents over grids of starts, against closed forms, and the separatrix of a pendulum."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lyaphybrid as lh
from interrupts import only_computed
from lyaphybrid.sweeps.ridges import ridge_points

BOX = [[-3.0, 0.5], [0.0, 2.5]]
PENDULUM = lh.Flow(lambda t, x, args: jnp.stack([x[1], -args * jnp.sin(x[0])]), names=("θ", "ω"))
BALL = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -args * x[1]])),
    names=("height", "speed"),
)


def bounced(height, speed, r, t):
    """The matrix of a ball after its only bounce, in closed form."""
    hit = np.sqrt(speed**2 + 2 * height)
    meets = hit + speed  # when
    d_hit = np.array([1.0, speed]) / hit
    d_meets = d_hit + np.array([0.0, 1.0])
    left = t - meets
    # height: r·hit·left − left²/2; speed: r·hit − left
    return np.stack([r * d_hit * left - r * hit * d_meets + left * d_meets, r * d_hit + d_meets])


@pytest.mark.slow
def test_a_ball_that_bounces_in_closed_form():
    found = lh.ftle_field(BALL, [[0.3, -0.3], [0.6, 0.5]], 0.8, t1=1.7, shape=(4, 5))
    assert_array_equal(found.status_code, 0)
    assert_array_equal(found.jumps, 1)
    for i, height in enumerate(found.axes[0]):
        for j, speed in enumerate(found.axes[1]):
            _, sizes, directions = np.linalg.svd(bounced(height, speed, 0.8, 1.7))
            assert_allclose(found.exponents[i, j], np.log(sizes) / 1.7, rtol=1e-9)
            assert abs(found.stretched[i, j] @ directions[0]) == pytest.approx(1.0, abs=1e-9)


def test_a_map_and_a_start_that_is_not_varied():
    """Arnold's cat: each iteration is the same matrix; z is multiplied by 1/2, and not varied."""
    cat = np.array([[2.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.5]])
    found = lh.ftle_field(lh.Map(lambda n, x, args: cat @ x), [[0.0, 0.0, 0.3], [1.0, 1.0, 0.3]], t1=5, shape=[3, 2])
    assert found.exponents.shape == (3, 2, 3)
    assert list(found.axes) == [0, 1]
    golden = np.log((3 + 5**0.5) / 2)
    assert_allclose(found.exponents, np.broadcast_to([golden, np.log(0.5), -golden], (3, 2, 3)), rtol=1e-12)


@pytest.mark.slow_cases("shape0")
@pytest.mark.parametrize("shape", [(60, 40), (90, 60)])
def test_the_sharpest_ridges_are_the_separatrix(shape):
    """θ' = ω, ω' = −sin θ: the manifolds of θ = ±π are ω² = 2 + 2 cos θ. In units of cells the distance is small."""
    found = lh.ftle_field(PENDULUM, BOX, 1.0, t1=14.0, shape=shape)
    theta, omega = found.ridges(sharpest=0.05).T
    assert len(theta) > 10
    above = omega - np.sqrt(2 + 2 * np.cos(theta))
    cell = 2.0 / shape[1]
    assert np.max(np.abs(above)) < 0.5 * cell
    assert np.ptp(theta) > 0.8  # all along it


def test_ridges_of_a_known_function():
    """A crest along a slanted line, to a fiftieth of a cell; no ridge where nothing is known, none in a plane."""
    i, j = np.meshgrid(np.arange(60.0), np.arange(50.0), indexing="ij")
    off = (i - 0.4 * j - 20.3) / np.hypot(1, 0.4)
    values = np.exp(-(off**2) / 18)
    places, bend = ridge_points(values, 1.0, 1.0)
    across = (places[:, 0] - 0.4 * places[:, 1] - 20.3) / np.hypot(1, 0.4)
    inside = (bend < -0.05) & np.all((places > 5) & (places < [54, 44]), axis=1)
    assert np.sum(inside) > 35
    assert np.max(np.abs(across[inside])) < 0.02
    values[:, :25] = np.nan
    assert np.min(ridge_points(values, 1.0, 1.0)[0][:, 1]) > 26
    assert len(ridge_points(0.1 * i + j, 1.0, 1.0)[0]) == 0
    assert len(ridge_points(np.full((8, 8), np.nan), 1.0, 1.0)[0]) == 0


def test_a_shadow_of_rounding_is_not_an_exponent():
    saddle = lh.Flow(lambda t, x, args: jnp.stack([x[0], -x[1]]))
    found = lh.ftle_field(saddle, [[-1.0, -1.0], [1.0, 1.0]], t1=20.0, shape=(2, 2))
    assert_allclose(found.exponents[..., 0], 1.0, rtol=1e-9)
    assert np.all(np.isnan(found.exponents[..., 1]))


def test_starts_that_fail_are_told():
    blows = lh.Flow(lambda t, x, args: x**2)
    found = lh.ftle_field(blows, [[-1.0], [1.0]], t1=2.0, shape=(4,))
    codes = [lh.STATUS(int(code)) for code in found.status_code]
    assert codes[:3] == [lh.STATUS.ok] * 3
    assert codes[3].failed
    assert found.status == codes[3]
    assert np.all(np.isnan(found.exponents[3]))
    x = found.axes[0][:3]
    assert_allclose(found.exponents[:3, 0], -2 * np.log(1 - 2 * x) / 2.0, rtol=1e-9)
    assert f"1 starts {codes[3].name}" in str(found)
    with pytest.raises(ValueError, match="two components"):
        found.plot()


@pytest.mark.slow
def test_a_field_is_resumed_and_becomes_a_dataset(tmp_path):
    how = {"t1": 3.0, "shape": (6, 4), "store": tmp_path / "field.zarr", "chunk": 8}
    found = lh.ftle_field(PENDULUM, BOX, 1.0, **how)
    again = lh.ftle_field(PENDULUM, BOX, 1.0, **how)
    assert_array_equal(found.exponents, again.exponents)
    data = found.to_xarray()
    assert data["exponents"].dims == ("θ", "ω", "exponent")
    assert_array_equal(data["θ"], found.axes[0])
    with pytest.raises(ValueError, match="another sweep"):
        lh.ftle_field(PENDULUM, BOX, 1.1, **how)


def test_a_picture_has_names_and_a_colour_bar():
    found = lh.ftle_field(PENDULUM, BOX, 1.0, t1=3.0, shape=(6, 4))
    ax = found.plot(exponent=2)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("θ", "ω")
    assert "lambda_2" in ax.figure.axes[1].get_ylabel()
    assert_allclose(np.asarray(ax.collections[0].get_array()).ravel(), found.exponents[..., 1].T.ravel())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"x0": [0.0, 1.0]}, r"two corners of a box of starts, \(2, n\)"),
        ({"x0": [[0.0, 1.0], [0.0, 1.0]]}, "corners of the box must differ"),
        ({"shape": (3,)}, "one number for each of the 2 varied components"),
        ({"t1": -1.0}, "t1, a length of time"),
        ({"system": dataclasses.replace}, "system"),
    ],
)
def test_what_cannot_be_is_refused(change, words):
    how = {"system": PENDULUM, "x0": BOX, "args": 1.0, "t1": 1.0, "shape": (3, 3)} | change
    with pytest.raises((ValueError, TypeError), match=words):
        lh.ftle_field(**how)


@pytest.mark.slow
@pytest.mark.parametrize(("how", "words"), [({"width": 0.0}, "width"), ({"sharpest": 0.0}, "sharpest")])
def test_ridges_refuse_what_does_not_fit(how, words):
    found = lh.ftle_field(PENDULUM, BOX, 1.0, t1=1.0, shape=(3, 3))
    with pytest.raises(ValueError, match=words):
        found.ridges(**how)


def test_what_was_not_computed_is_interrupted(monkeypatch):
    only_computed(monkeypatch, 4)
    found = lh.ftle_field(PENDULUM, BOX, 1.0, t1=1.0, shape=(3, 3))
    assert found.status == lh.STATUS.interrupted
    assert np.sum(np.isnan(found.exponents[..., 0])) == 5
    assert "5 starts interrupted" in str(found)
