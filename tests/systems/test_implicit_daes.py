"""Fully implicit equations of index one: against exact solutions, semi-linear forms, and what must be refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo


def forced(t, x, dx, args):
    """X = (sin t, sin² t) is a solution; its variations grow like exp ∫ −(1 + 2 sin t) / (1 + 0.3 cos² t)."""
    c, s = jnp.cos(t), jnp.sin(t)
    return jnp.stack([dx[0] + 0.1 * dx[0] ** 3 + x[0] + x[1] - (c + 0.1 * c**3 + s + s**2), x[1] - x[0] ** 2])


FORCED = lh.implicit_dae(forced, [0.0, 0.0], slope=[1.0, 0.0])
METHODS = {
    "half-explicit": lh.HalfExplicit(1e-9),
    "esdirk": lh.ESDIRK("kvaerno5", 1e-9),
    "radau": lh.RadauIIA(1e-7),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_an_exact_solution(name):
    start = lh.consistent_start(FORCED, [0.0, 0.7, 0.9])
    assert_allclose(start, [0.0, 0.0, 1.0], atol=1e-12)
    path = lh.trajectory(FORCED, start, t1=2.0, n=8, method=METHODS[name])
    exact = np.stack([np.sin(path.t), np.sin(path.t) ** 2, np.cos(path.t)], axis=1)
    assert_allclose(path.x, exact, atol=1e-7)


@pytest.mark.slow
def test_its_exponent():
    """The mean of −(1 + 2 sin t) / (1 + 0.3 cos² t) over a turn is −1 / √1.3."""
    start = lh.consistent_start(FORCED, [0.0, 0.0, 1.0])
    s = lh.lyapunov_spectrum(FORCED, start, t1=20 * np.pi, transient=2 * np.pi, method=lh.HalfExplicit(1e-9))
    assert s.status is lh.STATUS.ok
    assert s.exponents.shape == (1,)
    assert_allclose(s.exponents[0], -1 / np.sqrt(1.3), atol=1e-7)


@pytest.mark.slow
def test_a_semi_linear_system_in_implicit_form():
    """Example 5.1 as E x' − f = 0, its rows mixed: the same motion, and at rest the same exponents."""
    problem = zoo.spring_damper_dae()
    field, mixing = problem.system.field, np.random.default_rng(3).standard_normal((4, 4))

    def equations(t, x, dx, args):
        return jnp.asarray(mixing) @ (field.leading(t, args) @ dx - field.residual(t, x, args))

    dae = lh.implicit_dae(equations, problem.x0, problem.args)
    assert dae.n_differential == 2
    start = lh.consistent_start(dae, problem.x0, problem.args)
    assert_allclose(start[:4], problem.x0, atol=1e-12)
    method = lh.HalfExplicit(1e-9)
    ours, theirs = (
        lh.trajectory(system, x0, problem.args, t1=3.0, n=3, method=method).x[:, :4]
        for system, x0 in ((dae, start), (problem.system, problem.x0))
    )
    assert_allclose(ours, theirs, atol=1e-8)
    s = lh.lyapunov_spectrum(dae, start, problem.args, t1=50.0, transient=150.0, method=method)
    assert_allclose(s.exponents, [np.sqrt(7) / 2 - 1.5, -np.sqrt(7) / 2 - 1.5], atol=1e-7)


@pytest.mark.slow
def test_derivatives_that_occur_in_one_combination():
    """(x + y)' = −(x + y), x − 2 y = 0, by a function that sees x' + y' alone; and one without constraints."""
    dae = lh.implicit_dae(
        lambda t, x, dx, args: jnp.stack([jnp.sinh(dx[0] + dx[1] + x[0] + x[1]), x[0] - 2 * x[1]]), [1.0, 0.5]
    )
    assert dae.n_differential == 1
    path = lh.trajectory(dae, lh.consistent_start(dae, [1.0, 0.5]), t1=1.5, n=2)
    assert_allclose(path.x[-1, :2], np.exp(-1.5) * np.array([1.0, 0.5]), atol=1e-8)
    plain = lh.implicit_dae(lambda t, x, dx, args: dx + 0.2 * jnp.sin(dx) + args * x, [1.0, -1.0], 2.0)
    assert plain.n_differential == 2
    s = lh.lyapunov_spectrum(plain, lh.consistent_start(plain, [1.0, -1.0], 2.0), 2.0, t1=10.0, transient=20.0)
    assert_allclose(s.exponents, [-2 / 1.2, -2 / 1.2], atol=1e-6)


