"""Our engine against an outer scan over diffrax (diffrax_events.py): events, tangent map, exponents."""

import diffrax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from diffrax_events import Options, diffrax_spectrum
from lyaphybrid import zoo

TIGHT = {"rtol": 1e-12, "atol": 1e-13}
OURS = lh.RungeKutta("dopri8", **TIGHT)

CASES = {
    "impact_oscillator": (zoo.impact_oscillator(), 20.0, 8),
    "moving_table": (zoo.kicked_ball(restitution=0.5, amplitude=1.75), 20.0, 2),
}


def theirs(problem, t1, **options):
    transition = problem.system.transitions[0]
    return diffrax_spectrum(
        problem.system.fields[0],
        transition.guard,
        transition.reset,
        problem.x0,
        problem.args,
        t1=t1,
        solver=diffrax.Dopri8(),
        options=Options(**TIGHT, segments_per_call=32, **options),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["impact_oscillator", pytest.param("moving_table", marks=pytest.mark.slow)])
def test_same_events_and_tangent_map(name):
    problem, t1, at_least = CASES[name]
    other = theirs(problem, t1, orthonormalise=False)
    run = lh.trajectory(problem.system, problem.x0, problem.args, t1=t1, n=1, method=OURS)
    growth = max(1.0, np.abs(other.columns).max())  # of the errors on the way
    assert len(run.events) == len(other.t) >= at_least
    assert_allclose(run.events.t, other.t, rtol=0, atol=1e-8)
    assert_allclose(run.events.x_before, other.x_before, rtol=0, atol=1e-8)
    assert_allclose(run.events.x_after, other.x_after, rtol=0, atol=1e-8)
    assert_allclose(run.x[-1], other.x, rtol=0, atol=1e-9 * growth)
    ours = lh.tangent_map(problem.system, problem.x0, problem.args, t1=t1, method=OURS)
    assert_allclose(ours.matrix, other.columns, rtol=0, atol=1e-7 * growth)


@pytest.mark.slow
def test_same_exponents_over_the_same_time():
    problem, t1, _ = CASES["impact_oscillator"]
    other = theirs(problem, t1)
    ours = lh.lyapunov_spectrum(problem.system, problem.x0, problem.args, t1=t1, blocks=8, method=OURS)
    assert int(ours.jumps) == len(other.t)
    assert_allclose(ours.exponents, np.sort(other.exponents)[::-1], rtol=0, atol=1e-7)


@pytest.mark.slow
def test_bounces_are_where_the_closed_form_has_them():
    problem = zoo.bouncing_ball(restitution=0.8)
    other = theirs(problem, 9.0)
    assert len(other.t) == 10
    flights = 2 * 0.8 ** np.arange(len(other.t))
    assert_allclose(other.t, np.cumsum(flights), rtol=0, atol=1e-9)
    assert_allclose(other.x_after[:, 1], 0.8 ** np.arange(1, len(other.t) + 1), rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("depth", "reported"), [(1e-2, 7.712442), (1e-4, None)])
def test_signs_at_the_ends_of_steps_miss_a_peak_between_them(depth, reported):
    """Where sin t first passes 1 - depth: what the README says of ours, and of diffrax with Dopri8."""

    def turn(t, x, args):
        return jnp.stack([x[1], -x[0]])

    wall = lh.Transition(lambda t, x, args: 1 - args - x[0], terminal=True)
    ours = lh.trajectory(lh.Hybrid(turn, wall), [0.0, 1.0], depth, t1=10.0, n=1)
    assert_allclose(ours.events.t, [np.arcsin(1 - depth)], rtol=0, atol=1e-8)
    theirs = diffrax.diffeqsolve(
        diffrax.ODETerm(turn),
        diffrax.Dopri8(),
        0.0,
        10.0,
        None,
        jnp.asarray([0.0, 1.0]),
        stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-12),
        event=diffrax.Event(lambda t, y, args, **_: 1 - depth - y[0], optimistix.Bisection(1e-10, 1e-10)),
    )
    found = theirs.result == diffrax.RESULTS.event_occurred
    assert bool(found) is (reported is not None)
    assert_allclose(theirs.ts[-1], reported or 10.0, rtol=0, atol=1e-6)
