"""Orbits that stretch or contract much: M alone does not tell a contraction from a loss."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

import lyaphybrid as lh

TURNED = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])


def test_what_a_saddle_stretches_hides_no_multiplier():
    """A saddle that is driven along its motion, R diag(15, −15) Rᵀ x (1 + ½ cos 2πt): over one period exp(±15)."""
    field = TURNED @ np.diag([15.0, -15.0]) @ TURNED.T
    saddle = lh.Flow(lambda t, x, args: field @ x * (1 + 0.5 * jnp.cos(2 * jnp.pi * t)))
    found = lh.floquet(saddle, [0.0, 0.0], period=1.0)
    np.testing.assert_allclose(np.log(np.abs(found.multipliers)), [15.0, -15.0], atol=1e-6)


@pytest.mark.slow
def test_what_a_jump_destroys_has_the_multiplier_0():
    field = TURNED @ np.diag([15.0, -15.0]) @ TURNED.T
    forgets = lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: jnp.stack([x[0], 0.3 * x[0]]))
    saddle = lh.Hybrid(lambda t, x, args: field @ x, forgets)
    found = lh.floquet(saddle, [0.0, 0.0], period=1.0)
    assert abs(found.multipliers[0]) > 1e6
    assert found.multipliers[1] == 0


@pytest.mark.slow_cases("300.0")
@pytest.mark.parametrize("rate", [1.0, 10.0, 300.0])
def test_what_contracts_strongly_is_not_lost(rate):
    """r' = k r (1 − r²), φ' = 1, z' = 0.1 k (r² − 1 − z): exponents 0, −0.1 k, −2 k, however small exp(−4π k) is."""

    def field(t, x, k):
        r2 = x[0] ** 2 + x[1] ** 2
        grow = k * (1 - r2)
        return jnp.stack([grow * x[0] - x[1], grow * x[1] + x[0], 0.1 * k * (r2 - 1 - x[2])])

    found = lh.floquet(lh.Flow(field), [1.0, 0.0, 0.0], rate)
    assert found.status == lh.STATUS.ok
    np.testing.assert_allclose(found.exponents, [0.0, -0.1 * rate, -2 * rate], atol=1e-7, rtol=1e-7)
    assert found.stability == "stable"


@pytest.mark.slow
@pytest.mark.parametrize("forgets", [False, True])
def test_a_jump_beside_a_strong_contraction(forgets):
    """x' = −60 (x − cos t), y' = −90 y: exponents −60, −90; a clock halves y, or sets it to 0."""
    halved = lh.Transition(every=2 * np.pi, phase=1.0, reset=lambda t, x, part: jnp.stack([x[0], part * x[1]]))
    driven = lh.Hybrid(lambda t, x, part: jnp.stack([-60.0 * (x[0] - jnp.cos(t)), -90.0 * x[1] + 0 * t]), halved)
    found = lh.floquet(driven, [1.0, 0.0], 0.0 if forgets else 0.5, period=2 * np.pi)
    slow, fast = -60.0, -np.inf if forgets else -90 - np.log(2) / (2 * np.pi)
    np.testing.assert_allclose(found.exponents, [slow, fast], rtol=1e-7)


def test_a_strongly_contracting_map():
    """The map of a point on a circle of period 3, with x → 1e-9 x: the multiplier is 1e-27."""
    turned = lh.Map(lambda t, x, args: jnp.stack([-0.5 * x[1] + x[2] * 1e-9, x[0], 1e-9 * x[2] + 0 * x[0]]))
    found = lh.floquet(turned, [0.0, 0.0, 0.0], period=4)
    np.testing.assert_allclose(np.log(np.abs(found.multipliers)), [2 * np.log(0.5)] * 2 + [4 * np.log(1e-9)], rtol=1e-9)


@pytest.mark.slow_cases("30.0")
@pytest.mark.parametrize("stiffness", [5.0, 30.0])
def test_a_relaxation_oscillation(stiffness):
    """Van der Pol's: the second exponent is the mean of μ (1 − x²) along the cycle; for μ = 30 the multiplier is 0."""

    def field(t, x, mu):
        damping = mu * (1 - x[0] ** 2)
        return jnp.stack([x[1], damping * x[1] - x[0], damping])

    found = lh.floquet(lh.Flow(lambda t, x, mu: field(t, x, mu)[:2]), [2.0, 0.0], stiffness)
    run = lh.trajectory(lh.Flow(field), jnp.append(found.x0, 0.0), stiffness, t1=float(found.period))
    np.testing.assert_allclose(found.exponents, [0.0, run.x[-1, 2] / found.period], atol=1e-8, rtol=1e-8)


@pytest.mark.slow
def test_a_branch_on_which_the_period_grows_without_bound_ends():
    """A wheel without a rim, on slopes that let it just pass the top: in closed form."""
    alpha, turn = np.pi / 8, np.cos(np.pi / 4)

    def short_of_the_top(slope):
        energy = 4 * np.sin(slope) * np.sin(alpha) / (1 / turn**2 - 1)  # ω⁺² of the motion that repeats, g = l = 1
        return energy / 2 - (1 - np.cos(slope - alpha))

    wheel = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], jnp.sin(x[0])]),
        lh.Transition(
            lambda t, x, args: args["slope"] + alpha - x[0],
            lambda t, x, args: jnp.stack([args["slope"] - alpha + 0 * x[0], turn * x[1]]),
        ),
    )
    branch = lh.continuation(wheel, [0.12 - alpha, 0.5], {"slope": 0.12}, over={"slope": (0.02, 0.2)})
    assert branch.ends == ("no convergence", "range")
    assert_allclose(np.min(branch.values), scipy.optimize.brentq(short_of_the_top, 0.02, 0.12), rtol=1e-5)
