"""Derivatives of exponents at equilibria, against exact values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from known_gradients import of_spring_damper

DUFFING = lh.Flow(lambda t, x, k: jnp.stack([x[1], -3 * x[1] - k * x[0] - x[0] ** 3]))
LORENZ = lh.zoo.lorenz63()
PLANE = np.array([[1.0, 0.4, 0.2], [0.3, 1.2, -0.5], [0.1, 0.2, 0.9]])


def of_spring(k, **keywords):
    return lh.lyapunov_gradient(DUFFING, [0.4, 0.1], k, **({"t1": 200.0} | keywords))


def of_dae(system, x0, args, **keywords):
    return lh.lyapunov_gradient(system, lh.consistent_start(system, x0, args), args, **({"t1": 200.0} | keywords))


def test_two_real_eigenvalues():
    """λ = (−3 ± √(9 − 4k))/2, dλ/dk = ∓1/√(9 − 4k)."""
    found = of_spring(0.5)
    assert (found.method, found.trust) == ("equilibrium", True), found
    assert_allclose(found.value, (-3 + np.sqrt(7) * np.array([1, -1])) / 2, rtol=1e-13)
    assert_allclose(found.gradient, np.array([-1, 1]) / np.sqrt(7), rtol=1e-13)
    assert_allclose(found.gradient[0], -0.37796447, rtol=1e-8)
    assert np.all(found.stderr < 1e-12)


def test_a_complex_pair_has_the_derivative_of_its_real_part():
    found = of_spring(4.0)
    assert_allclose(found.value, [-1.5, -1.5], rtol=1e-13)
    assert_allclose(found.gradient, [0, 0], atol=1e-13)
    assert any("λ1, λ2: a complex pair" in reason for reason in found.reasons)


def test_a_double_eigenvalue_has_the_derivative_of_its_mean():
    """At k = 9/4 each has an infinite one."""
    found = of_spring(2.25)
    assert_allclose(np.mean(found.value), -1.5, rtol=1e-13)
    assert_allclose(found.gradient, [0, 0], atol=1e-7)


def test_a_real_eigenvalue_beside_a_pair_with_the_same_real_part():
    """-a, -a and -b with a = b = 1: the mean is -(2a + b)/3."""

    def field(t, x, args):
        y = jnp.linalg.solve(PLANE, x)
        turned = [-args["a"] * y[0] - 2 * y[1], 2 * y[0] - args["a"] * y[1], -args["b"] * y[2]]
        return PLANE @ jnp.stack(turned)

    found = lh.lyapunov_gradient(lh.Flow(field), [0.1, 0.2, 0.3], {"a": 1.0, "b": 1.0}, t1=100.0)
    assert_allclose(found.value, -1, rtol=1e-12)
    assert_allclose(found.gradient["a"], -2 / 3, rtol=1e-12)
    assert_allclose(found.gradient["b"], -1 / 3, rtol=1e-12)


def test_an_equilibrium_that_moves_with_the_parameters():
    """Lorenz at ρ = 10, against differences of the eigenvalues at the exact equilibrium."""

    def exact(args):
        side = np.sqrt(args["beta"] * (args["rho"] - 1))
        rows = [[-args["sigma"], args["sigma"], 0], [1, -1, -side], [side, side, -args["beta"]]]
        return np.sort(np.linalg.eigvals(rows).real)[::-1]

    args = {"sigma": 10.0, "rho": 10.0, "beta": 8 / 3}
    found = lh.lyapunov_gradient(LORENZ.system, LORENZ.x0, args, t1=200.0)
    assert (found.method, found.trust) == ("equilibrium", True), found
    assert_allclose(found.value, exact(args), rtol=1e-12)
    for name, step in {"sigma": 1e-4, "rho": 1e-4, "beta": 1e-4}.items():
        ahead, behind = (exact(args | {name: args[name] + sign * step}) for sign in (1, -1))
        assert_allclose(found.gradient[name], (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_a_dae_at_rest():
    """Example 5.1 of Linh et al."""
    problem = lh.zoo.spring_damper_dae()
    found = lh.lyapunov_gradient(problem.system, problem.x0, problem.args, t1=100.0)
    assert (found.method, found.trust) == ("equilibrium", True), found
    args = {name: jnp.asarray(value) for name, value in problem.args.items()}
    assert_allclose(found.value, of_spring_damper(args), rtol=1e-12)
    for name, exact in jax.jacfwd(of_spring_damper)(args).items():
        assert_allclose(found.gradient[name], exact, rtol=1e-11, atol=1e-12, err_msg=name)
        assert np.all(found.stderr[name] < 1e-11)


@pytest.mark.slow
def test_a_leading_matrix_that_depends_on_parameters():
    """c x' = −y, y = k x + x³: λ = −k/c."""
    system = lh.DAE(
        lambda t, args: jnp.stack([jnp.stack([args["c"], 0 * args["c"]]), jnp.zeros(2)]),
        lambda t, x, args: jnp.stack([-x[1], x[1] - args["k"] * x[0] - x[0] ** 3]),
        n_differential=1,
    )
    found = of_dae(system, [0.3, 0.1], {"c": 2.0, "k": 3.0})
    assert (found.method, found.trust) == ("equilibrium", True), found
    assert_allclose(found.value, [-1.5], rtol=1e-12)
    assert_allclose([found.gradient["c"][0], found.gradient["k"][0]], [3 / 4, -1 / 2], rtol=1e-12)


def test_an_unstable_equilibrium_is_not_trusted():
    at_the_top = lh.lyapunov_gradient(DUFFING, [1e-9, 0.0], -1.0, t1=1.0, transient=0, algorithm="equilibrium")
    assert not at_the_top.trust
    assert_allclose(at_the_top.gradient[0], -1 / np.sqrt(13), rtol=1e-10)
    assert any("not stable" in reason for reason in at_the_top.reasons)


def test_a_motion_that_does_not_come_to_rest_is_not_trusted():
    """Outside of an unstable cycle, from where Newton's method finds the stable focus within."""

    def field(t, x, a):
        square = x @ x
        rate = -a * (square - 0.25) * (square - 1)
        return jnp.stack([rate * x[0] - 0.3 * x[1], rate * x[1] + 0.3 * x[0]])

    found = lh.lyapunov_gradient(lh.Flow(field), [0.55, 0.0], 1e-3, t1=1.0, transient=0, algorithm="equilibrium")
    assert not found.trust, found
    assert any("does NOT come" in reason for reason in found.reasons)


def test_what_has_no_equilibrium():
    forced = lh.Flow(lambda t, x, a: jnp.stack([x[1], -a * x[1] - x[0] + jnp.cos(t)]))
    with pytest.raises(ValueError, match="depends on time"):
        lh.lyapunov_gradient(forced, [0.1, 0.2], 0.3, t1=10.0, algorithm="equilibrium")
    with pytest.raises(ValueError, match=r"lh\.Flow or lh\.DAE"):
        lh.lyapunov_gradient(lh.Map(lambda n, x, a: a * x), [0.1], 0.3, t1=10, algorithm="equilibrium")
    with pytest.raises(lh.NoDerivativeError, match="does not converge"):
        lh.lyapunov_gradient(lh.Flow(lambda t, x, a: a + x**2), [0.1], 0.3, t1=0.1, algorithm="equilibrium")


def test_progress_is_shown():
    seen = []
    of_spring(0.5, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
