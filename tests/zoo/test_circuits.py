"""Circuits of the zoo: values known otherwise, kinks that are landed on, ramps that a clock resets, idle diodes."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import brentq

import lyaphybrid as lh
from lyaphybrid import zoo
from references import assert_agrees

BUCK_PERIOD, BOOST_PERIOD = 400e-6, 1 / 3000
BUCK_SUM = -0.38684719535783363  # per period: −T/(RC)


# Chua's circuit.


@pytest.mark.slow
def test_chua():
    problem = zoo.chua()
    spectrum = problem.spectrum(t1=200_000.0)
    assert spectrum.status == lh.STATUS.ok
    assert_agrees(spectrum, problem.reference, gate=4e-3)
    assert spectrum.stderr[0] < 1.5e-3
    assert abs(spectrum.exponents[1]) < 2e-5
    assert spectrum.sum_rule_residual < 1e-11


def _chua_in_one_mode(t, x, args):
    current = args["m1"] * x[0] + (args["m0"] - args["m1"]) * jnp.clip(x[0], -1.0, 1.0)
    return jnp.stack([args["alpha"] * (x[1] - x[0] - current), x[0] - x[1] + x[2], -args["beta"] * x[1]])


@pytest.mark.slow
def test_stepping_over_kinks_spoils_the_zero_exponent():
    problem = zoo.chua()
    fixed = {"t1": 100_000.0, "method": lh.RungeKutta("rk4", dt=0.05)}
    landed = problem.spectrum(**fixed)
    over = lh.lyapunov_spectrum(lh.Flow(_chua_in_one_mode), problem.x0, problem.args, transient=200.0, **fixed)
    print(landed, over, sep="\n")
    assert abs(landed.exponents[1]) < 2e-4
    assert landed.stderr[1] < 4e-4
    assert over.exponents[1] < -2e-3
    assert over.stderr[1] < 1e-3


# The buck converter.


def _buck_by_small_steps(periods, per_period=50_000):
    """Comparator asked at the beginning of each of many steps, the flow in each of them exact."""
    args, x = zoo.buck_converter().args, np.array([12.0, 0.5])
    r, c, inductance = args["resistance"], args["capacitance"], args["inductance"]
    a = np.array([[-1 / (r * c), 1 / c], [-1 / inductance, 0.0]])
    move = expm(a * args["period"] / per_period)
    on = (move - np.eye(2)) @ np.linalg.solve(a, [0.0, args["voltage"] / inductance])
    for k in range(periods * per_period):
        ramp = args["low"] + (args["high"] - args["low"]) * (k % per_period) / per_period
        x = move @ x + (on if args["gain"] * (x[0] - args["wanted"]) < ramp else 0)
    return x


@pytest.mark.slow
def test_buck_switches_where_the_comparator_says():
    """Chaos multiplies the errors of the small steps, 1e-5 A a switching, by e^0.5 a period."""
    problem = zoo.buck_converter()
    for periods in (1, 2, 4):
        spectrum = problem.spectrum(t1=periods * BUCK_PERIOD, transient=0.0)
        assert_allclose(spectrum.x, _buck_by_small_steps(periods), atol=1e-3)


@pytest.mark.slow
def test_buck_converter():
    problem = zoo.buck_converter()
    spectrum = problem.spectrum(t1=100_000 * BUCK_PERIOD)
    assert spectrum.status == lh.STATUS.ok
    assert not spectrum.notes
    assert_agrees(spectrum, problem.reference, gate=6.0)
    assert spectrum.sum_rule_residual < 1e-9


@pytest.mark.slow
def test_buck_converter_in_a_long_run(nonsmooth):
    """Late crossings that are all but tangent are lost in the rounding of the time: they must not end the run."""
    problem, known = zoo.buck_converter(), nonsmooth["buck 33V"]
    spectrum = problem.spectrum(t1=1_000_000 * BUCK_PERIOD)
    assert spectrum.status == lh.STATUS.ok
    assert_agrees(spectrum, problem.reference, gate=2.5)
    per_period = np.asarray(spectrum.exponents) * BUCK_PERIOD
    errors = np.hypot(np.asarray(spectrum.stderr) * BUCK_PERIOD, known["se"])
    assert np.all(np.abs(per_period - known["exponents_per_T"]) <= 5 * errors)


@pytest.mark.slow
def test_the_sum_of_buck_is_exact():
    """S has determinant 1: −T/(RC) a period, whatever the orbit does."""
    for voltage in (20.0, 33.0, 40.0):
        spectrum = zoo.buck_converter(voltage=voltage).spectrum(t1=1000 * BUCK_PERIOD)
        assert_allclose(np.sum(spectrum.exponents) * BUCK_PERIOD, BUCK_SUM, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("voltage", "repeats"), [(24.0, 1), (25.5, 2)])
def test_buck_doubles_its_period(voltage, repeats):
    buck = zoo.buck_converter(voltage=voltage)
    ends = [buck.spectrum(t1=n * BUCK_PERIOD, transient=2000 * BUCK_PERIOD).x for n in (100, 101, 102)]
    assert_allclose(ends[2], ends[0], atol=1e-6)
    assert (abs(ends[1][0] - ends[0][0]) < 1e-6) == (repeats == 1)


@pytest.mark.slow
def test_buck_does_not_see_how_many_periods_are_over():
    """The phase is taken from the time: an even number of periods later everything is the same."""
    buck = zoo.buck_converter()
    first, later = (buck.spectrum(t0=n * BUCK_PERIOD, t1=20 * BUCK_PERIOD, transient=0.0) for n in (0, 5000))
    assert_allclose(later.x, first.x, rtol=1e-6)
    assert_allclose(later.exponents, first.exponents, rtol=1e-6)
    assert later.mode == first.mode


# The boost converter: while it is discontinuous v at a tick decides v at the next.


def _next_voltage(v, feedback):
    """v at the next tick, its derivative, and whether there was a pulse: in closed form, for arrays of v."""
    args = zoo.boost_converter().args
    source, wanted, period = args["voltage"], args["wanted"], args["period"]
    r, c, inductance = args["resistance"], args["capacitance"], args["inductance"]
    decay = 1 / (2 * r * c)
    omega = math.sqrt(1 / (inductance * c) - decay**2)
    duty = args["duty"] - feedback * (v - wanted)
    pulse = duty > 0
    on, d_on = np.where(pulse, duty, 0) * period, np.where(pulse, -feedback, 0) * period
    left = np.exp(-2 * decay * on)
    v1, i1 = v * left, source * on / inductance
    d_v1, d_i1 = left - 2 * decay * v1 * d_on, source * d_on / inductance
    a, b = v1 - source, i1 - source / r  # from the fixed point of the mode in which the diode conducts
    b_turned = (decay * b - a / inductance) / omega
    off = i1 * inductance / a
    for _ in range(8):
        cosine, sine, shrunk = np.cos(omega * off), np.sin(omega * off), np.exp(-decay * off)
        current = source / r + shrunk * (b * cosine + b_turned * sine)
        slope = shrunk * ((omega * b_turned - decay * b) * cosine - (omega * b + decay * b_turned) * sine)
        off = off - current / slope
    cosine, sine, shrunk = np.cos(omega * off), np.sin(omega * off), np.exp(-decay * off)
    v2 = source + shrunk * (a * cosine + (b / c - decay * a) / omega * sine)
    d_v2 = shrunk * (d_v1 * cosine + (d_i1 / c - decay * d_v1) / omega * sine)
    idle = period - on - off
    assert np.all(idle > 0)
    left = np.exp(-2 * decay * idle)
    # Where the diode stops v has the same slope on both sides: that instant's shift does not count.
    return v2 * left, d_v2 * left + 2 * decay * v2 * left * d_on, pulse


def _next_voltage_by_matrices(v, feedback):
    args = zoo.boost_converter().args
    r, c, inductance, source = args["resistance"], args["capacitance"], args["inductance"], args["voltage"]
    charging = np.array([[-1 / (r * c), 0, 0], [0, 0, source / inductance], [0, 0, 0]])
    conducting = np.array([[-1 / (r * c), 1 / c, 0], [-1 / inductance, 0, source / inductance], [0, 0, 0]])
    on = (args["duty"] - feedback * (v - args["wanted"])) * args["period"]
    start = expm(charging * on) @ [v, 0, 1]
    off = brentq(lambda s: (expm(conducting * s) @ start)[1], 1e-9, args["period"] - on, xtol=1e-18, rtol=1e-14)
    return (expm(conducting * off) @ start)[0] * math.exp(-(args["period"] - on - off) / (r * c))


def test_the_closed_form_of_boost():
    for v in (24.4, 25.0, 25.9):
        nearby = [_next_voltage_by_matrices(v + h, 0.2) for h in (-1e-4, 0.0, 1e-4)]
        image, multiplier, _ = _next_voltage(v, 0.2)
        assert_allclose(image, nearby[1], rtol=1e-12)
        assert_allclose(multiplier, (nearby[2] - nearby[0]) / 2e-4, rtol=1e-6)


def _by_the_map(feedback, orbits, periods, transient=1000):
    """Exponent a period with its error, and the fraction of periods with a pulse."""
    v = 25 + np.random.default_rng(1).uniform(-0.3, 0.3, orbits)
    for _ in range(transient):
        v = _next_voltage(v, feedback)[0]
    logs, pulses = np.zeros(orbits), 0.0
    for _ in range(periods):
        v, multiplier, pulse = _next_voltage(v, feedback)
        logs, pulses = logs + np.log(np.abs(multiplier)), pulses + np.mean(pulse)
    return np.mean(logs) / periods, np.std(logs) / periods / math.sqrt(orbits - 1), pulses / periods


@pytest.mark.slow
@pytest.mark.parametrize("feedback", [0.05, 0.1, 0.13, 0.165])
def test_pulses_that_repeat(feedback):
    """One a period, the last two different ones in turn: the mean logarithm of their multipliers."""
    expected, _, pulses = _by_the_map(feedback, orbits=2, periods=2)
    periods = 1024  # 64 blocks of 16
    spectrum = zoo.boost_converter(feedback=feedback).spectrum(t1=periods * BOOST_PERIOD, transient=1000 * BOOST_PERIOD)
    assert pulses == 1
    assert_allclose(spectrum.exponents[0] * BOOST_PERIOD, expected, atol=1e-8)
    assert spectrum.exponents[1] == -jnp.inf
    assert_allclose(spectrum.losses, [0, periods])
    assert "rank_lost" in spectrum.notes
    assert spectrum.jumps == 3 * periods


@pytest.mark.slow
def test_boost_converter():
    problem = zoo.boost_converter()
    spectrum = problem.spectrum(t1=100_000 * BOOST_PERIOD)
    assert spectrum.status == lh.STATUS.ok
    assert_agrees(spectrum, problem.reference, gate=5.0)
    exponent, error, pulses = _by_the_map(0.2, orbits=1000, periods=200)
    reference = problem.reference
    off = exponent - reference.exponents[0] * BOOST_PERIOD
    assert error < 2e-3
    assert abs(off) <= 5 * math.hypot(error, reference.stderr[0] * BOOST_PERIOD)
    assert 0.8 < pulses < 0.9
    assert_allclose(
        spectrum.loss_rate * BOOST_PERIOD, [0, pulses], atol=5e-3
    )  # without a pulse nothing is left to lose


# Corron's oscillator.


@pytest.mark.slow
@pytest.mark.parametrize(("beta", "omega"), [(0.68, 2 * math.pi), (0.3, 2 * math.pi), (0.68, 7.0)])
def test_corron_oscillator(beta, omega):
    """The start is an event: whole turns multiply by e^{2πβ/ω} exactly, with no transient."""
    problem, turn = zoo.corron_oscillator(beta=beta, omega=omega), 2 * math.pi / omega
    spectrum = problem.spectrum(t1=2000 * turn, transient=20 * turn)
    assert spectrum.status == lh.STATUS.ok
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=5e-3)
    assert_allclose(spectrum.exponents[0], beta, atol=1e-9)
    assert spectrum.sum_rule_residual < 1e-9
    assert abs(spectrum.jumps - 4000) <= 1
    assert abs(spectrum.x[0]) < 2


def test_corron_oscillator_must_be_bounded():
    with pytest.raises(ValueError, match="at most ω ln 2 / 2π = 0.6931"):
        zoo.corron_oscillator(beta=0.7)
