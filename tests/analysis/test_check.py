"""`lh.check` finds planted mistakes, and says nothing against systems that are right."""

import re
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import balls
import lyaphybrid as lh
from lyaphybrid import zoo
from planted import PLANTED

RIGHT = [
    "lorenz63", "rossler", "henon_map", "standard_map", "impact_oscillator", "friction_pendulum", "buck_converter",
    "block_on_plate", "henon_heiles", "hard_disks", "stadium", "integrate_and_fire", "adex", "gear_rattle",
    "relay_feedback", "rocking_block", "simplest_walker", "pendulum_dae", "kicked_ball", "chua", "conewise_linear",
    "boost_converter",
]  # fmt: skip
FAST = {"lorenz63", "henon_map"}


def found(name: str) -> tuple[lh.Report, str, str]:
    system, x0, topic, pattern = PLANTED[name]
    with jax.enable_x64(name != "float32"):
        return lh.check(system, x0, mode=0 if isinstance(system, lh.Hybrid) else None), topic, pattern


@pytest.mark.slow_cases("no mode continues", "guard of a clock")
@pytest.mark.parametrize(
    "name", [name if i % 8 == 1 else pytest.param(name, marks=pytest.mark.slow) for i, name in enumerate(PLANTED)]
)
def test_a_planted_mistake_is_found(name):
    start = time.process_time()
    report, topic, pattern = found(name)
    assert any(one.topic == topic and re.search(pattern, one.text) for one in report.notes), str(report)
    assert time.process_time() - start < 20  # 5 s on a machine of its own


@pytest.mark.parametrize(
    "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in RIGHT]
)
def test_nothing_is_said_against_a_right_system(name):
    problem = getattr(zoo, name)()
    report = lh.check(problem.system, problem.x0, problem.args, mode=problem.mode, method=problem.method)
    assert report.ok
    assert not report.notes, str(report)
    assert len(report.findings) >= 3


def test_continuous_qr_is_looked_at_by_the_method_within_it():
    """Its own columns are orthonormal, no derivative of the motion."""
    system = lh.Flow(lambda t, x, args: jnp.stack([0.3 * x[0] + x[1], -0.5 * x[1]]))
    report = lh.check(system, [1.0, 1.0], method=lh.ContinuousQR(lh.RungeKutta("dopri5", rtol=1e-9)))
    assert report.ok, str(report)


@pytest.mark.slow
def test_neurons_that_come_to_rest_below_the_threshold_they_cannot_fire_at():
    """v' = I − v with the guard v − 1, which rises: it never fires, and a perturbation decays to nothing."""
    spike = lh.Transition(lambda t, v, args: v - 1.0, lambda t, v, args, which: v.at[which].set(0.0))
    report = lh.check(lh.Hybrid(lambda t, v, args: args - v, spike), [0.2, 0.5], jnp.array([1.1, 1.2]))
    assert [(one.topic, one.verdict) for one in report.notes] == [("jumps", "note")]
    assert "never fired, but it rose through zero 2 times" in report.notes[0].text
    said = {one.topic: one.text for one in report.findings}
    assert "agrees with differences" in said["saltation"]


@pytest.mark.slow
def test_a_motion_that_comes_to_rest_is_no_mistake():
    """But a cascade without end is."""
    fall = lambda t, x, args: jnp.stack([x[1], -1.0 + 0.0 * x[1]])  # noqa: E731
    floor = lambda t, x, args: x[0]  # noqa: E731
    ball = lh.Hybrid(fall, lh.Transition(floor, lambda t, x, args: jnp.stack([x[0], -0.5 * x[1]])))
    report = lh.check(ball, [1.0, 0.0])
    assert report.ok
    assert [(one.topic, one.verdict) for one in report.notes] == [("run", "note")]
    assert "zeno" in report.notes[0].text
    assert "`.result`" not in report.notes[0].text
    again = lh.Hybrid(fall, lh.Transition(floor, lambda t, x, args: jnp.stack([x[0] - 0.1, x[1]])))
    assert [one.verdict for one in lh.check(again, [1.0, 0.0]).notes][-1] == "wrong"


