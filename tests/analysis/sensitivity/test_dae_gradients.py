"""Derivatives of exponents of constrained systems off equilibria, where they are known exactly."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from known_gradients import of_spring_damper
from lyaphybrid.analysis.sensitivity import implicit
from lyaphybrid.systems.bound import Bound
from lyaphybrid.systems.consistency import check_constraints
from lyaphybrid.systems.daes.points import landed


def _residual(t, x, args):
    return jnp.stack(
        [
            (-args["a"] + jnp.cos(t)) * x[0] + x[2],
            (-args["c"] + jnp.sin(t)) * x[1] + jnp.cos(t),
            x[2] - x[1] * jnp.sin(t) - jnp.cos(t),
        ]
    )


# The constraint couples the second component to the first one and drives both; triangular, so that exponents are means.
FORCED = lh.DAE(lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])), _residual, 2)
ARGS = {"a": 0.3, "c": 1.1}
METHODS = {
    "birkhoff": {"t1": 200 * np.pi},
    "regression": {"t1": 20 * np.pi, "key": jax.random.key(0)},
}


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_exponents_that_are_means_of_the_diagonal(method):
    """λ = (−a, −c): the derivatives are −1 and 0, off the equilibrium that there is none of."""
    start = lh.consistent_start(FORCED, [0.1, 0.2, 1.0], ARGS)
    found = lh.lyapunov_gradient(FORCED, start, ARGS, transient=6 * np.pi, algorithm=method, **METHODS[method])
    assert found.trust
    assert_allclose(found.value, [-0.3, -1.1], atol=1e-6)
    assert_allclose(found.gradient["a"], [-1.0, 0.0], atol=1e-6)
    assert_allclose(found.gradient["c"], [0.0, -1.0], atol=1e-6)


@pytest.mark.slow
def test_the_orbit_of_a_forced_dae():
    """The same to rounding: M has a multiplier 0 across the constraint, near to e^(−2πc), that is none of the orbit."""
    start = lh.consistent_start(FORCED, [0.1, 0.2, 1.0], ARGS)
    method = lh.HalfExplicit(rtol=1e-12)
    found = lh.lyapunov_gradient(FORCED, start, ARGS, t1=1.0, transient=0.0, period=2 * np.pi, method=method)
    assert (found.method, found.trust) == ("implicit", True), found
    assert_allclose(found.value, [-0.3, -1.1], atol=1e-10)
    assert_allclose(found.gradient["a"], [-1.0, 0.0], atol=1e-8)
    assert_allclose(found.gradient["c"], [0.0, -1.0], atol=1e-8)


@pytest.mark.parametrize("small", [0.5, 1e-6])
def test_multipliers_of_a_singular_monodromy_matrix(small):
    """M = V diag(μ) U with the multipliers 0.9 and `small` of an orbit, and 0 across constraints: d ln μ is known."""
    rng = np.random.default_rng(1)
    right, slopes, turning = rng.normal(size=(4, 4)), np.array([0.3, -2.0]), rng.normal(size=(4, 4))
    inside, inverse = np.diag([0.9, small, 0.0, 0.0]), np.linalg.inv(right)
    growing = np.diag([0.9 * slopes[0], small * slopes[1], 0.0, 0.0])
    matrix = right @ inside @ inverse
    change = right @ growing @ inverse + turning @ matrix - matrix @ turning  # V and U turn too
    found = implicit.Derivatives(matrix, change[None], np.zeros(1), 1.0)
    orbit = SimpleNamespace(multipliers=np.array([0.9, small]), exponents=np.log([0.9, small]), period=1.0)
    of = implicit.of_exponents(found, orbit, 2)
    assert of.groups == []
    assert_allclose(of.gradient[:, 0], slopes, rtol=1e-14 / small + 1e-12)


@pytest.mark.slow
def test_the_rest_of_example_5_1_as_an_orbit():
    """Of any period: derivatives by the orbit's equations are those of the eigenvalues, which are known."""
    problem = lh.zoo.spring_damper_dae()
    found = lh.lyapunov_gradient(problem.system, problem.x0, problem.args, t1=20.0, transient=0.0, period=2.0)
    assert (found.method, found.trust) == ("implicit", True), found
    args = {name: jnp.asarray(value) for name, value in problem.args.items()}
    assert_allclose(found.value, of_spring_damper(args), rtol=1e-10)
    for name, exact in jax.jacfwd(of_spring_damper)(args).items():
        assert_allclose(found.gradient[name], exact, atol=1e-9, err_msg=name)


