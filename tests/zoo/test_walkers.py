"""The rimless wheel and the simplest walker: multipliers of a step, exponents, scuffing and falling."""

import math

import jax
import numpy as np
import pytest
from scipy.integrate import quad

import lyaphybrid as lh
from lyaphybrid import zoo

PRECISE = lh.RungeKutta("dopri5", rtol=1e-11, atol=1e-13)
WHEEL, WALKER = "rimless a=pi/8,gam=0.2", "simplest walker long gamma=0.009"


def over_a_period(problem, period, begin):
    """The tangent map over a period that starts between two strikes, and where it starts."""
    start = lh.trajectory(problem.system, problem.x0, problem.args, t1=begin, n=1, method=PRECISE).x[-1]
    return start, lh.tangent_map(problem.system, start, problem.args, t1=period, method=PRECISE)


def test_references_are_those_of_the_data(nonsmooth):
    wheel, known = zoo.rimless_wheel(), nonsmooth[WHEEL]
    assert wheel.reference.exponents == pytest.approx(known["exponents"], rel=1e-14)
    assert wheel.t1 / 64 == pytest.approx(known["period"], rel=1e-14)
    np.testing.assert_allclose(wheel.x0, known["ic"], rtol=1e-14)
    walker, known = zoo.simplest_walker(), nonsmooth[WALKER]
    assert walker.reference.exponents == pytest.approx([float(e) for e in known["exponents"]], rel=1e-14)
    np.testing.assert_array_equal(walker.x0[:3], known["ic"][:3])
    theta, _, rate, other = np.asarray(walker.x0)
    assert other == pytest.approx((1 - math.cos(2 * theta)) * rate, rel=1e-15)


@pytest.mark.parametrize(("angle", "slope"), [(math.pi / 8, 0.2), (0.3, 0.06), (0.2, 0.3), (0.35, 0.9)])
def test_the_time_of_a_step_of_the_wheel_by_another_quadrature(angle, slope):
    wheel = zoo.rimless_wheel(angle=angle, slope=slope)
    first, launch = np.asarray(wheel.x0)
    time, error = quad(lambda a: 1 / math.sqrt(launch**2 + 2 * (math.cos(first) - math.cos(a))), first, slope + angle)
    assert error < 1e-8
    assert wheel.reference.exponents[1] == pytest.approx(2 * math.log(math.cos(2 * angle)) / time, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("angle", "slope"), [(math.pi / 8, 0.2), (0.3, 0.1)])
def test_the_multipliers_of_a_wheel(angle, slope):
    wheel = zoo.rimless_wheel(angle=angle, slope=slope)
    start, found = over_a_period(wheel, wheel.t1 / 64, 0.5)
    np.testing.assert_allclose(found.x, start, atol=1e-9)
    multipliers = np.sort(np.linalg.eigvals(np.asarray(found.matrix)))
    np.testing.assert_allclose(multipliers, [math.cos(2 * angle) ** 2, 1.0], atol=1e-8)


@pytest.mark.slow
def test_the_exponents_of_a_wheel():
    wheel = zoo.rimless_wheel()
    result = wheel.spectrum()
    assert result.jumps == 64
    assert np.all(result.stderr < 1e-7)
    np.testing.assert_allclose(result.exponents, wheel.reference.exponents, atol=1e-7)
    assert not result.losses.any()


def test_a_wheel_that_does_not_get_over_the_top_rocks_to_rest():
    wheel = zoo.rimless_wheel(angle=0.3, slope=0.02)
    assert wheel.reference is None
    motion = lh.trajectory(wheel.system, wheel.x0, wheel.args, t1=50.0, n=5, throw=False)
    assert motion.status == lh.STATUS.zeno
    ends = motion.events.x_after[:, 0]
    both = np.isclose(ends, 0.02 - 0.3) | np.isclose(ends, 0.02 + 0.3)
    assert both.all()
    assert len(set(np.round(np.asarray(ends[-6:]), 6))) == 2  # to and fro
    assert np.max(np.abs(motion.events.x_after[-4:, 1])) < 1e-3


