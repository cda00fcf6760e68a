"""Derivatives of exponents of periodic orbits against exact values, and what is refused."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from known_gradients import OF_IMPACTS, complex_pair, estimated, logistic, sheared_hopf
from lyaphybrid.analysis.sensitivity import gradient, implicit
from lyaphybrid.analysis.sensitivity.estimates import UntrustedError


def forcing_period(args):
    return 2 * jnp.pi / args["omega"]


def impact_gradient(omega, **keywords):
    problem = lh.zoo.impact_oscillator(omega=omega, zeta=0.02, restitution=0.8, gap=0.0)
    keywords = {"t1": 1000.0, "transient": 300.0, "algorithm": "implicit", "period": forcing_period} | keywords
    return lh.lyapunov_gradient(problem.system, problem.x0, problem.args, **keywords)


@pytest.fixture(scope="module")
def impacts():
    return {omega: impact_gradient(omega) for omega in (2.3, 2.65)}


@pytest.mark.slow
@pytest.mark.parametrize("omega", [2.3, 2.65])
def test_sums_over_an_orbit_with_impacts(impacts, omega):
    """λ₁ + λ₂ = −2ζ + 2 ln r/T."""
    found = impacts[omega]
    turn = 2 * np.pi / omega
    exact = {"restitution": 2 / (0.8 * turn), "zeta": -2, "omega": np.log(0.8) / np.pi, "amplitude": 0, "gap": 0}
    for name, value in exact.items():
        assert_allclose(np.sum(found.gradient[name]), value, rtol=1e-10, atol=1e-10)
    assert_allclose(np.sum(found.value), -0.04 + 2 * np.log(0.8) / turn, rtol=1e-12)
    assert found.trust, found.reasons


@pytest.mark.slow
def test_exponents_per_jump():
    """One impact a period: λ₁ + λ₂ = −2ζT + 2 ln r per jump."""
    found, turn = impact_gradient(2.65, clock="jumps"), 2 * np.pi / 2.65
    exact = {"restitution": 2 / 0.8, "zeta": -2 * turn, "omega": 0.04 * turn / 2.65}
    for name, value in exact.items():
        assert_allclose(np.sum(found.gradient[name]), value, rtol=1e-9)
    assert_allclose(np.sum(found.value), -0.04 * turn + 2 * np.log(0.8), rtol=1e-12)


@pytest.mark.slow
def test_an_orbit_counts_time_or_jumps():
    with pytest.raises(ValueError, match="per unit of time or per jump; got clock='hybrid'"):
        impact_gradient(2.65, clock="hybrid")
    with pytest.raises(ValueError, match="never end: an lh.Flow has no jumps"):
        lh.lyapunov_gradient(lh.Flow(lambda t, x, a: -a * x), [1.0], 1.0, t1=10, clock="jumps")
    with pytest.raises(ValueError, match="clock must be one of"):
        impact_gradient(2.65, clock="steps")


@pytest.mark.slow
def test_a_complex_pair_has_the_derivative_of_its_mean(impacts):
    found = impacts[2.3]
    assert_allclose(found.value, -0.1016831182, atol=5e-11)
    for slopes in found.gradient.values():
        assert_allclose(slopes[0], slopes[1], rtol=1e-12)
    assert any("mean" in reason for reason in found.reasons)


@pytest.mark.slow
def test_real_multipliers_with_impacts(impacts):
    """Against an independent program."""
    found = impacts[2.65]
    assert_allclose(found.value, [-0.0799054366, -0.1483208792], atol=5e-11)
    for name, value in OF_IMPACTS.items():
        assert_allclose(found.gradient[name][0], value, rtol=1e-7)  # the digits of the reference
        assert found.stderr[name][0] < 1e-9


def test_a_fixed_point_at_the_origin():
    found = lh.lyapunov_gradient(lh.Map(complex_pair), [0.1, 0.2, 0.3], 0.2, t1=1000, transient=100)
    assert found.method == "implicit"
    assert found.trust, found.reasons
    assert_allclose(found.value, [-0.16536051565782628, -0.16536051565782628, -1.0788096613719298], rtol=1e-12)
    assert_allclose(found.gradient, [-0.3, -0.3, 0.5882352941176471], rtol=1e-11)


@pytest.mark.slow
def test_a_cycle_whose_period_depends_on_the_parameter():
    found = lh.lyapunov_gradient(lh.Flow(sheared_hopf), [0.9, 0.0], 0.8, t1=500.0, transient=50.0)
    assert found.trust, found.reasons
    assert_allclose(found.value, [0, -1.6], atol=1e-10)
    assert_allclose(found.gradient, [0, -2], atol=1e-10)
    assert any("zero exponent" in reason for reason in found.reasons)


@pytest.mark.slow
def test_faster_time():
    """F → c f multiplies all exponents by c, jumps or not."""
    found = estimated("faster impact oscillator", "implicit")
    assert found.trust, found.reasons
    assert_allclose(found.gradient, found.value, rtol=1e-9)
    assert_allclose(found.value, [-0.0799054366, -0.1483208792], atol=5e-11)


@pytest.mark.parametrize(("r", "exact", "slope"), [(2.9, np.log(0.9), 1 / 0.9), (3.3, None, None)])
def test_cycles_of_the_logistic_map(r, exact, slope):
    """|2 − r| at the fixed point; 4 + 2r − r² over two iterations."""
    found = lh.lyapunov_gradient(lh.Map(logistic), [0.3], r, t1=1000)
    exact, slope = (exact, slope) if exact else (0.5 * np.log(abs(4 + 2 * r - r**2)), (1 - r) / (4 + 2 * r - r**2))
    assert found.trust, found.reasons
    assert_allclose(found.value, exact, rtol=1e-11)
    assert_allclose(found.gradient, slope, rtol=1e-10)


def test_parameters_in_a_tree_keep_their_places():
    def rule(n, x, args):
        return args["rates"] * x + args["shift"]

    args = {"rates": np.array([0.5, 0.25]), "shift": 0.1, "count": 3}
    found = lh.lyapunov_gradient(lh.Map(rule), [1.0, 1.0], args, t1=100)
    assert_allclose(found.gradient["rates"], [[2, 0], [0, 4]], atol=1e-12)
    assert_allclose(found.gradient["shift"], 0, atol=1e-12)
    assert found.gradient["count"] is None
    assert found.names == ("rates[0]", "rates[1]", "shift")
    assert "d/d rates[1]" in str(found)


def test_what_is_destroyed_has_no_derivative():
    found = lh.lyapunov_gradient(lh.Map(lambda n, x, a: a * jnp.stack([x[0], 0 * x[0]])), [1.0, 0.3], 0.5, t1=100)
    assert found.value[1] == -np.inf
    assert np.isnan(found.gradient[1])
    assert_allclose(found.gradient[0], 2)
    assert any("−∞" in reason for reason in found.reasons)


def test_an_unstable_orbit_is_not_trusted():
    """The fixed point of the logistic map in chaos: Newton finds it, the motion leaves it."""
    found = lh.lyapunov_gradient(lh.Map(logistic), [0.75001], 4.0, t1=100, transient=0, period=1, algorithm="implicit")
    assert_allclose(found.value, np.log(2))
    assert not found.trust
    assert any("not stable" in reason for reason in found.reasons)


def test_nearly_equal_multipliers_are_one_group():
    assert implicit._groups(np.array([0.5, 0.5 + 1e-9, 0.2j, -0.2j, -0.5])) == [[0, 1], [2, 3], [4]]


def nearly_triple(n, x, a):
    """The largest multiplier is 0.5 + a^⅓, with a derivative of ∞ at a = 0."""
    turned = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0] @ np.diag([1.0, 2.0, 4.0])
    block = jnp.array([[0.5, 1, 0], [0, 0.5, 1], [0, 0, 0.5]]).at[2, 0].set(a)
    return turned @ (block @ (np.linalg.inv(turned) @ x))


def test_multipliers_that_rounding_has_moved_apart_are_not_trusted():
    """The three at a = 0 are one, and come out 1e-5 apart."""
    found = lh.lyapunov_gradient(lh.Map(nearly_triple), [0.3, 0.2, 0.1], 0.0, t1=100, algorithm="implicit")
    assert not found.trust, found
    assert any("cannot be told from another" in reason for reason in found.reasons)


def test_the_error_of_nearly_equal_multipliers_includes_rounding():
    found = lh.lyapunov_gradient(lh.Map(nearly_triple), [0.3, 0.2, 0.1], 1e-6, t1=100, algorithm="implicit")
    assert found.trust, found.reasons
    exact = 1e4 / 3 / 0.51
    assert abs(found.gradient[0] - exact) <= found.stderr[0] < 1e-6 * exact


def test_multipliers_that_cannot_be_told_apart_have_no_derivative():
    """Two multipliers, and left and right eigenvectors that are orthogonal: there is no dual."""
    defective = np.array([[0.5, 1.0], [0.0, 0.5]])
    found = implicit.Derivatives(defective, np.eye(2)[None], np.zeros(1), 1.0)
    orbit = SimpleNamespace(multipliers=np.array([0.5, 0.5 + 1e-5]), exponents=np.log([0.5, 0.5]), period=1.0)
    with pytest.raises(UntrustedError, match="cannot be told from another"):
        implicit.of_exponents(found, orbit, 2)


@pytest.mark.parametrize("error", [np.linalg.LinAlgError, ValueError])
def test_an_error_within_a_method_is_not_taken_for_one_that_does_not_apply(monkeypatch, error):
    def broken(*args, **keywords):
        raise error("a defect")

    monkeypatch.setattr(gradient, "by_implicit", broken)
    with pytest.raises(error, match="a defect"):
        lh.lyapunov_gradient(lh.Map(logistic), [0.3], 2.9, t1=100)


def test_chaos_is_no_periodic_orbit():
    henon = lh.zoo.henon_map()
    with pytest.raises(lh.NoDerivativeError, match="does not come back"):
        lh.lyapunov_gradient(henon.system, henon.x0, henon.args, t1=100, algorithm="implicit")
    with pytest.raises(ValueError, match="key=jax.random.key"):
        lh.lyapunov_gradient(henon.system, henon.x0, henon.args, t1=100)


@pytest.mark.parametrize(
    ("keywords", "says"),
    [
        ({"algorithm": "shadowing"}, "must be one of"),
        ({"t1": -1.0}, "t1, a length"),
        ({"k": 3}, "at most 1"),
        ({"args": {"n": 3}}, "no floating-point number to differentiate by"),
    ],
)
def test_bad_input(keywords, says):
    given = {"args": 2.9, "t1": 100} | keywords
    with pytest.raises(ValueError, match=says):
        lh.lyapunov_gradient(lh.Map(logistic), [0.3], **given)


def test_it_decides_from_values():
    def under_jit(r):
        return lh.lyapunov_gradient(lh.Map(logistic), jnp.stack([r]), 2.9, t1=100).value

    with pytest.raises(ValueError, match="jit"):
        jax.jit(under_jit)(0.3)


@pytest.mark.slow
def test_trust_does_not_depend_on_units():
    """A driven oscillator whose velocity is counted in small units."""

    def gradient_in(unit):
        def field(t, x, args):
            v = unit * x[1]
            return jnp.stack([v, (jnp.cos(t) - args["damping"] * v - x[0] - 0.1 * x[0] ** 3) / unit])

        return lh.lyapunov_gradient(
            lh.Flow(field), [0.5, 0.5 / unit], {"damping": 0.3}, t1=50.0, transient=200.0, period=2 * np.pi,
            algorithm="implicit", over=["damping"], k=2,
        )  # fmt: skip

    here, there = gradient_in(1.0), gradient_in(1e-5)
    assert here.trust
    assert there.trust, there.reasons
    np.testing.assert_allclose(there.gradient["damping"], here.gradient["damping"], rtol=1e-5)
    np.testing.assert_allclose(np.sum(here.gradient["damping"]), -1.0, rtol=1e-6)  # λ₁ + λ₂ is minus the damping


@pytest.mark.slow
def test_a_period_that_moves_with_a_parameter_is_no_number():
    """x' = 1 − c x, kicked each T: a number as the period says nothing of dT."""
    clock = lh.Transition(every=lambda args: args["T"], reset=lambda t, x, args: args["m"] * x + 0.3)
    kicked, args = lh.Hybrid(lambda t, x, args: 1 - args["c"] * x, clock), {"c": 0.4, "m": -0.7, "T": 1.5}
    with pytest.raises(ValueError, match=r"it changes with the parameters .*\(T, c, m\): give a function"):
        lh.lyapunov_gradient(kicked, [0.1], args, t1=50.0, period=1.5)
    assert lh.lyapunov_gradient(kicked, [0.1], args, t1=50.0, period=1.5, over=["c", "m"]).trust
    found = lh.lyapunov_gradient(kicked, [0.1], args, t1=50.0, period=lambda args: args["T"])
    assert found.gradient["T"][0] == pytest.approx(-np.log(0.7) / 1.5**2, rel=1e-6)
