"""Bounds of exponents: they hold, for linear equations whose exact growth is known, and are not much too wide."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid._linalg.frames import generic_frame
from lyaphybrid.analysis.indicators.exponent_bounds import eliminated

A = np.array([[1.0, 30.0, -5.0], [0.0, -3.0, 20.0], [0.0, 0.0, -10.0]])


def grown(matrix, frame):
    """ln R_jj of a matrix times the frame, in many digits."""
    _, r = mpmath.qr(matrix * mpmath.matrix(np.asarray(frame).tolist()))
    return np.array([float(mpmath.log(abs(r[j, j]))) for j in range(r.cols)])


@pytest.mark.parametrize("size", [1e-8, 1e-3])
def test_the_recursion_is_a_bound(size):
    """Matrices R + E with errors of all kinds, signs that add up among them; QR of their product in many digits."""
    rng = np.random.default_rng(1)
    k, steps = 3, 25
    r = np.triu(rng.standard_normal((steps, k, k)), 1) + np.exp([0.4, -0.1, -1.0]) * np.eye(k)
    tilt, total, step = np.zeros((k, k)), np.zeros(k), jax.jit(eliminated)
    for one in r:
        tilt, share = (np.asarray(part) for part in step(np.abs(one), np.full((k, k), size), tilt))
        total += -np.log1p(-share)
    bound = total + np.cumsum(0.5 * np.log1p(np.sum(tilt**2, axis=0)))
    computed, worst = np.log(np.abs(r[:, range(k), range(k)])).sum(axis=0), np.zeros(k)
    kinds = [np.ones((k, k)), -np.ones((k, k)), np.eye(k), *np.sign(rng.standard_normal((6, k, k)))]
    kinds += [rng.uniform(-1, 1, (steps, k, k)) for _ in range(3)]
    with mpmath.workdps(80):
        for kind in kinds:
            product = mpmath.eye(k)
            for one in r + size * np.broadcast_to(kind, r.shape):
                product = mpmath.matrix(one.tolist()) * product
            worst = np.maximum(worst, np.abs(grown(product, np.eye(k)) - computed))
    print(bound / worst)
    assert np.all(worst < bound)
    assert np.all(bound < 30 * worst)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
@pytest.mark.parametrize("kind", ["nonnormal", "turning"])
def test_linear_equations(kind, tolerance):
    """x' = A x, and the same in coordinates that turn with time; exact by the matrix exponential."""
    t1, frame = 20.0, generic_frame(3, 3, float)
    turn = np.array([[0.0, 3.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 0.0, 0.0]])

    def field(t, x, args):
        c, s = jnp.cos(3 * t), jnp.sin(3 * t)
        q = jnp.eye(3).at[jnp.array([0, 0, 1, 1]), jnp.array([0, 1, 0, 1])].set(jnp.stack([c, s, -s, c]))
        return q @ jnp.asarray(A) @ q.T @ x + jnp.asarray(turn) @ x

    flow = lh.Flow(field) if kind == "turning" else lh.Flow(lambda t, x, args: jnp.asarray(A) @ x)
    found = lh.exponent_bounds(flow, jnp.zeros(3), t1=t1, method=lh.RungeKutta("dopri5", rtol=tolerance))
    with mpmath.workdps(120):
        exact = np.sort(grown(mpmath.expm(mpmath.matrix((A * t1).tolist())), frame))[::-1] / t1
    error = np.abs(found.exponents - exact)
    print(found, error, found.bound / error)
    assert np.all(error < found.bound)
    assert np.all(found.bound < 50 * tolerance)
    assert np.max(found.bound) < 5000 * np.max(error)  # of order 4 is the estimate, of order 5 the error
    assert found.tilt < 10 * tolerance
    assert found.local_error < 3 * tolerance
    assert found.steps > 100


@pytest.mark.slow
def test_a_linear_dae():
    """Two rates with a constraint; the exact growth in the metric of all components."""
    rates = np.array([0.3, -1.2])
    dae = lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])),
        lambda t, x, args: jnp.stack([rates[0] * x[0] + 0.5 * x[1], rates[1] * x[1], x[2] - x[0] + 2 * x[1]]),
        2,
    )
    found = lh.exponent_bounds(dae, jnp.zeros(3), t1=50.0, method=lh.HalfExplicit(1e-6))
    lift = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -2.0]])
    frame, _ = np.linalg.qr(lift @ generic_frame(3, 2, float)[:2])
    with mpmath.workdps(80):
        moved = mpmath.expm(50 * mpmath.matrix([[rates[0], 0.5], [0, rates[1]]])) * mpmath.matrix(frame[:2].tolist())
        exact = grown(mpmath.matrix(lift.tolist()) * moved, np.eye(2)) / 50
    error = np.abs(found.exponents - exact)
    print(found, error, found.bound / error)
    assert np.all(error < found.bound)
    assert np.all(found.bound < 1e-4)


def test_maps_are_known_to_rounding():
    cat = lh.Map(lambda n, x, args: jnp.array([[2.0, 1.0], [1.0, 1.0]]) @ x)
    found = lh.exponent_bounds(cat, jnp.zeros(2), t1=300, transient=50)
    golden = np.log((3 + np.sqrt(5)) / 2)
    assert np.all(np.abs(found.exponents - [golden, -golden]) < found.bound)
    assert np.all(found.bound < 1e-12)


def test_without_separation_the_bound_grows():
    """Equal exponents: directions may be off by as many local errors as there were steps."""
    spring = lh.Flow(lambda t, x, args: jnp.array([[0.0, 1.0], [-4.0, 0.0]]) @ x)
    gap = lh.Flow(lambda t, x, args: jnp.array([[0.0, 5.0], [0.0, -1.0]]) @ x)
    method = lh.RungeKutta("dopri5", rtol=1e-6)
    short, long = (lh.exponent_bounds(spring, jnp.zeros(2), t1=t, method=method) for t in (20.0, 200.0))
    print(short, long)
    assert long.tilt > 5 * short.tilt
    short, long = (lh.exponent_bounds(gap, jnp.zeros(2), t1=t, method=method) for t in (20.0, 200.0))
    assert_allclose(long.tilt, short.tilt, rtol=0.05)


def test_no_bound_where_a_direction_is_lost():
    flat = lh.Map(lambda n, x, args: jnp.array([[2.0, 1.0], [0.0, 0.0]]) @ x)
    found = lh.exponent_bounds(flat, jnp.zeros(2), t1=20)
    assert np.all(np.isinf(found.bound))


def test_bad_arguments():
    flow = lh.Flow(lambda t, x, args: -x)
    with pytest.raises(ValueError, match="give local_error"):
        lh.exponent_bounds(flow, jnp.zeros(1), t1=1.0, method=lh.RungeKutta("rk4", dt=0.1))
    with pytest.raises(ValueError, match="local_error must be positive"):
        lh.exponent_bounds(flow, jnp.zeros(1), t1=1.0, local_error=0.0)
    with pytest.raises(ValueError, match=r"needs an lh.Flow, lh.DAE or lh.Map"):
        lh.exponent_bounds(lh.zoo.impact_oscillator().system, jnp.zeros(2), t1=1.0)
    fixed = lh.exponent_bounds(flow, jnp.zeros(1), t1=1.0, method=lh.RungeKutta("rk4", dt=0.1), local_error=1e-6)
    assert abs(fixed.exponents[0] + 1) < fixed.bound[0]
