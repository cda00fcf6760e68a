"""A converter and its ramp, a runner, a juggler, rattling gears: against exact maps from event to event."""

import functools
import math

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

import lyaphybrid as lh
from benchmarks.capabilities.rows import Row, Stopwatch, apart, off

TITLE = "Engineering"
TURN = 2 * np.pi

# A boost converter in peak-current mode (Deane 1992, doi:10.1109/81.168922): on: L i' = V, C v' = −v/R; off: L i' =
# V − v, C v' = i − v/R; a clock closes the switch, which opens where i = I − m τ, τ the time since the tick.
V, L, C, R, T = 10.0, 1e-3, 12e-6, 20.0, 1e-4
ON = np.array([[-1 / (R * C), 0, 0], [0, 0, V / L], [0, 0, 0]])  # of (v, i, 1)
OFF = np.array([[-1 / (R * C), 1 / C, 0], [-1 / L, 0, V / L], [0, 0, 0]])
MARGIN = 0.8  # the size of the leading multiplier that is designed


def affine(matrix):
    return lambda t, x, args: jnp.asarray(matrix[:2, :2]) @ x + jnp.asarray(matrix[:2, 2])


def below_the_reference(t, x, args):
    """The time since the tick jumps shortly before the tick, where nobody asks."""
    early = 0.05 * T
    return args["I"] - args["m"] * (jnp.mod(t + early, T) - early) - x[1]


CONVERTER = lh.Hybrid(
    {"on": affine(ON), "off": affine(OFF)},
    [
        lh.Transition(below_the_reference, source="on", target="off"),
        lh.Transition(every=T, phase=0.9 * T, source="on", target="off"),
        lh.Transition(every=T, source="off", target="on"),
    ],
)


def leading(reference: float, ramp: float) -> float:
    """The most negative multiplier of the cycle with one pulse a period, by matrix exponentials."""

    def cycle(on):
        first, second = expm(ON * on), expm(OFF * (T - on))
        both = second @ first
        switch = first @ np.append(np.linalg.solve(np.eye(2) - both[:2, :2], both[:2, 2]), 1.0)
        return switch[1] + ramp * on - reference, switch, first, second

    on = brentq(lambda on: cycle(on)[0], 0.2 * T, 0.9 * T, xtol=1e-18, rtol=1e-14)
    _, switch, first, second = cycle(on)
    before, after = (ON @ switch)[:2], (OFF @ switch)[:2]
    saltation = np.eye(2) + np.outer(after - before, [0, 1]) / (ramp + before[1])
    return float(np.min(np.linalg.eigvals(second[:2, :2] @ saltation @ first[:2, :2]).real))


def margin(clock: Stopwatch) -> Row:
    args = {"I": 1.5, "m": 0.0}
    how = {"over": {"I": (1.4, 1.9)}, "period": T, "mode": "on", "transient": 200 * T}
    branch = clock(lambda: lh.continuation(CONVERTER, [15.0, 1.0], args, **how))
    exact = brentq(lambda reference: leading(reference, 0.0) + 1, 1.5, 2.0, xtol=1e-13)
    found = branch.of_kind("period doubling")[0].parameter
    remark, truth = f"{found:.8f} A", "matrix exponentials"
    return Row("the current at which a converter doubles its period", truth, abs(found - exact), 1e-9, "A", remark)


def ramp_by_design(clock: Stopwatch) -> Row:
    args = {"I": 2.5, "m": 3000.0}
    how = {"over": {"m": (0.0, 2e4)}, "algorithm": "implicit", "period": T, "mode": "on"}
    how |= {"t1": 100 * T, "transient": 200 * T}
    found = clock(lambda: lh.design(CONVERTER, [25.0, 2.3], args, np.log(MARGIN) / T, **how))
    exact = brentq(lambda ramp: leading(2.5, ramp) + MARGIN, 2000, 4000, xtol=1e-9, rtol=1e-14)
    ramp = float(found.parameters["m"])
    remark, truth = f"{ramp:.4f} A/s", "matrix exponentials"
    return Row("slope compensation by design, multiplier −0.8", truth, off(ramp, exact), 1e-9, "relative", remark)


