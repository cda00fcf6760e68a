"""Each status and each note, produced once; and whatever was computed before a failure is kept."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from examples import BALL_BLOCKS, BALL_METHOD, ENDLESS_CASCADE, LOGISTIC, TABLE, TABLE_ARGS, ball_spectrum
from lyaphybrid import STATUS

BLOCKS = BALL_BLOCKS
METHOD = BALL_METHOD


def computed(spectrum) -> int:
    """The number of blocks with a history, which must be finite and stand at the front."""
    reached = np.isfinite(np.asarray(spectrum.history.time))
    count = int(reached.sum())
    assert reached[:count].all()
    assert np.isfinite(spectrum.history.growth[:count]).all()
    assert np.isnan(spectrum.history.growth[count:]).all()
    assert np.isclose(spectrum.history.time[count - 1], spectrum.time, rtol=1e-12)
    return count


@pytest.mark.slow
def test_ok():
    spectrum = ball_spectrum(throw=True)
    assert spectrum.status is STATUS.ok
    assert spectrum.notes == frozenset()
    assert computed(spectrum) == BLOCKS
    assert spectrum.jumps == 10  # a period is 2: up and down from 1/2 with gravity 1


@pytest.mark.slow
def test_terminated():
    spectrum = ball_spectrum(gravity=-1.0, ceiling=0.6, throw=True)  # no error: this is how the run was meant to end
    assert spectrum.status is STATUS.terminated
    assert float(spectrum.t) == pytest.approx(math.sqrt(0.2), abs=1e-12)
    assert float(spectrum.x[0]) == pytest.approx(0.6, abs=1e-12)
    assert computed(spectrum) == 1


@pytest.mark.slow
def test_a_terminal_transition_resets_before_the_end():
    stop = lh.Transition(
        lambda t, x, args: 1 - x[0], lambda t, x, args: 5 * x, target="after", terminal=True, source="before"
    )
    rise = lambda t, x, args: jnp.ones_like(x)  # noqa: E731
    system = lh.Hybrid({"before": rise, "after": rise}, stop)
    path = lh.trajectory(system, [0.0], t1=3.0, n=3, mode="before", method=METHOD)
    assert path.status is STATUS.terminated
    assert path.events.x_after[0] == pytest.approx(5.0, rel=1e-12)
    assert path.events.mode_after[0] == 1
    assert np.isnan(path.x[1:]).all()


def test_max_steps():
    spectrum = ball_spectrum(t1=2000.0, max_steps=2000)
    assert spectrum.status is STATUS.max_steps
    count = computed(spectrum)
    assert 0 < count < BLOCKS
    assert np.all(np.diff(spectrum.history.time[:count]) > 0)


@pytest.mark.parametrize("start", [0.5, 1.0])
def test_zeno_tells_the_time_of_accumulation(start):
    r, first = 0.8, math.sqrt(2 * start)  # flights first, 2 r first, 2 r² first, …
    exact = first * (1 + r) / (1 - r)
    spectrum = ball_spectrum((start, 0.0), restitution=r)
    assert spectrum.status is STATUS.zeno
    assert float(spectrum.t) <= exact
    assert float(spectrum.accumulation_time) == pytest.approx(exact, rel=1e-7)
    assert 50 < spectrum.jumps < 200
    assert computed(spectrum) == math.ceil(exact / (20 / BLOCKS))


@pytest.mark.slow
def test_zeno_on_a_moving_table_whose_rounding_hides_the_last_bounces():
    """At height 0.2 a bounce slower than 1e-8 is lower than the last digit: the ball would fall through the table."""
    spectrum = lh.lyapunov_spectrum(TABLE, [1.0, 0.2], TABLE_ARGS, t1=30.0, blocks=BLOCKS, throw=False)
    assert spectrum.status is STATUS.zeno
    height = spectrum.x[0] - 0.2 * math.sin(1.3 * float(spectrum.t))
    assert abs(float(height)) < 1e-12
    assert 0 < float(spectrum.accumulation_time - spectrum.t) < 1e-5


@pytest.mark.slow
def test_zeno_of_an_exact_flow():
    def flight(t, x, args):
        return (x[1] + jnp.sqrt(x[1] ** 2 + 2 * x[0])), 0

    exactly = lh.EventDriven(
        flow=lambda dt, t, x, args: jnp.stack([x[0] + x[1] * dt - dt**2 / 2, x[1] - dt]),
        next_event=flight,
        jump=lambda t, x, args, which: jnp.stack([0 * x[0], -0.8 * x[1]]),
        guard=lambda t, x, args, which: x[0],
    )
    spectrum = lh.lyapunov_spectrum(exactly, [1.0, 0.0], t1=20.0, blocks=BLOCKS, throw=False)
    assert spectrum.status is STATUS.zeno
    assert float(spectrum.t) == pytest.approx(12.727922061357857, rel=1e-8)
    assert computed(spectrum) == math.ceil(12.73 / 2.5)


@pytest.mark.slow
def test_zeno_of_a_cascade_without_end():
    """Each reset throws the state onto the other guard; three at one instant are allowed."""
    spectrum = lh.lyapunov_spectrum(ENDLESS_CASCADE, [0.5, 1.0], t1=2.2, k=1, blocks=BLOCKS, method=METHOD, throw=False)
    assert spectrum.status is STATUS.zeno
    assert float(spectrum.t) == pytest.approx(0.5, abs=1e-12)
    assert computed(spectrum) == 2


def thermostat(on, off):
    """Heats until x rises through `off`, cools until it falls through `on`."""
    heats = lh.Transition(lambda t, x, args: x[0] - on, source="cools", target="heats", direction=-1)
    cools = lh.Transition(lambda t, x, args: x[0] - off, source="heats", target="cools", direction=+1)
    return lh.Hybrid({"heats": lambda t, x, args: 30.0 - x, "cools": lambda t, x, args: 10.0 - x}, [heats, cools])


@pytest.mark.slow
def test_zeno_of_a_hysteresis_the_wrong_way_round():
    """Where one mode ends the other one is beyond its threshold, and fires at once; the message says so."""
    assert lh.trajectory(thermostat(19.0, 21.0), [15.0], t1=5.0, mode="heats").status is STATUS.ok
    with pytest.raises(lh.RunFailedError, match=r"beyond zero .* exchanged thresholds") as caught:
        lh.trajectory(thermostat(21.0, 19.0), [15.0], t1=5.0, mode="heats")
    assert caught.value.status is STATUS.zeno
    assert float(caught.value.result.events.t[0]) == pytest.approx(math.log(15 / 11), abs=1e-9)


def fold(sink):
    """X falls at the rate `sink`; z = √x ends where x does."""
    return lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
        lambda t, x, args: jnp.stack([-sink + 0 * x[0], x[1] ** 2 - x[0]]),
        n_differential=1,
    )


@pytest.mark.slow
def test_inconsistent_start():
    spectrum = lh.lyapunov_spectrum(fold(1.0), [1.0, 0.9], t1=0.5, blocks=BLOCKS, throw=False)
    assert spectrum.status is STATUS.inconsistent_start
    assert np.isnan(spectrum.exponents).all()
    with pytest.raises(lh.RunFailedError, match="lh.consistent_start"):
        lh.trajectory(fold(1.0), [1.0, 0.9], t1=0.5)
    assert lh.trajectory(fold(1.0), lh.consistent_start(fold(1.0), [1.0, 0.9]), t1=0.5).status is STATUS.ok


@pytest.mark.slow
def test_singular_dae_where_the_constraint_folds():
    spectrum = lh.lyapunov_spectrum(fold(1.0), [1.0, 1.0], t1=2.2, blocks=BLOCKS, throw=False)
    assert spectrum.status is STATUS.singular_dae
    assert float(spectrum.t) == pytest.approx(1.0, abs=1e-9)
    assert computed(spectrum) == math.ceil(1.0 / (2.2 / BLOCKS))  # the fold is within a block, not at the end of one


@pytest.mark.slow
@pytest.mark.parametrize("method", [lh.HalfExplicit(), lh.HalfExplicit(rtol=1e-6), lh.ESDIRK(), lh.RadauIIA()])
def test_singular_dae_where_steps_creep_along_a_fold(method):
    """q' = −y, 0 = y³/3 − y − q folds at y = 1, at t = 3/2 − ln 2 from y = 2: steps that lead nowhere are no reason."""
    cubic = lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
        lambda t, x, args: jnp.stack([-x[1], x[1] ** 3 / 3 - x[1] - x[0]]),
        n_differential=1,
    )
    for t1 in (1.0, 2.0, 5.0):
        spectrum = lh.lyapunov_spectrum(cubic, [2 / 3, 2.0], t1=t1, method=method, throw=False)
        assert spectrum.status is STATUS.singular_dae
        assert float(spectrum.t) == pytest.approx(1.5 - math.log(2), abs=1e-7)


