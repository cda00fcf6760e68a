"""Bifurcation curves in two parameters and families of orbits, against closed forms."""

import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipk

import lyaphybrid as lh
from benchmarks.capabilities.rows import Row, Stopwatch, apart, off

TITLE = "Curves in two parameters, families of orbits"
TURN = 2 * np.pi
CUBIC = lh.Map(lambda n, x, args: args["a"] + (1 + args["b"]) * x - x**3)
HENON = lh.Map(lambda n, x, p: jnp.stack([1 - p["a"] * x[0] ** 2 + x[1], p["b"] * x[0]]))
TENT = lh.Map(lambda n, x, p: jnp.where(x < 0.25, p["a"] * x, 0.25 * p["a"] - 1.5 * (x - 0.25)) + p["m"])


def turn_of(args):
    return TURN / args["omega"]


def followed(clock: Stopwatch, system, x0, args, branch, over, kind, *, transient=0.0, **how) -> lh.BifurcationCurve:
    """The curve of a kind that begins on a branch in the first parameter."""

    def run():
        special = lh.continuation(system, x0, args, over=branch, transient=transient, **how).of_kind(kind)[0]
        return lh.bifurcation_curve(system, special, args, over=over, **how)

    return clock(run)


def folds(clock: Stopwatch) -> Row:
    ranges = {"a": (-0.4, 0.1)}, {"a": (-1.0, 1.0), "b": (-0.5, 1.0)}
    curve = followed(clock, CUBIC, [0.9], {"a": 0.0, "b": 0.75}, *ranges, "fold", period=1, step=0.1)
    a, b = curve.values.T
    error = max(apart(a**2, 4 * (b / 3) ** 3), apart(curve.specials[0].values, 0.0))
    assert [one.kind for one in curve.specials] == ["cusp"]
    return Row("folds of a cubic map through their cusp", "closed form, a² = 4 (b/3)³", error, 1e-10)


def doublings(clock: Stopwatch) -> Row:
    args, ranges = {"a": 0.3, "b": 0.3}, ({"a": (0.3, 0.5)}, {"a": (-1.2, 3.4), "b": (-1.1, 0.6)})
    curve = followed(clock, HENON, [0.6, 0.2], args, *ranges, "period doubling", period=1, step=0.3)
    a, b = curve.values.T
    return Row("doublings of Hénon's map", "closed form, a = 3 (1 − b)²/4", apart(a, 0.75 * (1 - b) ** 2), 1e-10)


def pairs(clock: Stopwatch) -> Row:
    args, ranges = {"a": 0.3, "b": -0.8}, ({"b": (-1.1, -0.7)}, {"b": (-1.2, 0.3), "a": (-2.0, 4.0)})
    curve = followed(clock, HENON, [0.6, 0.2], args, *ranges, "Neimark–Sacker", period=1, step=0.3)
    cosine = np.cos(curve.angles)
    error = max(apart(curve.values[:, 0], -1.0), apart(curve.values[:, 1], -cosine * (2 - cosine)))
    truth = "closed form, b = −1 and a = −c (2 − c), c = cos θ"
    return Row("Neimark–Sacker points of Hénon's map", truth, error, 1e-10)


def grazing(clock: Stopwatch) -> Row:
    problem = lh.zoo.impact_oscillator(omega=2.0, gap=1.0, amplitude=2.9)
    ranges = {"amplitude": (2.8, 3.05)}, {"amplitude": (0.01, 4.0), "omega": (0.4, 2.2)}
    how = {"period": turn_of, "step": 0.3}
    curve = followed(clock, problem.system, [-0.95, 0.0], problem.args, *ranges, "grazing", **how)
    amplitude, omega = curve.values.T
    exact = np.sqrt((1 - omega**2) ** 2 + (2 * problem.args["zeta"] * omega) ** 2)
    truth = "closed form, the amplitude of the linear response"
    return Row("grazing of an impact oscillator through its resonance", truth, apart(amplitude, exact), 1e-10)


def waves(t, p, q):
    """A motion, its velocity and its acceleration."""
    return (
        p * jnp.cos(t) + q * jnp.cos(2 * t) + 0.3 * jnp.sin(2 * t) + 0.1 * jnp.sin(3 * t),
        -p * jnp.sin(t) - 2 * q * jnp.sin(2 * t) + 0.6 * jnp.cos(2 * t) + 0.3 * jnp.cos(3 * t),
        -p * jnp.cos(t) - 4 * q * jnp.cos(2 * t) - 1.2 * jnp.sin(2 * t) - 0.9 * jnp.sin(3 * t),
    )


def nearest_extremum(p: float, q: float) -> float:
    """How far the nearest extremum of the waves is from the wall."""
    t = np.linspace(0, TURN, 2001) + 1e-4
    speed = np.asarray(waves(t, p, q)[1])
    turns = np.flatnonzero(speed[:-1] * speed[1:] < 0)
    found = [brentq(lambda s: float(waves(s, p, q)[1]), t[i], t[i + 1], xtol=1e-14) for i in turns]
    return min(abs(float(waves(s, p, q)[0]) - 1) for s in found)


