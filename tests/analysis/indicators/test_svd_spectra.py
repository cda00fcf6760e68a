"""Exponents and directions by singular values, against matrices in several hundred digits and closed forms."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid.analysis.indicators.graded import log_singular_values
from lyaphybrid.systems.consistency import tangent_frame

A = np.array([[1.0, 30.0, -5.0], [0.0, -3.0, 20.0], [0.0, 0.0, -10.0]])  # far from normal
NONNORMAL = lh.Flow(lambda t, x, args: jnp.asarray(A) @ x)


def svd(matrix):
    """Logarithms of the singular values (k,), and right singular vectors as columns."""
    _, values, vectors = mpmath.svd_r(matrix)
    k = matrix.cols
    return np.array([float(mpmath.log(value)) for value in values]), np.array(vectors.tolist(), float).reshape(k, k).T


def angles(a, b):
    """Between columns, up to their signs."""
    along = np.sum(a * b, axis=0)
    return np.arctan2(np.linalg.norm(a - along * b, axis=0), np.abs(along))


@pytest.mark.parametrize("k", [2, 4])
def test_graded_matrices(k):
    """Rows of lengths e^±300, of about the same lengths, and of the same; one of them zero."""
    rng = np.random.default_rng(k)
    rows, logs = rng.standard_normal((4, k, k)), rng.uniform(-300, 300, (4, k))
    logs[1], logs[2] = 1e-3 * logs[1], 0.0
    rows[3, 0], logs[3, 0] = 0.0, -np.inf
    with mpmath.workdps(700):
        exact = [
            svd(mpmath.diag([mpmath.exp(s) for s in log]) * mpmath.matrix(b.tolist()))
            for b, log in zip(rows[:3], logs[:3], strict=True)
        ]
    found, vectors = log_singular_values(rows, logs)
    for (values, directions), ours, columns in zip(exact, found, vectors, strict=False):
        assert_allclose(ours, values, atol=1e-13 * k, rtol=1e-14)
        assert np.max(angles(columns, directions)) < 1e-12
        assert_allclose(columns.T @ columns, np.eye(k), atol=1e-14)
    assert np.isneginf(found[3, -1])
    assert np.all(np.isfinite(found[3, :-1]))
    assert np.all(vectors[3, :, -1] == 0)


@pytest.fixture(scope="module")
def nonnormal():
    return lh.svd_spectrum(NONNORMAL, jnp.zeros(3), t1=40.0, blocks=16, method=lh.RungeKutta(rtol=1e-11, atol=1e-12))


def test_a_linear_system_far_from_normal(nonnormal):
    """The matrix exponential, whose singular values are e^445 apart at the end."""
    with mpmath.workdps(300):
        for time, ours, columns in zip(
            nonnormal.time[3::4], nonnormal.log_values[3::4], nonnormal.directions[3::4], strict=True
        ):
            values, directions = svd(mpmath.expm(mpmath.matrix((A * time).tolist())))
            print(time, ours - values, angles(columns, directions))
            assert_allclose(ours, values, atol=1e-11)
            assert np.max(angles(columns, directions)) < 1e-13
    assert_allclose(nonnormal.log_values.sum(axis=1), -12 * nonnormal.time, atol=1e-8)
    assert nonnormal.status is lh.STATUS.ok
    assert "by the SVD method" in str(nonnormal)


def test_the_error_is_the_error(nonnormal):
    """ln σ_i = λ_i t + c_i: c_i / T is what is said; and directions have settled further than they say."""
    true = np.abs(nonnormal.exponents - [1.0, -3.0, -10.0])
    assert np.min(true) > 0.01
    assert_allclose(nonnormal.error, true, rtol=1e-6)
    assert np.max(nonnormal.turned) < 1e-8


def test_qr_and_svd_differ_at_finite_times(nonnormal):
    """QR depends on the first frame; what no frame exceeds is σ_1, and volumes are the same in both."""
    method = lh.RungeKutta(rtol=1e-11, atol=1e-12)
    s = lh.lyapunov_spectrum(NONNORMAL, jnp.zeros(3), t1=40.0, blocks=16, method=method)
    qr = np.cumsum(np.asarray(s.history.growth), axis=0)
    difference = nonnormal.log_values - qr
    assert np.min(difference[:, 0]) > 1.0
    assert_allclose(difference.sum(axis=1), 0.0, atol=1e-7)
    # With the first frame along the directions both are the same once these have settled.
    along = lh.lyapunov_spectrum(
        NONNORMAL, jnp.zeros(3), t1=40.0, blocks=16, frame=nonnormal.directions[-1], method=method
    )
    assert_allclose(along.exponents, nonnormal.exponents, atol=1e-8)


@pytest.mark.slow
def test_a_product_of_maps():
    """Matrices that change from step to step; k of fewer directions grow by no more than all."""
    matrices = np.random.default_rng(5).standard_normal((60, 3, 3)) * np.array([3.0, 1.0, 0.1])
    system = lh.Map(lambda n, x, args: jnp.asarray(matrices)[jnp.asarray(n, int)] @ x)
    found = lh.svd_spectrum(system, jnp.zeros(3), t1=60, blocks=4)
    with mpmath.workdps(200):
        product = mpmath.eye(3)
        for matrix in matrices:
            product = mpmath.matrix(matrix.tolist()) * product
        values, directions = svd(product)
    assert_allclose(found.log_values[-1], values, rtol=1e-12)
    assert np.max(angles(found.directions[-1], directions)) < 1e-10
    fewer = lh.svd_spectrum(system, jnp.zeros(3), t1=60, blocks=4, k=2)
    assert fewer.exponents.shape == (2,)
    assert np.all(fewer.log_values[-1] < values[:2])
    assert np.all(fewer.log_values[-1] > values[:2] - 5)


def test_what_a_jump_destroys():
    """A matrix of rank two: one singular value is 0, the others are those of the product."""
    m = np.array([[2.0, 1.0, 0.0], [0.0, 0.5, 1.0], [0.0, 0.0, 0.0]])
    found = lh.svd_spectrum(lh.Map(lambda n, x, args: jnp.asarray(m) @ x), jnp.zeros(3), t1=12, blocks=3)
    exact = np.linalg.svd(np.linalg.matrix_power(m, 12), compute_uv=False)
    assert_allclose(found.log_values[-1, :2], np.log(exact[:2]), rtol=1e-9)
    assert np.isneginf(found.exponents[2])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["5.1", "5.2"])
def test_examples_of_linh_and_others(name):
    """Against the tangent map over a short time; over a long one the volume, and Λ's limits."""
    problem = zoo.spring_damper_dae() if name == "5.1" else zoo.rotated_dae(gamma1=1.0, gamma2=2.0, gamma3=3.0)
    method = lh.HalfExplicit(1e-9)
    found = lh.svd_spectrum(problem.system, problem.x0, problem.args, t1=4.0, blocks=16, method=method)
    matrix = lh.tangent_map(problem.system, problem.x0, problem.args, t1=4.0, method=lh.HalfExplicit(1e-12)).matrix
    # The tangent map takes what is across the constraints to nothing: on their tangent space it is Φ.
    basis, _ = np.linalg.qr(np.asarray(tangent_frame(problem.system, jnp.zeros(()), problem.x0, problem.args)))
    _, values, vectors = np.linalg.svd(np.asarray(matrix) @ basis, full_matrices=False)
    assert_allclose(found.log_values[-1], np.log(values), atol=1e-7)
    assert np.max(angles(found.directions[-1], basis @ vectors.T)) < 1e-7
    long = lh.svd_spectrum(problem.system, problem.x0, problem.args, t1=1000.0, blocks=16, method=lh.HalfExplicit(1e-7))
    print(long)
    assert_allclose(long.exponents.sum(), -0.17982701889600464 - 2.8206929901660955, atol=1e-6)
    # λ_i(T) = λ_i + C_i / T, with the limits of the eigenvalues at rest.
    limits = np.array([-0.17712435, -2.82287566])
    assert np.all(np.abs(long.exponents - limits) < 1.01 * long.error + 1e-6)
    assert np.max(long.error) < 0.01


