"""Bifurcation curves in two parameters, against closed forms and independent integrations."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from numpy.testing import assert_allclose

import lyaphybrid as lh
from interrupts import interrupted_at
from lyaphybrid import plots, zoo
from lyaphybrid.analysis.curves.equations import CurveEquations

TURN = 2 * np.pi
FORCED = TURN / 0.666


def kinds(curve):
    return sorted(special.kind for special in curve.specials)


def followed(system, x0, args, first, second, kind, **options):
    """The curve of a kind that begins on the branch in the first parameter."""
    own = {key: value for key, value in options.items() if key != "transient"}
    special = lh.continuation(system, x0, args, over=first, **options).of_kind(kind)[0]
    return lh.bifurcation_curve(system, special, args, over=first | second, **own)


# --- multipliers of maps --------------------------------------------------------------------------------------------

CUBIC = lh.Map(lambda n, x, args: args["a"] + (1 + args["b"]) * x - x**3)


@pytest.fixture(scope="module")
def cusp():
    """The folds of x = a + (1 + b) x − x³, a = ±2 (b/3)^(3/2)."""
    args, ranges = {"a": 0.0, "b": 0.75}, ({"a": (-1.0, 1.0)}, {"b": (-0.5, 1.0)})
    return followed(CUBIC, [0.9], args, *ranges, "fold", period=1, step=0.1)


@pytest.mark.slow
def test_folds_through_their_cusp(cusp):
    a, b = cusp.values.T
    assert_allclose(a**2, 4 * (b / 3) ** 3, atol=1e-12)
    assert (np.max(a), np.min(a)) == pytest.approx((2 / 27**0.5, -2 / 27**0.5), abs=1e-12)
    assert cusp.ends == ("range", "range")
    assert kinds(cusp) == ["cusp"]
    assert_allclose(cusp.specials[0].values, 0, atol=1e-10)
    assert_allclose(cusp.multipliers, 1, atol=1e-9)


@pytest.mark.slow
def test_a_curve_that_closes():
    """X = x + x² + p² + q² − 1 folds on a circle."""
    bowl = lh.Map(lambda n, x, args: x + x**2 + args[0] ** 2 + args[1] ** 2 - 1)
    args, ranges = np.array([0.2, 0.3]), ({"args[0]": (-2.0, 2.0)}, {"args[1]": (-2.0, 2.0)})
    circle = followed(bowl, [-0.9], args, *ranges, "fold", period=1, step=0.1)
    assert circle.ends == ("closed", "closed")
    assert circle.specials == ()
    assert_allclose(np.sum(circle.values**2, axis=1), 1, atol=1e-11)
    angles = np.sort(np.arctan2(*circle.values.T))
    assert np.max(np.diff(angles, append=angles[0] + TURN)) < 0.5


@pytest.mark.slow
def test_folds_and_doublings_of_henon_map():
    """Fixed points fold at a = −(1 − b)²/4 and double at 3 (1 − b)²/4; the product of the multipliers is −b."""
    args, first, second = {"a": 0.3, "b": 0.3}, {"a": (-1.2, 3.4)}, {"b": (-1.1, 0.6)}
    for kind, factor, double in (("fold", -0.25, "1:1 resonance"), ("period doubling", 0.75, "1:2 resonance")):
        curve = followed(HENON_OF_TWO, [0.6, 0.2], args, first, second, kind, period=1, step=0.1)
        a, b = curve.values.T
        assert_allclose(a, factor * (1 - b) ** 2, atol=1e-11)
        assert kinds(curve) == [double]
        assert_allclose(curve.specials[0].values, [4 * factor, -1.0], atol=1e-7)


HENON_OF_TWO = lh.Map(lambda n, x, p: jnp.stack([1 - p["a"] * x[0] ** 2 + x[1], p["b"] * x[0]]))


@pytest.mark.slow
def test_a_pair_of_multipliers_on_the_circle():
    """Where b = −1 Hénon's map keeps areas: a = −c (2 − c), c = cos θ."""
    args, first, second = {"a": 0.3, "b": -0.8}, {"b": (-1.2, 0.3)}, {"a": (-2.0, 4.0)}
    curve = followed(HENON_OF_TWO, [0.6, 0.2], args, first, second, "Neimark–Sacker", period=1, step=0.1)
    b, a = curve.values.T
    cosine = np.cos(curve.angles)
    assert_allclose(b, -1, atol=1e-11)
    assert_allclose(a, -cosine * (2 - cosine), atol=1e-11)
    assert sorted(curve.ends) == ["1:1 resonance", "1:2 resonance"]
    found = {special.kind: special.values[1] for special in curve.specials}
    assert set(found) == {"1:1 resonance", "1:2 resonance", "1:3 resonance", "1:4 resonance"}
    wanted = {"1:1 resonance": -1, "1:2 resonance": 3, "1:3 resonance": 1.25, "1:4 resonance": 0}
    assert found == pytest.approx(wanted, abs=1e-10)


