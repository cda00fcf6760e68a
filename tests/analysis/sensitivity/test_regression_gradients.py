"""Derivatives of chaotic exponents by regression against exact values and independent ones; and what is refused."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from known_gradients import baker, of_solenoid, perturbed_cat, solenoid
from lyaphybrid.analysis.sensitivity import estimates, regression
from lyaphybrid.zoo.bodies.walls import STRAIGHT_PATH, billiard, falls, lowest

KEY = jax.random.key(1)


def gradient(rule, x0, args, t1, **keywords):
    return lh.lyapunov_gradient(lh.Map(rule), x0, args, t1=t1, algorithm="regression", key=KEY, **keywords)


def assert_within(found, exact, known=0.0, most=3.0):
    assert np.all(np.abs(found.gradient - np.array(exact)) < most * np.hypot(found.stderr, np.array(known)) + 1e-9)
    assert found.trust, found.reasons


def assert_within_one(found, name, exact, known=0.0):
    assert abs(found.gradient[name][0] - exact) < 3 * np.hypot(found.stderr[name][0], known)
    assert found.trust, found.reasons


@pytest.mark.slow
def test_a_discontinuity_that_moves():
    """No trajectory's derivative sees it; λ₁ = −p ln p − (1−p) ln(1−p)."""
    found = gradient(baker, [0.31234, 0.1], 0.3, 20_000, window=0.2)
    slope = np.log(0.7 / 0.3)
    assert_within(found, [slope, -slope])
    assert found.stderr[0] < 0.03
    assert_allclose(found.value[0], -0.3 * np.log(0.3) - 0.7 * np.log(0.7), atol=4 * found.value_stderr[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("a", "window", "t1"), [(0.2, 0.8, 400_000), (0.4, 0.4, 1_000_000)], ids=["0.2-0.8", "0.4-0.4"]
)
def test_the_solenoid(a, window, t1):
    found = gradient(solenoid, [0.3, 0.1, 0.2], a, t1, window=window)
    assert_within(found, of_solenoid(a))
    assert found.stderr[0] < 1e-3
    assert_allclose(found.value[0], np.log(1 + np.sqrt(1 - a**2)), atol=4 * found.value_stderr[0])


@pytest.mark.slow
def test_the_perturbed_cat_map():
    found = gradient(perturbed_cat, [0.3, 0.1], 0.4, 500_000, window=0.25)
    assert_within(found, [-0.04806, 0.01293], [0.00032, 0.00026])
    assert np.max(found.stderr) < 1e-3


@pytest.mark.slow
def test_lorenz():
    problem = lh.zoo.lorenz63()
    sigma, beta = 10.0, 8 / 3

    def field(t, x, rho):
        return problem.system.field(t, x, {"sigma": sigma, "rho": rho, "beta": beta})

    found = lh.lyapunov_gradient(
        lh.Flow(field), problem.x0, 28.0, t1=1800.0, key=KEY, method=lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9)
    )
    assert found.method == "regression"
    assert_within(found, [0.0242, 0, -0.0243], [2e-4, 0, 2e-4])
    assert np.max(found.stderr) < 1e-3
    assert_allclose(np.sum(found.gradient), 0, atol=1e-6)  # Σλ = −σ − 1 − β


@pytest.mark.slow
def test_lorenz_by_three_parameters_at_once():
    problem = lh.zoo.lorenz63()
    found = lh.lyapunov_gradient(
        problem.system, problem.x0, problem.args, t1=300.0, key=KEY, degree=1, algorithm="regression",
        method=lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9),
    )  # fmt: skip
    for name, exact in {"sigma": -1, "rho": 0, "beta": -1}.items():
        assert_allclose(np.sum(found.gradient[name]), exact, atol=1e-5)
    assert any("zero exponent" in reason for reason in found.reasons)


@pytest.mark.slow
def test_hard_disks_and_their_energy():
    """λ ∝ √K: dλ₁/dK = λ₁/2K."""
    disks = lh.zoo.hard_disks(n=4, density=0.7)
    places, velocities = np.split(np.asarray(disks.x0), 2)

    def start(args):
        return jnp.concatenate([places, velocities * jnp.sqrt(args["energy"] / 4.0)])

    found = lh.lyapunov_gradient(
        disks.system, start, disks.args | {"energy": 4.0}, t1=1200.0, transient=50.0, key=KEY, k=1, over=["energy"],
        window=0.5, degree=3,
    )  # fmt: skip
    exact = found.value[0] / 8
    assert found.method == "regression"
    assert_within_one(found, "energy", exact)
    assert found.stderr["energy"][0] < 0.02 * exact
    assert found.gradient["mass"] is None


