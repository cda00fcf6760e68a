"""Which columns are lost, on either side of each bound; new columns for lost ones; unit vectors and determinants."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from lyaphybrid._linalg import frames

orthonormalise = jax.jit(frames.orthonormalise, static_argnums=(1, 3))
KINDS = ("mgs", "lapack", "cholesky")


def test_which_algorithm_is_taken():
    assert [frames.kind_for(k) for k in (1, 31, 32, 100)] == ["mgs", "mgs", "cholesky", "cholesky"]


def test_unit_vectors():
    assert_array_equal(frames.unit_vectors(3, 2, float), [[1, 0], [0, 1], [0, 0]])
    assert_array_equal(frames.unit_vectors(2, 2, "float32", paired=True), np.eye(2))
    # x = (q1, q2, p1, p2): q1, q2, p2, p1
    assert_array_equal(frames.unit_vectors(4, 4, float, paired=True), np.eye(4)[[0, 1, 3, 2]])
    assert frames.unit_vectors(4, 3, "float32").dtype == np.float32


def short(k, residual):
    """(k + 1, k), a second column of length 5 of which this much is left, before and after unit vectors."""
    frame = np.eye(k + 1, k)
    frame[:2, 1] = np.sqrt(25.0 - residual**2), residual
    return jnp.asarray(frame)


@pytest.mark.slow_cases("0.999-33-cholesky", "0.999-17-cholesky")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("k", [2, 5, 17, 33])
@pytest.mark.parametrize("part", [0.999, 1.001])
def test_a_column_is_lost_up_to_a_bound(kind, k, part):
    """absolute + relative · its length."""
    residual = part * (1e-4 + 2e-5 * 5)
    columns, log_r, lost = orthonormalise(short(k, residual), kind, 1e-4, 2e-5)
    assert_array_equal(lost, (np.arange(k) == 1) & (part < 1))
    assert_allclose(log_r, np.where(np.arange(k) == 1, 0.0 if part < 1 else np.log(residual), 0.0), atol=1e-9)
    assert_allclose(columns, np.eye(k + 1, k) * ~np.asarray(lost), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("k", [2, 5, 17, 33])
def test_where_nothing_is_tracked_nothing_is_lost(kind, k):
    _, log_r, lost = orthonormalise(short(k, 1e-3), kind, 1e-2, 0.0)
    assert not np.any(lost)
    assert_allclose(log_r, np.where(np.arange(k) == 1, np.log(1e-3), 0.0), atol=1e-9)


@pytest.mark.parametrize("k", [2, 5, 17])
def test_what_is_undefined_or_infinite_is_not_lost(k):
    for what in (np.nan, np.inf):
        frame = short(k, 1.0).at[0, 1].set(what)
        assert not np.any(orthonormalise(frame, "mgs", 1e-12, 1e-12)[2])
    assert not np.any(orthonormalise(short(k, 1e-3), "mgs", np.inf, 1e-12)[2])
    assert not np.any(orthonormalise(short(k, 1e-3), "mgs", -np.inf, 1e-12)[2])
    nothing = orthonormalise(short(k, 1.0).at[:, 1].set(0.0), "mgs", -1.0, 1e-12)
    assert_array_equal(nothing[2], np.arange(k) == 1)  # but what is zero is lost with any bound


@pytest.mark.parametrize("part", [0.99, 1.01])
def test_in_float32_a_column_is_lost_by_its_rounding(part):
    """4 eps of its length, or of 4 where it was stretched."""
    eps = np.finfo("float32").eps
    for length, bound in ((1.0, 4 * eps), (100.0, 16 * eps)):
        frame = jnp.array([[1.0, length], [0.0, part * bound]], "float32")
        assert orthonormalise(frame, "mgs", 0.0, 1e-12)[2].tolist() == [False, part < 1]
        assert not np.any(orthonormalise(frame, "mgs", -1.0, 1e-12)[2])


@pytest.mark.slow_cases("1-0.99")
@pytest.mark.parametrize("part", [0.99, 1.01])
@pytest.mark.parametrize("entry", [1, 2])
def test_a_short_column_is_lost_if_all_its_entries_are_rounding(entry, part):
    """1e-13 of their terms, those of what is removed included: 3 + 2 · 1, and 7."""
    frame, sizes = np.zeros((4, 3)), np.zeros((4, 3))
    frame[0, :2], frame[3, 2] = (1.0, 2.0), 1.0  # two times the first column is removed from the second …
    frame[entry, 1] = part * 1e-13 * (7.0 if entry == 2 else 5.0)
    sizes[0, 0], sizes[1, 0], sizes[1, 1], sizes[2, 1], sizes[3, 2] = 1.0, 1.0, 3.0, 7.0, 1.0  # … with its terms
    found, doubtful = frames.orthonormalise_after_jump(jnp.asarray(frame), "mgs", 1e-12, jnp.asarray(sizes))
    columns, log_r, lost = found
    assert not doubtful
    assert lost.tolist() == [False, part < 1, False]
    if part > 1:
        assert_allclose(log_r[1], np.log(frame[entry, 1]), rtol=1e-12)
        assert_allclose(np.abs(columns[entry, 1]), 1.0, rtol=1e-12)
    else:
        assert_array_equal(columns[:, 1], 0)
        assert log_r[1] == 0


@pytest.mark.slow_cases("3-[True, True, True]")
@pytest.mark.parametrize("live", [[True, True, True], [True, False, True], [False, True, False], [False] * 3], ids=str)
@pytest.mark.parametrize("n", [3, 5])
def test_new_columns_for_lost_ones(live, n):
    """Live columns come first, in their order; the others become orthonormal to them, in the tangent space."""
    rng = np.random.default_rng(1)
    frame = np.linalg.qr(rng.normal(size=(n, 3)))[0] * live
    found, source = frames.refill(jnp.asarray(frame), lambda dx: dx, jnp.array(live))
    order = [*np.flatnonzero(live), *np.flatnonzero(~np.array(live))]
    assert_array_equal(source, order)
    assert source.dtype == jnp.int32
    assert_array_equal(found[:, : sum(live)], frame[:, order[: sum(live)]])
    assert_allclose(found.T @ found, np.eye(3), atol=1e-15)


def test_a_tangent_space_without_room_leaves_columns_empty():
    normal = np.array([2.0, -1.0, 2.0]) / 3
    frame = np.zeros((3, 3))
    frame[:, 1] = np.array([1.0, 2.0, 0.0]) / np.sqrt(5)
    found, source = frames.refill(
        jnp.asarray(frame), lambda dx: dx - normal * (normal @ dx), jnp.array([False, True, False])
    )
    assert source.tolist() == [1, 0, 2]
    assert_array_equal(found[:, 0], frame[:, 1])
    assert_allclose(np.abs(found[:, 1]), np.abs(np.cross(normal, frame[:, 1])), atol=1e-15)
    assert_array_equal(found[:, 2], 0)


@pytest.mark.parametrize(("left", "filled"), [(0.9e-6, False), (1.1e-6, True)])
def test_a_direction_that_the_projection_nearly_destroys_is_not_taken(left, filled):
    found, _ = frames.refill(jnp.zeros((2, 1)), lambda dx: left * dx, jnp.array([False]))
    assert_allclose(found[:, 0], [filled, 0], atol=1e-15)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_logarithms_of_determinants(n):
    matrix = np.random.default_rng(n).normal(size=(n, n))
    for each in (matrix, np.eye(n)[::-1] * 3, -(2.0 ** np.arange(n)) * np.eye(n), np.roll(matrix * np.tri(n), 1, 0)):
        assert_allclose(frames.log_abs_det(jnp.asarray(each)), np.linalg.slogdet(each)[1], rtol=1e-13, atol=1e-13)


def test_a_pivot_is_the_largest_entry():
    """Without pivots 1e-20 would make the others vanish."""
    matrix = jnp.array([[1e-20, 1.0], [1.0, 1.0]])
    assert_allclose(frames.log_abs_det(matrix), 0.0, atol=1e-15)
    assert frames.log_abs_det(jnp.array([[1.0, 2.0], [2.0, 4.0]])) == -np.inf
    assert frames.log_abs_det(jnp.zeros((2, 2))) == -np.inf
    assert_allclose(frames.log_abs_det(jnp.array([[0.0, 1e-200], [-1e-80, 3.0]])), -280 * np.log(10), rtol=1e-14)


@pytest.mark.parametrize("length", [1e-3, 1e-7, 1e-9, 1e-12])
@pytest.mark.parametrize("part", [1e-4, 0.5, 2.0])
def test_a_long_column_of_rounding_is_doubtful_and_a_short_one_lost(length, part):
    """Rounding: 1e-13 of the terms in two dimensions, eps to doubt; short: 1e-11 of what was before, 1e-6 to doubt."""
    frame, terms = jnp.array([[1.0, 1.0], [0.0, length]]), jnp.ones((2, 2)).at[1, 1].set(length / (part * 1e-13))
    (_, _, lost), doubtful = frames.orthonormalise_after_jump(frame, "mgs", frames.LOST, terms)
    assert lost.tolist() == [False, part < 1 and length < 1e-11]
    assert doubtful == (part < 1e-3 and 1e-11 < length < 1e-6)
