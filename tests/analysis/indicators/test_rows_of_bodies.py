"""Indicators of systems whose state has a row for each body, against the same system written without a schedule."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import balls
import lyaphybrid as lh
from lyaphybrid.engine.evolvers.scheduled import predicting_anew

X0 = np.array([[0.4, 1.0, 0.3, 0.1], [0.25, -np.sqrt(2.0), 0.2, 0.7]])  # of each ball q, v and a hand (u, w)


def jump(t, rows, args, which):
    """The ball turns round, and its hand is mapped and pushed by its velocity."""
    q, v, u, w = rows[0]
    return jnp.stack([q + 2 * t * v, -v, 2 * u + w + 0.1 * v, u + w])[None]


BALLS = dataclasses.replace(
    balls.between_walls(names=["q", "v", "u", "w"]), flow=lambda dt, y, args: y.at[:, 0].add(dt * y[:, 1]), jump=jump
)
PLAIN = predicting_anew(BALLS, X0.shape)
GOLDEN = np.log((3 + np.sqrt(5.0)) / 2)  # growth of a hand at each impact


def test_covariant_vectors():
    options = {"t1": 40.0, "k": 2, "blocks": 20, "frame": np.eye(8)[:, [2, 6]]}
    found = lh.covariant_vectors(BALLS, X0, **options)
    expected = lh.covariant_vectors(PLAIN, X0.ravel(), **options)
    assert found.x.shape == (21, *X0.shape)
    np.testing.assert_allclose(found.x.reshape(21, -1), expected.x, atol=1e-9)
    np.testing.assert_allclose(np.abs(found.vectors), np.abs(expected.vectors), atol=1e-7)
    assert {"x", "vectors"} <= set(found.to_xarray())


def test_singular_values():
    found = lh.svd_spectrum(BALLS, X0, t1=40.0, k=2)
    expected = lh.svd_spectrum(PLAIN, X0.ravel(), t1=40.0, k=2)
    np.testing.assert_allclose(found.log_values, expected.log_values, rtol=1e-9)
    assert found.directions.shape[1:] == (8, 2)


def test_intervals_hold_the_growth_of_each_hand():
    """The first hand is hit once a unit of time, the second √2 times."""
    options = {"t1": 400.0, "k": 2, "window": 50.0, "tau": 100.0, "frame": np.eye(8)[:, [2, 6]]}
    found = lh.spectral_intervals(BALLS, X0, **options)
    rates = GOLDEN * np.array([np.sqrt(2.0), 1.0])
    assert np.all(found.lyapunov[:, 0] < rates + 0.01)
    assert np.all(found.lyapunov[:, 1] > rates - 0.02)


@pytest.mark.parametrize("verb", [lh.covariant_vectors, lh.svd_spectrum])
def test_several_starts_are_refused(verb):
    with pytest.raises(ValueError, match=r"x0 must have shape \(N, d\), one row a body; got \(3, 2, 4\)"):
        verb(BALLS, np.stack([X0] * 3), t1=1.0)