CELLS = np.stack(np.meshgrid(*2 * [np.arange(-2.0, 3.0)]), axis=-1).reshape(-1, 2)


def heights(q, args):
    """Above disks of two radii, those at the corners and those in the middle of unit squares."""
    from_both = [(q - jnp.round(q - place) - place)[None, :] - CELLS for place in (0.0, 0.5)]
    radii = args["corner"], args["middle"]
    return jnp.concatenate([(jnp.sum(d * d, axis=1) - r * r) / 2 for d, r in zip(from_both, radii, strict=True)])


def next_event(t, x, args):
    return jnp.min(falls(STRAIGHT_PATH, heights, x, args)), 0


@pytest.mark.slow
def test_the_mean_free_time_of_a_lorentz_gas():
    """⟨τ⟩ = π area/perimeter (N. Chernov, J. Stat. Phys. 88 (1997) 1, doi:10.1007/BF02508462), the speed being 1."""
    gas = billiard(STRAIGHT_PATH, next_event, lambda q, args, which: lowest(heights(q, args)))
    found = lh.lyapunov_gradient(
        gas, [0.5, 0.05, 0.6, 0.8], {"corner": 0.38, "middle": 0.3}, t1=10_000.0, transient=20.0, key=KEY, k=1,
        over=["corner"], window=0.04,
    )  # fmt: skip
    assert found.method == "regression"
    assert_within_one(found, "corner", 24.17, 0.1)
    free = (1 - np.pi * (0.38**2 + 0.3**2)) / (2 * 0.68)
    assert_within_one(found.time_per_jump, "corner", -(np.pi * 0.38 + free) / 0.68)
    assert_allclose(found.time_per_jump.value, free, atol=4 * found.time_per_jump.value_stderr[0])
    assert found.time_per_jump.stderr["corner"] < 0.03
    assert re.search(r"time per jump +0\.19", str(found))


@pytest.mark.slow
def test_faster_time():
    """F → c f multiplies all exponents by c."""
    problem = lh.zoo.lorenz63()

    def field(t, x, c):
        return c * problem.system.field(t, x, {"sigma": 10.0, "rho": 28.0, "beta": 8 / 3})

    found = lh.lyapunov_gradient(
        lh.Flow(field), problem.x0, 1.0, t1=1000.0, key=KEY, algorithm="regression",
        method=lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9),
    )  # fmt: skip
    assert_within(found, found.value)


@pytest.mark.slow
def test_henon_is_refused():
    """Windows of periodic motion lie everywhere: λ is no smooth function of a."""

    def henon(n, x, a):
        return jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]])

    # Of runs of 20_000 only every other ensemble is refused: their noise hides the windows.
    found = gradient(henon, [0.1, 0.1], 1.4, 60_000, window=0.007)
    assert not found.trust
    assert any("χ²" in reason and "no smooth function" in reason for reason in found.reasons)


@pytest.mark.slow
def test_a_chaotic_impact_oscillator_is_refused():
    """Periodic windows everywhere: χ² grows with the length of the runs."""

    def field(t, x, omega):
        return jnp.stack([x[1], -x[0] - 0.1 * x[1] + jnp.cos(omega * t)])

    wall = lh.Transition(guard=lambda t, x, omega: -x[0], reset=lambda t, x, omega: x * jnp.array([1.0, -0.8]))
    found = lh.lyapunov_gradient(
        lh.Hybrid(field, wall), [0.0, -0.5], 2.8, t1=2000.0, algorithm="regression", key=KEY, window=0.007,
        method=lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9),
    )  # fmt: skip
    assert not found.trust
    assert any("χ²" in reason and "no smooth function" in reason for reason in found.reasons)


@pytest.mark.slow
def test_two_degrees_must_agree():
    """A bend that a cubic over this window cannot follow, without any noise."""

    def rule(n, x, a):
        return x * jnp.exp(jnp.tanh(20 * (a - 1)) - 3)

    found = gradient(rule, [1e-3], 1.0, 50, window=0.5)
    assert not found.trust


