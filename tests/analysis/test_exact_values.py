"""Values that are known otherwise: closed forms as far as they are exact, the rest within its error bars.

Where an orbit's statistics decide, |value − reference| ≤ 5 combined standard errors, and the standard error
itself is below a gate, so that noise cannot buy a pass.
"""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo
from references import assert_agrees

ANTIPHASE = 0.3819215677837863  # time between the firings of two neurons that inhibit each other


STATISTICAL = [  # problem, parameters, keywords, gate, sum rule to
    ("henon_map", {}, {"t1": 4_000_000}, 3e-4, 1e-12),
    ("logistic_map", {}, {"t1": 2_000_000}, 3e-5, 1e-12),
    ("standard_map", {}, {"t1": 6_000_000}, 1.2e-3, 1e-12),
    ("baker_map", {}, {"t1": 4_000_000}, 3e-4, 1e-12),
    ("lorenz63", {}, {"t1": 40_000.0}, 1.2e-3, 1e-9),
    ("skew_tent_roof", {}, {"t1": 400_000.0}, 7e-4, 1e-9),
    ("grow_reset", {}, {"t1": 400_000.0, "transient": 200.0}, 9e-4, 1e-8),
    ("grow_reset", {"q": 0}, {"t1": 400_000.0}, 9e-4, None),
    ("kicked_ball", {"restitution": 0.5, "amplitude": 1.75}, {"t1": 200_000.0, "blocks": 1000}, 4e-4, 1e-8),
    ("impact_oscillator", {}, {}, 4e-3, 1e-8),
    # Corridors: one flight of 600 makes an error of 2e-2 in 80 000.
    ("sinai_billiard", {}, {"t1": 320_000.0}, 1.2e-2, 1e-9),
]


SLOW = ("standard_map", "skew_tent_roof", "sinai_billiard")


@pytest.mark.slow_cases(
    "baker_map",
    "lorenz63",
    "grow_reset",
    "grow_reset{'q': 0}",
    "kicked_ball{'restitution': 0.5, 'amplitude': 1.75}",
    "henon_map",
)
@pytest.mark.parametrize(
    ("name", "parameters", "keywords", "gate", "closes"),
    [pytest.param(*case, marks=pytest.mark.slow if case[0] in SLOW else ()) for case in STATISTICAL],
    ids=[f"{name}{parameters or ''}" for name, parameters, *_ in STATISTICAL],
)
def test_known_values(name, parameters, keywords, gate, closes):
    problem = zoo.get(name)(**parameters)
    spectrum = problem.spectrum(**keywords)
    assert spectrum.status == lh.STATUS.ok
    assert_agrees(spectrum, problem.reference, gate)
    assert spectrum.sum_rule_residual is None if closes is None else spectrum.sum_rule_residual <= closes


LONG = [
    ("lorenz63", {}, {"t1": 1_000_000.0}, 3e-4),
    ("rossler", {}, {"t1": 1_000_000.0}, 2e-4),
    ("zaslavsky", {}, {"t1": 1_000_000.0}, 6e-4),
    ("impact_oscillator", {}, {"t1": 200_000.0}, 1.3e-3),
    ("sinai_billiard", {}, {"t1": 1_000_000.0}, 3.5e-3),
    ("hard_disks", {"n": 2, "density": 0.32, "aspect": 1}, {"t1": 800_000.0}, 3.5e-3),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "parameters", "keywords", "gate"), LONG, ids=[name for name, *_ in LONG])
def test_known_values_in_long_runs(name, parameters, keywords, gate):
    problem = zoo.get(name)(**parameters)
    assert_agrees(problem.spectrum(**keywords), problem.reference, gate)


def test_two_violent_jumps_in_a_row_are_no_loss():
    """As two grazing collisions of disks: together they stretch by more than rounding resolves."""

    def stretching(n, x, args):
        stretch = jnp.where((n % 100 == 50) | (n % 100 == 51), 2e4, 1.1)
        return jnp.stack([jnp.sin(stretch * x[0]), x[1] / stretch])

    spectrum = lh.lyapunov_spectrum(lh.Map(stretching), [0.0, 0.0], t1=1000)
    mean = (98 * np.log(1.1) + 2 * np.log(2e4)) / 100
    assert_allclose(spectrum.exponents, [mean, -mean], rtol=1e-12)
    assert not spectrum.notes


# Exact for every orbit, or up to the first turn of the frame.


