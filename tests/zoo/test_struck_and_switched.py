"""Kicks, hops, clocks, genes, spikes, brakes and loops: their references by other ways."""

import functools
import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.optimize import brentq

import lyaphybrid as lh
from lyaphybrid import zoo

PRECISE = lh.RungeKutta("dop853", rtol=1e-11, atol=1e-13)
integrate = functools.partial(solve_ivp, method="DOP853", rtol=1e-12, atol=1e-13)


def until(guard, direction):
    guard.terminal, guard.direction = True, direction
    return guard


def slope(function, h):
    """The derivative at 0 by differences of fourth order."""
    one, two = (function(m * h) - function(-m * h) for m in (1, 2))
    return (8 * one - two) / (12 * h)


def over_cycles(problem, **how):
    """The exponents of the cycle to which the problem's start leads."""
    found = lh.floquet(problem.system, problem.x0, problem.args, mode=problem.mode, method=PRECISE, **how)
    assert found.status == lh.STATUS.ok
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameters", "how"),
    [
        ("escapement_clock", {}, {"transient": 200.0}),
        ("escapement_clock", {"damping": 0.3, "energy": 2.0}, {"transient": 50.0}),
        ("paddle_juggler", {}, {"transient": 50.0}),
        ("paddle_juggler", {"gain": 0.2, "height": 2.0, "restitution": 0.5}, {"transient": 100.0}),
        ("vertical_hopper", {}, {"transient": 300.0}),
        ("abs_brake", {}, {"transient": 20.0}),
        ("charge_pump_pll", {}, {"transient": 200.0, "period": 1.0}),
        ("charge_pump_pll", {"integral": 0.1, "proportional": 1.2, "leak": 0.03}, {"transient": 300.0, "period": 1.0}),
    ],
)
def test_the_cycle_has_the_exponents_of_the_reference(name, parameters, how):
    problem = zoo.get(name)(**parameters)
    found, known = np.sort(over_cycles(problem, **how).exponents), np.sort(problem.reference.exponents)
    assert_allclose(found, known, rtol=1e-7, atol=1e-7)


def landing_speed(speed, k, c, thrust):
    """The next one, and the time between, of the hopper."""

    def on_the_leg(length):
        return lambda t, y: [y[1], k * (length - y[0]) - c * y[1] - 1]

    down = integrate(on_the_leg(1.0), (0, 50), [1.0, -speed], events=until(lambda t, y: y[1], 1))
    up = integrate(on_the_leg(1 + thrust), (0, 50), down.y[:, -1], events=until(lambda t, y: y[0] - 1 - thrust, 1))
    lift, then = up.y[1, -1], math.sqrt(up.y[1, -1] ** 2 + 2 * thrust)
    return then, down.t[-1] + up.t[-1] + lift + then


@pytest.mark.slow
def test_the_hopper_by_scipy():
    problem = zoo.vertical_hopper()
    speed = 2.3
    for _ in range(120):
        speed, period = landing_speed(speed, *problem.args.values())
    found = slope(lambda d: landing_speed(speed + d, *problem.args.values())[0], 1e-3)
    assert math.log(found) / period == pytest.approx(problem.reference.exponents[1], rel=1e-9)
    cycle = over_cycles(problem, transient=300.0)
    assert cycle.period == pytest.approx(period, rel=1e-10)


def next_apex(y, energy, k, angle):
    """The height, and the time between, of the runner."""
    down = math.sqrt(2 * (y - math.sin(angle)))

    def stance(t, x):
        pull = k * (1 / math.hypot(x[0], x[1]) - 1)
        return [x[2], x[3], pull * x[0], pull * x[1] - 1]

    start = [-math.cos(angle), math.sin(angle), math.sqrt(2 * (energy - y)), -down]
    run = integrate(stance, (0, 10), start, events=until(lambda t, x: x[0] ** 2 + x[1] ** 2 - 1, 1))
    end = run.y[:, -1]
    return end[1] + end[3] ** 2 / 2, down + run.t[-1] + end[3]


