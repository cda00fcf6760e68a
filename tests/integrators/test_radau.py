"""Radau IIA: its coefficients, one step against the exact rational function, order, exponents, stiff equations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from examples import STIFF
from lyaphybrid import zoo
from lyaphybrid._jax.engines import compiled
from lyaphybrid.integrators.implicit import radau
from lyaphybrid.systems.bound import Bound

# Example 5.1 and 5.2, T = 1000, ln R(t₀) not counted: as in test_daes.py.
EXACT = (-0.17982701889600464, -2.8206929901660955)


def test_coefficients():
    """B(5), C(3) and D(2) give order 5 (Butcher); the last stage is the end; γ as Hairer and Wanner print it."""
    a, b, c = radau.A, radau.A[-1], radau.C
    for q in range(1, 6):
        assert abs(b @ c ** (q - 1) - 1 / q) < 1e-15
    for q in range(1, 4):
        assert_allclose(a @ c ** (q - 1), c**q / q, atol=1e-15)
    for q in range(1, 3):
        assert_allclose((b * c ** (q - 1)) @ a, b * (1 - c**q) / q, atol=1e-15)
    root = 6**0.5
    assert_allclose(1 / radau.GAMMA, 3 + 3 ** (2 / 3) - 3 ** (1 / 3), rtol=1e-14)
    assert_allclose(radau.ERROR_WEIGHTS, radau.GAMMA / 3 * np.array([-13 - 7 * root, -13 + 7 * root, -1]), rtol=1e-13)


@pytest.mark.slow
def test_one_step_of_linear_equations_is_the_rational_function():
    """R(z) = (1 + 2z/5 + z²/20) / (1 − 3z/5 + 3z²/20 − z³/60), for state and frame; with a constraint beside."""
    rates = np.array([-1.3, 0.7, -1e5])
    dae = lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 1.0, 0.0])),
        lambda t, x, args: jnp.append(jnp.asarray(rates) * x[:3], x[3] - x[0] - x[1] - x[2]),
        3,
    )
    field, method, h = Bound(dae.field, None), lh.RadauIIA(1e-10), 0.3
    x = jnp.array([1.0, 2.0, 0.5, 3.5])
    frame = jnp.concatenate([jnp.eye(3), jnp.ones((1, 3))])

    @compiled()
    def run(x, frame):
        done = method.step(field, jnp.zeros(()), x, field(0.0, x), jnp.asarray(h))
        return done.x, method.tangent(field, jnp.zeros(()), x, jnp.asarray(h), frame, done.stage_points).frame

    z = h * rates
    exact = (1 + 0.4 * z + z**2 / 20) / (1 - 0.6 * z + 0.15 * z**2 - z**3 / 60)
    new, moved = run(x, frame)
    assert_allclose(new[:3], exact * x[:3], rtol=1e-10)
    assert_allclose(moved[:3], np.diag(exact), rtol=1e-10, atol=1e-14)
    assert_allclose(moved[3], moved[:3].sum(axis=0), rtol=1e-12)


@pytest.mark.slow
def test_the_tangent_is_the_derivative_of_the_step():
    problem = zoo.rotated_dae(gamma1=1.0, gamma2=2.0, gamma3=3.0)
    field, method = Bound(problem.system.field, problem.args), lh.RadauIIA(1e-13)
    t, h = jnp.asarray(0.0), jnp.asarray(0.2)

    @compiled()
    def run(x):
        done, frame = (
            method.step(field, t, x, field(t, x), h),
            field.field.inverse_blocks(t, x, field.args).differential_part,
        )
        return done.x, frame, method.tangent(field, t, x, h, frame, done.stage_points).frame

    _, frame, moved = run(problem.x0)
    for dx, ours in zip(np.asarray(frame).T, np.asarray(moved).T, strict=True):
        ends = [run(problem.x0 + shift * dx)[0] for shift in (-2e-4, -1e-4, 1e-4, 2e-4)]
        straight = (8 * (ends[2] - ends[1]) - (ends[3] - ends[0])) / 12e-4
        assert_allclose(ours, straight, atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["5.1", "5.2"])
@pytest.mark.parametrize(
    ("of", "tolerances"), [(lambda method: method, 3), (lh.ContinuousQR, 10)], ids=["QR", "continuous"]
)
def test_exponents(name, of, tolerances):
    """Errors are far below the tolerance, as the estimate has a lower order than the method."""
    problem = zoo.spring_damper_dae() if name == "5.1" else zoo.rotated_dae(gamma1=1.0, gamma2=2.0, gamma3=3.0)
    for tolerance in (1e-4, 1e-6):
        s = problem.spectrum(t1=1000.0, transient=0.0, method=of(lh.RadauIIA(tolerance)), blocks=2)
        error = np.asarray(s.exponents) - EXACT
        print(name, tolerance, error / tolerance)
        assert s.status is lh.STATUS.ok
        assert np.max(np.abs(error)) < tolerances * tolerance


@pytest.mark.slow
def test_stiff_equations():
    """At rest the exponent is an eigenvalue; the other one is −1e6: an explicit method would take a million steps."""
    start = lh.consistent_start(STIFF, [1.0, jnp.sin(1.0), 0.0], 1e6)
    slow = max(np.linalg.eigvals([[-1.0, 0.5], [1e6, -1e6]]).real)
    s = lh.lyapunov_spectrum(STIFF, start, 1e6, t1=50.0, transient=50.0, k=1, max_steps=3000, method=lh.RadauIIA(1e-7))
    assert s.status is lh.STATUS.ok
    assert_allclose(s.exponents[0], slow, rtol=1e-5)


def turning(t, x, args):
    """Y' = (Θ B Θᵀ + Θ' Θᵀ) Y with the rotation Θ by the angle t: from Θ(0) = I on, Q = Θ and (ln R_ii)' = b_ii."""
    c, s = jnp.cos(t), jnp.sin(t)
    rotation = jnp.array([[c, -s], [s, c]])
    triangular = jnp.array([[jnp.cos(t), 1.0], [0.0, jnp.sin(2 * t) - 2.0]])
    return (rotation @ triangular @ rotation.T + jnp.array([[0.0, -1.0], [1.0, 0.0]])) @ x