@pytest.mark.slow
def test_a_fold_meets_a_flip():
    """Two maps side by side, X = x + p + x² and y ↦ q y − y³: folds at p = 0, y doubles at q = −1."""
    both = lh.Map(lambda n, x, a: jnp.stack([x[0] + a["p"] + x[0] ** 2, a["q"] * x[1] - x[1] ** 3]))
    args, first, second = {"p": -0.2, "q": -0.6}, {"p": (-0.5, 0.5)}, {"q": (-1.5, 0.5)}
    fold = followed(both, [-0.45, 0.0], args, first, second, "fold", period=1, step=0.1)
    assert_allclose(fold.values[:, 0], 0, atol=1e-12)
    assert kinds(fold) == ["fold–flip"]
    assert_allclose(fold.specials[0].values, [0, -1], atol=1e-9)
    flip = followed(both, [-0.45, 0.0], args, second, first, "period doubling", period=1, step=0.1)
    assert_allclose(flip.values[:, 0], -1, atol=1e-12)
    assert "fold–flip" in kinds(flip)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "step"),
    [
        ("pitchfork", lambda n, x, a: (1 + a["p"] + a["q"] ** 2) * x - x**3),
        ("transcritical", lambda n, x, a: (1 + a["p"] + a["q"] ** 2) * x - x**2),
    ],
)
def test_two_branches_that_cross_along_a_curve(kind, step):
    args, first, second = {"p": -0.3, "q": 0.2}, {"p": (-0.8, 0.5)}, {"q": (-0.7, 0.7)}
    curve = followed(lh.Map(step), [0.0], args, first, second, kind, period=1, step=0.1)
    p, q = curve.values.T
    assert_allclose(p, -(q**2), atol=1e-11)
    assert (np.min(q), np.max(q)) == pytest.approx((-0.7, 0.7), abs=1e-12)


def test_a_fixed_point_on_a_border():
    """X = a x + m left of the border, so that x = c there where m = c (1 − a)."""
    tent = lh.Map(lambda n, x, p: jnp.where(x < 0.25, p["a"] * x, 0.25 * p["a"] - 1.5 * (x - 0.25)) + p["m"])
    curve = lh.bifurcation_curve(
        tent, [0.2], {"a": 0.5, "m": 0.1}, over={"m": (-0.5, 0.6), "a": (-0.9, 0.9)}, period=1, step=0.1,
        border=lambda n, x, args: x[0] - 0.25,
    )  # fmt: skip
    m, a = curve.values.T
    assert curve.kind == "border"
    assert_allclose(m, 0.25 * (1 - a), atol=1e-12)
    assert (np.min(a), np.max(a)) == pytest.approx((-0.9, 0.9), abs=1e-12)


# --- multipliers of flows -------------------------------------------------------------------------------------------


def turn_of(args):
    return TURN / args["omega"]