@pytest.mark.slow
def test_the_runner_by_scipy():
    problem = zoo.slip_runner()
    energy, y = float(problem.x0[2] ** 2 / 2 + problem.x0[1]), 0.95
    arguments = energy, *problem.args.values()
    for _ in range(20):
        y, period = next_apex(y, *arguments)
    found = slope(lambda d: next_apex(y + d, *arguments)[0], 5e-4)
    known = problem.reference
    assert abs(math.log(abs(found)) / period - known.exponents[2]) < known.stderr[2]
    motion = lh.trajectory(problem.system, problem.x0, problem.args, t1=60.0, n=2, mode=problem.mode, method=PRECISE)
    apexes = np.asarray(motion.events.x_before)[np.asarray(motion.events.transition) == 0]
    assert_allclose(apexes[-1, 1], y, rtol=0, atol=1e-9)
    mode = problem.system.mode_names[int(motion.mode[-1])]
    over = lh.tangent_map(problem.system, motion.x[-1], problem.args, t1=period, mode=mode, method=PRECISE)
    assert_allclose(over.x, motion.x[-1], rtol=0, atol=1e-9)
    multipliers = np.sort_complex(np.linalg.eigvals(np.asarray(over.matrix)))
    assert_allclose(multipliers, [found, 0.0, 1.0, 1.0], rtol=0, atol=1e-5)


@pytest.mark.slow
def test_a_runner_falls_or_runs_on():
    steep, flat = zoo.slip_runner(angle=math.radians(50.0)), zoo.slip_runner()
    ends = [lh.trajectory(p.system, p.x0, p.args, t1=30.0, n=2, mode=p.mode, throw=False).status for p in (steep, flat)]
    assert ends == [lh.STATUS.terminated, lh.STATUS.ok]


def test_the_brake_by_its_divergence():
    """s' and so f · ∇h are continuous where the valve switches: the other exponent is the mean divergence."""
    problem = zoo.abs_brake()
    apply, release, high, low, c = problem.args.values()

    def phase(y, rate, to, direction):
        def field(t, y):
            grip = 1.28 * (1 - math.exp(-23.99 * y[0])) - 0.52 * y[0]
            return [c * (y[1] - grip), rate, -c * (1.28 * 23.99 * math.exp(-23.99 * y[0]) - 0.52)]

        run = integrate(field, (0, 50), y, events=until(lambda t, y: y[0] - to, direction))
        return run.y[:, -1], run.t[-1]

    y = np.array([low, 1.0, 0.0])
    for _ in range(20):
        y[2] = 0.0
        y, first = phase(y, apply, high, 1)
        y, second = phase(y, -release, low, -1)
    assert y[2] / (first + second) == pytest.approx(problem.reference.exponents[1], rel=1e-7)


@pytest.mark.slow
def test_the_best_gain_forgets_at_once():
    """At s = 1 the juggler's map is flat at its fixed point: the exponent is −∞ there, and large before."""
    best = zoo.paddle_juggler(gain=1 / 3.4)
    assert best.reference.exponents == (0.0, -math.inf)
    assert over_cycles(best, transient=50.0).exponents[-1] < -5


@pytest.mark.slow
def test_an_irregular_juggler_is_its_map():
    problem = zoo.paddle_juggler(gain=0.9)
    assert problem.reference is None
    c, h = 1.7 * 0.9, 1.0
    w = np.linspace(1.0, 1.3, 400)
    growth, time = np.zeros((2, w.size))
    for n in range(3500):
        if n >= 500:
            growth, time = growth + np.log(np.abs(1 + c * (h - 1.5 * w**2))), time + 2 * w
        w = w * (1 + c * (h - w**2 / 2))
    each = growth / time
    found = problem.spectrum()
    error = math.hypot(float(found.stderr[0]), np.std(each) / len(each) ** 0.5)
    assert abs(float(found.exponents[0]) - np.mean(each)) < 4 * error
    assert float(found.exponents[0]) > 0.1


