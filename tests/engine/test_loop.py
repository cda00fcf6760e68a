"""The loop by itself: when it orthonormalises, what an attempt is, how blocks, logs and windows end."""

from fractions import Fraction
from types import SimpleNamespace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lyaphybrid as lh
from examples import alone, between_walls, wall_ahead
from lyaphybrid.engine import loop, preparation, stalling, states
from lyaphybrid.engine.blocks import targets_for
from lyaphybrid.engine.host import driver
from lyaphybrid.engine.problems import RunPlan
from lyaphybrid.engine.states import QRSchedule
from lyaphybrid.native.lowering.lowering import lower
from lyaphybrid.statuses import RUNNING, STATUS

ROOM = 100


class Instants(NamedTuple):
    """The times of orthonormalisations."""

    count: jnp.ndarray
    times: jnp.ndarray  # (ROOM,)


class Instant:
    """An observer of these times."""

    def init(self, t, frame):
        return Instants(jnp.asarray(0), jnp.zeros(ROOM))

    def update(self, state, seen):
        return Instants(state.count + 1, state.times.at[state.count].set(seen.t))

    def moved(self, state, source):
        return state

    def next_block(self, state):
        return state

    def __hash__(self):
        return 1

    def __eq__(self, other):
        return isinstance(other, Instant)


def begun(system, x0, plan, *, method=None, every=1.0):
    """The problem, and the state at the start of its run."""
    problem, x0, t0, mode = preparation.prepare(system, x0, None, 0.0, method, None)
    return problem, driver.start(problem, plan, t0, x0, jnp.eye(x0.shape[0]), mode, jnp.asarray(every))


def advanced(system, x0, ends, plan, *, budget=10**6, clock="time", **more):
    """The state and the records after one call of the loop."""
    problem, loop_state = begun(system, x0, plan, **more)
    targets = targets_for(np.asarray(ends, float), clock, isinstance(system, lh.Map), np.dtype(float))
    return driver.once(problem, plan, loop_state, *targets, np.int32(budget))


def instants(system, x0, ends, unit="steps", every=3.0, **more):
    """When a run orthonormalises its frame."""
    plan = RunPlan(QRSchedule(unit, False), observer=Instant(), count_jumps=more.get("clock") == "jumps")
    loop_state, records = advanced(system, x0, ends, plan, every=every, **more)
    assert np.all(records.valid)
    seen = loop_state.carry.observer
    return np.asarray(seen.times[: int(seen.count)])


# --- orthonormalisations ---------------------------------------------------------------------------------------------

HALVED = lh.Map(lambda n, x, args: 0.5 * x)
FALLING = lh.Hybrid(
    lambda t, x, args: -jnp.ones_like(x), lh.Transition(lambda t, x, args: x[0], lambda t, x, args: x + 1.0)
)
RK4 = lh.RungeKutta("rk4", dt=0.125)  # so that times are exact
COUNTING = lh.EventDriven(  # an event each unit of time
    lambda dt, t, x, args: x - dt,
    lambda t, x, args: (x[0], 0),
    lambda t, x, args, which: x + 1.0,
    lambda t, x, args, which: x[0],
)


def test_a_map_orthonormalises_when_it_is_due_and_at_the_ends_of_blocks():
    assert_array_equal(instants(HALVED, [1.0], [4, 10]), [3, 4, 7, 10])


def test_a_flow_with_guards_orthonormalises_when_it_is_due_and_at_the_ends_of_blocks():
    """Steps of 1/8, the third of each three; the guard is at zero at t = 100."""
    assert_allclose(instants(FALLING, [100.0], [0.5, 1.0], method=RK4), [0.375, 0.5, 0.875, 1.0], rtol=1e-15)


def test_a_reset_orthonormalises_before_and_after():
    assert_allclose(instants(FALLING, [0.3], [1.0], every=100.0, method=RK4), [0.3, 0.3, 1.0], rtol=1e-14)


@pytest.mark.slow
def test_in_a_block_of_jumps_too_and_once_more_only_at_its_end():
    found = instants(FALLING, [0.3], [1, 3], every=100.0, method=RK4, clock="jumps")
    assert_allclose(found, [0.3, 0.3, 0.3, 1.3, 1.3, 2.3, 2.3, 2.3], rtol=1e-14)