def rotating(t, x, args):
    """Z' = (−δ + i |z|²) z + F exp(iωt), whose response is z = Z exp(iωt) with |Z|² (δ² + (ω − |Z|²)²) = F²."""
    square, angle = x @ x, args["omega"] * t
    force = args["force"] * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return -0.3 * x + square * jnp.stack([-x[1], x[0]]) + force


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 2])
def test_folds_of_a_response_through_their_cusp(segments):
    args, first, second = {"omega": 0.5, "force": 0.5}, {"omega": (0.2, 3.0)}, {"force": (0.05, 0.6)}
    options = {"period": turn_of, "t0": 0.2, "transient": 100.0, "step": 0.1, "segments": segments}
    curve = followed(lh.Flow(rotating), [0.5, 0.0], args, first, second, "fold", **options)
    (omega, force), square = curve.values.T, np.sum(curve.x0**2, axis=1)
    assert_allclose(square * (0.09 + (omega - square) ** 2), force**2, atol=1e-10)
    assert_allclose(0.09 + (omega - square) ** 2, 2 * square * (omega - square), atol=1e-8)  # dF/d|Z|² = 0
    assert kinds(curve) == ["cusp"]
    assert_allclose(curve.specials[0].values, [0.3 * 3**0.5, (8 * 0.3**3 / 27**0.5) ** 0.5], atol=1e-8)


@pytest.mark.slow
def test_two_cycles_that_meet():
    """R' = r (m + c r² − r⁴) folds at m = −c²/4; the angle turns at the rate 1 + r²."""

    def field(t, x, args):
        square = x @ x
        return (args["m"] + args["c"] * square - square**2) * x + (1 + square) * jnp.stack([-x[1], x[0]])

    args, first, second = {"m": -0.1, "c": 1.0}, {"m": (-0.8, 0.5)}, {"c": (0.5, 1.7)}
    curve = followed(lh.Flow(field), [0.95, 0.0], args, first, second, "fold", step=0.1, transient=20.0)
    m, c = curve.values.T
    assert_allclose(m, -(c**2) / 4, atol=1e-10)
    assert_allclose(curve.period, TURN / (1 + c / 2), atol=1e-9)


@pytest.mark.slow
def test_doublings_of_roessler_in_two_parameters():
    """Where the curve is at another a, the branch there doubles."""
    problem = zoo.rossler()
    args, first = problem.args | {"c": 2.5}, {"c": (2.0, 4.5)}
    curve = followed(problem.system, problem.x0, args, first, {"a": (0.17, 0.22)}, "period doubling", transient=300.0,
                     step=0.1)  # fmt: skip
    c, a = curve.values[np.argmin(np.abs(curve.values[:, 1] - 0.18))]
    branch = lh.continuation(problem.system, problem.x0, args | {"a": float(a), "c": 2.5}, over=first, transient=300.0)
    assert branch.of_kind("period doubling")[0].parameter == pytest.approx(c, abs=1e-8)


# --- jumps ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_doublings_of_an_orbit_with_impacts():
    """Each orbit of the curve by hand: a linear oscillator between two impacts, and the saltation of the impact."""
    problem = zoo.impact_oscillator(omega=2.8, gap=-0.2)
    first, second = {"omega": (2.5, 4.0)}, {"gap": (-0.4, -0.1)}
    curve = followed(problem.system, problem.x0, problem.args, first, second, "period doubling", period=turn_of,
                     transient=300.0, step=0.1)  # fmt: skip
    assert len(curve.values) > 5
    assert np.ptp(curve.values[:, 1]) == pytest.approx(0.3)
    for (omega, gap), orbit in zip(curve.values[::4], curve.orbits[::4], strict=True):
        assert orbit.jumps == 1
        miss, multipliers = by_hand(orbit, problem.args | {"gap": gap, "omega": omega})
        assert miss < 1e-8
        assert np.min(np.abs(multipliers + 1)) < 1e-6