def grazing_through_cusps(clock: Stopwatch) -> Row:
    def field(t, x, args):
        place, velocity, push = waves(t, args["p"], args["q"])
        return jnp.stack([x[1], push - 0.4 * (x[1] - velocity) - (x[0] - place)])

    wall = lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]]))
    ranges, how = ({"p": (0.0, 0.75)}, {"p": (-2.2, 1.0), "q": (-1.2, 0.4)}), {"period": TURN, "step": 0.2}
    curve = followed(clock, lh.Hybrid(field, wall), [0.2, 0.9], {"p": 0.1, "q": 0.1}, *ranges, "grazing", **how)
    cusps = sum(one.kind == "cusp" for one in curve.specials)
    assert cusps
    error = max(nearest_extremum(p, q) for p, q in curve.values)
    remark = f"{len(curve.values)} points, {cusps} {'cusp' if cusps == 1 else 'cusps'}"
    return Row("grazing of two waves through cusps", "closed form, extrema of the motion", error, 1e-10, remark=remark)


def steady(t, friction, c):
    """v' = sin t − c v − F, while it moves on, without the part that decays."""
    return (c * np.sin(t) - np.cos(t)) / (1 + c**2) - friction / c


def sticking(clock: Stopwatch) -> Row:
    """It turns back at sin t = F; half a turn later the velocity is the opposite one, 0 again."""

    def rubbed(sign):
        return lambda t, x, args: jnp.stack([jnp.sin(t) - args["c"] * x[0] - args["F"] * sign])

    block = lh.filippov(rubbed(1), rubbed(-1), lambda t, x, args: x[0])
    args, begins = {"c": 0.2, "F": 0.45}, np.arcsin(0.45)
    turned = steady(np.pi, 0.45, 0.2) - steady(begins, 0.45, 0.2) * np.exp(-0.2 * (np.pi - begins))
    ranges, how = ({"F": (0.42, 0.5)}, {"F": (0.1, 0.9), "c": (0.05, 2.0)}), {"period": TURN, "step": 0.2}
    curve = followed(clock, block, [-turned], args, *ranges, "grazing", **how)
    friction, c = curve.values.T
    start = np.arcsin(friction)
    error = apart(steady(start + np.pi, friction, c), steady(start, friction, c) * np.exp(-c * np.pi))
    truth = "closed form, the force at a reversal is that of friction"
    return Row("where a block begins to stick (switching–sliding)", truth, error, 1e-10)


def border(clock: Stopwatch) -> Row:
    how = {"period": 1, "step": 0.1, "border": lambda n, x, args: x[0] - 0.25}
    over = {"m": (-0.5, 0.6), "a": (-0.9, 0.9)}
    curve = clock(lambda: lh.bifurcation_curve(TENT, [0.2], {"a": 0.5, "m": 0.1}, over=over, **how))
    m, a = curve.values.T
    return Row("border collision of a map", "closed form, m = (1 − a)/4", apart(m, 0.25 * (1 - a)), 1e-12)


CONVERTER = lh.Hybrid(
    {
        "on": lambda t, x, args: jnp.stack([args["V"] - 0.3 * x[0]]),
        "off": lambda t, x, args: jnp.stack([args["V"] - args["E"] - 0.8 * x[0]]),
    },
    [
        lh.Transition(lambda t, x, args: 1.4 - x[0], source="on", target="off"),
        lh.Transition(every=1.0, source="off", target="on"),
    ],
)


def converter(clock: Stopwatch) -> Row:
    """From the peak 1.4 at a tick the switch is open until the next one, then closed until 1.4 at that after it."""
    closed, opened = np.exp(-0.3), np.exp(-0.8)
    r, s = (1 - closed) / 0.3, closed * (1 - opened) / 0.8

    def exact(e):
        return (1.4 * (1 - closed * opened) + s * e) / (r + s)

    near = exact(2.4)
    rest = (near - 2.4) / 0.8
    args, over = {"V": 0.998 * near, "E": 2.4}, {"V": (0.5 * near, 2 * near), "E": (1.5, 4.0)}
    how = {"period": 2.0, "mode": "on"}
    start = [rest + (1.4 - rest) * opened]
    curve = followed(clock, CONVERTER, start, args, {"V": (0.996 * near, 1.001 * near)}, over, "grazing", **how)
    voltage, e = curve.values.T
    error = off(voltage, exact(e))
    return Row("border collision of a converter", "closed form, two exponentials", error, 1e-10, "relative")


PENDULUM = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))


def pendulum_family(clock: Stopwatch) -> Row:
    branch = clock(lambda: lh.continuation(PENDULUM, [1.0, 0.0], None, over=(-0.9, 0.9), conserve=True, step=0.2))
    error = off(branch.period, 4 * ellipk((branch.values + 1) / 2))
    return Row("the family of a pendulum by its energy", "closed form, elliptic integrals", error, 1e-9, "relative")


def ball_family(clock: Stopwatch) -> Row:
    ball = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
    )
    energy = lambda x, args: x[0] + x[1] ** 2 / 2  # noqa: E731
    branch = clock(lambda: lh.continuation(ball, [0.7, 0.3], None, over=(0.3, 3.0), conserve=energy, step=0.2))
    error = off(branch.period, np.sqrt(8 * branch.values))
    return Row("the family of a bouncing ball by its energy", "closed form, √(8E)", error, 1e-9, "relative")


ROWS = (
    folds,
    doublings,
    pairs,
    grazing,
    grazing_through_cusps,
    sticking,
    border,
    converter,
    pendulum_family,
    ball_family,
)