def test_chaos():
    """The tangent map of Lorenz over a short time; over a long one the exponents of the QR method."""
    problem = zoo.lorenz63()
    found = lh.svd_spectrum(
        problem.system, problem.x0, problem.args, t1=1.5, blocks=2, method=lh.RungeKutta(rtol=1e-12)
    )
    matrix = lh.tangent_map(problem.system, problem.x0, problem.args, t1=1.5, method=lh.RungeKutta(rtol=1e-12)).matrix
    assert_allclose(found.log_values[-1], np.log(np.linalg.svd(matrix, compute_uv=False)), atol=1e-5)
    long = lh.svd_spectrum(problem.system, problem.x0, problem.args, t1=300.0, transient=20.0)
    assert np.all(np.abs(long.exponents - [0.9056, 0.0, -14.5723]) < 3 * long.error)
    assert np.max(long.error) < 0.3


def test_bad_arguments():
    cat = lh.Map(lambda n, x, args: jnp.array([[2.0, 1.0], [1.0, 1.0]]) @ x)
    with pytest.raises(ValueError, match="follows one orbit"):
        lh.svd_spectrum(cat, jnp.zeros((3, 2)), t1=10)
    with pytest.raises(ValueError, match="in a space of 2 dimensions"):
        lh.svd_spectrum(cat, jnp.zeros(2), t1=10, k=3)
    with pytest.raises(ValueError, match="under jit, vmap and grad there are none"):
        jax.jit(lambda x: lh.svd_spectrum(cat, x, t1=10).log_values)(jnp.zeros(2))
    continuous = lh.ContinuousQR(lh.RungeKutta())
    for verb in (lh.svd_spectrum, lh.covariant_vectors, lh.fli, lh.gali):
        with pytest.raises(ValueError, match="give the method within it"):
            verb(NONNORMAL, jnp.zeros(3), t1=10.0, method=continuous)