def roots(function, times):
    """The roots between the times at which a function changes sign."""
    values = np.asarray(function(times))
    changes = np.flatnonzero(values[:-1] * values[1:] < 0)
    return [scipy.optimize.brentq(function, times[i], times[i + 1], xtol=1e-15) for i in changes]


class Oscillator:
    """x'' + 2ζx' + x = A cos ωt between two impacts, in closed form."""

    def __init__(self, args):
        self.omega, self.zeta, self.amplitude = args["omega"], args["zeta"], args["amplitude"]
        self.matrix = np.array([[0.0, 1.0], [-1.0, -2 * self.zeta]])

    def forced(self, t):
        omega = self.omega
        phasor = self.amplitude / (1 - omega**2 + 2j * self.zeta * omega) * np.exp(1j * omega * t)
        return np.array([phasor.real, (1j * omega * phasor).real])

    def free(self, x, t, s):
        return self.forced(t + s) + scipy.linalg.expm(self.matrix * s) @ (x - self.forced(t))

    def pushes(self, x, t):
        return self.amplitude * np.cos(self.omega * t) - x[0] - 2 * self.zeta * x[1]

    def hit(self, x, gap, length):
        """The time at which it first goes clearly beyond the gap."""
        at = np.linspace(0, length, 20001)
        beyond = np.array([self.free(x, 0.0, s)[0] for s in at]) - gap
        i = np.flatnonzero(beyond > 1e-7)[0]
        return scipy.optimize.brentq(lambda s: self.free(x, 0.0, s)[0] - gap, at[i - 1], at[i], xtol=1e-15)

    def extrema(self, x, t, length):
        """The places at which it turns."""
        times = np.linspace(1e-6, length, 2001)
        speed = np.vectorize(lambda s: self.free(x, t, s)[1])
        return [self.free(x, t, s)[0] for s in roots(speed, times)]


def by_hand(orbit, args):
    """How far an orbit with one impact is from closing, and its multipliers."""
    free, restitution, start = Oscillator(args), args["restitution"], np.asarray(orbit.x0)
    hit = free.hit(start, args["gap"], orbit.period)
    before = free.free(start, 0.0, hit)
    after = before * [1, -restitution]
    corner = (free.pushes(after, hit) + restitution * free.pushes(before, hit)) / before[1]
    saltation = np.array([[-restitution, 0], [corner, -restitution]])
    parts = [scipy.linalg.expm(free.matrix * s) for s in (hit, orbit.period - hit)]
    end = free.free(after, hit, orbit.period - hit)
    return np.linalg.norm(end - start), np.linalg.eigvals(parts[1] @ saltation @ parts[0])


@pytest.mark.slow
def test_an_orbit_that_hits_the_wall_and_then_touches_it():
    """One impact in two periods of the drive; the curve ends where a third maximum touches the wall too."""
    problem = zoo.impact_oscillator(omega=3.2, gap=0.1)
    first, second = {"gap": (-0.3, 0.6)}, {"omega": (2.9, 4.0)}
    curve = followed(problem.system, problem.x0, problem.args, first, second, "grazing", step=0.1, transient=300.0,
                     period=lambda args: 2 * turn_of(args))  # fmt: skip
    assert sorted(curve.ends) == ["grazing", "range"]
    assert kinds(curve) == ["grazing"]
    for (gap, omega), orbit in zip(curve.values[::6], curve.orbits[::6], strict=True):
        args = problem.args | {"gap": gap, "omega": omega}
        assert by_hand(orbit, args)[0] < 1e-8
        free, start = Oscillator(args), np.asarray(orbit.x0)
        hit = free.hit(start, gap, orbit.period)
        after = free.free(start, 0.0, hit) * [1, -args["restitution"]]
        turns = [*free.extrema(start, 0.0, hit), *free.extrema(after, hit, orbit.period - hit)]
        assert np.min(np.abs(np.array(turns) - gap)) < 1e-9
    gap, omega = curve.specials[0].values
    orbit, args = curve.specials[0].orbit, problem.args | {"gap": gap, "omega": omega}
    free, start = Oscillator(args), np.asarray(orbit.x0)
    hit = free.hit(start, gap, orbit.period)
    after = free.free(start, 0.0, hit) * [1, -args["restitution"]]
    turns = [*free.extrema(start, 0.0, hit), *free.extrema(after, hit, orbit.period - hit)]
    assert np.sum(np.abs(np.array(turns) - gap) < 1e-6) == 2