@pytest.mark.slow
def test_functions_are_looked_at_by_one_program_each():
    """XLA takes 0.02 s of CPU time and more for each program, and would make one for each operation of a field."""
    problem, made = zoo.friction_pendulum(), []
    jax.monitoring.register_event_duration_secs_listener(lambda event, *rest, **more: made.append(event))
    assert lh.check(problem.system, problem.x0, problem.args, mode=problem.mode).ok
    assert made.count("/jax/core/compile/backend_compile_duration") <= 12


def test_a_report_prints_and_becomes_a_dataset():
    report = lh.check(lh.Map(lambda n, x, args: args * x * (1 - x)), [0.3], 3.9)
    assert str(report).startswith("Check of a system: ok (0 wrong, 0 notes)")
    assert "<table>" in report._repr_html_()
    assert list(report.to_xarray().topic.values) == [one.topic for one in report.findings]


def test_what_is_no_system_is_refused():
    with pytest.raises(ValueError, match=r"lh\.Flow"):
        lh.check(lambda t, x, args: x, [1.0])
    with pytest.raises(ValueError, match="t1"):
        lh.check(lh.Flow(lambda t, x, args: -x), jnp.array([1.0]), t1=-1.0)


def test_several_starts_and_parameters_without_a_motion_are_reported():
    damped = lh.Flow(lambda t, x, a: jnp.stack([x[1], -x[0] - a * x[1]]))
    several = lh.check(damped, [[0.1, 0.2], [0.3, 0.4]], 0.3)
    assert not several.ok
    assert "one start" in several.notes[0].text
    nowhere = lh.check(damped, [0.1, 0.2], float("nan"), t1=1.0)
    assert [one.topic for one in nowhere.notes if one.verdict == "wrong"] == ["run"]


def test_bodies_in_rows_with_a_schedule():
    """The docstring's own example: a state with one row a body."""
    report = lh.check(balls.between_walls(), balls.START)
    assert report.ok
    assert "saltation" in str(report)


@pytest.mark.slow
def test_arrays_of_numpy_in_args_that_a_reset_indexes_by_the_event():
    """Two balls, and a reset that looks up the ball's own coefficient of restitution."""

    def hit(t, x, args, which):
        return x.at[2 + which].multiply(-args["r"][which])

    balls = lh.Hybrid(
        lambda t, x, args: jnp.concatenate([x[2:], -jnp.ones(2)]), lh.Transition(lambda t, x, args: x[:2], hit)
    )
    assert lh.check(balls, [1.0, 2.0, 0.0, 0.0], {"r": np.array([0.9, 0.8])}, t1=5.0).ok


def test_a_timer_that_runs_out_is_no_wall():
    """The second guard is passed each time that the timer runs out, and only sets the flag: a note, nothing wrong."""

    def field(t, x, args):  # voltage, whether it is ready, time since the spike
        return jnp.stack([x[1] * (1.3 - x[0]), 0 * x[1], 1 + 0 * x[2]])

    spike = lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: 0 * x)
    over = lh.Transition(lambda t, x, args: 0.3 - x[2], lambda t, x, args: x.at[1].set(1.0))
    report = lh.check(lh.Hybrid(field, [spike, over]), [0.2, 1.0, 0.0])
    assert [(one.topic, one.verdict) for one in report.notes] == [("jumps", "note")]
    assert "transition 1 changes nothing that moves its guard" in report.notes[0].text


@pytest.mark.parametrize(("unit", "noted"), [(1e-3, False), (1e-9, True)])
def test_states_so_small_that_absolute_tolerances_are_coarse(unit, noted):
    swing = lh.Flow(lambda t, x, args: jnp.stack([x[1], unit * jnp.cos(2.8 * t) - x[0]]), names=["x", "v"])
    said = [one.text for one in lh.check(swing, [0.0, 0.5 * unit], t1=10.0).notes if one.topic == "tolerance"]
    assert bool(said) == noted
    if noted:
        assert "x and v: at most" in said[0]
        assert "method=lh.RungeKutta(atol=" in said[0]


