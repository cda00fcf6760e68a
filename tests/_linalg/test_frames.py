"""Orthonormalisation: against LAPACK, where columns nearly depend on each other, and where some are lost."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from lyaphybrid._jax.engines import compiled
from lyaphybrid._linalg import frames
from lyaphybrid.native.lowering.lowering import lower

KINDS = ("mgs", "lapack", "cholesky")
orthonormalise = compiled()(frames.orthonormalise)


@pytest.mark.slow_cases(
    "20-cholesky", "33-cholesky", "100-cholesky", "3-cholesky", "33-lapack", "100-mgs", "33-mgs", "100-lapack"
)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("k", [3, 20, 33, 100])
def test_both_engines_agree(kind, k):
    frame = jnp.asarray(np.random.default_rng(k).normal(size=(k + 3, k)))
    by_xla = jax.jit(frames.orthonormalise, static_argnums=(1, 3))
    for tolerance in (0.0, frames.LOST):
        for found, wanted in zip(
            orthonormalise(frame, kind, tolerance, tolerance), by_xla(frame, kind, tolerance, tolerance), strict=True
        ):
            assert_allclose(found, wanted, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_blocks_of_columns_in_place(dtype):
    """By BLAS and LAPACK, which XLA does not see: the same columns, ratios of lengths, and derivatives."""
    frame = np.random.default_rng(0).normal(size=(90, 70)).astype(dtype)
    small, blocks = 20 * np.finfo(dtype).eps, compiled()(frames.orthonormal_by_blocks)
    q, r = np.linalg.qr(frame.astype("float64"))
    columns, lengths, uneven = blocks(jnp.asarray(frame))
    assert columns.dtype == lengths.dtype == uneven.dtype == dtype
    assert_allclose(columns, q * np.sign(np.diag(r)), atol=20 * small)
    assert_allclose(lengths, np.abs(np.diag(r)), rtol=20 * small)
    panels = np.split(lengths, [17, 35, 52])
    assert_allclose(uneven, max(float(panel.max() / panel.min()) for panel in panels), rtol=1e-6)
    frame[:, 40] = 0
    assert not blocks(jnp.asarray(frame))[2] < frames.UNEVEN
    many = blocks(jnp.asarray(frame[:, :35]))
    assert_allclose(jax.vmap(blocks)(jnp.asarray(frame[None, :, :35]))[1][0], many[1], rtol=small)
    moved = jax.jvp(lambda x: blocks(x)[1], [jnp.asarray(frame[:, :35])], [jnp.asarray(frame[:, 35:])])[1]
    assert np.all(np.isfinite(moved))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("shape", [(9, 9), (16, 16), (18, 11), (67, 64), (135, 130)])
def test_gram_schmidt_in_vectors(shape, dtype):
    """What machine code does in vectors of the CPU, parts of vectors among them, XLA does column by column."""
    frame = np.random.default_rng(0).normal(size=shape).astype(dtype)
    frame[:, 5] = 0  # a column that is nothing stays nothing
    for function in (frames.modified_gram_schmidt, frames.orthonormal):
        columns, lengths = compiled()(function)(jnp.asarray(frame))
        wanted, known = jax.jit(frames._in_a_loop)(jnp.asarray(frame))
        assert columns.dtype == lengths.dtype == dtype
        assert_allclose(columns, wanted, atol=500 * np.finfo(dtype).eps)
        assert_allclose(lengths, known, rtol=500 * np.finfo(dtype).eps)


@pytest.mark.parametrize("k", [8, 9])
def test_from_nine_columns_on_gram_schmidt_is_in_vectors(k):
    text = lower(jax.make_jaxpr(frames.modified_gram_schmidt)(np.ones((12, k))), 16)
    assert ("@panel" in text) == (k > 8)


@pytest.mark.slow
def test_the_linear_part_of_gram_schmidt_is_not_taken_for_it():
    """Of this name is also what a derivative calls, with other operands or results."""
    rng = np.random.default_rng(4)
    frame, other = rng.normal(size=(2, 12, 10))

    def moved(frame, other):
        (columns, lengths), linear = jax.linearize(frames.modified_gram_schmidt, frame)
        return columns, lengths, *linear(other)

    found, wanted = compiled()(moved)(frame, other), jax.jit(moved)(frame, other)
    for ours, theirs in zip(found, wanted, strict=True):
        assert_allclose(ours, theirs, rtol=1e-10, atol=1e-10)


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


@pytest.mark.parametrize("relative", [0.0, 1e-13])
@pytest.mark.parametrize("second", [[1.0, 0.0], [0.0, 0.0], [0.6, 0.8]])
def test_reverse_derivatives_beside_a_lost_column(second, relative):
    def first_length(matrix):
        columns, log_r, _ = frames.orthonormalise(matrix, "mgs", 1e-12 * relative, relative)
        return log_r[0] + columns[1, 0]

    matrix = jnp.stack([jnp.array([0.6, 0.8]), jnp.array(second)], axis=1)
    assert_allclose(jax.grad(first_length)(matrix), jax.jacfwd(first_length)(matrix), atol=1e-14)
    assert np.all(np.isfinite(jax.grad(first_length)(matrix)))