@pytest.mark.slow
def test_smooth_dependence_is_found_without_noise():
    found = gradient(lambda n, x, a: x * a, [0.5], 0.5, 100, window=0.01, degree=5)
    assert_allclose(found.gradient, 2.0, rtol=1e-6)
    assert found.trust, found.reasons


@pytest.mark.slow
def test_several_parameters_at_once():
    def rule(n, x, args):
        return jnp.stack([args["rates"][0] * x[0], args["rates"][1] * x[1]])

    found = gradient(rule, [0.5, 0.5], {"rates": np.array([0.6, 0.3])}, 100, window=np.array([0.01, 0.005]), degree=3)
    assert_allclose(found.gradient["rates"], [[1 / 0.6, 0], [0, 1 / 0.3]], atol=1e-4)


@pytest.mark.slow
def test_an_exponent_of_minus_infinity():
    found = gradient(lambda n, x, a: jnp.stack([a * x[0], 0 * x[1]]), [0.5, 0.5], 0.5, 100, window=0.01)
    assert found.value[1] == -np.inf
    assert np.isnan(found.gradient[1])
    assert_allclose(found.gradient[0], 2.0, rtol=1e-5)
    assert any("−∞" in reason for reason in found.reasons)


@pytest.mark.slow
def test_runs_that_fail_are_left_out_and_counted():
    """x' = a + x² ends in a finite time for a > 0."""
    runaway = lh.Flow(lambda t, x, a: a + x**2)
    found = lh.lyapunov_gradient(
        runaway, [-0.5], -1e-3, t1=60.0, algorithm="regression", key=KEY, window=np.array([0.01])
    )
    assert not found.trust
    assert "runs failed" in found.reasons[0]


@pytest.mark.slow
def test_smooth_dependence_may_ask_for_a_smaller_window():
    """A cubic ends long before the noise of regular motion, of which there is none."""
    found = gradient(lambda n, x, a: x * a, [0.5], 0.5, 100)
    assert not found.trust
    assert any("take a smaller one" in reason for reason in found.reasons)


def test_good_cases_are_seldom_refused():
    random, at = np.random.default_rng(0), regression._points(KEY, 24, 1)
    refused, scores = 0, []
    for _ in range(2000):
        exponents = 1 + 0.1 * at + 1e-3 * random.standard_normal((24, 4))
        found = regression._judged("λ1", exponents, at, 3)
        refused += not found.good
        scores.append((found.slope[0] - 0.1) / found.errors[0])
    assert refused < 25  # 0.4 % of 2000 are 8
    assert_allclose(np.std(scores), 1.0, atol=0.2)


@pytest.mark.slow
def test_minus_infinity_in_a_part_of_the_window():
    found = gradient(lambda n, x, a: jnp.stack([0.5 * x[0], jnp.where(a > 0.5, 0.3, 0.0) * x[1]]), [0.5, 0.5], 0.5, 100)
    assert not found.trust
    assert np.isnan(found.value[1])
    assert any("48 of 96" in reason for reason in found.reasons)


@pytest.mark.slow
def test_too_few_points_are_left():
    runaway = lh.Flow(lambda t, x, a: a + x**2)
    found = lh.lyapunov_gradient(
        runaway, [-0.5], -1e-3, t1=60.0, algorithm="regression", key=KEY, window=np.array([0.01]), points=8
    )
    assert not found.trust
    assert np.isnan(found.gradient[0])
    assert any("too few points" in reason for reason in found.reasons)


@pytest.mark.slow
def test_lanes_that_were_not_computed_count_as_failed(monkeypatch):
    """After Ctrl-C they hold zeros, which is also the code of a run that went well."""
    whole = regression.map_lanes

    def interrupted(*args, **keywords):
        results, done = whole(*args, **keywords)
        done[-30:] = False
        for leaf in results:
            leaf[-30:] = 0
        return results, done

    monkeypatch.setattr(regression, "map_lanes", interrupted)
    found = gradient(lambda n, x, a: x * a, [0.5], 0.5, 100, window=0.01, degree=5)
    assert not found.trust
    assert_allclose(found.gradient, 2.0, rtol=1e-6)
    assert "30 of 96 runs failed" in found.reasons