def until(guard, direction):
    guard.terminal, guard.direction = True, direction
    return guard


def next_apex(y: float, level: float, k: float, angle: float) -> tuple[float, float]:
    """The height of the runner's next flight, and the time between."""
    down = math.sqrt(2 * (y - math.sin(angle)))

    def stance(t, x):
        pull = k * (1 / math.hypot(x[0], x[1]) - 1)
        return [x[2], x[3], pull * x[0], pull * x[1] - 1]

    start = [-math.cos(angle), math.sin(angle), math.sqrt(2 * (level - y)), -down]
    leaves = until(lambda t, x: x[0] ** 2 + x[1] ** 2 - 1, 1)
    run = solve_ivp(stance, (0, 10), start, "DOP853", events=leaves, rtol=1e-12, atol=1e-13)
    _, height, _, speed = run.y[:, -1]
    return height + speed**2 / 2, down + run.t[-1] + speed


def slope(function, h: float) -> float:
    """The derivative at 0 by differences of fourth order."""
    one, two = (function(m * h) - function(-m * h) for m in (1, 2))
    return (8 * one - two) / (12 * h)


def runner(clock: Stopwatch) -> Row:
    problem = lh.zoo.slip_runner()
    k, angle = problem.args["stiffness"], problem.args["angle"]
    energy = lambda x, args: (x[2] ** 2 + x[3] ** 2) / 2 + x[1]  # noqa: E731
    spring = lambda x, args: energy(x, args) + args["stiffness"] / 2 * (1 - jnp.hypot(x[0], x[1])) ** 2  # noqa: E731
    how = {"mode": problem.mode, "transient": 50.0, "conserve": {"ascent": energy, "descent": energy, "stance": spring}}
    gait = clock(lambda: lh.floquet(problem.system, problem.x0, problem.args, **how))
    level = float(problem.x0[2] ** 2 / 2 + problem.x0[1])
    height = brentq(lambda y: next_apex(y, level, k, angle)[0] - y, 0.935, 0.96, xtol=1e-14)
    multiplier = slope(lambda d: next_apex(height + d, level, k, angle)[0], 5e-5)
    (found,) = (mu.real for mu in np.asarray(gait.multipliers) if 1e-6 < abs(mu) < 0.9)
    error = max(abs(found - multiplier), abs(gait.period - next_apex(height, level, k, angle)[1]))
    truth, remark = "map from apex to apex by SciPy", f"{found:.8f}"
    return Row("multiplier and period of a running gait", truth, error, 1e-8, remark=remark)


def juggler(clock: Stopwatch) -> Row:
    gains, rates, exact = (0.2, 0.4, 0.5), [], []
    problems = [lh.zoo.paddle_juggler(gain=gain) for gain in gains]
    run = lambda one: lh.floquet(one.system, one.x0, one.args, transient=50.0)  # noqa: E731
    for gain, orbit in zip(gains, clock(lambda: [run(one) for one in problems]), strict=True):
        rates.append(np.sort(orbit.exponents))
        exact.append([math.log(abs(1 - 3.4 * gain)) / (2 * math.sqrt(2)), 0.0])
    truth = "closed form, multipliers 1 and 1 − s"
    return Row("exponents of a paddle juggler", truth, apart(rates, exact), 1e-7)


GEAR = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], args["amplitude"] * jnp.cos(t) - args["drag"]]),
    lh.Transition(
        lambda t, x, args: jnp.stack([x[0], 1 - x[0]]), lambda t, x, args, which: jnp.stack([x[0], -0.6 * x[1]])
    ),
)
RATTLE, LOUD = {"amplitude": 0.12, "drag": 0.1}, {"amplitude": 0.44, "drag": 0.1}
LOST = (1 - 0.6) / (1 + 0.6)