@pytest.mark.slow
def test_singular_dae_where_the_rank_of_e_falls():
    """(1 - t) x' = -x: x = 1 - t goes on smoothly, but nothing says so."""
    falling = lh.DAE(
        lambda t, args: jnp.diag(jnp.stack([1 - t, 0 * t])),
        lambda t, x, args: jnp.stack([-x[0], x[1] - x[0]]),
        n_differential=1,
    )
    path = lh.trajectory(falling, [1.0, 1.0], t1=3.0, n=4, throw=False)
    assert path.status is STATUS.singular_dae
    assert np.allclose(path.x[0], [0.25, 0.25], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_singular_dae_where_the_rank_of_e_rises():
    rising = lh.DAE(
        lambda t, args: jnp.diag(jnp.stack([1 + 0 * t, jnp.maximum(t - 1, 0.0)])),
        lambda t, x, args: jnp.stack([-x[0], x[1] - x[0]]),
        n_differential=1,
    )
    path = lh.trajectory(rising, [1.0, 1.0], t1=3.0, n=12, throw=False)
    assert path.status is STATUS.singular_dae
    assert 1.0 < np.nanmax(path.t) <= 1.5


@pytest.mark.slow
def test_constraint_drift():
    """A method for ordinary equations integrates x' and forgets the constraints."""
    turning = lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
        lambda t, x, args: jnp.stack([x[1], x[1] - jnp.cos(5 * t) * (2 + jnp.sin(x[0]))]),
        n_differential=1,
    )
    start, method = jnp.array([0.0, 2.0]), lh.RungeKutta("dopri5", rtol=1e-4, atol=1e-4)
    spectrum = lh.lyapunov_spectrum(turning, start, t1=50.0, blocks=BLOCKS, method=method, throw=False)
    assert spectrum.status is STATUS.constraint_drift
    careful = lh.RungeKutta(rtol=1e-11, atol=1e-11)
    assert lh.lyapunov_spectrum(turning, start, t1=50.0, blocks=BLOCKS, method=careful).status is STATUS.ok
    assert lh.lyapunov_spectrum(turning, start, t1=50.0, blocks=BLOCKS).status is STATUS.ok