@pytest.mark.slow
def test_the_order_of_the_continuous_method():
    """Q and ln R at t = 1 by steps of 1/4 and 1/8 against the exact ones: order 5."""
    field, method = Bound(lh.Flow(turning).field, None), lh.ContinuousQR(lh.RadauIIA(1e-10))

    @compiled()
    def run(frame, steps):
        h = 1.0 / steps

        def step(i, state):
            frame, growth = state
            done = method.tangent(field, i * h, jnp.zeros(2), h, frame)
            return done.frame, growth + done.growth

        return jax.lax.fori_loop(0, steps.astype(int), step, (frame, jnp.zeros(2)))

    exact, c, s = np.array([np.sin(1.0), (1 - np.cos(2.0)) / 2 - 2]), np.cos(1.0), np.sin(1.0)
    errors = []
    for steps in (4.0, 8.0):
        frame, growth = run(jnp.eye(2), jnp.asarray(steps))
        errors.append((np.max(np.abs(growth - exact)), np.max(np.abs(frame - np.array([[c, -s], [s, c]])))))
    orders = np.log2(np.array(errors[0]) / errors[1])
    assert np.all(np.abs(orders - 5) < 0.5), (errors, orders)


@pytest.mark.slow
def test_stiff_equations_by_the_continuous_method():
    """Both exponents, −0.5 nearly and −1e6: steps do not see the second one."""
    start = lh.consistent_start(STIFF, [1.0, jnp.sin(1.0), 0.0], 1e6)
    exact = np.sort(np.linalg.eigvals([[-1.0, 0.5], [1e6, -1e6]]).real)[::-1]
    method = lh.ContinuousQR(lh.RadauIIA(1e-7))
    s = lh.lyapunov_spectrum(STIFF, start, 1e6, t1=50.0, transient=50.0, max_steps=3000, method=method)
    assert s.status is lh.STATUS.ok
    assert_allclose(s.exponents, exact, rtol=1e-5)


def test_bad_arguments():
    with pytest.raises(ValueError, match="rtol must be positive"):
        lh.RadauIIA(0.0)
    with pytest.raises(ValueError, match="control must be"):
        lh.RadauIIA(control="Y")