@pytest.mark.slow_cases("<lambda>-not of index one0")
@pytest.mark.parametrize(
    ("equations", "message"),
    [
        (lambda t, x, dx, args: jnp.stack([dx[0] - x[1], x[0] - jnp.sin(t)]), "not of index one"),
        (lambda t, x, dx, args: jnp.stack([dx[0] + x[0], x[0] + dx[0]]), "not of index one"),
        (lambda t, x, dx, args: jnp.stack([x[0] * dx[0] + x[1] * dx[1], x[0] - 2 * x[1]]), "kernel of ∂F/∂x' changes"),
        (lambda t, x, dx, args: x, "nothing is differential"),
        (lambda t, x, dx, args: dx[:1], "must have the shape of x0"),
        (3.0, "equations must be a function"),
    ],
)
def test_what_is_refused(equations, message):
    with pytest.raises(ValueError, match=message):
        lh.implicit_dae(equations, [1.0, 0.5])


@pytest.mark.slow
def test_the_pendulum_is_refused_with_positions_and_taken_with_accelerations():
    """Index three as it stands; with the constraint differentiated twice the multiplier is found."""

    def pendulum(level):
        def equations(t, x, dx, args):
            (px, py, vx, vy, tension), (ax, ay) = x, (dx[2], dx[3])
            held = (px**2 + py**2 - 1, px * vx + py * vy, vx**2 + vy**2 + px * ax + py * ay)[level]
            return jnp.stack([dx[0] - vx, dx[1] - vy, ax + tension * px, ay + tension * py + 1, held])

        return equations

    start = [0.6, -0.8, 0.0, 0.0, 0.8]
    for level in (0, 1):
        with pytest.raises(ValueError, match="not of index one"):
            lh.implicit_dae(pendulum(level), start)
    dae = lh.implicit_dae(pendulum(2), start)
    path = lh.trajectory(dae, lh.consistent_start(dae, start), t1=3.0, n=3, method=lh.HalfExplicit(1e-10))
    angle = lh.trajectory(
        lh.Flow(lambda t, x, args: jnp.stack([x[1], -jnp.sin(x[0])])), [np.arcsin(0.6), 0.0], t1=3.0, n=3
    )
    assert_allclose(path.x[:, 0], np.sin(angle.x[:, 0]), atol=1e-7)
    assert_allclose(path.x[:, 4], np.cos(angle.x[:, 0]) + angle.x[:, 1] ** 2, atol=1e-7)


def fast_slow(t, x, dx, eps):
    """ε y' = −y + …: with ε = 0 it is algebraic, with ε = 1 both exponents at rest are −1."""
    return jnp.stack([dx[0] + x[0] - x[1], eps * dx[1] + x[1] - 0.5 * x[0] + jnp.sin(x[0])])


def test_other_args_than_it_was_built_with():
    """A term in x' that was zero at the construction was dropped: one exponent −1.491 for ε = 1, instead of −1, −1."""
    algebraic = lh.implicit_dae(fast_slow, [1.0, 0.2], 0.0)
    start = lh.consistent_start(algebraic, [1.0, 0.2], 0.0)
    message = r"with args = 0\.1 at t = 0, x = .* F contains x1', which would be dropped; it was built with args = 0\.0"
    for call in (lh.consistent_start, lambda *given: lh.lyapunov_spectrum(*given, t1=5.0)):
        with pytest.raises(ValueError, match=message):
            call(algebraic, start, 0.1)
    report = lh.check(algebraic, start, 0.1)
    assert not report.ok
    assert "F contains x1'" in str(report)


