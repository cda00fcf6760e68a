"""Branches of periodic orbits and their bifurcations, against closed forms and independent programs."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.optimize
from numpy.testing import assert_allclose

import lyaphybrid as lh
from examples import HENON, LOGISTIC
from interrupts import interrupted_at
from lyaphybrid import plots, zoo
from lyaphybrid.analysis.continuation.continuing import parameters_named
from lyaphybrid.analysis.continuation.equations import BranchEquations

FORCED = 2 * np.pi / 0.666


def places(branch, kind):
    return [special.parameter for special in branch.of_kind(kind)]


def kinds(branch):
    return [special.kind for special in branch.specials]


# --- maps ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cascade():
    """The fixed point of the logistic map, its 2-cycle and its 4-cycle, each begun where the one before doubles."""
    options = {"over": {"args": (1.5, 3.6)}, "period": 1}
    found = [lh.continuation(LOGISTIC, [0.6], 2.5, **options)]
    for _ in range(2):
        found.append(lh.continuation(LOGISTIC, found[-1].of_kind("period doubling")[0], 2.5, **options))
    return found


@pytest.mark.slow
def test_the_logistic_map_doubles_where_it_should(cascade):
    exact = [3.0, 1 + np.sqrt(6), 3.5440903595519228536]  # the last: a root of a polynomial, OEIS A086181
    for branch, value, turns in zip(cascade, exact, (1, 2, 4), strict=True):
        assert kinds(branch) == ["period doubling"]
        special = branch.specials[0]
        assert special.parameter == pytest.approx(value, abs=1e-12)
        assert complex(special.multipliers[0]) == pytest.approx(-1.0, abs=1e-10)
        assert special.period == turns


@pytest.mark.slow
def test_the_whole_branch_is_the_closed_form(cascade):
    fixed, cycle, _ = cascade
    r = fixed.values
    assert r[0] == 1.5
    assert r[-1] == 3.6
    assert_allclose(fixed.x0[:, 0], 1 - 1 / r, atol=1e-12)
    assert_allclose(fixed.multipliers[:, 0], 2 - r, atol=1e-11)
    assert np.all(fixed.stable == (r < 3))
    assert fixed.ends == ("range", "range")
    r = cycle.values[1:]
    assert_allclose(cycle.multipliers[1:, 0], 4 + 2 * r - r**2, atol=1e-10)
    assert_allclose(cycle.largest[1:, 0], (r + 1 + np.sqrt((r - 3) * (r + 1))) / (2 * r), atol=1e-12)
    assert cycle.ends == ("start", "range")


@pytest.mark.slow
def test_the_window_of_period_three_begins_in_a_fold():
    branch = lh.continuation(LOGISTIC, [0.1567], 3.84, over={"args": (3.8, 3.9)}, period=3)
    assert places(branch, "fold") == pytest.approx([1 + np.sqrt(8)], abs=1e-12)
    assert np.any(branch.stable)
    assert not np.all(branch.stable)
    assert np.min(branch.values) >= 1 + np.sqrt(8) - 1e-12


@pytest.mark.slow
def test_a_system_that_only_jumps_is_a_map():
    jumps = lh.Hybrid(None, lh.Transition(lambda n, x, r: x[0], lambda n, x, r: r * x * (1 - x)))
    branch = lh.continuation(jumps, [0.6], 2.5, over={"args": (2.0, 3.2)}, period=1)
    assert places(branch, "period doubling") == pytest.approx([3.0], abs=1e-12)


def henon_doubling(start, a, period):
    """Where an orbit of Hénon's map has the multiplier −1, by Newton's method on its own."""

    def misses(u):
        x, y, matrix = u[0], u[1], np.eye(2)
        for _ in range(period):
            matrix = np.array([[-2 * u[2] * x, 1.0], [0.3, 0.0]]) @ matrix
            x, y = 1 - u[2] * x**2 + y, 0.3 * x
        return [x - u[0], y - u[1], np.linalg.det(matrix + np.eye(2))]

    return scipy.optimize.fsolve(misses, [*start, a], xtol=1e-12)[2]


@pytest.mark.slow
def test_henon_map_folds_and_doubles():
    """b = 0.3: fold at −(1 − b)²/4, doublings at 3(1 − b)²/4 and (1 − b)² + (1 + b)²/4."""
    options = {"over": {"args": (-0.13, 1.1)}, "period": 1, "step": 0.1}
    branch = lh.continuation(HENON, [0.8, 0.2], 0.2, **options)
    assert places(branch, "fold") == pytest.approx([-0.1225], abs=1e-12)
    assert kinds(branch) == ["fold", "period doubling"]
    exact = [0.3675, 0.9125, None, None]
    for turns, value in zip((1, 2, 4, 8), exact, strict=True):
        assert [special.orbit.period for special in branch.of_kind("period doubling")] == [turns]
        special = branch.of_kind("period doubling")[0]
        value = henon_doubling(special.x0, special.parameter + 1e-5, turns) if value is None else value
        assert special.parameter == pytest.approx(value, abs=1e-10)
        assert np.prod(special.multipliers) == pytest.approx((-0.3) ** turns, abs=1e-10)
        branch = lh.continuation(HENON, special, 0.2, **options)
        assert branch.period[-1] == 2 * turns


def henon(x, a=1.4):
    return np.array([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]])


@pytest.mark.slow
def test_all_cycles_of_henon_map_up_to_period_eight():
    """On the attractor there are 1, 0, 1, 0, 2, 4, 7 of the periods 2 to 8 (Biham & Wenzel 1989).

    doi:10.1103/PhysRevLett.63.819; the exponents by the product of Jacobians around the cycle.
    """
    motion = [np.array([0.1, 0.1])]
    for _ in range(40_000):
        motion.append(henon(motion[-1]))
    motion = np.array(motion[100:])
    for period, count in zip(range(2, 9), (1, 0, 1, 0, 2, 4, 7), strict=True):
        returns = np.linalg.norm(motion[period:] - motion[:-period], axis=1)
        cycles = {}
        for i in np.argsort(returns)[:150]:
            orbit = lh.floquet(HENON, motion[i], 1.4, period=period, throw=False)
            if orbit.residual > 1e-12:
                continue
            around, matrix = [np.asarray(orbit.x0)], np.eye(2)
            for _ in range(period):
                matrix = np.array([[-2.8 * around[-1][0], 1.0], [0.3, 0.0]]) @ matrix
                around.append(henon(around[-1]))
            around = np.array(around)
            if any(np.linalg.norm(around[m] - around[0]) < 1e-6 for m in range(1, period)):
                continue  # of a smaller period
            sizes = np.sort(np.abs(np.linalg.eigvals(matrix)))[::-1]
            assert_allclose(orbit.exponents, np.log(sizes) / period, atol=1e-9)
            cycles[round(float(np.max(around[:, 0])), 7)] = orbit
        assert len(cycles) == count, period


@pytest.mark.slow
def test_a_circle_is_born_in_the_delayed_logistic_map():
    """X⁺ = r x (1 − y), y⁺ = x: at r = 2 the multipliers are exp(±iπ/3)."""
    delayed = lh.Map(lambda n, x, r: jnp.stack([r * x[0] * (1 - x[1]), x[0]]))
    branch = lh.continuation(delayed, [0.3, 0.3], 1.5, over={"args": (1.2, 2.5)}, period=1)
    assert kinds(branch) == ["Neimark–Sacker"]
    special = branch.specials[0]
    assert special.parameter == pytest.approx(2.0, abs=1e-12)
    assert_allclose(np.sort_complex(np.asarray(special.multipliers)), np.exp([-1j * np.pi / 3, 1j * np.pi / 3]))
    with pytest.raises(ValueError, match="No branch begins at a Neimark–Sacker"):
        lh.continuation(delayed, special, 1.5, over={"args": (1.2, 2.5)}, period=1)


@pytest.mark.slow
def test_a_branch_that_begins_at_a_doubling_needs_the_period_too(cascade):
    with pytest.raises(ValueError, match="period, of a map its number of iterations"):
        lh.continuation(LOGISTIC, cascade[0].specials[0], 2.5, over={"args": (2.0, 3.6)})
    with pytest.raises(ValueError, match="args is 3: it must be in over, from 3.2 to 3.6"):
        lh.continuation(LOGISTIC, cascade[0].specials[0], 2.5, over={"args": (3.2, 3.6)}, period=1)


@pytest.mark.slow
def test_two_real_multipliers_whose_product_is_one_are_nothing_special():
    saddle = lh.Map(lambda n, x, p: jnp.stack([p * x[0] + 0.1, 0.5 * x[1]]))
    branch = lh.continuation(saddle, [-0.2, 0.0], 1.5, over={"args": (1.2, 2.5)}, period=1)
    assert kinds(branch) == []


@pytest.mark.slow
def test_a_fold_with_a_parameter_that_is_one_entry_of_an_array():
    fold = lh.Map(lambda n, x, args: x + args["rates"][1] - x**2)
    args = {"rates": np.array([7.0, 0.25]), "count": 3}
    branch = lh.continuation(fold, [0.5], args, over={"rates[1]": (-0.5, 0.5)}, period=1)
    assert places(branch, "fold") == pytest.approx([0.0], abs=1e-14)
    assert_allclose(branch.x0[:, 0] ** 2, branch.values, atol=1e-12)
    assert branch.ends == ("range", "range")


def cubic(n, x, args):
    return args["p"] * x - x**3


@pytest.mark.slow
def test_a_pitchfork_from_its_handle_and_from_a_prong():
    options = {"over": {"p": (0.2, 2.5)}, "period": 1, "step": 0.1}
    handle = lh.continuation(lh.Map(cubic), [0.0], {"p": 0.5}, **options)
    assert kinds(handle) == ["pitchfork"]
    assert handle.specials[0].parameter == pytest.approx(1.0, abs=1e-12)
    prongs = lh.continuation(lh.Map(cubic), handle.specials[0], {"p": 0.5}, **options)
    assert_allclose(prongs.x0[:, 0] ** 2, prongs.values - 1, atol=1e-10)
    assert np.sign(prongs.x0[0, 0]) == -np.sign(prongs.x0[-1, 0])
    assert places(prongs, "period doubling") == pytest.approx([2.0, 2.0], abs=1e-12)
    arrived = lh.continuation(lh.Map(cubic), [0.9], {"p": 1.8}, **options)
    assert kinds(arrived) == ["period doubling", "pitchfork", "period doubling"]
    back = lh.continuation(lh.Map(cubic), arrived.of_kind("pitchfork")[0], {"p": 1.8}, **options)
    assert_allclose(back.x0, 0.0, atol=1e-9)


@pytest.mark.slow
def test_two_branches_that_cross():
    crossing = lh.Map(lambda n, x, p: (1 + p) * x - x**2)
    options = {"over": {"args": (-0.9, 0.9)}, "period": 1}
    first = lh.continuation(crossing, [0.0], -0.5, **options)
    assert kinds(first) == ["transcritical"]
    assert first.specials[0].parameter == pytest.approx(0.0, abs=1e-12)
    second = lh.continuation(crossing, first.specials[0], -0.5, **options)
    assert_allclose(second.x0[:, 0], second.values, atol=1e-12)
    assert second.values[0] * second.values[-1] == pytest.approx(-0.81)


@pytest.mark.slow
def test_a_branch_that_closes():
    circle = lh.Map(lambda n, x, p: x + 0.3 * (1 - p**2 - x**2))
    branch = lh.continuation(circle, [1.0], 0.0, over={"args": (-2.0, 2.0)}, period=1, step=0.05)
    assert branch.ends == ("closed", "closed")
    assert sorted(places(branch, "fold")) == pytest.approx([-1.0, 1.0], abs=1e-12)
    assert_allclose(branch.x0[:, 0] ** 2 + branch.values**2, 1.0, atol=1e-12)


# --- flows ---------------------------------------------------------------------------------------------------------


def turn_of(args):
    return 2 * jnp.pi / args["omega"]


def hopf(t, x, args):
    """Radius √m, frequency 1 + c m."""
    square = x @ x
    turn, growth = 1 + args["c"] * square, args["m"] - square
    return jnp.stack([growth * x[0] - turn * x[1], turn * x[0] + growth * x[1]])


@pytest.mark.slow
def test_a_limit_cycle_whose_radius_and_period_are_known():
    branch = lh.continuation(lh.Flow(hopf), [0.7, 0.0], {"m": 0.5, "c": 0.3}, over={"m": (0.2, 1.5)})
    m = branch.values
    assert (np.min(m), np.max(m)) == (0.2, 1.5)
    assert_allclose(np.linalg.norm(branch.x0, axis=1), np.sqrt(m), atol=1e-12)
    assert_allclose(branch.period, 2 * np.pi / (1 + 0.3 * m), atol=1e-12)
    assert_allclose(branch.exponents, np.stack([0 * m, -2 * m], axis=1), atol=1e-9)
    assert kinds(branch) == []
    assert np.all(branch.stable)


def rotating(t, x, args):
    """Z' = (−δ + i |z|²) z + F exp(iωt): the response is z = Z exp(iωt), with |Z|² (δ² + (ω − |Z|²)²) = F²."""
    square, angle = x @ x, args["omega"] * t
    force = args["force"] * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return -args["delta"] * x + square * jnp.stack([-x[1], x[0]]) + force


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_folds_of_a_response_in_its_frequency(segments):
    args = {"omega": 0.5, "delta": 0.3, "force": 0.5}
    options = {"over": {"omega": (0.4, 3.5)}, "period": turn_of, "t0": 0.2, "transient": 100.0, "step": 0.1}
    branch = lh.continuation(lh.Flow(rotating), [0.5, 0.0], args, segments=segments, **options)
    square, omega = np.sum(branch.x0**2, axis=1), branch.values
    assert_allclose(square * (0.09 + (omega - square) ** 2), 0.25, atol=1e-10)
    assert_allclose(branch.period, 2 * np.pi / omega, rtol=1e-14)
    # ω = ρ + √(F²/ρ − δ²), ρ = |Z|², turns where 4 F² ρ³ − 4 δ² ρ⁴ = F⁴.
    rho = np.roots([-4 * 0.09, 4 * 0.25, 0.0, 0.0, -0.0625])
    rho = np.sort(rho[np.isreal(rho) & (rho.real > 0)].real)[::-1]
    exact = rho + np.sqrt(0.25 / rho - 0.09)
    assert places(branch, "fold") == pytest.approx(exact, abs=1e-10)
    assert branch.ends == ("range", "range")