def test_deadlock_where_no_transition_applies():
    spectrum = ball_spectrum(floor=0.0)
    assert spectrum.status is STATUS.deadlock
    assert np.allclose(spectrum.x, [0, -1], rtol=0, atol=1e-12)  # at the guard, before any jump
    assert spectrum.jumps == 0
    assert computed(spectrum) == 1


def test_deadlock_of_a_ball_that_does_not_rebound():
    spectrum = ball_spectrum(restitution=0.0)
    assert spectrum.status is STATUS.deadlock
    assert np.allclose(spectrum.x, 0, rtol=0, atol=1e-12)
    assert float(spectrum.t) == pytest.approx(1.0, abs=1e-12)
    assert spectrum.jumps == 1


def test_nonfinite_where_the_solution_escapes():
    spectrum = ball_spectrum(gravity=0.0, escape=1.0, ceiling=1e300, t1=10.0)
    assert spectrum.status is STATUS.nonfinite
    assert np.isfinite(spectrum.x).all()  # the last state that was one
    assert 1 <= computed(spectrum) < BLOCKS


ESCAPE = lh.Flow(lambda t, x, args: args * x * x)


@pytest.mark.parametrize("method", [None, lh.RungeKutta("rk4", dt=0.001)], ids=["adaptive", "fixed"])
def test_nonfinite_of_a_flow_without_events(method):
    """x' = x², x = 1/(1 - t), δx ∝ x²."""
    spectrum = lh.lyapunov_spectrum(ESCAPE, [1.0], 1.0, t1=2.0, blocks=16, method=method, throw=False)
    assert spectrum.status is STATUS.nonfinite
    assert 0.99 < float(spectrum.t) < 1.13  # a fixed step may leap over the pole; the block's end notices
    assert computed(spectrum) in (8, 9)
    done = np.arange(1, 8)
    grown = -2 * np.log(1 - done / 8) / (done / 8)
    assert np.allclose(spectrum.history.exponents[:7, 0], grown, rtol=1e-5)