@pytest.mark.slow
def test_the_rotor_is_the_standard_map():
    """Tangents of 2000 starts; and without damping the sum is 0, with damping −γ."""
    rotor = zoo.kicked_rotor()
    rng = np.random.default_rng(3)
    theta, p, a, b = *rng.uniform(0, 2 * np.pi, (2, 2000)), np.ones(2000), np.zeros(2000)
    growth = 0.0
    for n in range(1020):
        b = b + 10 * np.cos(theta) * a
        p = np.mod(p + 10 * np.sin(theta), 2 * np.pi)
        theta, a = np.mod(theta + p, 2 * np.pi), a + b
        size = np.hypot(a, b)
        growth, a, b = growth + (np.log(size) if n >= 20 else 0.0), a / size, b / size
    error = np.std(growth / 1000) / 2000**0.5
    assert abs(np.mean(growth) / 1000 - rotor.reference.exponents[0]) < 4 * error + rotor.reference.stderr[0]
    damped = zoo.kicked_rotor(damping=0.3)
    assert damped.reference is None
    assert float(np.sum(damped.spectrum(t1=500.0).exponents)) == pytest.approx(-0.3, abs=1e-12)


@pytest.mark.slow
def test_a_ball_between_a_wall_and_a_moving_one():
    """Each meeting by the roots of the wall's motion; the motion itself, for it is chaotic only after a while."""
    problem = zoo.moving_wall_billiard(amplitude=0.2)
    found = lh.trajectory(problem.system, problem.x0, problem.args, t1=40.0, n=2, method=PRECISE)
    t, q, v, hits = 0.0, 0.3, 0.2, 0
    while True:
        steps = t + np.linspace(1e-9, 12.0, 40_001)
        gaps = 1 + 0.2 * np.cos(steps) - (q + v * (steps - t))
        wall = steps[np.argmax(gaps < 0)] if np.any(gaps < 0) else np.inf
        rest = t - q / v if v < 0 else np.inf
        if min(wall, rest) > 40.0:
            break
        hits += 1
        if rest < wall:
            t, q, v = rest, 0.0, -v
            continue
        s = wall
        for _ in range(50):
            s -= (1 + 0.2 * math.cos(s) - q - v * (s - t)) / (-0.2 * math.sin(s) - v)
        t, q, v = s, 1 + 0.2 * math.cos(s), -v - 0.4 * math.sin(s)
    assert len(found.events.t) == hits
    assert_allclose(np.asarray(found.x[-1]), [q + v * (40.0 - t), v], rtol=0, atol=1e-8)
    spectrum = problem.spectrum(t1=500.0)
    assert abs(float(np.sum(spectrum.exponents))) < 1e-12


def rule_of(table):
    """Where the genes go: the other three, the first of them counted as 1, the next 2 and 4."""

    def focal(on):
        others = [[on[j] for j in range(4) if j != i] for i in range(4)]
        return np.array([2.0 * int(table[i][o[0] + 2 * o[1] + 4 * o[2]]) - 1 for i, o in enumerate(others)])

    return focal


def products(focal, x, switches, transient):
    """Growth rates of the products of 1 − F_i F eᵢᵀ per unit of time, by switchings alone."""
    n, x = len(x), list(x)
    on, time, growth = [v > 0 for v in x], 0.0, np.zeros(len(x) - 1)
    columns = np.linalg.qr(np.random.default_rng(0).normal(size=(n, n - 1)))[0]
    for step in range(switches):
        f = focal(on)
        i = min(
            (j for j in range(n) if f[j] * x[j] < 0 or (x[j] == 0 and on[j] != (f[j] > 0))), key=lambda j: abs(x[j])
        )
        wait = 1 + abs(x[i])
        columns, r = np.linalg.qr(columns - np.outer(f * f[i], columns[i]))
        x = [(x[j] - f[j] * f[i] * x[i]) / wait for j in range(n)]
        x[i], on[i] = 0.0, not on[i]
        if step >= transient:
            growth, time = growth + np.log(np.abs(np.diagonal(r))), time + math.log(wait)
    return growth / time


