"""Flights from a guard and back that are lower than its rounding: they end a run, and nothing falls through."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

OMEGA, GRAVITY, RESTITUTION = 20 * np.pi, 9.81, 0.8


def height(t, x, args):
    """Of a ball above a table that moves as A sin Ωt."""
    return x[0] - args["A"] * jnp.sin(OMEGA * t)


def bounce(t, x, args):
    table = args["A"] * OMEGA * jnp.cos(OMEGA * t)
    return jnp.stack([x[0], (1 + RESTITUTION) * table - RESTITUTION * x[1]])


def flight(t, x, args):
    return jnp.stack([x[1], jnp.full_like(x[1], -GRAVITY)])


BALL = lh.Hybrid(flight, lh.Transition(height, bounce))


def ends(strength, t1, starts):
    """Statuses, final states, and the times from the end to the estimated accumulation."""
    args = {"A": strength * GRAVITY / OMEGA**2}
    found = [lh.lyapunov_spectrum(BALL, [y, 0.0], args, t1=t1, throw=False) for y in starts]
    above = [float(height(run.t, run.x, args)) for run in found]
    return [run.status.name for run in found], above, [float(run.accumulation_time - run.t) for run in found]


@pytest.mark.slow_cases("1.5")
@pytest.mark.parametrize("strength", [1.5, 3.0])
def test_no_ball_falls_through_the_table(strength):
    """At t = 1000 the table's position is known to 4e-12; a ball that bounces lower than that has come to rest."""
    statuses, above, ahead = ends(strength, 1000.0, [0.05, 0.0961538461538, 0.1294871794871, 0.15])
    assert min(above) > -1e-11
    assert set(statuses) <= {"ok", "zeno"}
    assert "zeno" in statuses
    for status, time in zip(statuses, ahead, strict=True):
        if status == "zeno":  # what is left of the sequence lasts for about as long as its last flights together
            assert 0 < time < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("strength", [1.2, 1.5, 2.0, 2.5, 3.0, 4.0])
def test_none_of_many(strength):
    statuses, above, ahead = ends(strength, 3000.0, np.linspace(0.05, 0.15, 40))
    assert min(above) > -1e-10
    assert max(time for status, time in zip(statuses, ahead, strict=True) if status == "zeno") < 1e-4


@pytest.mark.slow
def test_events_before_a_hidden_flight_are_those_of_a_ball_that_bounces_geometrically():
    """On a table at rest each flight takes r times as long as the last, down to the rounding of the guard."""
    args = {"A": 0.0}
    run = lh.trajectory(BALL, [1.0, 0.0], args, t1=10.0, throw=False)
    flights = np.diff(np.asarray(run.events.t))
    assert run.status.name == "zeno"
    np.testing.assert_allclose(flights[1:40] / flights[:39], RESTITUTION, rtol=1e-6)
    end = np.sqrt(2 / GRAVITY) * (1 + 2 * RESTITUTION / (1 - RESTITUTION))
    assert abs(float(run.events.t[-1]) - end) < 1e-7
    found = lh.lyapunov_spectrum(BALL, [1.0, 0.0], args, t1=10.0, throw=False)
    assert abs(float(found.accumulation_time) - end) < 1e-9


def test_a_run_that_ends_before_its_transient_has_no_dimension():
    found = lh.lyapunov_spectrum(BALL, [1.0, 0.0], {"A": 0.0}, t1=10.0, transient=50.0, throw=False)
    assert found.status.name == "zeno"
    assert np.all(np.isnan(found.exponents))
    assert np.isnan(found.kaplan_yorke_dimension())


@pytest.mark.parametrize("t0", [0.0, 1e3, 1e5])
def test_a_ball_that_chatters_on_a_moving_table_at_late_times(t0):
    """The table's place is rounded to ε A ω t; flights as high as that rounding ended in a stall, beyond the table.

    The instant at which impacts accumulate, the last flight and a geometric series, is by 50 digits of mpmath.
    """
    amplitude, w, r, weight = 0.0125, 50 * np.pi, 0.9, 9.81

    def table(t):
        return amplitude * jnp.sin(w * t), amplitude * w * jnp.cos(w * t)

    def bounces(t, x, args):
        return jnp.stack([x[0], -r * x[1] + (1 + r) * table(t)[1]])

    system = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], -weight]), lh.Transition(lambda t, x, args: x[0] - table(t)[0], bounces)
    )
    phase = 0.0202692365549
    found = lh.trajectory(
        system, [-0.0004284871662479755, -2.0424415234991384], t0=t0 + phase, t1=0.2, n=2, throw=False
    )
    assert found.status.name == "zeno"
    times = np.asarray(found.events.t) - t0
    end = times[-1] + (times[-1] - times[-2]) * r / (1 - r)
    assert abs(end - 0.0350609836368568) < 1e-10 + 1e-11 * t0
