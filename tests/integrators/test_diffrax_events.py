"""`lh.DiffraxEvents` against closed forms and the default method: event times, states, exponents; and its limits."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo

THEIRS = lh.DiffraxEvents(diffrax.Dopri8(), rtol=1e-12, atol=1e-13)
OURS = lh.RungeKutta("dopri8", rtol=1e-12, atol=1e-13)
PERIOD = 2 * np.pi / 0.666


@pytest.mark.slow
def test_bounces_are_where_the_closed_form_has_them():
    problem = zoo.bouncing_ball(restitution=0.8)
    run = lh.trajectory(problem.system, problem.x0, problem.args, t1=9.0, n=1, method=THEIRS)
    assert len(run.events) == 10
    assert_allclose(run.events.t, np.cumsum(2 * 0.8 ** np.arange(10)), rtol=0, atol=1e-12)
    assert_allclose(run.events.x_after[:, 1], 0.8 ** np.arange(1, 11), rtol=0, atol=1e-12)


CASES = {
    "impact_oscillator": (zoo.impact_oscillator(), 20.0, 8),
    "moving_table": (zoo.kicked_ball(restitution=0.5, amplitude=1.75), 20.0, 2),
    "slip_to_and_fro": (zoo.friction_pendulum(beta=0.3), 10 * PERIOD, 20),
    "two_sticks_a_period": (zoo.friction_pendulum(alpha=0.5), 10 * PERIOD, 40),
    "a_clock": (zoo.buck_converter(), 0.003, 15),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_events_and_exponents_are_those_of_the_default_method(name):
    problem, t1, at_least = CASES[name]
    start = {"t1": t1, "mode": problem.mode}
    mine, other = (
        lh.trajectory(problem.system, problem.x0, problem.args, n=1, method=m, **start) for m in (OURS, THEIRS)
    )
    assert len(mine.events) == len(other.events) >= at_least
    assert_allclose(other.events.t, mine.events.t, rtol=0, atol=1e-8 * t1)
    assert_allclose(other.events.x_before, mine.events.x_before, rtol=0, atol=1e-8 * np.abs(mine.events.x_before).max())
    assert list(other.events.transition) == list(mine.events.transition)
    mine, other = (
        lh.lyapunov_spectrum(problem.system, problem.x0, problem.args, blocks=8, method=m, **start)
        for m in (OURS, THEIRS)
    )
    assert mine.jumps == other.jumps
    assert list(mine.losses) == list(other.losses)
    assert_allclose(other.exponents, mine.exponents, rtol=1e-7, atol=1e-7)
    if other.sum_rule_residual is not None:
        assert float(other.sum_rule_residual) < 1e-9 * np.abs(other.exponents).max()


@pytest.mark.slow
def test_forward_derivatives_are_those_of_the_default_method(monkeypatch):
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "auto")  # diffrax's derivatives call Python where they fail
    problem = zoo.impact_oscillator()

    def end(restitution, method):
        args = problem.args | {"restitution": restitution}
        return lh.tangent_map(problem.system, problem.x0, args, t1=5.0, method=method).x

    other, mine = (jax.jacfwd(end)(jnp.asarray(0.8), method) for method in (THEIRS, OURS))
    assert np.abs(mine).max() > 0.1
    assert_allclose(other, mine, rtol=1e-7)


# x' = x (1 - x), halved at ticks.
GROWING = lh.Hybrid(
    lambda t, x, args: x * (1 - x), lh.Transition(every=lambda args: args, reset=lambda t, x, args: 0.5 * x)
)


@pytest.mark.slow
def test_derivatives_by_the_end_of_the_run_and_by_the_period_of_a_clock(monkeypatch):
    """They were zero; by the start too. The run ends between two ticks, and at one."""
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "auto")  # diffrax's derivatives call Python where they fail

    def grown(x, dt):
        return x * jnp.exp(dt) / (1 + x * (jnp.exp(dt) - 1))

    def exact(x, period, t1):
        for _ in range(2):
            x = 0.5 * grown(x, period)
        return grown(x, t1 - 2 * period)

    def found(x, period, t1):
        return lh.trajectory(GROWING, x[None], period, t1=t1, n=2, method=THEIRS, throw=False).x[-1, 0]

    for t1 in (1.3, 1.0):
        point = jnp.asarray(0.3), jnp.asarray(0.5), jnp.asarray(t1)
        for along in jnp.eye(3):
            x, dx = jax.jvp(found, point, tuple(along))
            known, moved = jax.jvp(exact, point, tuple(along))
            assert_allclose(x, known, rtol=1e-10)
            assert_allclose(dx, moved, rtol=1e-9)


@pytest.mark.slow
def test_a_plain_flow_has_derivatives_by_its_end(monkeypatch):
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "auto")
    spin = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0]]))

    def final(t1):
        return lh.trajectory(spin, jnp.array([1.0, 0.0]), t1=t1, n=3, method=THEIRS, throw=False).x[-1]

    x, dx = jax.jvp(final, (2.0,), (1.0,))
    assert_allclose(x, [np.cos(2.0), -np.sin(2.0)], rtol=1e-10)
    assert_allclose(dx, [-np.sin(2.0), -np.cos(2.0)], rtol=1e-10)


@pytest.mark.slow
def test_what_diffrax_misses_is_missed():
    """The limit that the docstring states: sin t passes 0.99 between two ends of steps (at t = 1.43)."""
    turn = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0]])).field
    wall = lh.Transition(lambda t, x, args: 0.99 - x[0], terminal=True)
    first = np.arcsin(0.99)
    system = lh.Hybrid(turn, wall)
    default = lh.trajectory(system, [0.0, 1.0], t1=3.0, n=1)
    assert_allclose(default.events.t, [first], rtol=0, atol=1e-8)
    coarse = lh.DiffraxEvents(diffrax.Dopri8(), rtol=1e-3, atol=1e-3)
    assert len(lh.trajectory(system, [0.0, 1.0], t1=3.0, n=1, method=coarse).events) == 0


def test_what_it_does_not_take_is_refused():
    with pytest.raises(ValueError, match="root_finder must be one of optimistix"):
        lh.DiffraxEvents(diffrax.Dopri8(), root_finder="newton")
    with pytest.raises(ValueError, match="with an error estimate"):
        lh.DiffraxEvents(diffrax.Euler())
    pendulum = zoo.pendulum_dae()
    with pytest.raises(ValueError, match=r"this is an lh\.DAE: leave method=None"):
        lh.lyapunov_spectrum(pendulum.system, pendulum.x0, pendulum.args, t1=1.0, method=THEIRS)