def test_beta_clock_is_exact():
    problem = zoo.beta_clock()
    spectrum = problem.spectrum()
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=1e-12)
    assert spectrum.sum_rule_residual < 1e-8
    assert 999 <= spectrum.jumps <= 1000  # the last is due at the very end


@pytest.mark.slow
def test_conewise_linear_is_exact_at_every_turn():
    problem = zoo.conewise_linear()
    assert_allclose(problem.spectrum().exponents, problem.reference.exponents, atol=1e-10)


@pytest.mark.parametrize("form", ["map", "jumps"])
def test_cat_map_is_exact(form):
    problem = zoo.cat_map(form=form)
    spectrum = problem.spectrum()
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=1e-13)
    assert spectrum.jumps == spectrum.time == 10_000


def test_kaplan_yorke_map_is_exact_but_for_the_first_turn():
    problem = zoo.kaplan_yorke_map()
    spectrum = problem.spectrum(t1=1_000_000)
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=5e-6)
    assert_allclose(np.sum(spectrum.exponents), np.sum(problem.reference.exponents), atol=1e-12)


@pytest.mark.slow
def test_skew_tent_exponents_go_together():
    """Per jump both are linear in the fraction of left branches, whatever the orbit does."""
    spectrum, c = zoo.skew_tent_roof().spectrum(t1=100_000.0), 0.3
    growth, zero, decay = np.asarray(spectrum.per_jump())
    left = (growth + math.log(1 - c)) / (math.log(1 - c) - math.log(c))
    assert_allclose(decay, left * math.log(0.25) + (1 - left) * math.log(0.4), atol=1e-4)
    assert_allclose(zero, 0, atol=1e-4)


@pytest.mark.slow
def test_grow_reset_decays_between_jumps_and_at_them():
    spectrum = zoo.grow_reset().spectrum(t1=100_000.0, transient=200.0)
    _, zero, decay = np.asarray(spectrum.exponents)
    assert_allclose(decay, 0.25 + math.log(0.5) * float(spectrum.jumps / spectrum.time), atol=1e-4)
    assert_allclose(zero, 0, atol=1e-4)


@pytest.mark.slow
def test_a_reset_that_kills_a_direction_gives_minus_infinity():
    problem = zoo.grow_reset(q=0)
    spectrum = problem.spectrum(transient=0.0, t1=1000.0)
    assert spectrum.exponents[2] == -jnp.inf
    assert "rank_lost" in spectrum.notes
    assert_allclose(spectrum.losses, [0, 0, spectrum.jumps])  # refilled, and killed again at every jump
    assert_allclose(spectrum.first_loss[2], 0.5 + problem.x0[0], rtol=1e-9)  # at the first jump
    assert np.all(np.isnan(spectrum.first_loss[:2]))
    assert_allclose(spectrum.loss_rate[2], spectrum.jumps / spectrum.time)
    assert spectrum.sum_rule_residual is None


@pytest.mark.slow
def test_period_1_of_the_kicked_ball():
    """Complex multipliers turn for ever: a smooth average makes both exponents ln(r)/T."""
    problem, period = zoo.kicked_ball(), 2 * math.pi
    span = {"t1": 1000 * period, "transient": 100 * period, "blocks": 1000}
    spectrum = problem.spectrum(**span, averaging="birkhoff")
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=1e-10)
    assert spectrum.jumps == 1000
    assert spectrum.sum_rule_residual < 1e-8
    uniform = problem.spectrum(**span)
    assert_allclose(np.mean(uniform.exponents), math.log(0.8) / period, atol=1e-11)  # the sum does not turn


@pytest.mark.slow_cases("hybrid")
@pytest.mark.parametrize("form", ["hybrid", "event_driven"])
def test_two_neurons_in_antiphase(form):
    problem = zoo.integrate_and_fire(form=form)
    spectrum = problem.spectrum(t1=2000 * ANTIPHASE, transient=400 * ANTIPHASE)
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=1e-11)
    assert spectrum.jumps == 2000
    assert spectrum.sum_rule_residual < 1e-8
    if form == "hybrid":
        return
    per_jump = problem.spectrum(t1=2000, transient=400, clock="jumps")
    assert_allclose(per_jump.time, 2000 * ANTIPHASE, rtol=1e-11)
    assert_allclose(per_jump.exponents / ANTIPHASE, problem.reference.exponents, atol=1e-11)


# Zeno.