@pytest.mark.slow
def test_the_multipliers_of_the_simplest_walker(nonsmooth):
    walker, known = zoo.simplest_walker(), nonsmooth[WALKER]
    start, found = over_a_period(walker, known["period"], 1.3)
    np.testing.assert_allclose(found.x, start, atol=1e-9)
    expected = np.array([complex(*m) for m in known["multipliers"]])
    multipliers = np.linalg.eigvals(np.asarray(found.matrix))
    for multiplier in expected:
        assert np.min(np.abs(multipliers - multiplier)) < 1e-7
    assert np.linalg.svd(np.asarray(found.matrix), compute_uv=False)[3] < 1e-12


@pytest.mark.slow
def test_the_simplest_walker_strikes_once_a_step_and_not_where_the_foot_scuffs(nonsmooth):
    walker, period = zoo.simplest_walker(), nonsmooth[WALKER]["period"]
    motion = lh.trajectory(walker.system, walker.x0, walker.args, t1=10.5 * period, n=4000, method=PRECISE)
    events = motion.events
    np.testing.assert_allclose(events.t, period * np.arange(11), atol=1e-9)
    # It starts on the surface of the strike, where it has just struck, and goes on.
    np.testing.assert_allclose(events.x_after[0], walker.x0, atol=1e-15)
    assert np.all(np.asarray(events.x_before[1:, 0]) < -0.1)
    foot = np.asarray(2 * motion.x[:, 0] - motion.x[:, 1])
    assert np.sum(np.diff(np.sign(foot)) > 0) in (10, 11)  # the legs pass each other in every step
    np.testing.assert_allclose(events.x_after[1:], np.broadcast_to(walker.x0, (10, 4)), atol=1e-8)


@pytest.mark.slow
def test_the_exponents_of_the_simplest_walker(nonsmooth):
    walker, known = zoo.simplest_walker(), nonsmooth[WALKER]
    period = known["period"]
    result = walker.spectrum(t1=256 * period, transient=40.5 * period)
    assert result.exponents[3] == -math.inf
    np.testing.assert_array_equal(result.losses, [0, 0, 0, 256])
    gate = np.array([1e-8, 0.01, 0.01])
    assert np.all(result.stderr[:3] < gate)
    apart = np.abs(np.asarray(result.exponents[:3]) - walker.reference.exponents[:3])
    assert np.all(apart <= 5 * np.asarray(result.stderr[:3]))
    # The second and the third turn about each other: only their sum does not fluctuate.
    assert float(np.sum(result.exponents[1:3])) == pytest.approx(2 * walker.reference.exponents[1], abs=1e-8)


@pytest.mark.slow
def test_steeper_the_walker_doubles_its_period_becomes_chaotic_and_falls():
    """Garcia et al.: stable up to 0.0151, period doublings, chaos, and falls beyond 0.019."""
    for slope, strides in [(0.0145, 1), (0.016, 2)]:
        walker = zoo.simplest_walker(slope=slope)
        # its long gait is unstable beyond 0.0151: a start a little off
        start = np.asarray(walker.x0) * [1.0, 1.0, 1.0001, 1.0001]
        motion = lh.trajectory(walker.system, start, walker.args, t1=900.0, n=1)
        last = np.asarray(motion.events.x_after[-8:, 0])
        np.testing.assert_allclose(last[strides:], last[:-strides], atol=1e-6)
        assert strides == 1 or np.ptp(last) > 0.01
    chaos = zoo.simplest_walker(slope=0.0185).spectrum(t1=1000.0)
    assert chaos.stderr[0] < 0.015
    assert chaos.exponents[0] > 2 * chaos.stderr[0]
    fallen = zoo.simplest_walker(slope=0.0195).spectrum(t1=1000.0)
    assert fallen.status == lh.STATUS.terminated


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: zoo.rimless_wheel(angle=0.8), r"angle must be between 0 and π/4; got 0.8"),
        (lambda: zoo.rimless_wheel(slope=0), r"slope must be positive"),
        (lambda: zoo.simplest_walker(slope=-0.009), r"slope must be positive"),
    ],
)
def test_bad_parameters(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_traced_slope_gives_the_same_start():
    for build in (zoo.rimless_wheel, zoo.simplest_walker):
        start = jax.jit(lambda slope, build=build: build(slope=slope).x0)(0.012)
        np.testing.assert_allclose(start, build(slope=0.012).x0, rtol=1e-12)