def variational(field, jacobian, x0, period):
    """The end of a turn and the multipliers, by DOP853 and equations written by hand."""
    n = len(x0)

    def both(t, y):
        return np.concatenate([field(y[:n]), (jacobian(y[:n]) @ y[n:].reshape(n, n)).ravel()])

    start = np.concatenate([x0, np.eye(n).ravel()])
    end = scipy.integrate.solve_ivp(both, (0, period), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    return end[:n], np.linalg.eigvals(end[n:].reshape(n, n))


@pytest.mark.slow
def test_doublings_of_an_autonomous_flow():
    """Rössler's cycle doubles, and once more; at both places an independent integration has the multiplier −1."""
    problem = zoo.rossler()
    options = {"over": {"c": (2.0, 4.5)}, "transient": 300.0}
    first = lh.continuation(problem.system, [0.0, -4.0, 0.02], problem.args | {"c": 2.5}, **options)
    second = lh.continuation(problem.system, first.specials[0], problem.args, segments=2, **options)
    for branch in (first, second):
        assert kinds(branch) == ["period doubling"]
        special = branch.specials[0]
        c = special.parameter
        end, multipliers = variational(
            lambda x, c=c: np.array([-x[1] - x[2], x[0] + 0.2 * x[1], 0.2 + x[2] * (x[0] - c)]),
            lambda x, c=c: np.array([[0.0, -1.0, -1.0], [1.0, 0.2, 0.0], [x[2], 0.0, x[0] - c]]),
            np.asarray(special.x0),
            special.period,
        )
        assert_allclose(end, special.x0, atol=1e-10)
        assert np.min(np.abs(multipliers + 1)) < 1e-8


@pytest.mark.slow
def test_a_symmetric_cycle_of_lorenz_loses_its_symmetry_and_doubles():
    """Near ρ = 313 and 229.4 (C. Sparrow, The Lorenz Equations, Springer 1982, doi:10.1007/978-1-4612-5767-7)."""
    problem = zoo.lorenz63(rho=330.0)
    options = {"over": {"rho": (200.0, 350.0)}, "transient": 30.0}
    symmetric = lh.continuation(problem.system, [30.0, 30.0, 320.0], problem.args, **options)
    assert places(symmetric, "pitchfork") == pytest.approx([312.97], abs=0.01)
    lopsided = lh.continuation(problem.system, symmetric.specials[0], problem.args, **options)
    assert kinds(lopsided) == ["period doubling"] * 2
    assert places(lopsided, "period doubling") == pytest.approx([229.4] * 2, abs=0.05)
    assert np.max(lopsided.values) < 312.98
    assert_allclose(lopsided.exponents[0], lopsided.exponents[-1], atol=1e-8)  # of each other's mirror images
    for special, value in ((symmetric.specials[0], 1.0), (lopsided.specials[0], -1.0)):
        _, multipliers = variational(*lorenz(special.parameter), np.asarray(special.x0), special.period)
        less_the_trivial = np.delete(multipliers, np.argmin(np.abs(multipliers - 1)))
        assert np.min(np.abs(less_the_trivial - value)) < 1e-4  # at the pitchfork both of two near 1 are off by a root


def lorenz(rho):
    """The field and its Jacobian."""
    field = lambda x: np.array([10 * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]])  # noqa: E731
    jacobian = lambda x: np.array([[-10.0, 10.0, 0.0], [rho - x[2], -1.0, -x[0]], [x[1], x[0], -8 / 3]])  # noqa: E731
    return field, jacobian