@pytest.mark.slow
def test_nonfinite_where_the_field_is_undefined():
    root = lh.Flow(lambda t, x, args: jnp.sqrt(args - t) + 0 * x)
    spectrum = lh.lyapunov_spectrum(root, [1.0], 1.0, t1=2.0, blocks=16, throw=False)
    assert spectrum.status is STATUS.nonfinite
    assert float(spectrum.t) == pytest.approx(1.0, abs=1e-9)
    assert computed(spectrum) in (8, 9)


@pytest.mark.slow
def test_nonfinite_of_a_map():
    spectrum = lh.lyapunov_spectrum(LOGISTIC, [1.3], 5.0, t1=64, blocks=BLOCKS, throw=False)
    assert spectrum.status is STATUS.nonfinite
    assert "rank_lost" not in spectrum.notes  # an overflow is no loss of rank
    assert float(spectrum.t) < 15
    assert np.isfinite(spectrum.history.growth[0]).all()


def _without_derivative(x):
    """0 up to 10, where the derivative that JAX finds is 0/0."""
    return jnp.sqrt(jnp.maximum(x - 10.0, 0.0))


@pytest.mark.slow_cases("reset", "event-driven", "map")
@pytest.mark.parametrize(
    ("system", "method"),
    [
        (lh.Map(lambda n, x, args: 0.5 * x + _without_derivative(x)), None),
        (lh.Flow(lambda t, x, args: -x + _without_derivative(x)), METHOD),
        (lh.Flow(lambda t, x, args: -x + _without_derivative(x)), lh.RungeKutta("rk4", dt=0.1)),
        (
            lh.Hybrid(lambda t, x, args: -x, lh.Transition(every=1.0, reset=lambda t, x, args: _without_derivative(x))),
            METHOD,
        ),
        (
            lh.EventDriven(
                flow=lambda dt, t, x, args: jnp.exp(-dt) * x,
                next_event=lambda t, x, args: (1.0, 0),
                jump=lambda t, x, args, which: x + _without_derivative(x),
                guard=lambda t, x, args, which: x[0],
            ),
            None,
        ),
    ],
    ids=["map", "flow", "fixed steps", "reset", "event-driven"],
)
def test_a_derivative_that_is_no_number_is_no_loss_of_rank(system, method):
    """The state stays finite: only the frame says that something is wrong."""
    spectrum = lh.lyapunov_spectrum(system, [1.0], t1=10, blocks=2, method=method, throw=False)
    assert spectrum.status is STATUS.nonfinite
    assert "rank_lost" not in spectrum.notes


@pytest.mark.slow
def test_nonfinite_of_an_exact_flow():
    broken = lh.EventDriven(
        flow=lambda dt, t, x, args: x - dt,
        next_event=lambda t, x, args: (x[0], 0),
        jump=lambda t, x, args, which: x + jnp.where(t < 2.5, 1.0, jnp.nan),
        guard=lambda t, x, args, which: x[0],
    )
    spectrum = lh.lyapunov_spectrum(broken, [1.0], t1=8.0, blocks=BLOCKS, throw=False)
    assert spectrum.status is STATUS.nonfinite
    assert float(spectrum.t) == pytest.approx(3.0, abs=1e-12)
    assert 1 <= computed(spectrum) <= 3


def test_step_underflow_where_the_field_jumps():
    """Friction that jumps at v = 0, without a mode of its own: the ball slides there, and no step is short enough."""
    spectrum = ball_spectrum((0.5, 1.0), t0=1.0, dry=1e9)
    assert spectrum.status is STATUS.step_underflow
    assert abs(float(spectrum.x[1])) < 1e-9
    assert computed(spectrum) == 1


@pytest.mark.slow
def test_stalled_where_a_field_pulls_back_from_both_sides():
    """x' = -sign(x), y' = -y: from t = 1 on each step crosses zero, and none can be long."""
    valley = lh.Flow(lambda t, x, args: jnp.stack([jnp.where(x[0] > 0, -1.0, 1.0), -x[1]]))
    spectrum = lh.lyapunov_spectrum(valley, [1.0, 1.0], t1=1e4, throw=False)
    assert spectrum.status is STATUS.stalled
    assert float(spectrum.t) == pytest.approx(1.0, abs=1e-4)
    assert np.allclose(spectrum.x, [0.0, math.exp(-1.0)], rtol=0, atol=1e-4)