@pytest.mark.slow
def test_events_orthonormalise_when_they_are_due_and_at_the_last_jump_of_a_block():
    assert_array_equal(instants(COUNTING, [1.0], [4.5, 11.5], unit="jumps"), [3, 4.5, 7, 10, 11.5])
    assert_array_equal(instants(COUNTING, [1.0], [4, 10], unit="jumps", clock="jumps"), [3, 4, 7, 10])


@pytest.mark.parametrize(
    ("factor", "automatic", "expected"), [(200, True, [1, 2, 3.5]), (1, True, [3.5]), (200, False, [3.5])]
)
def test_a_frame_that_a_jump_has_stretched_is_orthonormalised_at_once(factor, automatic, expected):
    """By more than `STRETCHED`: before the interval has passed, unless the user fixed it. The last goes with the flight
    to the end.
    """
    stretching = lh.EventDriven(
        lambda dt, t, x, args: jnp.stack([x[0] - dt, x[1]]),
        lambda t, x, args: (x[0], 0),
        lambda t, x, args, which: jnp.stack([x[0] + 1.0, factor * x[1]]),
        lambda t, x, args, which: x[0],
    )
    plan = RunPlan(QRSchedule("jumps", automatic), observer=Instant())
    seen = advanced(stretching, [1.0, 1.0], [3.5], plan, every=4.0)[0].carry.observer
    assert_array_equal(seen.times[: int(seen.count)], expected)


def test_small_entries_of_a_frame_are_looked_at_only_where_a_direction_is_lost():
    """Until then 1e-17 may be rounding or not: intervals stay as long as they are."""
    nearly_apart = lh.Map(lambda n, x, args: jnp.stack([2 * x[0], 0.5 * x[1] + 1e-17 * x[0]]))
    assert_array_equal(instants(nearly_apart, [1.0, 1.0], [7]), [3, 6, 7])


@pytest.mark.slow
def test_what_is_lost_is_lost_once():
    """A reset that destroys a direction each time: two of three columns stay, their growth is that of the jumps."""
    crushing = lh.Hybrid(
        lambda t, x, args: jnp.stack([-jnp.ones_like(t), 0 * x[1], 0 * x[2]]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0] + 1.0, 2 * x[1], 0 * x[2]])),
    )
    plan = RunPlan(QRSchedule("steps", True), sum_rule=True)
    loop_state, records = advanced(crushing, [0.5, 1.0, 1.0], [2.0, 4.0], plan, method=RK4)
    assert_array_equal(np.sum(records.losses, axis=1), [2, 4])
    assert_array_equal(np.asarray(records.valid), [True, True])
    assert_allclose(np.max(records.growth, axis=1), 2 * np.log(2.0), rtol=1e-12)
    assert_array_equal(np.sort(records.order, axis=1), [[0, 1, 2]] * 2)
    assert_array_equal(loop_state.carry.order, [0, 1, 2])  # a new block begins


# --- attempts --------------------------------------------------------------------------------------------------------

DECAY = lh.Flow(lambda t, x, args: -x)
ATTEMPTS = {
    "map": (HALVED, [1.0], 10.0, None, QRSchedule("steps", False, each=True), 10),
    "map, every 3": (HALVED, [1.0], 10.0, None, QRSchedule("steps", False), 10),
    "flow": (DECAY, [1.0], 2.0, RK4, QRSchedule("steps", False, each=True), 16),
    "flow, never": (DECAY, [1.0], 2.0, RK4, QRSchedule("never", False), 16),
}


@pytest.mark.parametrize("name", ATTEMPTS)
def test_a_step_is_one_attempt(name):
    """With one attempt fewer the block is not finished; what is not needed is left."""
    system, x0, end, method, schedule, needed = ATTEMPTS[name]
    for budget, left in ((needed - 1, 0), (needed, 0), (needed + 7, 7)):
        loop_state, records = advanced(system, x0, [end], RunPlan(schedule), method=method, budget=budget)
        assert bool(records.valid[0]) == bool(loop_state.block) == (budget >= needed)
        assert int(loop_state.carry.budget) == left
        assert int(loop_state.carry.status) == RUNNING


