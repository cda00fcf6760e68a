"""Parameters at which exponents are what is wanted, against exact values and independent runs."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

import lyaphybrid as lh

LOGISTIC = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
DIAGONAL = lh.Map(lambda n, x, args: jnp.stack([args["a"] * args["b"], args["b"]]) * x)
ACCUMULATION = 3.5699456718709449  # of the doublings of the logistic map


def logistic(target=-0.5, r=2.8, **keywords):
    return lh.design(LOGISTIC, [0.3], {"r": r}, target, **{"t1": 1000, "over": "r"} | keywords)


@pytest.mark.slow_cases("None")
@pytest.mark.parametrize("bounds", [None, {"r": (2.5, 2.99)}, {"r": (2.5, None)}, {"r": (None, 2.99)}])
def test_one_exponent_by_one_parameter(bounds):
    """λ = ln|2 − r|."""
    found = logistic(over=bounds or "r")
    assert (found.converged, found.trust) == (True, True), found
    assert_allclose(found.parameters["r"], 2 + np.exp(-0.5), rtol=1e-12)
    assert_allclose(found.exponents, [-0.5], rtol=1e-11)
    assert found.args["r"] == found.parameters["r"]
    assert_allclose(found.history[0], [2.8, np.log(0.8)], rtol=1e-12)


UNSTABLE = {"algorithm": "implicit", "period": 1, "transient": 0}


def from_unstable(target, **keywords):
    """From the fixed point at r = 3.3, which motions leave: λ = ln|2 − r|."""
    return lh.design(LOGISTIC, [0.69], {"r": 3.3}, target, t1=1000, over="r", **UNSTABLE, **keywords)


def test_an_unstable_orbit_is_made_stable():
    """Motions near it were no use; the orbit of the given period is followed where that is asked for by name."""
    found = from_unstable(-0.5)
    assert (found.converged, found.trust) == (True, True), found
    assert_allclose(found.history[0], [3.3, np.log(1.3)], rtol=1e-12)
    assert_allclose(found.parameters["r"], 2 + np.exp(-0.5), rtol=1e-10)


def test_an_unstable_orbit_that_stays_so_is_not_trusted():
    """The exponents are those of the orbit, not of motions near it."""
    found = from_unstable(np.log(1.5))
    assert (found.converged, found.trust) == (True, False), found
    assert_allclose(found.parameters["r"], 3.5, rtol=1e-10)
    assert any("not stable" in reason for reason in found.reasons)
    slope = lh.lyapunov_gradient(LOGISTIC, [0.69], {"r": 3.3}, t1=1000, **UNSTABLE)
    assert (slope.of_unstable_orbit, slope.trust) == (True, False)
    assert_allclose(slope.gradient["r"], [1 / 1.3], rtol=1e-10)
    with pytest.raises(ValueError, match=r"the orbit is not stable.* give algorithm='implicit'.*regression needs key="):
        lh.lyapunov_gradient(LOGISTIC, [0.74], {"r": 3.9}, t1=1000, period=1, transient=0)


@pytest.mark.slow
def test_an_objective_along_an_unstable_orbit():
    found = from_unstable(lambda exponents, args: (exponents[0] + 0.5) ** 2, steps=200)
    assert found.trust
    assert_allclose(found.parameters["r"], 2 + np.exp(-0.5), rtol=1e-3)


def test_two_exponents_by_two_parameters():
    found = lh.design(DIAGONAL, [0.1, 0.1], {"a": 0.8, "b": 0.5}, [-1.0, -2.0], t1=100, over=("a", "b"))
    assert found.converged, found
    values = sorted(np.log([found.parameters["a"] * found.parameters["b"], found.parameters["b"]]))
    assert_allclose(values, [-2, -1], rtol=1e-11)


def test_one_exponent_by_two_parameters_takes_the_shortest_way():
    """λ₁ = ln b does not depend on a here: a stays."""
    found = lh.design(DIAGONAL, [0.1, 0.1], {"a": 0.8, "b": 0.5}, -1.0, t1=100, over=("a", "b"))
    assert_allclose([found.parameters["a"], found.parameters["b"]], [0.8, np.exp(-1)], rtol=1e-11)


def test_a_target_that_is_not_reached():
    """λ = ln|4 − r| of the cycle at r > 3 has its largest value, 0, at its ends."""
    found = logistic(0.5, r=2.8, over={"r": (2.1, 2.95)}, steps=8)
    assert not found.converged
    assert found.exponents[0] < 0.5


@pytest.mark.slow
def test_an_objective():
    """Of (λ + 1/2)² + (r − 2.7)², with λ = ln(r − 2): by the gradient that optax is handed."""

    def objective(exponents, args):
        return (exponents[0] + 0.5) ** 2 + (args["r"] - 2.7) ** 2

    found = logistic(objective, optimiser=optax.sgd(0.2), steps=60)
    r = scipy.optimize.brentq(lambda r: (np.log(r - 2) + 0.5) / (r - 2) + r - 2.7, 2.5, 2.9, xtol=1e-14)
    assert_allclose(found.parameters["r"], r, rtol=1e-8)
    assert found.converged
    assert str(found).startswith("Design: all steps made in 60 points")  # the objective might fall further


@pytest.mark.slow
def test_the_edge_of_chaos_by_bisection():
    found = logistic(0.0, r=3.57, t1=200_000, over={"r": (3.55, 3.58)}, optimiser="bisection", steps=20)
    assert found.converged, found
    assert_allclose(found.parameters["r"], ACCUMULATION, atol=2e-5)
    assert_allclose(found.exponents, [0], atol=2e-3)


def test_bisection_over_replicates():
    """Of the tent map with its fold at p: λ = −p ln p − (1 − p) ln(1 − p)."""
    tent = lh.Map(lambda n, x, p: jnp.where(x < p, x / p, (1 - x) / (1 - p)))
    found = lh.design(tent, [0.3123], 0.4, 0.6, t1=4000, over={"args": (0.1, 0.5)}, optimiser="bisection",
                      key=jax.random.key(0), replicates=8)  # fmt: skip
    assert found.converged, found
    exact = scipy.optimize.brentq(lambda p: -p * np.log(p) - (1 - p) * np.log(1 - p) - 0.6, 0.1, 0.5)
    slope = np.log((1 - exact) / exact)
    assert_allclose(found.parameters["args"], exact, atol=5 * found.stderr[0] / slope)


def test_bounds_on_one_side_are_no_bracket():
    found = logistic(0.0, r=2.8, over={"r": (2.6, 2.9)}, optimiser="bisection")
    assert (found.converged, found.trust) == (False, False)
    assert "one side" in found.reasons[0]


@pytest.mark.slow
def test_chaos_that_has_no_derivative_ends_the_search():
    found = logistic(0.3, r=3.9, key=jax.random.key(0), t1=20_000)
    assert not found.converged
    assert "not to be trusted" in found.reasons[0]


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"target": np.nan}, "target"),
        ({"over": "s"}, "over must name"),
        ({"over": {"r": (3.0, 4.0)}}, "between the bounds"),
        ({"over": {"q": (3.0, 4.0)}}, "over must name"),
        ({"over": {"r": (3.0,)}}, "pairs"),
        ({"optimiser": "newton"}, "bisection"),
        ({"optimiser": 3}, "optax"),
        ({"optimiser": "bisection"}, "both bounds"),
        ({"optimiser": "bisection", "target": lambda e, a: e[0]}, "one number"),
        ({"k": 2}, "k is for a target that is a function"),
        ({"t1": -1}, "t1"),
    ],
)
def test_bad_input(keywords, message):
    with pytest.raises(ValueError, match=message):
        logistic(**keywords)


@pytest.mark.slow
def test_damping_of_an_impact_oscillator():
    """A complex pair has λ = −ζ + ln r/T."""
    problem = lh.zoo.impact_oscillator(omega=2.3, zeta=0.02, restitution=0.8, gap=0.0)
    found = lh.design(
        problem.system, problem.x0, problem.args, -0.05, t1=1000.0, transient=300.0,
        over={"restitution": (0.0, 1.0)}, period=lambda args: 2 * jnp.pi / args["omega"],
    )  # fmt: skip
    assert found.converged, found
    assert_allclose(found.parameters["restitution"], np.exp(2 * np.pi / 2.3 * (-0.05 + 0.02)), rtol=1e-10)


@pytest.mark.slow
def test_lorenz_at_one():
    """By regression over ensembles; another ensemble at the end agrees."""
    problem = lh.zoo.lorenz63()
    found = lh.design(
        problem.system, problem.x0, problem.args, 1.0, t1=2000.0, over={"rho": (26.0, 45.0)},
        algorithm="regression", key=jax.random.key(3), window=0.05,
    )  # fmt: skip
    assert found.converged, found
    again = lh.lyapunov_spectrum(
        problem.system, problem.x0, found.args, t1=4000.0, transient=100.0, replicates=8, key=jax.random.key(77), k=1
    )
    spread = np.hypot(found.stderr[0], float(again.stderr[0]))
    assert abs(float(again.exponents[0]) - found.exponents[0]) <= 3 * spread
    assert abs(float(again.exponents[0]) - 1.0) <= 3 * np.hypot(found.stderr[0], float(again.stderr[0]))


@pytest.mark.slow
def test_an_objective_need_not_use_an_exponent_that_is_minus_infinity():
    """The stopwatch of a sampled oscillator forgets its past at each tick; the objective asks for the motion's λ₁.

    λ² + 0.2 λ + k has the root −0.05 at k = 0.0075.
    """

    def field(t, x, args):
        return jnp.stack([x[1], -args["k"] * x[0] - 0.2 * x[1], 1.0 + 0 * x[2]])

    tick = lh.Transition(every=1.0, reset=lambda t, x, args: x.at[2].set(0.0))
    found = lh.design(
        lh.Hybrid(field, tick), [0.1, 0.0, 0.0], {"k": 0.005}, lambda exponents, args: 1e3 * (exponents[0] + 0.05) ** 2,
        over={"k": (1e-4, 0.009)}, period=1.0, t1=50.0, steps=60,
    )  # fmt: skip
    assert not any("failed" in reason for reason in found.reasons)
    assert found.parameters["k"] == pytest.approx(0.0075, rel=0.02)


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_steps_to_an_objective_do_not_hang_on_the_unit(unit):
    """Least (λ + 2)² of λ = −r/unit, from 1.2, in three units of r."""
    sink = lh.Flow(lambda t, x, args: -args["r"] / unit * x)
    how = {"t1": 8.0, "over": "r", "steps": 100, "algorithm": "equilibrium"}
    found = lh.design(sink, [0.0], {"r": 1.2 * unit}, lambda exponents, args: (exponents[0] + 2) ** 2, **how)
    assert_allclose(found.parameters["r"] / unit, 2.0, rtol=2e-3)


def test_more_targets_than_parameters_are_met_by_least_squares():
    """Exponents −r and −2 r cannot both be −1: nearest at r = 3/5."""
    sink = lh.Flow(lambda t, x, args: jnp.stack([-args["r"], -2 * args["r"]]) * x)
    found = lh.design(sink, [0.0, 0.0], {"r": 1.0}, [-1.0, -1.0], t1=2.0, over="r", algorithm="equilibrium")
    assert_allclose(found.parameters["r"], 0.6, rtol=1e-6)
    assert "2 targets, 1 parameters: the least squares" in str(found)