@pytest.mark.slow
def test_an_autonomous_orbit_on_constraints():
    """Van der Pol's, y = 1 − x² an algebraic component: exponents and derivatives are the ordinary equation's."""

    def flow(t, x, args):
        return jnp.stack([x[1], args["mu"] * (1 - x[0] ** 2) * x[1] - args["w"] * x[0]])

    def residual(t, x, args):
        return jnp.stack([x[1], args["mu"] * x[2] * x[1] - args["w"] * x[0], x[2] - 1 + x[0] ** 2])

    constrained = lh.DAE(lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])), residual, 2)
    args = {"mu": 1.0, "w": 1.3}
    free = lh.lyapunov_gradient(lh.Flow(flow), [2.0, 0.0], args, t1=20.0, algorithm="implicit")
    held = lh.lyapunov_gradient(constrained, [2.0, 0.0, -3.0], args, t1=20.0, algorithm="implicit")
    assert free.trust
    assert held.trust
    assert_allclose(held.value, free.value, atol=1e-11)
    for name in args:
        assert_allclose(held.gradient[name], free.gradient[name], atol=1e-9, err_msg=name)


def test_linear_response_refuses_constraints():
    start = lh.consistent_start(FORCED, [0.1, 0.2, 1.0], ARGS)
    with pytest.raises(ValueError, match="cannot see how jumps or constraints move"):
        lh.lyapunov_gradient(FORCED, start, ARGS, t1=10.0, algorithm="linear_response", key=jax.random.key(0))


# Functions that close over a parameter, in place of args: x' = −a y (1 + x²/10), and y + a y³ = x or y + y³ = x.


def _closing_over(a, moving: bool):
    share = a if moving else 1.0
    return lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
        lambda t, x, args: jnp.stack([-a * x[1] * (1 + 0.1 * x[0] ** 2), x[1] + share * x[1] ** 3 - x[0]]),
        1,
    )


def _point(p):
    """The y with y + a y³ = x, at p = (x, a)."""
    x, a = p
    return landed(_closing_over(a, moving=True).field, None, jnp.zeros(()), jnp.stack([x, 0.4 + 0 * a]))[1]


POINTS = jnp.array([[0.5, 1.3], [0.5, 1.7]])


@pytest.mark.slow
def test_a_point_on_constraints_that_close_over_a_parameter():
    """(1, −y³) / (1 + 3 a y²), by each kind of derivative and of many values at once."""
    y = np.array([float(_point(one)) for one in POINTS])
    exact = np.stack([np.ones(2), -(y**3)], axis=1) / (1 + 3 * POINTS[:, 1] * y**2)[:, None]
    assert_allclose(jax.vmap(jax.jit(_point))(POINTS), y, rtol=1e-14)
    assert_allclose(jax.jit(jax.vmap(jax.grad(_point)))(POINTS), exact, rtol=1e-13)
    assert_allclose([jax.jacfwd(_point)(one) for one in POINTS], exact, rtol=1e-13)