DAMPED = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], -x[0] - 0.2 * x[1] + args * jnp.sin(t)]),
    lh.Transition(lambda t, x, args: x[0] + 0.5, lambda t, x, args: jnp.stack([x[0], -0.9 * x[1]])),
)
FREE = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], -x[0] - 0.2 * x[1]]),
    lh.Transition(lambda t, x, args: x[0] + 0.5, lambda t, x, args: jnp.stack([x[0], -0.9 * x[1]])),
)


@pytest.mark.slow
@pytest.mark.parametrize("method", [METHOD, lh.RungeKutta("rk4", dt=0.05)], ids=["adaptive", "fixed"])
@pytest.mark.parametrize("t1", [4, 400])  # the jump alone in its block, or with others that do not come
def test_no_more_jumps_where_the_motion_comes_to_rest(method, t1):
    """One impact, then the oscillator settles: what is counted ends with the impact, det = e^(-0.2 τ) r²."""
    spectrum = lh.lyapunov_spectrum(FREE, [1.0, 0.0], t1=t1, clock="jumps", method=method, throw=False)
    assert spectrum.status is STATUS.no_more_jumps
    assert spectrum.jumps == 1
    assert np.allclose(spectrum.x, 0.0, rtol=0, atol=1e-6)
    impact = lh.trajectory(FREE, [1.0, 0.0], t1=3.0, n=1, method=METHOD).events.t[0]
    assert float(jnp.sum(spectrum.exponents)) == pytest.approx(-0.2 * float(impact) + 2 * math.log(0.9), abs=1e-6)
    with pytest.raises(lh.RunFailedError, match="no_more_jumps: .*clock='time'"):
        lh.lyapunov_spectrum(FREE, [1.0, 0.0], t1=t1, clock="jumps", method=method)


@pytest.mark.slow
def test_no_more_jumps_where_it_never_comes_to_rest():
    """Forced for ever: nothing says that the wall is out of reach but a million steps without an impact."""
    spectrum = lh.lyapunov_spectrum(DAMPED, [0.0, 0.0], 0.05, t1=10, clock="jumps", k=1, method=METHOD, throw=False)
    assert spectrum.status is STATUS.no_more_jumps
    assert spectrum.jumps == 0
    assert np.isnan(spectrum.exponents).all()


@pytest.mark.slow
def test_no_more_jumps_where_the_motion_leaves_for_ever():
    leaving = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1]]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -2 * x[1]])),
    )
    spectrum = lh.lyapunov_spectrum(leaving, [1.0, -1.0], t1=10, clock="jumps", method=METHOD, throw=False)
    assert spectrum.status is STATUS.no_more_jumps
    assert spectrum.jumps == 1
    assert float(jnp.sum(spectrum.exponents)) == pytest.approx(2 * math.log(2), abs=1e-9)


def wait_for_a_wall(scheduled):
    """A particle that meets one wall, and then nothing; of an exact flow the next event says so."""

    def ahead(y):
        return jnp.where(y[1] < 0, -y[0] / y[1], jnp.inf)

    if not scheduled:
        return lh.EventDriven(
            flow=lambda dt, t, x, args: jnp.stack([x[0] + dt * x[1], x[1]]),
            next_event=lambda t, x, args: (ahead(x), 0),
            jump=lambda t, x, args, which: jnp.stack([0 * x[0], -2 * x[1]]),
            guard=lambda t, x, args, which: x[0],
        )
    return lh.EventDriven(
        flow=lambda dt, y, args: jnp.stack([y[:, 0] + dt * y[:, 1], y[:, 1]], axis=1),
        next_event=None,
        jump=lambda t, rows, args, which: jnp.stack([rows[:, 0] + 3 * t * rows[:, 1], -2 * rows[:, 1]], axis=1),
        guard=lambda t, rows, args, which: rows[0, 0] + t * rows[0, 1],
        schedule=lh.Schedule(
            init=lambda t, y, args: t + ahead(y[0]),
            next=lambda cache: (cache, jnp.asarray(0, jnp.int32)),
            update=lambda cache, t, y, args, which: t + ahead(y[0] + jnp.stack([t * y[0, 1], 0 * t])),
            shift=lambda cache, dt: cache - dt,
            touch=lambda which: which[None],
        ),
    )