# Starts near orbits by their turns about the left and the right fixed point, such that the first close return is the
# orbit's; periods and orbits: D. Viswanath, Nonlinearity 16 (2003) 1035, doi:10.1088/0951-7715/16/3/314.
LORENZ = {
    "LR": ([-2.1473, 2.078, 26.9999], 1.5586522107161762),
    "LLR": ([-3.5021, -5.8858, 13.4435], 2.3059072639398495),
    "LLLR": ([-10.8776, -5.7168, 35.1471], 3.0235837034338604),
    "LLRR": ([-3.3569, 0.3628, 27.0009], 3.0842767758220555),
    "LLLLR": ([-6.736089, -1.895018, 30.705185], 3.725641771555767),
    "LLLRR": ([-4.2505, -1.0085, 27.0001], 3.820254163436777),
    "LLRRR": ([-3.1624, 0.6485, 26.9993], 3.8202541634367755),
}


@pytest.mark.slow
def test_unstable_periodic_orbits_of_lorenz():
    problem = zoo.lorenz63()
    for word, (start, period) in LORENZ.items():
        # Of the smallest multiplier, 1e-11 to 1e-26 of the largest, only the pieces know more than rounding.
        orbit = lh.floquet(problem.system, start, problem.args, segments=6)
        assert orbit.period == pytest.approx(period, abs=1e-10), word
        end, multipliers = variational(*lorenz(28.0), np.asarray(orbit.x0), orbit.period)
        assert_allclose(end, orbit.x0, atol=1e-9)
        leading = np.log(np.max(np.abs(multipliers))) / orbit.period
        # Which multiplier is e^(−15 T) rounding hides from that integration; the trace of the field, −41/3, does not.
        assert_allclose(orbit.exponents, [leading, 0.0, -41 / 3 - leading], atol=1e-8, err_msg=word)