@pytest.mark.slow
def test_genes_by_products_of_matrices():
    from lyaphybrid.zoo.switched.gene_networks import CHAOTIC

    known = zoo.glass_network().reference
    starts = np.random.default_rng(11).normal(size=(5, 4))[1:] / 2
    found = np.array([products(rule_of(CHAOTIC), x, 20_000, 500) for x in starts]) - 1
    error = np.std(found[:, 0], ddof=1) / 2
    assert abs(np.mean(found[:, 0]) - known.exponents[0]) < 4 * error
    assert_allclose(np.mean(found[:, [1, 2]], axis=0), np.array(known.exponents)[[1, 3]], rtol=0, atol=5e-3)


@pytest.mark.parametrize("n", [3, 5, 9])
def test_a_ring_of_genes_has_the_multipliers_of_its_cycle(n):
    ring = zoo.glass_network(network="ring", n=n)
    found = ring.spectrum(t1=2000.0, transient=300.0)
    assert_allclose(found.exponents, ring.reference.exponents, rtol=0, atol=5e-3)
    motion = lh.trajectory(ring.system, ring.x0, ring.args, t1=60.0, n=2)
    on = np.asarray(motion.events.which)[-2 * n :]
    assert np.all(np.diff(on) % n == 1)  # one after the other


def test_tangents_of_genes_are_differences():
    ring = zoo.glass_network(network="ring", n=5)
    x, size = np.asarray(ring.x0), 1e-5

    def after(x):
        return np.asarray(lh.tangent_map(ring.system, x, ring.args, t1=2.0).x)

    differences = [slope(lambda h, unit=unit: after(x + h * unit), size) for unit in np.eye(5)]
    found = lh.tangent_map(ring.system, x, ring.args, t1=2.0)
    assert found.jumps > 2
    assert_allclose(found.matrix, np.stack(differences, axis=1), rtol=0, atol=1e-8)


def rk4(rate, x, y, h):
    one = rate(x, y)
    two = rate(x + h / 2, y + h / 2 * one)
    three = rate(x + h / 2, y + h / 2 * two)
    return y + h / 6 * (one + 2 * two + 2 * three + rate(x + h, y + h * three))


def from_spike_to_spike(p, u):
    """u after the next spike, its derivative and the time, of many: in an arc length, then over v, which only grows."""

    def rates(v, u):
        return 0.04 * v**2 + 5 * v + 140 - u + p["current"], p["a"] * (p["b"] * v - u)

    def slowly(_, y):
        v, u, _, dv, du = y
        rate, drift = rates(v, u)
        turned = (0.08 * v + 5) * dv - du, p["a"] * (p["b"] * dv - du)
        return np.stack([rate, drift, np.ones_like(v), *turned]) / (1 + np.abs(rate) / 4)

    def over_v(v, y):
        u, _, du = y
        rate, drift = rates(v, u)
        return np.stack([drift / rate, 1 / rate, (drift / rate - p["a"]) / rate * du])

    y = np.stack([np.full_like(u, p["c"]), u, 0 * u, 0 * u, 1 + 0 * u])
    while np.any(y[0] < -20.0):
        y = np.where(y[0] < -20.0, rk4(slowly, 0.0, y, 0.01), y)
    v, u, time, dv, du = y
    rate, drift = rates(v, u)
    y, h = np.stack([u, time, du - drift / rate * dv]), (p["peak"] - v) / 400
    for i in range(400):
        y = rk4(over_v, v + i * h, y, h)
    return y[0] + p["d"], y[2], y[1]