SECOND = {
    "forward over forward": lambda f: jax.jacfwd(jax.jacfwd(f)),
    "forward over reverse": jax.hessian,
    "reverse over forward": lambda f: jax.jacrev(jax.jacfwd(f)),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", SECOND)
def test_second_derivatives_of_a_point_on_curved_constraints(kind):
    """With F = y + a y³ − x and s = 1 + 3 a y²: y'' = −(6 a y y' y' + 3 y² (a' y' + y' a')) / s."""
    second = jax.jit(jax.vmap(SECOND[kind](_point)))(POINTS)
    for (x, a), ours in zip(POINTS, second, strict=True):
        y = float(_point(jnp.stack([x, a])))
        slope, turn = np.array([1.0, -(y**3)]) / (1 + 3 * a * y**2), np.array([0.0, 1.0])
        crossed = np.outer(turn, slope)
        exact = -(6 * a * y * np.outer(slope, slope) + 3 * y**2 * (crossed + crossed.T)) / (1 + 3 * a * y**2)
        assert_allclose(ours, exact, rtol=1e-12, atol=1e-14)


@pytest.mark.slow
def test_a_third_derivative_of_a_point():
    """Of the inverse of x = y + y³, which is (3 x_yy² - x_y x_yyy) / x_y⁵."""
    third = jax.jacfwd(jax.hessian(_point))(jnp.array([0.5, 1.0]))[0, 0, 0]
    y = float(_point(jnp.array([0.5, 1.0])))
    slope = 1 + 3 * y**2
    assert_allclose(third, (3 * (6 * y) ** 2 - slope * 6) / slope**5, rtol=1e-11)


# y' = −a y beside x = y + y³, solved for y by no formula: all is known at all times.

CURVED = lh.DAE(
    lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
    lambda t, x, a: jnp.stack([-a * x[1] * (1 + 3 * x[1] ** 2), x[1] + x[1] ** 3 - x[0]]),
    1,
)
IMPLICIT = {
    "half-explicit": lh.HalfExplicit(1e-11),
    "ESDIRK": lh.ESDIRK("esdirk54b", rtol=1e-11),
    "Radau": lh.RadauIIA(1e-11),
}


def _curved_end(p, duration):
    y = p[0] * jnp.exp(-p[1] * duration)
    return jnp.stack([y + y**3, y])


def _curved_rate(p, duration):
    """The exponent over this time: the tangent is along (1 + 3 y², 1), and δy falls as y does."""
    before, after = (1 + (1 + 3 * y**2) ** 2 for y in (p[0], _curved_end(p, duration)[1]))
    return -p[1] + jnp.log(after / before) / (2 * duration)


@pytest.mark.slow
@pytest.mark.parametrize("name", IMPLICIT)
def test_second_derivatives_of_a_step_on_a_curved_constraint(name):
    h, p = 1e-2, jnp.array([0.6, 0.8])

    def step(p):
        field, x = Bound(CURVED.field, p[1]), _curved_end(p, 0.0)
        return IMPLICIT[name].step(field, jnp.zeros(()), x, field(jnp.zeros(()), x), jnp.asarray(h)).x

    exact = jax.jacfwd(jax.jacfwd(lambda p: _curved_end(p, h)))(p)
    assert_allclose(jax.jit(jax.jacfwd(jax.jacfwd(step)))(p), exact, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", IMPLICIT)
def test_second_derivatives_of_a_run_on_a_curved_constraint(name):
    p, duration = jnp.array([0.6, 0.8]), 0.7

    def found(p):
        run = lh.lyapunov_spectrum(CURVED, _curved_end(p, 0.0), p[1], t1=duration, blocks=2, method=IMPLICIT[name])
        return run.x, run.exponents[0]

    def exact(p):
        return _curved_end(p, duration), _curved_rate(p, duration)

    for derivative in (jax.jacfwd, lambda f: jax.jacfwd(jax.jacfwd(f))):
        for ours, known in zip(jax.jit(derivative(found))(p), derivative(exact)(p), strict=True):
            assert_allclose(ours, known, atol=1e-8)


@pytest.mark.slow
def test_second_derivatives_of_a_pendulum_in_cartesian_coordinates():
    """Those of θ'' = −g sin θ, for which no constraint need be solved."""

    def rod(t, z, g):
        """The rod's force on a unit mass, F, keeps x² + y² = 1: v² − g y = F (x² + y²)."""
        x, y, u, v, force = z
        return jnp.stack([u, v, -force * x, -force * y - g, u**2 + v**2 - g * y - force * (x**2 + y**2)])

    cartesian = lh.DAE(lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 1.0, 1.0, 0.0])), rod, 4)
    polar = lh.Flow(lambda t, z, g: jnp.stack([z[1], -g * jnp.sin(z[0])]))

    def in_cartesian(p):
        angle, g = p
        start = jnp.stack([jnp.sin(angle), -jnp.cos(angle), 0 * g, 0 * g, g * jnp.cos(angle)])
        return lh.trajectory(cartesian, start, g, t1=2.0, n=2, method=lh.HalfExplicit(1e-11)).x[-1]

    def in_polar(p):
        start = jnp.stack([p[0], 0 * p[0]])
        angle, rate = lh.trajectory(polar, start, p[1], t1=2.0, n=2, method=lh.RungeKutta(rtol=1e-12)).x[-1]
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        return jnp.stack([sine, -cosine, rate * cosine, rate * sine, rate**2 + p[1] * cosine])

    p = jnp.array([1.2, 1.7])
    ours, exact = (jax.jit(jax.jacfwd(jax.jacfwd(f)))(p) for f in (in_cartesian, in_polar))
    assert_allclose(ours, exact, atol=1e-8)


def test_constraints_that_close_over_a_parameter_are_not_asked_for_values():
    """Outside of jit, under a derivative: the start is known, and the functions are not."""
    x = jnp.array([0.4 + 0.4**3, 0.4])

    def asked(a):
        check_constraints(_closing_over(a, moving=False), x, jnp.zeros(()), None)
        return a

    assert jax.jvp(asked, (1.3,), (1.0,)) == (1.3, 1.0)
    assert_allclose(jax.vmap(asked)(jnp.array([1.3, 1.7])), [1.3, 1.7])


@pytest.mark.slow
@pytest.mark.parametrize("moving", [True, False])
def test_a_run_of_constraints_that_close_over_a_parameter(moving):
    """Its exponent and derivative outside of jit, against central differences."""

    def rate(a):
        start = jnp.stack([0.4 + (a if moving else 1.0) * 0.4**3, jnp.asarray(0.4)])
        dae, method = _closing_over(a, moving), lh.HalfExplicit(1e-10)
        return lh.lyapunov_spectrum(dae, start, t1=1.0, blocks=2, method=method).exponents[0]

    behind, here, ahead = jax.vmap(rate)(jnp.array([1.299, 1.3, 1.301]))
    value, slope = jax.jvp(rate, (1.3,), (1.0,))
    assert_allclose(value, here, rtol=1e-12)
    assert_allclose(slope, (ahead - behind) / 2e-3, rtol=1e-5)