# --- jumps ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_orbit_ends_where_it_touches_the_wall():
    """Without impacts the amplitude is A/√((1 − ω²)² + 4ζ²ω²), and it may not exceed the gap."""
    problem = zoo.impact_oscillator(omega=2.0, gap=1.0)
    branch = lh.continuation(problem.system, [-0.3, 0.0], problem.args, over={"amplitude": (0.5, 4.0)}, period=turn_of)
    assert branch.ends == ("range", "grazing")
    assert kinds(branch) == ["grazing"]
    assert branch.specials[0].parameter == pytest.approx(np.sqrt(9 + 0.04), abs=1e-10)
    assert_allclose(branch.largest[:, 0], branch.values / np.sqrt(9.04), rtol=1e-4)  # of a thousand points
    assert_allclose(branch.exponents, -0.05, atol=1e-10)


@pytest.mark.slow
def test_an_orbit_with_impacts_doubles_and_ends_where_they_graze():
    problem = zoo.impact_oscillator(omega=2.0)
    branch = lh.continuation(problem.system, problem.x0, problem.args, over={"gap": (-0.1, 1.0)}, period=turn_of,
                             transient=300.0)  # fmt: skip
    assert kinds(branch) == ["period doubling", "grazing"]
    assert branch.ends == ("range", "grazing")
    impacts = np.array([orbit.jumps for orbit in branch.orbits])
    assert np.all(impacts == 1)
    product = np.exp(-0.1 * np.pi) * 0.8**2  # e^(−2ζT) r², whatever the orbit
    moderate = np.abs(branch.multipliers[:, 0]) < 100  # of the next to a grazing the smaller is lost in rounding
    assert_allclose(np.prod(branch.multipliers[moderate], axis=1), product, rtol=2e-6)
    assert np.abs(branch.specials[-1].multipliers[0]) > 100  # it grows as one over the velocity of the impact