@pytest.mark.slow
@pytest.mark.parametrize("scheduled", [False, True], ids=["exact", "scheduled"])
def test_no_more_jumps_of_an_exact_flow(scheduled):
    system, start = wait_for_a_wall(scheduled), [1.0, -1.0]
    start = [start] if scheduled else start
    spectrum = lh.lyapunov_spectrum(system, start, t1=10, clock="jumps", throw=False)
    assert spectrum.status is STATUS.no_more_jumps
    assert (int(spectrum.jumps), float(spectrum.t)) == (1, 1.0)
    assert np.isfinite(spectrum.x).all()
    assert float(jnp.sum(spectrum.exponents)) == pytest.approx(2 * math.log(2), abs=1e-12)
    hybrid = lh.lyapunov_spectrum(system, start, t1=10, clock="hybrid")  # max(t, j) goes on
    assert hybrid.status is STATUS.ok
    assert (int(hybrid.jumps), float(hybrid.time)) == (1, 10.0)


@pytest.mark.slow
def test_a_motion_past_a_slow_point_is_waited_for():
    """x' = a + x² takes π/√a from -∞ to ∞, nearly all of it where x' is about a, with a fast variable beside it."""
    slow = lh.Hybrid(
        lambda t, x, args: jnp.stack([args + x[0] ** 2, -1000.0 * x[1]]),
        lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: -x),
    )
    spectrum = lh.lyapunov_spectrum(slow, [-1.0, 1.0], 1e-3, t1=3, clock="jumps", blocks=3, k=1, method=METHOD)
    passage = 2 * math.atan(1 / math.sqrt(1e-3)) / math.sqrt(1e-3)
    assert spectrum.jumps == 3
    assert float(spectrum.time) == pytest.approx(3 * passage, rel=1e-6)


def test_a_failure_in_the_transient_leaves_no_answer():
    def after(transient, **options):
        return lh.lyapunov_spectrum(ESCAPE, [1.0], 1.0, t1=1.0, transient=transient, blocks=16, throw=False, **options)

    for spectrum, status in (
        (after(2.0), STATUS.nonfinite),
        (after(0.9, max_steps=3), STATUS.max_steps),
    ):
        assert spectrum.status is status
        assert float(spectrum.time) == 0
        assert np.isnan(spectrum.exponents).all()
        assert np.isnan(spectrum.history.time).all()


def test_failures_raise_with_the_result_and_the_causes():
    with pytest.raises(lh.RunFailedError) as caught:
        ball_spectrum((1.0, 0.0), restitution=0.8, throw=True)
    error = caught.value
    assert error.status is STATUS.zeno
    assert error.result.status is STATUS.zeno
    assert computed(error.result) == 6
    for part in ("zeno: events accumulate", "(a)", "(b)", "It stood at t = 12.7279", "throw=False", "accumulate at"):
        assert part in str(error)
    with pytest.raises(lh.RunFailedError, match="max_steps") as caught:
        lh.trajectory(ESCAPE, [1.0], 1.0, t1=0.9, n=4, max_steps=5)
    assert np.isnan(caught.value.result.x[-1]).all()
    with pytest.raises(lh.RunFailedError, match="nonfinite") as caught:
        lh.tangent_map(ESCAPE, [1.0], 1.0, t1=2.0)
    assert caught.value.result.status is STATUS.nonfinite
    assert lh.tangent_map(ESCAPE, [1.0], 1.0, t1=2.0, throw=False).status is STATUS.nonfinite


def test_no_orbit():
    orbit = lh.floquet(LOGISTIC, [0.3], 3.9, period=5, max_iterations=1, throw=False)
    assert orbit.status is STATUS.no_orbit


@pytest.mark.parametrize("status", list(STATUS), ids=lambda status: status.name)
def test_every_status_says_its_name(status):
    assert str(status).startswith(f"{status.name}: ")
    assert len(str(status)) > len(status.name) + 12
    assert status.failed == (status.name not in ("ok", "terminated", "interrupted"))
    assert any(name.startswith(f"test_{status.name}") for name in globals()), "a status without a test that produces it"