def between_walls(mass: float, forgets: bool, **promises):
    """Two particles on a line between walls at 0 and 1 that pass each other; the second may forget how fast it came."""

    def next_event(t, x, args):
        away = jnp.where(x[2:] < 0, x[:2] / -x[2:], (1 - x[:2]) / x[2:]) * jnp.array([1.0, mass])
        return jnp.min(away), jnp.argmin(away)

    def flow(dt, t, x, args):
        return jnp.concatenate([x[:2] + dt * x[2:] / jnp.array([1.0, mass]), x[2:]])

    def jump(t, x, args, which):
        x = x.at[2 + which].multiply(-1.0)
        return x.at[3].set(jnp.where(forgets & (which == 1), 0.8 * jnp.sign(x[3]), x[3]))

    def guard(t, x, args, which):
        return jnp.where(x[2 + which] < 0, x[which], 1 - x[which])

    return lh.EventDriven(flow, next_event, jump, guard, **promises)


@pytest.mark.parametrize(
    ("mass", "forgets", "promises", "says"),
    [
        (3.0, False, {"canonical": True}, None),
        (3.0, False, {"invertible": True}, None),
        (3.0, False, {}, None),
        (3.0, True, {"invertible": True}, "invertible=True promises that no event destroys a direction"),
        (3.0, True, {"canonical": True}, "canonical=True promises that no event destroys a direction"),
    ],
)
def test_promises_of_event_driven_systems(mass, forgets, promises, says):
    report = lh.check(between_walls(mass, forgets, **promises), [0.3, 0.7, 0.5, -0.8])
    said = [one for one in report.findings if one.topic == "promises"]
    assert [one.verdict for one in said] == ([] if not promises else ["right" if says is None else "wrong"])
    assert says is None or says in said[0].text


def test_promises_of_a_run_that_ends():
    """A ball that keeps half its speed comes to rest at t = 3 √2; its first bounces are looked at all the same."""
    ball = lh.EventDriven(
        flow=lambda dt, t, x, args: jnp.array([x[0] + x[1] * dt - dt**2 / 2, x[1] - dt]),
        next_event=lambda t, x, args: (x[1] + jnp.sqrt(x[1] ** 2 + 2 * x[0]), 0),
        jump=lambda t, x, args, which: jnp.array([0 * x[0], -0.5 * x[1]]),
        guard=lambda t, x, args, which: x[0],
        invertible=True,
    )
    report = lh.check(ball, [1.0, 0.0], t1=6.0)
    assert not report.ok
    assert [one.verdict for one in report.findings if one.topic == "promises"] == ["right"]


def test_velocities_in_place_of_momenta():
    """Two discs of masses 1 and 2 that exchange velocities on a line: dq∧dp is conserved, dq∧dv is not."""

    def exchanging(scale):
        """x = (q, s v) with s = `scale`: momenta, or velocities where s = 1."""
        s, m = jnp.asarray(scale), jnp.array([1.0, 2.0])

        def velocity(x):
            return x[2:] / s

        def next_event(t, x, args):
            v = velocity(x)
            wall = jnp.where(v < 0, x[:2] / -v, (1 - x[:2]) / v)
            meet = jnp.where(v[0] > v[1], (x[1] - x[0]) / (v[0] - v[1]), jnp.inf)
            return jnp.minimum(jnp.min(wall), meet), jnp.argmin(jnp.append(wall, meet))

        def jump(t, x, args, which):
            v = velocity(x)
            centre = (m @ v) / jnp.sum(m)
            met = 2 * centre - v
            after = jnp.where(jnp.full(2, which == 2), met, jnp.where(jnp.arange(2, dtype=which.dtype) == which, -v, v))
            return jnp.concatenate([x[:2], s * after])

        def guard(t, x, args, which):
            v = velocity(x)
            wall = jnp.where(v < 0, x[:2], 1 - x[:2])
            return jnp.append(wall, x[1] - x[0])[which]

        flow = lambda dt, t, x, args: jnp.concatenate([x[:2] + dt * velocity(x), x[2:]])  # noqa: E731
        return lh.EventDriven(flow, next_event, jump, guard, canonical=True)

    for scale, verdict in (([1.0, 2.0], "right"), ([1.0, 1.0], "wrong")):
        start = np.array([0.3, 0.7, 0.5 * scale[0], -0.8 * scale[1]])
        report = lh.check(exchanging(scale), start, t1=6.0)
        assert [one.verdict for one in report.findings if one.topic == "promises"] == [verdict]