def rolling(angle, slope):
    """Θ' after an impact, and the time of a step."""
    launch = 2 * np.sqrt(np.sin(slope) * np.sin(angle)) / np.tan(2 * angle)
    start, end = slope - angle, slope + angle

    def rate(theta):
        return 1 / np.sqrt(launch**2 + 2 * (np.cos(start) - np.cos(theta)))

    return launch, scipy.integrate.quad(rate, start, end, epsabs=1e-13, epsrel=1e-13)[0]


@pytest.mark.slow
def test_rimless_wheels_on_all_slopes():
    problem = zoo.rimless_wheel()
    branch = lh.continuation(problem.system, problem.x0, problem.args, over={"slope": (0.1, 0.4)})
    assert branch.ends == ("range", "range")
    assert kinds(branch) == []
    exact = np.array([rolling(np.pi / 8, slope) for slope in branch.values])
    assert_allclose(branch.period, exact[:, 1], atol=1e-10)
    assert_allclose(branch.multipliers, np.broadcast_to([1.0, 0.5], branch.multipliers.shape), atol=1e-9)
    energy = branch.x0[:, 1] ** 2 / 2 + np.cos(branch.x0[:, 0])
    wanted = exact[:, 0] ** 2 / 2 + np.cos(branch.values - np.pi / 8)
    assert_allclose(energy, wanted, atol=1e-10)


@pytest.mark.slow
def test_a_runner_whose_flight_ends_where_it_begins_to_fall():
    """Where the highest point of the flight is as high as it lands, there is no gait beyond; from the equations."""
    problem = zoo.slip_runner()
    level, stiffness = 1.596**2 / 2 + 1, problem.args["stiffness"]

    def energy(x, args):
        return (x[2] ** 2 + x[3] ** 2) / 2 + x[1]

    def with_spring(x, args):
        return energy(x, args) + args["stiffness"] * (1 - jnp.hypot(x[0], x[1])) ** 2 / 2

    kept = {"ascent": energy, "descent": energy, "stance": with_spring}
    gait = lh.floquet(problem.system, problem.x0, problem.args, mode=problem.mode, transient=50.0, conserve=kept)
    how = {"mode": problem.system.mode_names[gait.mode], "conserve": kept, "step": 0.1}
    branch = lh.continuation(problem.system, gait.x0, problem.args, over={"angle": (1.18, 1.3)}, **how)
    assert sorted(branch.ends) == ["grazing", "range"]

    def rises_above(angle):
        def field(t, x):
            push = stiffness * (1 / np.hypot(x[0], x[1]) - 1)
            return [x[2], x[3], push * x[0], push * x[1] - 1]

        def leaves(t, x):
            return np.hypot(x[0], x[1]) - 1

        leaves.terminal, leaves.direction = True, 1
        start = [-np.cos(angle), np.sin(angle), np.sqrt(2 * (level - np.sin(angle))), 0.0]
        run = scipy.integrate.solve_ivp(field, (0, 5), start, events=leaves, method="DOP853", rtol=1e-12, atol=1e-13)
        return run.y[1, -1] + run.y[3, -1] ** 2 / 2 - np.sin(angle)

    exact = scipy.optimize.brentq(rises_above, 1.22, 1.25, xtol=1e-13)
    end = branch.of_kind("grazing")[0]
    assert np.max(np.abs(end.multipliers)) > 1e4  # so near to it Newton's method comes
    assert end.parameter == pytest.approx(exact, abs=2e-6)