# --- notes -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_rank_lost():
    """The second component is thrown away at every tick."""
    forget = lh.Hybrid(
        lambda t, x, args: jnp.stack([0.5 * x[0], -0.1 * x[1]]),
        lh.Transition(every=1.0, reset=lambda t, x, args: jnp.stack([x[0], args * x[1]])),
    )

    def run(factor):
        return lh.lyapunov_spectrum(forget, [1.0, 1.0], factor, t1=8.0, blocks=BLOCKS, method=METHOD)

    lost, kept = run(0.0), run(0.5)
    assert lost.notes == {"rank_lost"}
    assert float(lost.exponents[0]) == pytest.approx(0.5, abs=1e-9)
    assert lost.exponents[1] == -math.inf
    assert math.isnan(lost.stderr[1])
    assert lost.losses.tolist() == [0, 8]
    assert float(lost.loss_rate[1]) == pytest.approx(1.0, abs=1e-12)
    assert float(lost.first_loss[1]) == pytest.approx(1.0, abs=1e-9)
    assert math.isnan(lost.first_loss[0])
    assert lost.sum_rule_residual is None
    assert kept.notes == frozenset()
    assert np.allclose(kept.exponents, [0.5, -0.1 + math.log(0.5)], rtol=0, atol=1e-9)
    assert np.isnan(kept.first_loss).all()


@pytest.mark.slow
def test_grazing():
    """x = cos t meets a wall a little below its maximum: the sine of the angle at the wall tells how little.

    Where it misses the wall by less than the tolerance, it may as well have met it.
    """
    oscillator = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], -x[0]]),
        lh.Transition(lambda t, x, args: args - x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
    )

    def run(wall):
        return lh.lyapunov_spectrum(
            oscillator, [0.0, 1.0], wall, t1=4.0, k=1, blocks=BLOCKS, method=lh.RungeKutta(rtol=1e-12)
        )

    slanting, grazing, missing, exact = run(0.8), run(1 - 1e-8), run(1 + 1e-8), run(1 + 1e-13)
    assert slanting.notes == frozenset()
    assert float(slanting.min_transversality) == pytest.approx(0.6, abs=1e-9)  # v / √(v² + x²)
    assert grazing.notes == {"grazing"}
    assert float(grazing.min_transversality) == pytest.approx(math.sqrt(2e-8), rel=1e-3)
    assert missing.notes == {"guard_unreached"}
    assert missing.min_transversality == math.inf
    assert (int(slanting.jumps), int(grazing.jumps), int(missing.jumps)) == (1, 1, 0)
    # Whether this one meets the wall is beyond what the integration tells.
    assert exact.notes == {"grazing"} | (set() if exact.jumps else {"guard_unreached"})


@pytest.mark.slow
def test_simultaneous_only_where_the_order_matters():
    """Two clocks of sand run out together; one adds 1 to a counter, the other multiplies it."""

    def turned(i):
        def reset(t, x, args):
            count = x[2] + 1 if i == 0 else args * x[2]
            return jnp.stack([x[0] + float(i == 0), x[1] + float(i == 1), count])

        return lh.Transition(lambda t, x, args: x[i], reset)

    sand = lh.Hybrid(lambda t, x, args: jnp.stack([0 * x[0] - 1, 0 * x[1] - 1, 0 * x[2]]), [turned(0), turned(1)])

    def run(factor, second=0.5):
        return lh.lyapunov_spectrum(sand, [0.5, second, 1.0], factor, t1=0.8, k=1, blocks=BLOCKS, method=METHOD)

    matters, equal, apart = run(2.0), run(1.0), run(2.0, 0.4)
    assert matters.jumps == equal.jumps == apart.jumps == 2
    assert matters.notes == {"simultaneous"}
    assert equal.notes == apart.notes == frozenset()
    assert float(matters.x[2]) == pytest.approx(4.0, abs=1e-12)  # the first transition goes first


@pytest.mark.slow
def test_guard_unreached():
    """A wall at 0.8 is met by x = cos t, one at 1.2 is not; one met in the transient was met."""
    oscillator = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], -x[0]]),
        lh.Transition(lambda t, x, args: args - x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
    )

    def notes(wall, **options):
        return lh.lyapunov_spectrum(oscillator, [0.0, 1.0], wall, **({"t1": 4.0, "k": 1, "blocks": 2} | options)).notes

    assert notes(0.8) == frozenset()
    assert notes(1.2) == {"guard_unreached"}
    assert notes(0.8, transient=1.0, t1=0.1) == frozenset()