@pytest.mark.slow
def test_args_that_are_traced_end_the_run():
    algebraic = lh.implicit_dae(fast_slow, [1.0, 0.2], 0.0)
    start = lh.consistent_start(algebraic, [1.0, 0.2], 0.0)
    status = jax.jit(lambda eps: lh.lyapunov_spectrum(algebraic, start, eps, t1=5.0, throw=False).status)
    assert (int(status(0.0)), int(status(0.1))) == (lh.STATUS.ok, lh.STATUS.singular_dae)


@pytest.mark.slow
def test_fewer_slopes_than_it_was_built_with():
    """Built at ε = 0.1 the exponents at rest are those of the matrix; at ε = 0 the message says what has changed."""
    both = lh.implicit_dae(fast_slow, [0.1, 0.1], 0.1)
    s = lh.lyapunov_spectrum(both, lh.consistent_start(both, [0.1, 0.1], 0.2), 0.2, t1=50.0, transient=50.0)
    exact = np.linalg.eigvals([[-1, 1], [-0.5 / 0.2, -1 / 0.2]]).real
    assert_allclose(s.exponents, np.sort(exact)[::-1], atol=1e-6)
    with pytest.raises(lh.NoConsistentPointError, match=r"rank 1 with args = 0\.0, and .* built with args = 0\.1"):
        lh.consistent_start(both, [0.1, 0.1], 0.0)
    with pytest.raises(ValueError, match=r"rank 1 with args = 0\.0, and .* built with args = 0\.1"):
        lh.trajectory(both, [0.1, 0.1, 0.0, 0.0], 0.0, t1=1.0, n=1)


@pytest.mark.slow
def test_a_kernel_that_changes_on_the_way():
    """At x = 4, three units of time after the start, F begins to contain x1'; without stopping it was dropped."""

    def equations(t, x, dx, args):
        return jnp.stack([dx[0] - 1, jnp.maximum(x[0] - 4, 0) * dx[1] + x[1] - 0.5 * x[0]])

    dae = lh.implicit_dae(equations, [1.0, 0.5])
    start = lh.consistent_start(dae, [1.0, 0.5])
    path = lh.trajectory(dae, start, t1=8.0, n=8, throw=False)
    assert path.status is lh.STATUS.singular_dae
    assert lh.check(dae, start, t1=2.0).ok
    assert any(
        one.topic == "constraints" and "F contains x1'" in one.text for one in lh.check(dae, start, t1=8.0).notes
    )


@pytest.mark.slow
def test_the_units_of_an_equation_do_not_matter():
    """A row 10⁹ times the other: the slope in the other is seen; rounding in rows that are mixed is not."""

    def equations(t, x, dx, args):
        return jnp.stack([1e3 * (dx[0] + x[0] - x[1]), 1e-6 * (args * dx[1] + x[1] - 0.5 * x[0])])

    dae = lh.implicit_dae(equations, [1.0, 0.5], 0.0)
    with pytest.raises(ValueError, match="F contains x1'"):
        lh.consistent_start(dae, [1.0, 0.5], 1.0)
    mixing, leading = np.random.default_rng(3).standard_normal((3, 3)), np.diag([1e3, 1.0, 0.0])

    def mixed(t, x, dx, args):
        return jnp.asarray(mixing) @ (jnp.asarray(leading) @ dx - args * jnp.stack([-x[0], -x[1], x[2] - x[0]]))

    dae = lh.implicit_dae(mixed, [1.0, 1.0, 1.0], 1.0)
    assert_allclose(lh.consistent_start(dae, [1.0, 1.0, 1.0], 2.0)[:3], 1.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_slope_chooses_the_branch(sign):
    """x'² − 0.1 x' = x has two slopes at each x > 0."""

    def equations(t, x, dx, args):
        return jnp.stack([dx[0] ** 2 - 0.1 * dx[0] - x[0], x[1] - x[0]])

    dae = lh.implicit_dae(equations, [1.0, 1.0], slope=[sign, 0.0])
    assert_allclose(lh.consistent_start(dae, [1.0, 1.0])[2], 0.05 + sign * np.sqrt(1.0025), rtol=1e-12)