@pytest.mark.slow
def test_a_pendulum_that_sticks_from_some_friction_on():
    """It does where the force at a reversal is no larger than the friction: where A sin ωt − λ sin θ = ±α there."""
    problem = zoo.friction_pendulum(beta=0.052, alpha=0.5)
    branch = lh.continuation(problem.system, problem.x0, problem.args, over={"alpha": (0.38, 0.55)}, period=FORCED,
                             step=0.1)  # fmt: skip
    assert kinds(branch) == ["fold", "fold", "grazing"]
    onset = branch.of_kind("grazing")[0]
    args = problem.args | {"alpha": onset.parameter}
    motion = lh.trajectory(problem.system, onset.x0, args, t1=FORCED, method=lh.RungeKutta(rtol=1e-12, atol=1e-14))
    force = 0.586 * np.sin(0.666 * motion.events.t) - 0.87 * np.sin(motion.events.x_before[:, 0])
    assert np.min(np.abs(np.abs(force) - onset.parameter)) < 1e-8
    sticks = np.array([orbit.jumps for orbit in branch.orbits]) == 4
    assert np.all(branch.multipliers[sticks, 1] == 0)
    assert np.all(branch.multipliers[~sticks, 1] != 0)


@pytest.mark.slow
def test_the_pendulum_with_dry_friction_in_its_damping():
    """Against an independent program."""
    problem, options = zoo.friction_pendulum(beta=0.3, alpha=0.01), {"over": {"beta": (0.14, 0.3)}, "period": FORCED}
    symmetric = lh.continuation(problem.system, problem.x0, problem.args, **options)
    broken = symmetric.of_kind("pitchfork")[0]
    assert broken.parameter == pytest.approx(0.19052195475, abs=1e-10)
    lopsided = lh.continuation(problem.system, broken, problem.args, **options)
    assert places(lopsided, "period doubling") == pytest.approx([0.14671901457] * 2, abs=1e-10)
    b = problem.args | {"beta": 0.155}
    third = lh.continuation(
        problem.system, [-6.71092484, -0.9236297], b, over={"beta": (0.144, 0.17)}, period=3 * FORCED
    )
    assert places(third, "fold") == pytest.approx([0.1587880508], abs=1e-9)
    assert places(third, "pitchfork") == pytest.approx([0.1459824746], abs=1e-9)


@pytest.mark.slow
def test_a_cascade_ends_at_the_edge_of_chaos():
    """Doublings follow each other by Feigenbaum's ratio; where they accumulate a bisection finds that λ₁ passes 0."""
    problem, ratio = zoo.friction_pendulum(beta=0.144, alpha=0.01), 4.669201609
    start, options = [-2.04, -1.22], {"period": 2 * FORCED, "step": 0.1}
    branch = lh.continuation(problem.system, start, problem.args, over={"beta": (0.139, 0.146)}, transient=400 * FORCED,
                             **options)  # fmt: skip
    doublings = places(branch, "period doubling")
    for gap in (1.4e-3, 3e-4, 7e-5):
        # Lengths are in units of the range: in a narrower one the branch begins so steeply that rounding hides it.
        over = {"beta": (doublings[-1] - 1.5 * gap, doublings[-1] + 10 * gap)}
        branch = lh.continuation(
            problem.system, branch.of_kind("period doubling")[0], problem.args, over=over, **options
        )
        doublings += places(branch, "period doubling")[:1]
    apart = -np.diff(doublings)
    assert_allclose(apart[:-1] / apart[1:], ratio, rtol=0.01)
    edge = lh.design(problem.system, start, problem.args, 0.0, over={"beta": (0.13, 0.15)},
                     optimiser="bisection", t1=2000 * FORCED, transient=500 * FORCED)  # fmt: skip
    assert edge.converged
    assert edge.parameters["beta"] == pytest.approx(doublings[-1] - apart[-1] / (ratio - 1), abs=1e-6)


def buck_doubling():
    """Where the buck converter's cycle doubles: exact flows of both positions of the switch, Newton on the rest.

    A period T is off for d, until the ramp meets the control, then on. The multipliers follow from how d depends on
    the state.
    """
    r, l, c, period, gain, wanted, low, high = 22.0, 20e-3, 47e-6, 400e-6, 8.4, 11.3, 3.8, 8.2  # noqa: E741
    a = np.array([[-1 / (r * c), 1 / c], [-1 / l, 0.0]])

    def misses(u):
        v, i, share, voltage = u
        source, d = np.array([0.0, voltage / l]), share * period
        rest = -np.linalg.solve(a, source)
        off, on = scipy.linalg.expm(a * d), scipy.linalg.expm(a * (period - d))
        middle = off @ [v, i]
        end = rest + on @ (middle - rest)
        ramp = low + (high - low) * share
        # h = gain (v − wanted) − ramp vanishes at d; the end depends on the start directly and through d.
        along, slope = gain * off[0], gain * (a @ middle)[0] - (high - low) / period
        by_d = on @ (a @ middle) - on @ (a @ (middle - rest))
        matrix = on @ off - np.outer(by_d, along) / slope
        return [end[0] - v, end[1] - i, gain * (middle[0] - wanted) - ramp, np.linalg.det(matrix + np.eye(2))]

    found, _, _, message = scipy.optimize.fsolve(misses, [12.02, 0.6, 0.5, 24.5], xtol=1e-13, full_output=True)
    assert np.max(np.abs(misses(found))) < 1e-9, message
    return found