@pytest.mark.slow
def test_where_an_oscillator_first_touches_the_wall():
    """Without impacts the amplitude is A/√((1 − ω²)² + 4ζ²ω²): through the resonance, where the phase turns by π."""
    problem = zoo.impact_oscillator(omega=2.0, gap=1.0)
    args, first, second = problem.args, {"amplitude": (0.01, 4.0)}, {"omega": (0.4, 2.2)}
    curve = followed(problem.system, [-0.3, 0.0], args, first, second, "grazing", period=turn_of, step=0.1)
    amplitude, omega = curve.values.T
    assert curve.ends == ("range", "range")
    assert (np.min(omega), np.max(omega)) == pytest.approx((0.4, 2.2), abs=1e-12)
    assert_allclose(amplitude, np.sqrt((1 - omega**2) ** 2 + (0.1 * omega) ** 2), atol=1e-11)
    assert_allclose(curve.period, TURN / omega, rtol=1e-14)


@pytest.mark.slow
def test_one_of_two_walls_with_one_guard():
    """The nearer wall is touched first, wherever it stands in the guard."""

    def field(t, x, args):
        return jnp.stack([x[1], args["force"] * jnp.cos(args["omega"] * t) - x[0] - 0.1 * x[1]])

    def walls(t, x, args):
        return jnp.stack([3.0 + x[0], 1.0 - x[0]])

    both = lh.Hybrid(field, lh.Transition(walls, lambda t, x, args, which: jnp.stack([x[0], -0.8 * x[1]])))
    args, first, second = {"force": 0.5, "omega": 2.0}, {"force": (0.05, 5.0)}, {"omega": (0.5, 2.4)}
    curve = followed(both, [-0.1, 0.0], args, first, second, "grazing", period=turn_of, step=0.1)
    force, omega = curve.values.T
    assert curve.ends == ("range", "range")
    assert_allclose(force, np.sqrt((1 - omega**2) ** 2 + (0.1 * omega) ** 2), atol=1e-11)


@pytest.mark.slow
def test_a_limit_cycle_that_touches_a_wall():
    """R' = (m − r²) r and a turn: the circle r² = m touches the wall x = w where m = w²."""

    def field(t, x, args):
        return (args["m"] - x @ x) * x + jnp.stack([-x[1], x[0]])

    wall = lh.Transition(lambda t, x, args: args["w"] - x[0], lambda t, x, args: jnp.stack([x[0], -0.7 * x[1]]))
    args, first, second = {"m": 0.3, "w": 1.0}, {"m": (0.05, 3.0)}, {"w": (0.4, 1.6)}
    curve = followed(lh.Hybrid(field, wall), [0.5, 0.0], args, first, second, "grazing", step=0.1)
    m, w = curve.values.T
    assert (np.min(w), np.max(w)) == pytest.approx((0.4, 1.6), abs=1e-12)
    assert_allclose(m, w**2, atol=1e-11)
    assert_allclose(curve.period, TURN, atol=1e-10)


WAVES = (0.3, 0.1)


def waves(t, p, q):
    """A motion and its two derivatives."""
    (s, c), u = WAVES, 2 * t
    return (
        p * jnp.cos(t) + q * jnp.cos(u) + s * jnp.sin(u) + c * jnp.sin(3 * t),
        -p * jnp.sin(t) - 2 * q * jnp.sin(u) + 2 * s * jnp.cos(u) + 3 * c * jnp.cos(3 * t),
        -p * jnp.cos(t) - 4 * q * jnp.cos(u) - 4 * s * jnp.sin(u) - 9 * c * jnp.sin(3 * t),
    )