def test_a_run_that_has_ended_takes_no_attempts():
    plan = RunPlan(QRSchedule("steps", False, each=True))
    problem, loop_state = begun(HALVED, [1.0], plan)
    ended = loop_state._replace(carry=loop_state.carry._replace(status=jnp.asarray(STATUS.terminated, jnp.int32)))
    after, records = driver.once(problem, plan, ended, np.array([5.0]), np.array([np.inf]), np.int32(10))
    assert (float(after.carry.x[0]), float(after.carry.s)) == (1.0, 0.0)
    assert int(after.carry.budget) == 0


EACH = QRSchedule("steps", False, each=True)
AT_ONCE = {
    "flow": (DECAY, [1.0], lh.RungeKutta(), RunPlan(EACH), True),
    "sometimes": (DECAY, [1.0], lh.RungeKutta(), RunPlan(EACH._replace(each=False)), False),
    "observed": (DECAY, [1.0], lh.RungeKutta(), RunPlan(EACH, observer=Instant()), False),
    "fixed step": (DECAY, [1.0], RK4, RunPlan(EACH), False),
    "guards": (FALLING, [0.3], lh.RungeKutta(), RunPlan(EACH), False),
}


@pytest.mark.parametrize("name", AT_ONCE)
def test_where_a_step_also_orthonormalises(name):
    """Where a step may be rejected, and nothing else is to be done between two steps."""
    system, x0, method, plan, expected = AT_ONCE[name]
    problem, state = begun(system, x0, plan, method=method)
    assert loop._at_once(driver.settings_of(problem, plan, state.base[0], state.carry.x)) == expected


def test_what_has_only_regular_steps_orthonormalises_without_a_branch():
    """The one that there is belongs to the windows."""
    plan = RunPlan(QRSchedule("steps", False))
    problem, state = begun(DECAY, [1.0], plan, method=RK4)
    targets = targets_for(np.array([4.0]), "time", False, np.dtype(float))
    text = str(jax.make_jaxpr(lambda state: driver._loop(problem, plan, state, *targets, 10))(state))
    assert text.count(" cond[") == 1


# --- the ends of blocks ----------------------------------------------------------------------------------------------


def test_what_is_collected_is_that_of_the_end_of_a_block():
    plan = RunPlan(collect=lambda t, carry: (t, carry.x))
    _, records = advanced(HALVED, [1.0], [2, 5], plan)
    times, points = records.collected
    assert_array_equal(times, [2.0, 5.0])
    assert_array_equal(points[:, 0], [0.25, 0.5**5])


GROWING = {
    "map": (lh.Map(lambda n, x, args: jnp.stack([0.5 * x[0], x[1] + 1e308])), None),
    "flow": (lh.Flow(lambda t, x, args: jnp.stack([-x[0], 0 * x[1] + 1e308])), RK4),
}


@pytest.mark.parametrize("name", GROWING)
def test_a_state_one_component_of_which_is_no_number_is_not_finite(name):
    """The frame, one column along the other component, does not see it."""
    system, method = GROWING[name]
    problem, x0, t0, mode = preparation.prepare(system, [1.0, 0.0], None, 0.0, method, None)
    plan = RunPlan(QRSchedule("steps", False))
    loop_state = driver.start(problem, plan, t0, x0, jnp.eye(2)[:, :1], mode, jnp.asarray(1.0))
    after, _ = driver.once(problem, plan, loop_state, np.array([9.0]), np.array([np.inf]), np.int32(100))
    assert int(after.carry.status) == STATUS.nonfinite