@pytest.mark.slow
def test_the_buck_converter_doubles():
    """The model's periods are even and odd in turn: a doubling is the pitchfork of an orbit of two periods."""
    problem = zoo.buck_converter(voltage=24.0)
    branch = lh.continuation(problem.system, problem.x0, problem.args, over={"voltage": (23.0, 26.0)}, period=800e-6,
                             mode=problem.mode, transient=problem.transient)  # fmt: skip
    assert kinds(branch) == ["pitchfork"]
    v, i, _, voltage = buck_doubling()
    assert branch.specials[0].parameter == pytest.approx(voltage, abs=1e-8)
    assert_allclose(branch.specials[0].x0, [v, i], atol=1e-8)
    doubled = lh.continuation(problem.system, branch.specials[0], problem.args, over={"voltage": (23.0, 26.0)},
                              period=800e-6, mode=problem.mode)  # fmt: skip
    assert np.all(doubled.stable[np.abs(doubled.values - 25.0) < 0.3])


# --- what cannot be followed, and what cannot be right --------------------------------------------------------------


@pytest.mark.slow
def test_where_newton_fails_the_branch_ends_and_is_kept():
    """X = 2 √(1 − p) ends at p = 1, and what is beyond is no number."""
    ending = lh.Map(lambda n, x, p: x / 2 + jnp.sqrt(1 - p))
    branch = lh.continuation(ending, [2.0], 0.0, over={"args": (-0.5, 2.0)}, period=1)
    assert branch.ends == ("range", "no convergence")
    assert 0.99 < branch.values[-1] <= 1
    assert_allclose(branch.x0[:, 0], 2 * np.sqrt(1 - branch.values), atol=1e-8)
    short = lh.continuation(LOGISTIC, [0.6], 2.5, over={"args": (1.5, 3.6)}, period=1, max_points=3)
    assert short.ends == ("max_points", "max_points")
    assert len(short.values) == 5


@pytest.mark.filterwarnings("ignore:interrupted")
def test_ctrl_c_leaves_what_was_computed(monkeypatch):
    interrupted_at(monkeypatch, BranchEquations, "corrected", 10)
    branch = lh.continuation(LOGISTIC, [0.6], 2.5, over={"args": (1.5, 3.6)}, period=1)
    assert branch.ends == ("interrupted", "interrupted")
    assert 2 < len(branch.values) < 12
    assert_allclose(branch.x0[:, 0], 1 - 1 / branch.values, atol=1e-12)


def test_a_family_of_orbits_at_one_parameter_is_refused():
    anywhere = lh.Map(lambda n, x, p: jnp.stack([x[0], 0.5 * x[1] + p]))
    with pytest.raises(ValueError, match="one of a family at the same parameter"):
        lh.continuation(anywhere, [0.3, 0.0], 0.1, over={"args": (0.0, 1.0)}, period=1)


def test_large_arrays_in_args_are_carried_along_as_they_are():
    few, many = {"p": 0.3, "rates": np.ones(3)}, {"p": 0.3, "rates": np.ones((200, 200))}
    (of_few,), _ = parameters_named(few, "p")
    (of_many,), (value,) = parameters_named(many, "p")
    assert (len(of_few.leaf), len(of_many.leaf), value) == (4, 1, 0.3)
    assert of_many(0.5)["p"] == of_few(0.5)["p"] == 0.5
    assert of_many(0.5)["rates"].shape == (200, 200)