def touching(tau):
    """The p and q with which that motion touches 1 at the time τ, and its second derivative there."""
    columns = [np.array(waves(tau, p, q)) for p, q in ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0))]
    matrix = np.column_stack([column - columns[2] for column in columns[:2]])[:2]
    p, q = np.linalg.solve(matrix, np.array([1.0, 0.0]) - columns[2][:2])
    return np.array([p, q]), float(waves(tau, p, q)[2])


@pytest.mark.slow
def test_touches_of_two_waves_through_their_cusps():
    """An oscillator that is pushed so that it moves as p cos t + q cos 2t + …: where three touches meet is a cusp."""

    def field(t, x, args):
        position, velocity, push = waves(t, args["p"], args["q"])
        return jnp.stack([x[1], push - 0.4 * (x[1] - velocity) - (x[0] - position)])

    wall = lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]]))
    args, first, second = {"p": 0.1, "q": 0.1}, {"p": (-3.0, 3.0)}, {"q": (-1.5, 1.2)}
    curve = followed(lh.Hybrid(field, wall), [0.2, 0.9], args, first, second, "grazing", period=TURN, step=0.1)
    times = np.linspace(0, TURN, 4001) + 1e-4  # at 0 and π waves of p and q touch for no p and q, or for many
    for p, q in curve.values:  # some extremum of the motion is at the wall
        heights = [float(waves(tau, p, q)[0]) for tau in roots(lambda tau, p=p, q=q: waves(tau, p, q)[1], times)]
        assert np.min(np.abs(np.array(heights) - 1)) < 1e-10
    bends = roots(np.vectorize(lambda tau: touching(tau)[1]), times)
    triples = [tau for tau in bends if abs(touching(tau - 1e-3)[1]) < 1]
    cusps = np.array([touching(tau)[0] for tau in triples])
    found = [special for special in curve.specials if special.kind == "cusp"]
    assert len(found) >= 1
    for special in found:
        assert np.min(np.linalg.norm(cusps - special.values, axis=1)) < 1e-8


@pytest.mark.slow
def test_where_a_block_begins_to_stick():
    """V' = sin t − c v − F sign v sticks from where the force at a reversal is F: sin t = F there."""

    def rubbed(sign):
        return lambda t, x, args: jnp.stack([jnp.sin(t) - args["c"] * x[0] - args["F"] * sign])

    block = lh.filippov(rubbed(1), rubbed(-1), lambda t, x, args: x[0])
    args, first, second = {"c": 0.2, "F": 0.3}, {"F": (0.1, 0.9)}, {"c": (0.05, 2.0)}
    curve = followed(block, [0.1], args, first, second, "grazing", period=TURN, transient=50.0, step=0.1)
    assert curve.kind == "edge"
    friction, c = curve.values.T
    start, a, b = np.arcsin(friction), c / (1 + c**2), -1 / (1 + c**2)

    def steady(t):
        return a * np.sin(t) + b * np.cos(t) - friction / c

    assert_allclose(steady(start + np.pi), steady(start) * np.exp(-c * np.pi), atol=1e-10)
    assert np.ptp(c) == pytest.approx(1.95)


@pytest.mark.slow
def test_where_the_pendulum_with_dry_friction_begins_to_stick():
    """Where the curve is at another β, the branch there changes its sequence of events."""
    problem = zoo.friction_pendulum(beta=0.052, alpha=0.5)
    args, first, second = problem.args, {"alpha": (0.38, 0.55)}, {"beta": (0.045, 0.06)}
    curve = followed(problem.system, problem.x0, args, first, second, "grazing", period=FORCED, step=0.1)
    assert curve.kind == "edge"
    alpha, beta = curve.values[0]
    assert beta in (pytest.approx(0.045), pytest.approx(0.06))
    there = lh.continuation(
        problem.system, problem.x0, args | {"beta": float(beta)}, over=first, period=FORCED, step=0.1
    )
    assert there.of_kind("grazing")[0].parameter == pytest.approx(alpha, abs=1e-8)


