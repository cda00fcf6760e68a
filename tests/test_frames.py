"""Orthonormalisation: against LAPACK, where columns nearly depend on each other, and where some are lost."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from lyaphybrid import frames

KINDS = ("mgs", "lapack", "cholesky")
orthonormalise = jax.jit(frames.orthonormalise, static_argnums=(1, 3))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("k", [2, 3, 16, 20, 64, 100])
def test_columns_and_lengths_are_those_of_lapack(kind, k):
    frame = np.random.default_rng(k).normal(size=(k + 3, k))
    columns, log_r, lost = orthonormalise(jnp.asarray(frame), kind)
    q, r = np.linalg.qr(frame)
    assert not np.any(lost)
    assert_allclose(columns, q * np.sign(np.diag(r)), atol=1e-12)
    assert_allclose(log_r, np.log(np.abs(np.diag(r))), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("k", [3, 12, 20, 40])
def test_columns_stay_orthonormal_where_they_nearly_depend_on_each_other(kind, k):
    """Cleared once, columns that are 1e-8 apart are orthogonal to 1e-8; where losses are to be told, all are twice."""
    rng = np.random.default_rng(k)
    frame = rng.normal(size=(k, 1)) + 1e-8 * rng.normal(size=(k, k))
    columns, _, lost = orthonormalise(jnp.asarray(frame), kind, frames.LOST, frames.LOST)
    assert not np.any(lost)
    assert_allclose(columns.T @ columns, np.eye(k), atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_the_columns_after_a_lost_one_keep_their_lengths(kind):
    """Two neurons have fired together: two rows are equal, and the third column depends on the first two."""
    rng = np.random.default_rng(2)
    frame = rng.normal(size=(4, 4))
    frame[:, 2] = frame[:, :2] @ rng.normal(size=2)
    frame[1] = frame[0]
    _, log_r, lost = orthonormalise(jnp.asarray(frame), kind, frames.LOST, frames.LOST)
    assert np.asarray(lost).tolist() == [False, False, True, False]
    assert_allclose(log_r[3], np.log(np.abs(np.linalg.qr(frame[:, [0, 1, 3]])[1][2, 2])), atol=1e-12)