def test_nothing_near_the_start_is_said():
    none = lh.Map(lambda n, x, p: x + 1 + 0 * p)
    with pytest.raises(lh.NoPeriodicOrbitError):
        lh.continuation(none, [0.3], 0.1, over={"args": (0.0, 1.0)}, period=1)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"over": {"q": (0.0, 1.0)}}, "over must name some of p, rates, where; got"),
        ({"args": {"p": 0.3, "turns": 2}, "over": {"turns": (1.0, 3.0)}}, "turns is an integer in args: write 2.0 for"),
        ({"over": {3: (0.0, 1.0)}}, "the parameter must be the name of an entry of args; got 3"),
        ({"over": {"rates": (0.0, 1.0)}}, r"over must name one number, such as 'rates\[0\]'; got 'rates'"),
        ({"over": {"p": (0.0, 1.0), "where": (0.0, 1.0)}}, "over must name one parameter"),
        ({"over": {"p": (0.4, 0.9)}}, "p is 0.3: it must be in over, from 0.4 to 0.9"),
        ({"over": {"p": (0.4, 0.1)}}, "low < high"),
        ({"over": {"p": 0.4}}, r"over must be \(low, high\)"),
        ({"over": {"p": (0.0, np.inf)}}, "high, of over, must be a finite number"),
        ({"step": 0.0}, "step must be positive"),
        ({"max_points": 1}, "max_points must be an integer of at least 2"),
        ({"segments": 0}, "segments must be an integer of at least 1"),
        ({"period": None}, "period, of a map its number of iterations"),
        ({"system": "map"}, "continuation needs an lh.Flow, lh.Hybrid or lh.Map; got 'map'"),
    ],
)
def test_bad_arguments(arguments, says):
    args = {"p": 0.3, "rates": np.array([1.0, 2.0]), "where": 1.0}
    good = {"system": lh.Map(lambda n, x, args: 0.5 * x + args["p"]), "x0": [0.6], "args": args,
            "over": {"p": (0.0, 1.0)}, "period": 1}  # fmt: skip
    with pytest.raises(ValueError, match=says):
        lh.continuation(**(good | arguments))


# --- pictures ------------------------------------------------------------------------------------------------------


def test_the_picture(cascade):
    upper, lower = cascade[0].plot()
    stable, unstable = upper.lines[:2]
    assert stable.get_linestyle() == "-"
    assert unstable.get_linestyle() == "--"
    assert np.max(stable.get_xdata()) == pytest.approx(np.min(unstable.get_xdata()))
    assert np.max(stable.get_xdata()) == pytest.approx(3.0, abs=0.1)
    assert [text.get_text() for text in upper.get_legend().get_texts()] == ["period doubling"]
    assert lower.get_xlabel() == "args"
    together = plots.continuation(cascade)[0]
    assert sum(line.get_marker() == "D" for line in together.lines) == 3


def test_a_branch_prints_what_it_found(cascade):
    lines = str(cascade[0]).splitlines()
    assert lines[0].startswith("Branch of periodic orbits over args from 1.5 to 3.6: ")
    assert lines[1] == "  period doubling at 3, T = 1"


@pytest.mark.slow
def test_the_largest_value_may_be_one_before_a_jump():
    """A rimless wheel leans farthest where its next leg lands, at the slope plus half of the angle between legs."""
    half = np.pi / 8
    lands = lh.Transition(
        lambda t, x, slope: slope + half - x[0],
        lambda t, x, slope: jnp.stack([slope - half, jnp.cos(2 * half) * x[1]]),
    )
    wheel = lh.Hybrid(lambda t, x, slope: jnp.stack([x[1], jnp.sin(x[0])]), lands)
    branch = lh.continuation(wheel, [0.1 - half, 0.6], 0.1, over={"args": (0.09, 0.12)}, transient=20.0)
    assert_allclose(branch.largest[:, 0], branch.values + half, rtol=0, atol=1e-9)
    assert_allclose(branch.smallest[:, 0], branch.values - half, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_branch_from_an_orbit_in_the_mode_that_it_begins_in():
    """The orbit passes through other modes, at the point where its derivatives are taken, too."""

    def slips(sign):
        return lambda t, x, a: jnp.stack([x[1], -x[0] - 0.05 * x[1] - sign * a["mu"] + jnp.cos(0.5 * t)])

    block, turn = lh.filippov(slips(1.0), slips(-1.0), surface=lambda t, x, a: x[1]), 4 * np.pi
    orbit = lh.floquet(block, [0.5, 1.0], {"mu": 0.3}, period=turn, transient=30 * turn)
    branch = lh.continuation(block, orbit.x0, {"mu": 0.3}, over={"mu": (0.28, 0.32)}, mode=orbit.mode, period=turn)
    assert branch.ends == ("range", "range")


@pytest.mark.slow
def test_a_branch_along_which_the_surface_moves_that_holds_the_orbit():
    """A block sticks to a belt whose speed is the parameter: nodes are where it slips. Periods from SciPy."""

    def slips(sign):
        return lambda t, x, vb: jnp.stack([x[1], -x[0] - sign / (1 + 3 * sign * (x[1] - vb))])

    system = lh.filippov(slips(1.0), slips(-1.0), lambda t, x, vb: x[1] - vb)
    found = lh.continuation(system, [0.0, 0.0], 0.2, over={"args": (0.1, 0.6)}, transient=40.0)
    assert found.ends == ("range", "range")
    assert found.specials == ()
    for i in (0, len(found.values) // 2, -1):
        vb = float(found.values[i])

        def caught(t, x, vb=vb):
            return x[1] - vb

        caught.terminal, caught.direction = True, 1.0
        slip = scipy.integrate.solve_ivp(
            lambda t, x, vb=vb: [x[1], -x[0] + 1 / (1 - 3 * (x[1] - vb))],
            (0.0, 50.0),
            [1.0, vb],  # the friction gives way at x = 1
            events=caught, rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        period = slip.t[-1] + (1.0 - slip.y[0, -1]) / vb
        assert abs(found.orbits[i].period - period) < 1e-8 * period