# --- what cannot be right, and how it looks --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"over": {"a": (0.0, 1.0)}}, "over must name two parameters"),
        ({"over": {"a": (-1.0, 1.0), "q": (0.0, 1.0)}}, "over must name some of a, b; got"),
        ({"over": {"a": (-1.0, 1.0), "b": (0.8, 1.0)}}, "b is 0.75: it must be in over, from 0.8 to 1"),
        ({"over": {"a": (-1.0, 1.0), "b": 1.0}}, r"over must be \(low, high\)"),
        ({"x0": [0.5]}, "x0 must be a Special of an lh.continuation"),
        ({"x0": [0.5], "border": 3.0}, "border must be a function"),
        ({"step": 0.0}, "step must be positive"),
        ({"system": lh.Flow(rotating), "border": lambda n, x, args: x[0]}, "border is for an lh.Map"),
        ({"system": "map"}, "bifurcation_curve needs an lh.Flow, lh.Hybrid or lh.Map; got 'map'"),
    ],
)
def test_bad_arguments(arguments, says, fold):
    good = {"system": CUBIC, "x0": fold, "args": {"a": 0.0, "b": 0.75}, "over": {"a": (-1.0, 1.0), "b": (-0.5, 1.0)},
            "period": 1}  # fmt: skip
    with pytest.raises(ValueError, match=says):
        lh.bifurcation_curve(**(good | arguments))


@pytest.fixture(scope="module")
def fold():
    args = {"a": 0.0, "b": 0.75}
    return lh.continuation(CUBIC, [0.9], args, over={"a": (-1.0, 1.0)}, period=1).of_kind("fold")[0]


def test_a_special_of_another_branch_is_refused(fold):
    with pytest.raises(lh.NoPeriodicOrbitError, match="the first name in over must be the parameter of its branch"):
        lh.bifurcation_curve(
            CUBIC, fold, {"a": 0.0, "b": -0.4}, over={"a": (-1.0, 1.0), "b": (-0.5, 1.0)}, period=1
        )  # fmt: skip


@pytest.mark.filterwarnings("ignore:interrupted")
def test_ctrl_c_leaves_what_was_computed(fold, monkeypatch):
    interrupted_at(monkeypatch, CurveEquations, "corrected", 12)
    curve = lh.bifurcation_curve(
        CUBIC, fold, {"a": 0.0, "b": 0.75}, over={"a": (-1.0, 1.0), "b": (-0.5, 1.0)}, period=1
    )
    assert curve.ends == ("interrupted", "interrupted")
    assert 2 < len(curve.values) < 14
    a, b = curve.values.T
    assert_allclose(a**2, 4 * (b / 3) ** 3, atol=1e-12)


@pytest.mark.slow
def test_the_picture(cusp):
    ax = plots.curves(cusp)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("a", "b")
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["fold", "cusp"]
    from matplotlib import pyplot

    turned = pyplot.subplots()[1]
    turned.set(xlabel="b", ylabel="a")
    plots.curves([cusp], turned)
    assert_allclose(turned.lines[0].get_xdata(), cusp.values[:, 1])
    with pytest.raises(ValueError, match="All curves must be in the plane of a and b"):
        plots.curves([cusp, HENON_CURVE])


class HENON_CURVE:  # noqa: N801  only its parameters are looked at
    parameters = ("a", "c")
    orbits = ()


def test_a_curve_prints_what_it_found_and_can_be_stored(cusp):
    first, second = str(cusp).splitlines()[:2]
    assert first.startswith("Curve of fold: a from -0.3849 to 0.3849, b from ")
    assert second.startswith("  cusp at a = ")
    stored = cusp.to_xarray()
    assert stored["values"].shape == (len(cusp.values), 2)
    assert list(stored["special_kind"].values) == ["cusp"]