@pytest.mark.parametrize(("start", "step"), [(1e6 + 0.1, 0.1), (0.1, 1e6 + 0.3)])
def test_the_time_is_kept_in_twice_the_digits(start, step):
    """The sum of a hundred lengths of blocks, against fractions."""
    nothing = jnp.zeros(2)
    settings = SimpleNamespace(evolver=SimpleNamespace(rebase=lambda solver, s: solver), observer=None)
    carry = states.StepState(
        s=jnp.asarray(step), x=nothing, frame=nothing, since=0, budget=7, status=0, jumps=3, growth=nothing + 1,
        log_volume=jnp.asarray(2.0), losses=None, first_loss=None, order=jnp.asarray([1, 0]), foreign=None,
        solver_state=None,
        log=None, left=states.Compensation(jnp.asarray(1e-9), nothing + 1e-9, None),
    )  # fmt: skip
    state, exact = states.LoopState(carry, jnp.asarray([start, 0.0]), 0.0, 0, 1.0, 0.0), Fraction(start)
    for _ in range(100):
        state = loop._next_block(settings, state._replace(carry=state.carry._replace(s=jnp.asarray(step))))
        exact += Fraction(step)
    high, low = map(Fraction, np.asarray(state.base).tolist())
    assert abs(high + low - exact) < Fraction(2) ** -90 * exact
    assert abs(low) < Fraction(2) ** -45 * exact
    assert int(state.block) == 100
    assert float(state.elapsed) == pytest.approx(100 * step)
    cleared = (state.carry.s, state.carry.log_volume, *state.carry.growth, state.carry.left.s, *state.carry.left.growth)
    assert_array_equal(cleared, 0.0)
    assert_array_equal(state.carry.order, [0, 1])
    assert (state.carry.jumps, state.carry.budget) == (3, 7)


# --- logs and windows ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_log_keeps_room_for_a_cascade():
    """With room for two more than a cascade it pauses at the third event; the host empties it, and it goes on."""
    plan = RunPlan(log=states.MOST_AT_ONCE + 2)
    loop_state, records = advanced(COUNTING, [1.0], [10.5], plan)
    assert int(loop_state.carry.log.count) == 3
    assert_array_equal(loop_state.carry.log.t[:3], [1.0, 2.0, 3.0])
    assert not bool(records.valid[0])
    loop_state, _ = advanced(FALLING, [0.3], [10.5], plan, method=RK4)
    assert int(loop_state.carry.log.count) == 3


@pytest.fixture
def small_windows(monkeypatch):
    """Windows of ten attempts, of a thousand in all."""
    monkeypatch.setattr(stalling, "ATTEMPTS_OF_WINDOW", 10)
    monkeypatch.setattr(stalling, "FOREVER", 1000)


def test_the_end_of_a_run_is_that_of_its_last_block(small_windows):
    """After three windows it is clear that 1e9 iterations will not be reached by a thousand attempts."""
    run = jax.jit(lambda x: advanced(HALVED, x, [5, 6, 7, 1e9], RunPlan(), budget=1000)[0])
    loop_state = run(jnp.ones(1))
    assert int(loop_state.carry.status) == STATUS.stalled
    assert float(loop_state.elapsed + loop_state.carry.s) == 30.0
    loop_state = jax.jit(lambda x: advanced(HALVED, x, [5, 6, 7, 99], RunPlan(), budget=1000)[0])(jnp.ones(1))
    assert int(loop_state.carry.status) == RUNNING
    assert int(loop_state.block) == 4


def test_the_last_jump_of_a_run_is_that_of_its_last_block(small_windows):
    plan = RunPlan(count_jumps=True)

    def run(last):
        return jax.jit(lambda x: advanced(COUNTING, x, [5, 6, 7, last], plan, budget=1000, clock="jumps")[0])(
            jnp.ones(1)
        )

    loop_state = run(1e9)
    assert int(loop_state.carry.status) == STATUS.stalled
    assert int(loop_state.carry.jumps) == 30
    loop_state = run(99)
    assert (int(loop_state.carry.status), int(loop_state.block)) == (RUNNING, 4)


# --- reverse derivatives ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reverse", [False, True])
def test_only_what_is_differentiated_backwards_keeps_checkpoints(reverse):
    plan = RunPlan(QRSchedule("steps", False, each=True))
    problem, loop_state = begun(HALVED, [1.0], plan)
    targets = targets_for(np.array([4.0]), "time", True, np.dtype(float))
    closed = jax.make_jaxpr(lambda state: driver._loop(problem, plan, state, *targets, 10, reverse=reverse))(loop_state)
    assert any(name in str(closed) for name in ("remat", "checkpoint")) == reverse