@functools.cache
def regular_rattle() -> lh.Continuation:
    """Of a tooth that meets the drive flank once a turn, from half a turn after the impact; over the amplitude."""
    alpha, delta = RATTLE["amplitude"], RATTLE["drag"]
    phase, speed = -np.arcsin(np.pi * delta / alpha * LOST), np.pi * delta * (1 - LOST)
    start = [
        speed * np.pi - delta * np.pi**2 / 2 + alpha * (2 * np.cos(phase) - np.pi * np.sin(phase)),
        speed - delta * np.pi - 2 * alpha * np.sin(phase),
    ]
    how = {"over": {"amplitude": (0.05, 0.2)}, "period": TURN, "t0": phase + np.pi, "step": 0.3}
    return lh.continuation(GEAR, start, RATTLE, **how)


def rattle_begins(clock: Stopwatch) -> Row:
    branch = clock(regular_rattle.__wrapped__)
    fold, doubling = (branch.of_kind(kind)[0].parameter for kind in ("fold", "period doubling"))
    first, bend = np.pi * LOST, 2 * (1 + 0.6**2) / 1.6**2
    exact = 0.1 * np.array([first, np.hypot(first, bend)])
    truth = "closed form, the map from impact to impact"
    return Row("where the rattle of a gear begins, and doubles", truth, apart([fold, doubling], exact), 1e-9)


def flight(t, v, s, x):
    """Position and velocity a time s after an impact at t."""
    alpha, delta = LOUD["amplitude"], LOUD["drag"]
    wave = np.cos(t) - np.cos(t + s) - s * np.sin(t)
    return x + v * s - delta * s**2 / 2 + alpha * wave, v - delta * s + alpha * (np.sin(t + s) - np.sin(t))


def until_impact(t, v, x) -> np.ndarray:
    """The time of flight of many gears, by bisection."""

    def inside(s):
        place, _ = flight(t, v, s, x)
        return (place > 0) & (place < 1)

    grid = np.linspace(0, 2 * TURN, 193)
    first = np.argmax(~inside(grid[1:, None]), axis=0)
    low, high = grid[first], grid[first + 1]
    for _ in range(45):
        middle = (low + high) / 2
        good = inside(middle)
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return (low + high) / 2


def from_impact_to_impact(gears: int = 100, skipped: int = 50, impacts: int = 300) -> tuple[float, float]:
    """λ₁ of the map (t, v) -> (t, v) of the impacts, per time, with its standard error."""
    rng = np.random.default_rng(1)
    t, v = rng.uniform([[4.8], [0.4]], [[5.5], [0.6]], (2, gears))
    x, growth, time, vector = 0 * t, np.zeros(gears), np.zeros(gears), np.array([0 * t + 1, 0 * t])
    for n in range(skipped + impacts):
        s = until_impact(t, v, x)
        place, w = flight(t, v, s, x)
        before, after = LOUD["amplitude"] * np.cos([t, t + s]) - LOUD["drag"]
        dt = ((v + s * before) * vector[0] - s * vector[1]) / w  # of the next impact
        vector = np.array([dt, -0.6 * (vector[1] - before * vector[0] + after * dt)])
        size = np.hypot(*vector)
        t, v, x, vector = (t + s) % TURN, -0.6 * w, np.round(place), vector / size
        if n >= skipped:
            growth, time = growth + np.log(size), time + s
    each = growth / time
    return float(np.mean(each)), float(np.std(each, ddof=1) / gears**0.5)


def chaotic_rattle(clock: Stopwatch) -> Row:
    how = {"t1": 3000 * TURN, "transient": 200 * TURN}
    found = clock(lambda: lh.lyapunov_spectrum(GEAR, [0.3, 0.0], LOUD, **how))
    exact, stderr = from_impact_to_impact()
    assert abs(np.sum(found.exponents) - 2 * math.log(0.6) * float(found.jumps) / how["t1"]) < 1e-9  # the sum rule
    rate, error = float(found.exponents[0]), math.hypot(float(found.stderr[0]), stderr)
    remark = f"{rate:.4f}, one se of both together {error:.4f}"
    return Row(
        "λ₁ of a gear that rattles chaotically",
        "map from impact to impact",
        abs(rate - exact) / error,
        3.0,
        "se",
        remark,
    )


ROWS = (margin, ramp_by_design, runner, juggler, rattle_begins, chaotic_rattle)