def test_step_too_long():
    """The exact sum is -0.1; a step of RK4 takes other areas than the flow does, by its own polynomial."""
    damped = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0] - 0.1 * x[1]]))

    def run(dt, k=None, **options):
        method = lh.RungeKutta("rk4", dt=dt)
        return lh.lyapunov_spectrum(damped, [1.0, 0.0], t1=400.0, blocks=4, method=method, k=k, **options)

    long, short = run(2.0), run(0.05)
    assert long.notes == {"step_too_long"}
    step = np.array([[0.0, 2.0], [-2.0, -0.2]])
    powers = [np.linalg.matrix_power(step, i) / math.factorial(i) for i in range(5)]
    volume = math.log(abs(np.linalg.det(sum(powers)))) / 2.0
    assert float(jnp.sum(long.exponents)) == pytest.approx(volume, abs=1e-9)
    assert abs(volume + 0.1) > 0.05
    assert short.notes == frozenset()
    assert run(2.0, k=1).notes == {"step_too_long"}  # with fewer columns some steps tell
    assert run(0.05, k=1).notes == frozenset()


def test_unresolved():
    saddle = lh.Flow(lambda t, x, args: jnp.stack([x[0], -x[1]]))
    rare, often = (lh.lyapunov_spectrum(saddle, [0.0, 0.0], t1=40.0, every=every, blocks=2) for every in (100.0, 1.0))
    assert rare.notes == {"unresolved"}
    assert often.notes == frozenset()
    assert np.allclose(often.exponents, [1, -1], atol=1e-8)


@pytest.mark.slow_cases("hybrid")
@pytest.mark.parametrize("transitions", [None, lh.Transition(lambda t, x, args: 1.0 + x[0])], ids=["flow", "hybrid"])
def test_unresolved_from_the_step_on_that_the_interval_allows(transitions):
    """Rates ±100, a step of 0.01: RK4 spreads two columns by 1.977 a step, and e²⁵ is passed at the thirteenth."""

    def field(t, x, args):
        return args * x * jnp.array([1.0, -1.0])

    system = lh.Flow(field) if transitions is None else lh.Hybrid(field, transitions)
    method = lh.RungeKutta("rk4", dt=0.01)

    def notes(every):  # 12 000 steps in two blocks: several calls, none of them a multiple of 13
        return lh.lyapunov_spectrum(system, [0.0, 0.0], 100.0, t1=120.0, blocks=2, method=method, every=every).notes

    # One step of RK4 multiplies areas by 2.7083 · 0.375 = 1.0156, not by 1.
    always = {"step_too_long"} | ({"guard_unreached"} if transitions else set())
    assert notes(12) == always
    assert notes(13) == always | {"unresolved"}


@pytest.mark.slow
def test_interrupted_keeps_what_is_computed():
    seen = []

    def stop(fraction):
        seen.append(fraction)
        if fraction > 0:
            raise KeyboardInterrupt

    with pytest.warns(UserWarning, match="interrupted"):
        spectrum = lh.lyapunov_spectrum(LOGISTIC, [0.3], 4.0, t1=50_000_000, blocks=4096, progress=stop)
    assert spectrum.notes == {"interrupted"}
    assert spectrum.status is STATUS.interrupted
    assert 0 < seen[-1] < 1
    count = computed(spectrum)
    assert 0 < count < 4096
    assert abs(float(spectrum.exponents[0]) - math.log(2)) < 0.1


@pytest.mark.slow
def test_identity_reset():
    """A jump that hands back the state is told, where neither the mode changes nor the run ends."""

    def guard(t, x, args):
        return x[0] - 0.5

    def same(t, x, args):
        return x

    def notes(*transitions, **modes):
        system = lh.Hybrid(modes or (lambda t, x, args: -x), list(transitions))
        start = {"mode": "before"} if modes else {}
        return lh.lyapunov_spectrum(system, [1.0], t1=4.0, blocks=2, **start).notes

    assert notes(lh.Transition(guard, same)) == {"identity_reset"}
    assert notes(lh.Transition(guard, lambda t, x, args: 2 * x)) == frozenset()
    assert notes(lh.Transition(guard)) == frozenset()  # said on purpose
    assert notes(lh.Transition(guard, same, terminal=True)) == frozenset()
    fields = {"before": lambda t, x, args: -x, "after": lambda t, x, args: -2 * x}
    assert notes(lh.Transition(guard, same, source="before", target="after"), **fields) == frozenset()
    vector = lh.Transition(lambda t, x, args: jnp.stack([x[0] - 0.5, x[0] + 0.7]), lambda t, x, args, which: x)
    assert notes(vector) == {"identity_reset"}