@pytest.mark.slow_cases("1000000.0")
@pytest.mark.parametrize("t0", [0.0, 1e6])
def test_the_time_of_a_field_does_not_drift_over_many_blocks(t0):
    """ẋ = cos t − x from its periodic motion; each block's start rounds the time, and what is cut off is kept."""

    def periodic(t):
        return (np.cos(t) + np.sin(t)) / 2

    blocks = 10_000
    first = 100.0 / blocks
    found = lh.covariant_vectors(
        lh.Flow(lambda t, x, args: jnp.cos(t) - x), [periodic(t0)], t0=t0, t1=100.0, blocks=blocks, transient=first,
        settle=1.0, method=lh.RungeKutta("dopri8", rtol=1e-12, atol=1e-14),
    )  # fmt: skip
    off = np.asarray(found.x)[:, 0] - periodic(t0 + first + np.asarray(found.time))
    assert np.max(np.abs(off)) < 1e-12 + np.spacing(t0)


# --- calls -----------------------------------------------------------------------------------------------------------

BODIES = lh.EventDriven(  # two between walls at 0 and 1
    lambda dt, y, args: jnp.stack([y[:, 0] + dt * y[:, 1], y[:, 1]], axis=1),
    None,
    lambda t, rows, args, which: jnp.stack([rows[:, 0] + 2 * t * rows[:, 1], -rows[:, 1]], axis=1),
    between_walls,
    schedule=alone(wall_ahead),
)
STARTS = [[0.2, 0.31], [0.7, -0.13]]
CALLS = {
    "map": (lh.Map(lambda n, x, args: 3.7 * x * (1 - x)), [0.3], 50.0, None, QRSchedule("steps", False), 3.0),
    "guards": (FALLING, [0.3], 3.0, lh.RungeKutta(), QRSchedule("steps", True), 1.0),
    "guards, by time": (FALLING, [0.3], 3.0, lh.RungeKutta(), QRSchedule("time", False), 0.3),
    "events": (COUNTING, [0.3], 9.5, None, QRSchedule("jumps", True), 1.0),
    "events, by time": (COUNTING, [0.3], 9.5, None, QRSchedule("time", False), 0.3),
    "bodies": (BODIES, STARTS, 20.0, None, QRSchedule("jumps", True), 1.0),
    "bodies, by time": (BODIES, STARTS, 20.0, None, QRSchedule("time", False), 0.3),
}


@pytest.mark.slow_cases("bodies", "bodies, by time", "guards")
@pytest.mark.parametrize("name", CALLS)
def test_the_bits_do_not_depend_on_where_calls_end(name):
    """One attempt a call, or all at once; many orthonormalisations lie between two events, and none is left out."""
    system, x0, end, method, schedule, every = CALLS[name]
    plan = RunPlan(schedule, observer=Instant())
    problem, state = begun(system, x0, plan, method=method, every=every)
    targets = targets_for(np.array([end / 4, end]), "time", isinstance(system, lh.Map), np.dtype(float))
    whole, _ = driver.once(problem, plan, state, *targets, np.int32(10**6))
    assert schedule.unit != "time" or int(whole.carry.observer.count) >= end / every
    for _ in range(200):
        if int(state.block) < 2:
            state, _ = driver.once(problem, plan, state, *targets, np.int32(1))
    for one, other in zip(jax.tree.leaves(emptied(state)), jax.tree.leaves(emptied(whole)), strict=True):
        assert_array_equal(one, other)


def emptied(loop_state):
    """The state without the attempts that are left."""
    return loop_state._replace(carry=loop_state.carry._replace(budget=0))


@pytest.mark.slow
def test_a_transient_within_a_traced_program_is_the_same_code():
    """A sweep's program holds the loop once, for the transient and for what is counted."""
    oscillator = lh.zoo.impact_oscillator()

    def run(omega, transient=0.0, throw=False):
        args = oscillator.args | {"omega": omega}
        return oscillator.spectrum(args=args, t1=20.0, transient=transient, blocks=10, throw=throw)

    def size(transient):
        return lower(jax.make_jaxpr(lambda omega: run(omega, transient).exponents)(2.5), 16).count("\n")

    assert size(10.0) < 1.3 * size(0.0)
    assert_array_equal(jax.jit(lambda omega: run(omega, 10.0).exponents)(2.5), run(2.5, 10.0).exponents)