@pytest.mark.slow
def test_the_bouncing_ball_has_exponents_per_jump():
    """The frame starts along the field (v, −g), which one cycle maps onto (rv, −g)."""
    problem = zoo.bouncing_ball()
    frame = jnp.array([[1.0, 0.0], [-1.0, 1.0]])
    spectrum = problem.spectrum(frame=frame, transient=15, t1=12)
    assert spectrum.status == lh.STATUS.ok
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=1e-9)
    assert_allclose(spectrum.t + spectrum.x[1], 4 - spectrum.x[1], atol=1e-9)  # v = 2^-27, two v to go


@pytest.mark.slow_cases("0.9-3000")
@pytest.mark.parametrize(("restitution", "reached"), [(0.9, 3000), (0.5, 450)])
def test_per_jump_the_bouncing_ball_goes_on_to_the_end_of_double_precision(restitution, reached):
    """The first column turns once from (1, −1) to the field (v, −g); what it loses, ln √2, the second gains."""
    problem, frame = zoo.bouncing_ball(restitution=restitution), jnp.array([[1.0, 0.0], [-1.0, 1.0]])
    known = np.array(problem.reference.exponents)
    turned = math.log(2) / 2 * np.array([-1, 1])

    def run(t1, clock):
        return problem.spectrum(frame=frame, transient=0, t1=t1, clock=clock, throw=False)

    for clock in ("jumps", "hybrid"):  # max(t, j): t stays below 20
        spectrum = run(400, clock)
        assert spectrum.status is lh.STATUS.ok
        assert spectrum.jumps == 400
        assert_allclose(spectrum.exponents, known + turned / 400, atol=1e-10)
        assert_allclose(spectrum.x[1], restitution**400, rtol=1e-6)
        assert "rank_lost" not in spectrum.notes
    spectrum = run(10 * reached, "jumps")
    assert spectrum.status is lh.STATUS.zeno
    assert spectrum.jumps >= reached
    assert_allclose(spectrum.exponents, known + turned / int(spectrum.jumps), atol=1e-10)
    assert_allclose(spectrum.accumulation_time, 2 / (1 - restitution), rtol=1e-12)


def ping_pong(a, b):
    """Two guards, each of whose resets lands beyond the other; the rest of the state is multiplied by a and by b."""

    def onto(x0, x1, matrix):
        return lambda t, x, args: jnp.concatenate([jnp.array([x0, x1]), jnp.array(matrix) @ x[2:]])

    left = lh.Transition(lambda t, x, args: x[0], onto(1.0, -1.0, a))
    right = lh.Transition(lambda t, x, args: x[1], onto(-1.0, 1.0, b))
    return lh.Hybrid(lambda t, x, args: jnp.where(jnp.arange(len(x)) < 2, -1.0, 0.1 * x), [left, right])


@pytest.mark.slow
@pytest.mark.parametrize("matrices", [([[2, 1], [0.3, 0.5]], [[0.5, 0.2], [0.1, 1.5]]), ([[0.5, 0.3], [0, 0.01]],) * 2])
def test_a_cascade_without_end_has_the_exponents_of_its_product(matrices):
    """After the first jump time stands still. The second pair contracts by 1e-2 a jump: it must not look lost."""
    a, b = np.array(matrices, float)
    spectrum = lh.lyapunov_spectrum(ping_pong(a, b), [0.5, 1.0, 1.0, 1.0], t1=400, transient=20, clock="jumps")
    assert spectrum.status is lh.STATUS.ok
    assert spectrum.jumps == 400
    assert_allclose(spectrum.t, 0.5, atol=1e-12)
    expected = np.log(np.sort(np.abs(np.linalg.eigvals(b @ a)))[::-1]) / 2
    assert_allclose(spectrum.exponents[:2], expected, atol=1e-9)
    assert np.all(np.isneginf(spectrum.exponents[2:]))  # where the resets put the state down, nothing is remembered
    for clock in ("jumps", "hybrid"):
        short = lh.lyapunov_spectrum(ping_pong(a, b), [0.5, 1.0, 1.0, 1.0], t1=7, clock=clock, blocks=7)
        assert (short.status, int(short.jumps)) == (lh.STATUS.ok, 7)


