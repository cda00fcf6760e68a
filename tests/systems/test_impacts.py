"""The impact oscillator with sticking: chatter that is completed, what it does to the tangent, when the mass leaves."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lyaphybrid as lh
from lyaphybrid import zoo

BOUNCE, STICK, LEAVE, TURN = range(4)  # the transitions
CASES = [
    {"omega": 0.5, "restitution": 0.3, "gap": -0.5},
    {"omega": 0.8, "restitution": 0.5, "gap": -0.3},
    {"omega": 0.3, "restitution": 0.8, "gap": 0.0},
    {"omega": 0.1, "restitution": 0.95, "gap": -0.8},
]


@pytest.mark.parametrize("parameters", CASES)
@pytest.mark.slow
def test_sticking_loses_both_directions_once_a_period(parameters):
    period = 2 * math.pi / parameters["omega"]
    problem = zoo.impact_oscillator(**parameters, sticking=True)
    assert problem.reference is None
    result = problem.spectrum(t1=16 * period, transient=3.3 * period)
    assert result.status == lh.STATUS.ok
    np.testing.assert_array_equal(result.exponents, [-math.inf, -math.inf])
    np.testing.assert_array_equal(result.losses, [16, 16])
    assert "rank_lost" in result.notes


@pytest.mark.slow
@pytest.mark.parametrize("parameters", CASES[:3])
def test_without_the_option_the_run_ends_where_the_chatter_does(parameters):
    plain, sticking = zoo.impact_oscillator(**parameters), zoo.impact_oscillator(**parameters, sticking=True)
    assert (plain.mode, plain.system.mode_names) == (None, ("flow",))
    assert plain.args == sticking.args
    period = 2 * math.pi / parameters["omega"]
    ended = plain.spectrum(t1=3 * period, transient=0.0, throw=False)
    assert ended.status == lh.STATUS.zeno
    motion = lh.trajectory(sticking.system, sticking.x0, sticking.args, t1=3 * period, n=1, mode="free")
    sticks = np.asarray(motion.events.t)[np.asarray(motion.events.transition) == STICK]
    np.testing.assert_allclose(ended.accumulation_time, sticks[0], atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("parameters", CASES[:3])
def test_the_mass_leaves_where_the_acceleration_ends_and_flies_on(parameters):
    omega, r, gap = parameters.values()
    period = 2 * math.pi / omega
    problem = zoo.impact_oscillator(**parameters, sticking=True)
    method = lh.RungeKutta("dopri5", rtol=1e-11, atol=1e-13)
    start = (problem.system, problem.x0, problem.args)
    events = lh.trajectory(*start, t1=4 * period, n=1, mode="free", method=method).events
    t, kind, after = (np.asarray(a) for a in (events.t, events.transition, events.x_after))
    leaves = t[kind == LEAVE]
    np.testing.assert_allclose(leaves % period, math.acos(gap) / omega, atol=1e-12)
    resting = after[(kind == STICK) | (kind == LEAVE)]
    np.testing.assert_array_equal(resting, np.broadcast_to([gap, 0.0], resting.shape))

    def field(t, x):
        return [x[1], math.cos(omega * t) - x[0] - 2 * 0.05 * x[1]]

    def wall(t, x):
        return gap - x[0] if t > leaves[0] + 0.1 else 1.0

    def turn(t, x):
        return x[1] if t > leaves[0] + 0.1 else -1.0

    wall.terminal, wall.direction, turn.direction = True, -1, 1
    flight = solve_ivp(
        field, (leaves[0], leaves[0] + period), [gap, 0.0], "DOP853", events=(wall, turn), rtol=1e-12, atol=1e-14
    )
    following = np.flatnonzero(kind == LEAVE)[0] + 1
    assert list(kind[following : following + 2]) == [TURN, BOUNCE]
    np.testing.assert_allclose(t[following], flight.t_events[1][0], atol=1e-8)
    np.testing.assert_allclose(t[following + 1], flight.t_events[0][0], atol=1e-8)
    np.testing.assert_allclose(after[following + 1, 1], -r * flight.y_events[0][0, 1], atol=1e-8)


@pytest.mark.slow
def test_periods_after_a_rest_are_the_same():
    """What happened before the first rest is forgotten: two starts, one motion."""
    problem = zoo.impact_oscillator(**CASES[1], sticking=True)
    ends = [
        lh.trajectory(problem.system, [-0.3, v], problem.args, t1=60.0, n=1, mode="free").x[-1] for v in (-0.5, -0.2)
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


@pytest.mark.slow
def test_sticking_changes_nothing_where_there_is_no_chatter():
    plain, sticking = zoo.impact_oscillator(omega=2.0), zoo.impact_oscillator(omega=2.0, sticking=True)
    results = [p.spectrum(t1=500.0) for p in (plain, sticking)]
    np.testing.assert_allclose(results[0].exponents, results[1].exponents, atol=1e-6)
    assert sticking.reference is None is not plain.reference


@pytest.mark.slow
def test_a_mass_that_is_pressed_for_ever_stays():
    problem = zoo.impact_oscillator(gap=-3.0, omega=0.5, restitution=0.5, sticking=True)
    motion = lh.trajectory(problem.system, problem.x0, problem.args, t1=100.0, n=4, mode="free")
    assert problem.system.mode_names[int(motion.mode[-1])] == "stuck"
    np.testing.assert_array_equal(motion.x[-1], [-3.0, 0.0])
    result = problem.spectrum(t1=100.0, transient=0.0)
    np.testing.assert_array_equal(result.exponents, [-math.inf, -math.inf])


def test_sticking_is_yes_or_no():
    with pytest.raises(ValueError, match="sticking must be True or False; got 1"):
        zoo.impact_oscillator(sticking=1)