@pytest.mark.slow
def test_izhikevichs_neuron_is_its_map():
    problem = zoo.izhikevich()
    grid = np.linspace(-122.0, -96.0, 10_001)  # the map turns within a narrow range, where the neuron hesitates
    after, derivative, time = (CubicSpline(grid, column) for column in from_spike_to_spike(problem.args, grid))
    u = np.random.default_rng(0).uniform(-119, -108, 4000)
    growth, length = np.zeros((2, u.size))
    for n in range(2200):
        if n >= 200:
            growth, length = growth + np.log(np.abs(derivative(u))), length + time(u)
        u = after(u)
    each = growth / length
    known = problem.reference
    assert abs(np.mean(each) - known.exponents[0]) < 4 * np.std(each) / u.size**0.5 + known.stderr[0]
    found = problem.spectrum()
    assert abs(float(found.exponents[0]) - known.exponents[0]) < 4 * float(found.stderr[0])


@pytest.mark.slow
def test_a_dendrite_that_no_spike_resets():
    """Between spikes the motion is linear; the other exponent is the trace and what the jump does to areas."""
    problem = zoo.two_compartment_neuron()
    coupling, current, reset = (problem.args[name] for name in ("coupling", "current", "reset"))
    matrix, drive = np.array([[-1 - coupling, coupling], [coupling, -1 - coupling]]), np.array([0.0, current])
    rest = -np.linalg.solve(matrix, drive)

    def later(x, t):
        return rest + expm(matrix * t) @ (x - rest)

    d = 1.0
    for _ in range(60):
        time = brentq(lambda t, d=d: later([reset, d], t)[0] - 1, 1e-9, 50.0, xtol=1e-15)
        before = later([reset, d], time)
        d = before[1]
    after = np.array([reset, d])
    rate = np.trace(matrix) + math.log((matrix @ after + drive)[0] / (matrix @ before + drive)[0]) / time
    assert_allclose(problem.reference.exponents, [0.0, rate], atol=1e-9)
    assert_allclose(np.sort(over_cycles(problem, transient=50.0).exponents), [rate, 0.0], atol=1e-8)


@pytest.mark.slow
def test_a_neuron_that_tires():
    """The conductance decays exponentially: its mean, and so the trace along the motion, is known from a period."""
    problem = zoo.conductance_neuron()
    current, gain, memory, reversal = (problem.args[name] for name in ("current", "gain", "memory", "reversal"))

    def rate_of(v, g):
        return -v - g * (v - reversal) + current

    g, threshold = 0.5, until(lambda t, x: x[0] - 1, 1)
    for _ in range(60):
        run = integrate(lambda t, x: [rate_of(*x), -x[1] / memory], (0, 100), [0.0, g], events=threshold)
        g, time = run.y[1, -1] + gain, run.t[-1]
    mean = g * memory * (1 - math.exp(-time / memory)) / time
    jump = math.log(rate_of(0.0, g) / rate_of(1.0, g - gain)) / time
    rate = -1 - mean - 1 / memory + jump
    assert_allclose(problem.reference.exponents, [0.0, rate], atol=1e-8)
    assert_allclose(np.sort(over_cycles(problem, transient=100.0).exponents), [rate, 0.0], atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("period", [300.0, 250.0, 225.0])
def test_the_beats_of_a_heart(period):
    problem = zoo.cardiac_alternans(period=period)
    assert problem.reference.source == ("long and short beats in turn" if period == 225.0 else "equal beats")
    found = problem.spectrum(t1=2000)
    assert_allclose(found.exponents, problem.reference.exponents, rtol=1e-3)
    late = [float(x) for x in itertools.islice(beats(problem), 5000, 5002)]
    assert (abs(late[0] - late[1]) > 1.0) == (period == 225.0)


def beats(problem):
    x = problem.x0
    while True:
        x = problem.system.rule(0, x, problem.args)
        yield x[0]