@pytest.mark.slow
def test_a_cascade_that_ends_after_all_is_no_product():
    """A clock throws a neuron so high that it spikes 21 times at one instant, each time 1 lower."""
    spike = lh.Transition(lambda t, x, args: 1.0 - x[0], lambda t, x, args: x - 1.0)
    kick = lh.Transition(every=10.0, phase=0.5, reset=lambda t, x, args: x + 20.7)

    def run(most, clock):
        neuron = lh.Hybrid(lambda t, x, args: jnp.ones_like(x), [spike, kick], max_cascade=most)
        return lh.lyapunov_spectrum(neuron, [0.0], t1=24, clock=clock, blocks=2, throw=False)

    for clock in ("jumps", "hybrid"):
        assert run(25, clock).status is lh.STATUS.ok
        too_many = run(16, clock)
        assert too_many.status is lh.STATUS.zeno
        assert int(too_many.jumps) == 22
    assert run(16, "time").status is lh.STATUS.zeno


@pytest.mark.slow_cases("0.5")
@pytest.mark.parametrize("restitution", [0.5, 0.8])
def test_in_time_the_bouncing_ball_accumulates(restitution):
    problem, end = zoo.bouncing_ball(restitution=restitution), 2 / (1 - restitution)
    with pytest.raises(lh.RunFailedError, match="accumulate at t = ") as failed:
        problem.spectrum(clock="time", t1=end + 5, transient=0)
    result = failed.value.result
    assert result.status == lh.STATUS.zeno
    assert_allclose(result.accumulation_time, end, rtol=1e-8)
    assert_allclose(result.t, end, rtol=1e-6)


# Clocks.


@pytest.mark.slow
def test_clocks_read_the_same_run():
    """Of a system with more jumps than units of time, and of one with fewer."""
    neurons = zoo.integrate_and_fire(form="event_driven").spectrum
    jumps, time, hybrid = (
        neurons(t1=length, transient=0.0, clock=clock)
        for clock, length in (("jumps", 1000), ("time", 1000 * ANTIPHASE), ("hybrid", 1000))
    )
    assert jumps.jumps == hybrid.jumps == 1000
    assert_allclose(hybrid.exponents, jumps.exponents, rtol=1e-12, atol=1e-14)
    assert_allclose(hybrid.per_jump(), hybrid.exponents, rtol=1e-12, atol=1e-14)
    assert_allclose(jumps.time, time.time, rtol=1e-3)  # the start is off the orbit
    assert_allclose(time.per_jump(), jumps.exponents, atol=1e-3)
    assert [s.clock for s in (jumps, time, hybrid)] == ["jumps", "time", "hybrid"]

    ray = zoo.sinai_billiard(radius=0.2).spectrum  # mean free path 2.19; rounding grows thirtyfold at each reflection
    jumps = ray(t1=4, transient=0.0, clock="jumps")
    time, hybrid = (ray(t1=jumps.time * (1 + 1e-9), transient=0.0, clock=clock) for clock in ("time", "hybrid"))
    assert jumps.jumps == time.jumps == hybrid.jumps == 4
    assert_allclose(hybrid.exponents, time.exponents, rtol=1e-12, atol=1e-12)
    assert_allclose(time.per_jump(), jumps.exponents, rtol=1e-6, atol=1e-6)


def test_the_periodic_impact_oscillator():
    """At omega = 2 a whole number of periods needs no average."""
    problem, period = zoo.impact_oscillator(omega=2.0), math.pi
    spectrum = problem.spectrum(t1=640 * period, transient=4000 * period)
    assert_allclose(spectrum.exponents, problem.reference.exponents, atol=5e-6)  # the reference's error is 1e-6
    total = -2 * 0.05 + 2 * math.log(0.8) * spectrum.jumps / spectrum.time
    assert_allclose(np.sum(spectrum.exponents), total, atol=1e-8)


# Billiards.


@pytest.mark.slow
def test_two_disks_are_a_sinai_billiard(event_driven):
    """Their relative coordinate is one: λ = (2√K/L) λ_Sinai(σ/L)."""
    known, side = event_driven["billiards"]["sq", 0.4], 2.5
    scale = 2 * math.sqrt(2) / side
    problem = zoo.hard_disks(n=2, density=0.32, aspect=1)
    assert_allclose(problem.args["width"], side)
    spectrum = problem.spectrum(t1=320_000.0, every=1)  # long free flights: the errors of short runs scatter widely
    values, error = np.asarray(spectrum.exponents), float(spectrum.stderr[0]) / scale
    assert error < 0.01
    assert abs(values[0] / scale - known["lam_time_best"]) <= 5 * math.hypot(error, known["se_best"])
    assert_allclose(values + values[::-1], 0, atol=1e-9)
    assert_allclose(values[1:-1], 0, atol=1e-10)