@pytest.mark.slow
def test_threads_change_nothing():
    case = estimates.case_of(lh.Map(baker), jnp.array([0.31234, 0.1]), 0.3, 2, {"t1": 500})
    one, two = (regression.by_regression(case, key=KEY, threads=threads) for threads in (1, 2))
    assert np.array_equal(one.gradient, two.gradient)


def test_designs_are_symmetric():
    for p in (1, 3):
        at = regression._points(KEY, 24, p)
        assert at.shape == (24, p)
        assert_allclose(at[:12], -at[12:], atol=1e-15)
        assert np.min(np.abs(np.diff(np.sort(at[:, 0])))) > 0
        assert np.max(np.abs(at)) <= 1


@pytest.mark.parametrize(
    ("keywords", "says"),
    [
        ({"replicates": 1}, "replicates"),
        ({"window": 0.0}, "window must be positive"),
        ({"window": np.ones(3)}, "one for each parameter, shape"),
        ({"args": 0.0}, "has no width where args = 0"),
        ({"points": 3}, "points"),
        ({"degree": 0}, "degree"),
        ({"key": None}, "key=jax.random.key"),
        ({"over": ["mu"]}, "over must name some of args"),
        ({"over": ["args[0]"]}, r"args\[0\] is one entry: name args, all of it"),
    ],
)
def test_bad_input(keywords, says):
    given = {"args": 0.5, "key": KEY} | keywords
    with pytest.raises(ValueError, match=says):
        lh.lyapunov_gradient(lh.Map(lambda n, x, a: a * x), [0.5], t1=100, algorithm="regression", **given)


def test_names_of_parameters():
    _, args_of, names = estimates.parameters_of({"a": 1.0, "b": np.ones(2), "n": 3}, None)
    assert names == ("a", "b[0]", "b[1]")
    assert args_of(np.array([5.0, 6.0, 7.0]))["n"] == 3


def test_doubtful_runs_are_not_trusted():
    """Steps of RK4 that are too long have another exponent than Lorenz's system, as smooth a function of ρ."""
    lorenz, method = lh.zoo.lorenz63(), lh.RungeKutta("rk4", dt=0.08)
    found = lh.lyapunov_gradient(
        lorenz.system, lorenz.x0, lorenz.args, t1=100.0, transient=10.0, method=method, over=["rho"], k=1,
        algorithm="regression", key=KEY,
    )  # fmt: skip
    assert not found.trust
    assert found.reasons[0] == "96 of 96 runs have the note step_too_long, unresolved or beyond_guard"


def test_no_derivative_along_a_doubtful_run():
    """The exponents are −c/2; those of the steps had the derivative −0.56, and were trusted."""
    damped = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0] - args * x[1]]))
    method = lh.RungeKutta("rk4", dt=2.0)
    with pytest.raises(lh.NoDerivativeError, match="step_too_long"):
        lh.lyapunov_gradient(damped, [1.0, 0.0], 0.1, t1=20_000.0, algorithm="birkhoff", method=method)


RELAXING = lh.Hybrid(
    {
        "up": lambda t, x, args: jnp.stack([1 - x[0] + args["c"] * x[1], -x[1] / 50]),
        "down": lambda t, x, args: jnp.stack([-x[0] / 0.3, (1 - x[1]) / 50]),
    },
    [
        lh.Transition(lambda t, x, args: 0.7 - x[0], source="up", target="down"),
        lh.Transition(lambda t, x, args: x[0] - 0.2, source="down", target="up"),
    ],
)


@pytest.mark.slow_cases("on the guard")
@pytest.mark.parametrize(
    ("x0", "said"),
    [([0.7, 0.2755], "note step_too_long, unresolved or beyond_guard"), ([0.5, 0.27], "λ1: a zero exponent")],
    ids=["on the guard", "beside it"],
)
def test_a_cycle_is_not_trusted(x0, said):
    """From a start on a guard half of the starts around it are beyond it; what a finite run leaves of 0 is smooth."""
    found = lh.lyapunov_gradient(
        RELAXING, x0, {"c": 0.01}, mode="up", over="c", t1=405.0, algorithm="regression", key=KEY
    )
    assert not found.trust
    assert any(said in reason for reason in found.reasons)
