"""Dry friction: exponents against independent values, losses of rank, grazing."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid import zoo

PERIOD = 2 * np.pi / 0.666


def agree(found, stderr, reference, reference_stderr, gate):
    """Within five combined standard errors, ours below a gate."""
    assert 0 < stderr < gate, stderr
    assert abs(found - reference) <= 5 * np.hypot(stderr, reference_stderr), (found, stderr)


@pytest.mark.slow
def test_a_block_slips_and_sticks():
    """Over whole periods both exponents are exact: each period has the same multipliers."""
    slipping = zoo.block_on_plate().spectrum()
    np.testing.assert_allclose(slipping.exponents, zoo.block_on_plate().reference.exponents, atol=1e-9)
    assert slipping.notes == frozenset()
    sticking = zoo.block_on_plate(alpha=0.6).spectrum()
    assert abs(float(sticking.exponents[0])) < 1e-12
    assert np.isneginf(sticking.exponents[1])
    assert sticking.losses[1] == 2 * 50  # twice a period
    assert float(sticking.loss_rate[1]) == pytest.approx(1 / np.pi)
    assert "rank_lost" in sticking.notes
    assert sticking.sum_rule_residual is None


@pytest.mark.slow
@pytest.mark.parametrize("angle", [-0.44, -0.45, -0.5])
def test_a_start_at_rest_leaves_when_the_pull_exceeds_friction(angle):
    """The field there is a difference of equal forces, some 1e-17: that is no speed to choose a step by."""
    problem = zoo.friction_pendulum(beta=0.052, alpha=0.45)
    run = lh.trajectory(problem.system, [angle, 0.0], problem.args, t1=0.3, n=3)
    exact = np.arcsin((0.45 + 0.87 * np.sin(angle)) / 0.586) / 0.666
    assert float(run.events.t[0]) == pytest.approx(exact, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["forced", "autonomous"])
def test_slip_to_and_fro(form):
    problem = zoo.friction_pendulum(beta=0.3, form=form)
    spectrum = problem.spectrum(t1=4000 * PERIOD)
    np.testing.assert_allclose(spectrum.exponents, problem.reference.exponents, atol=1e-4)
    assert spectrum.notes == frozenset()
    assert float(spectrum.sum_rule_residual) < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("form", ["forced", "autonomous"])
def test_two_sticks_a_period(form):
    problem = zoo.friction_pendulum(alpha=0.5, form=form)
    spectrum = problem.spectrum(t1=2000 * PERIOD)
    np.testing.assert_allclose(spectrum.exponents[:-1], problem.reference.exponents[:-1], atol=1e-4)
    assert np.isneginf(spectrum.exponents[-1])
    assert spectrum.losses[-1] == 4000
    assert not np.any(spectrum.losses[:-1])


@pytest.mark.slow
def test_chaos_that_rarely_sticks(nonsmooth):
    known, problem = nonsmooth["fu_fig3"], zoo.friction_pendulum()
    spectrum = problem.spectrum(t1=200_000 * PERIOD, transient=2000 * PERIOD)
    agree(float(spectrum.exponents[0]), float(spectrum.stderr[0]), 0.12031, 1e-4, gate=5e-4)
    assert np.isneginf(spectrum.exponents[1])
    rate = float(spectrum.losses[1]) / 200_000
    assert known["sticks_per_period"] / 1.5 < rate < known["sticks_per_period"] * 1.5
    # The finite part differs from the sum, which is known to 4e-6, by the first exponent.
    finite = float(spectrum.finite_exponents[1])
    agree(finite, float(spectrum.stderr[0]), known["lambda2_finite_part"], known["lambda2_finite_part_se"], gate=5e-4)


@pytest.mark.slow
def test_a_mass_on_a_shaken_belt(nonsmooth):
    known, problem = nonsmooth["forced belt chaos 1.4"], zoo.stick_slip_belt(force=0.5)
    spectrum = problem.spectrum(t1=600_000.0)
    value, error = known["exponents"][0], known["se"][0]
    agree(float(spectrum.exponents[0]), float(spectrum.stderr[0]), value, error, gate=5e-4)
    assert np.isneginf(spectrum.exponents[1])
    per_period = float(spectrum.losses[1]) / 600_000 * 2 * np.pi / 1.4
    assert per_period == pytest.approx(known["sticks_per_period"], rel=0.02)


# What a stick does, and what would go wrong without it.


@pytest.mark.slow
def test_a_direction_across_the_surface_does_not_live_on_while_sliding():
    """x' = −x/2 along the surface; across it the convex combination would let a δy grow, e^{2t}, that cannot exist."""

    def pushed(sign):
        return lambda t, x, args: jnp.stack([-0.5 * x[0], 2 * x[1] - sign])

    system = lh.filippov(pushed(1.0), pushed(-1.0), lambda t, x, args: x[1])
    method = lh.RungeKutta("rk4", dt=0.02)
    spectrum = lh.lyapunov_spectrum(system, [1.0, 0.2], t1=20.0, transient=2.0, method=method)
    assert float(spectrum.exponents[0]) == pytest.approx(-0.5, abs=1e-8)
    assert np.isneginf(spectrum.exponents[1])
    free = lh.Hybrid(
        dict(zip(system.mode_names, system.fields, strict=True)),
        system.transitions,
        initial_mode=system.initial_mode,
    )  # the same without the tangent spaces
    phantom = lh.lyapunov_spectrum(free, [1.0, 0.2], t1=20.0, transient=2.0, method=method)
    assert np.isfinite(phantom.exponents).all()


# Grazing.


@pytest.mark.parametrize("velocity", [1.0, 1e-2, 1e-4])
def test_the_saltation_matrix_grows_like_one_over_the_velocity(velocity):
    """An oscillator at a wall, x = 0: S = [[−r, 0], [(a⁺ + r a⁻)/v, −r]], accelerations a± = cos ωt − 2ζv±."""
    problem = zoo.impact_oscillator()
    zeta, r, omega, t = 0.05, 0.8, 2.8, 0.3
    found = np.asarray(lh.saltation_matrix(problem.system, t, [0.0, velocity], problem.args))
    before = np.cos(omega * t) - 2 * zeta * velocity
    after = np.cos(omega * t) + 2 * zeta * r * velocity
    exact = np.array([[-r, 0.0], [(after + r * before) / velocity, -r]])
    np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-13)


@pytest.mark.slow
def test_late_in_a_run_a_stick_ends_once():
    """The instant is blurred by 6e-11, and the force at it: the motion must not be thrown to and fro between modes."""
    problem = zoo.friction_pendulum()
    theta, breaks_away = 656.1150770428819, 450600.46537728485
    for before in (1e-3, 3e-3, 1e-2, 2e-2):
        start = np.array([theta, 0.0])
        run = lh.trajectory(
            problem.system, start, problem.args, t0=breaks_away - before, t1=0.5, n=5, mode="sliding", throw=False
        )
        assert run.status == lh.STATUS.ok
        assert len(run.events) == 1
        assert abs(float(run.events.t[0]) - breaks_away) < 2e-9
