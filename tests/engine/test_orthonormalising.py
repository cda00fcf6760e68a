"""One orthonormalisation: what is added to the sums, the next interval, which columns are lost; in pairs of numbers."""

from types import SimpleNamespace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import lyaphybrid as lh
from lyaphybrid import native
from lyaphybrid.engine import orthonormalising, preparation
from lyaphybrid.engine.binding import settings_of
from lyaphybrid.engine.host import driver
from lyaphybrid.engine.problems import RunPlan
from lyaphybrid.engine.states import Clock, QRSchedule
from lyaphybrid.statuses import RUNNING, STATUS

AUTOMATIC = QRSchedule("steps", True)
CLOCK = Clock(jnp.asarray(7.0), jnp.asarray(0.0), jnp.asarray(100.0), jnp.asarray(jnp.inf))


class Seen(NamedTuple):
    """How many orthonormalisations there were, the sum of their times, and where the columns come from."""

    count: jnp.ndarray
    times: jnp.ndarray
    source: jnp.ndarray  # (k,)


class Counting:
    """An observer of this."""

    def init(self, t, frame):
        return Seen(jnp.asarray(0), jnp.asarray(0.0), jnp.arange(frame.shape[1], dtype=jnp.int32))

    def update(self, state, seen):
        return Seen(state.count + 1, state.times + seen.t, state.source)

    def moved(self, state, source):
        return state._replace(source=state.source[source])

    def next_block(self, state):
        return state


def begun(rule, frame, x=None, plan=None):
    """Settings and state of a map's run with this frame; growth and spread have been there before."""
    frame = jnp.asarray(frame)
    plan = plan or RunPlan(AUTOMATIC, observer=Counting())
    x = jnp.ones(frame.shape[0]) if x is None else jnp.asarray(x)
    problem, x0, t0, mode = preparation.prepare(lh.Map(rule), x, None, 7.0, None, None)
    state = driver.start(problem, plan, t0, x0, frame, mode, jnp.asarray(4.0))
    carry = state.carry._replace(growth=jnp.full(frame.shape[1], 0.25), s=jnp.asarray(3.0), budget=jnp.asarray(9))
    return settings_of(problem, plan, state.base[0], x0), carry


def orthonormalised(settings, carry, interval=4.0, spread=0.5):
    """The state, the interval and the spread after one orthonormalisation."""

    def run(carry):
        return orthonormalising.orthonormalise(settings, CLOCK, carry, (), jnp.asarray(interval), jnp.asarray(spread))

    carry, ahead, interval, spread = native.compile(run, carry)(carry)
    assert ahead == ()
    assert float(carry.since) == 0.0
    return carry, float(interval), float(spread)


# --- the next interval -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("since", "interval", "gained", "expected"),
    [
        (4, 4, (3, -1), 4),  # ln(R_11 / R_kk) = 4 is aimed at
        (3, 3, (3, -2), 2),  # 2.4
        (4, 4, (2.5, 0.5), 6),  # 6.4: what all columns grow counts, too
        (4, 4, (-0.5, -2.5), 6),
        (4, 4, (1, 0), 8),  # at most twice as long
        (4, 4, (0, 0), 8),
        (4, 4, (8, -8), 2),  # at least half as long
        (1, 1, (9, -9), 1),
        (16, 16, (1, 0), 20),  # the longest
        (2, 4, (1, 0), 4),  # too early to tell
        (2, 4, (8, 0), 2),
    ],
)
def test_intervals_aim_at_a_spread(since, interval, gained, expected):
    evolver = SimpleNamespace(
        kept_to_constraints=lambda carry, clock: carry, jumps_uncontrolled=False, may_lose_rank=True,
        longest_interval=20.0, spread_wanted=4.0,
    )  # fmt: skip
    for schedule in (AUTOMATIC, AUTOMATIC._replace(automatic=False)):
        plan = RunPlan(schedule, observer=Counting())
        settings, carry = begun(lambda n, x, args: x, np.diag(np.exp(gained)), plan=plan)
        settings, carry = settings._replace(evolver=evolver), carry._replace(since=jnp.asarray(float(since)))
        carry, found, spread = orthonormalised(settings, carry, float(interval))
        assert found == (expected if schedule.automatic else interval)
        assert_allclose(spread, max(*gained, 0) - min(*gained, 0) or 0.5, rtol=1e-14)
        assert_allclose(carry.growth, np.add(gained, 0.25), rtol=1e-14)
        assert (int(carry.status), float(carry.observer.times)) == (RUNNING, 10.0)


def test_a_frame_that_is_no_number_changes_no_sum():
    settings, carry = begun(lambda n, x, args: x, [[1.0, 0.0], [0.0, np.nan]])
    carry, _, spread = orthonormalised(settings, carry)
    assert int(carry.status) == STATUS.nonfinite
    assert_array_equal(carry.growth, 0.25)
    assert spread == 0.5


# --- lost columns ----------------------------------------------------------------------------------------------------


def test_what_is_lost_moves_to_the_end_and_is_counted():
    """The second of three columns, then the new second one; the time of a column's first loss stays."""
    settings, carry = begun(lambda n, x, args: x, [[2.0, 2.0, 0.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.0]])
    carry = carry._replace(since=jnp.asarray(1.0))
    carry, *_ = orthonormalised(settings, carry)
    assert_allclose(carry.growth, 0.25 + np.log([2.0, 3.0, 1.0]), rtol=1e-14)
    assert_array_equal(carry.order, [0, 2, 1])
    assert_array_equal(carry.observer.source, [0, 2, 1])
    assert_array_equal(carry.losses, [0, 0, 1])
    assert_array_equal(carry.first_loss, [np.nan, np.nan, 10.0])
    assert_allclose(np.abs(carry.frame), np.eye(3), atol=1e-15)
    carry = carry._replace(frame=np.asarray(carry.frame) * [1.0, 0.0, 1.0], s=jnp.asarray(4.0), since=jnp.asarray(1.0))
    carry, *_ = orthonormalised(settings, carry)
    assert_array_equal(carry.order, [0, 1, 2])
    assert_array_equal(carry.losses, [0, 1, 1])
    assert_array_equal(carry.first_loss, [np.nan, 10.0, 11.0])
    carry = carry._replace(frame=np.asarray(carry.frame) * [1.0, 0.0, 1.0], s=jnp.asarray(5.0), since=jnp.asarray(1.0))
    carry, *_ = orthonormalised(settings, carry)
    assert_array_equal(carry.losses, [0, 1, 2])
    assert_array_equal(carry.first_loss, [np.nan, 11.0, 10.0])


@pytest.mark.parametrize(
    ("unit", "since", "lost"), [("steps", 1.0, True), ("steps", 2.0, False), ("time", 0.3, True), ("time", 9.0, True)]
)
def test_a_short_column_is_lost_where_one_jump_made_it(unit, since, lost):
    """After several it may have been shortened by all of them; by time, each jump makes an orthonormalisation due."""
    settings, carry = begun(lambda n, x, args: x, np.diag([1.0, 1e-15]), plan=RunPlan(QRSchedule(unit, False)))
    carry, *_ = orthonormalised(settings, carry._replace(since=jnp.asarray(since)))
    assert_array_equal(carry.losses, [0, lost])


def test_columns_that_were_empty_before_are_not_lost_again():
    settings, carry = begun(lambda n, x, args: x, np.eye(2))
    found = jnp.diag(jnp.array([1.0, 0.0])), jnp.zeros(2), jnp.array([False, True])
    carry = orthonormalising.accumulate(settings, carry, 7.0, found, was_live=jnp.array([True, False]))
    assert_array_equal(carry.losses, [0, 0])
    assert_array_equal(carry.first_loss, [np.nan, np.nan])


# --- twice the digits ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("columns", "n", "unit", "expected"),
    [
        (2, 2, "steps", True),
        (1, 2, "steps", True),
        (0, 2, "steps", False),
        (2, 2, "never", False),
        (2, 17, "steps", False),
    ],
)
def test_where_twice_the_digits_are_needed(columns, n, unit, expected):
    """Where columns are followed, of few components, and nothing is differentiated backwards."""
    settings, carry = begun(lambda n, x, args: 2 * x, np.eye(n, columns), plan=RunPlan(QRSchedule(unit, False)))
    for reverse, wanted in ((False, expected), (True, False)):
        settings = settings._replace(reverse=reverse)
        assert orthonormalising.needs_twice_the_digits(settings, CLOCK, carry, ()) == wanted


@pytest.mark.parametrize(("uncontrolled", "loses"), [(True, False), (False, True), (False, False)])
def test_where_no_jump_may_destroy_a_direction_they_are_not(uncontrolled, loses):
    settings, carry = begun(lambda n, x, args: 2 * x, np.eye(2))
    evolver = SimpleNamespace(jumps_uncontrolled=uncontrolled, may_lose_rank=loses, tangent=lambda *_: lambda dx: dx)
    assert not orthonormalising.needs_twice_the_digits(settings._replace(evolver=evolver), CLOCK, carry, ())


def stepped(rule, frame, since=0.0, **more):
    """The state, the interval and the spread after one step."""
    settings, carry = begun(rule, frame, **more)
    carry = carry._replace(since=jnp.asarray(since))

    def step(carry):
        start = carry, (), jnp.asarray(4.0), jnp.asarray(0.5)
        return orthonormalising.step_with_twice_the_digits(settings, CLOCK, *start)

    carry, ahead, interval, spread = native.compile(step, carry)(carry)
    assert ahead == ()
    assert float(carry.since) == 0.0
    return carry, float(interval), float(spread)


@pytest.mark.slow_cases("False")
@pytest.mark.parametrize("automatic", [True, False])
def test_a_step_with_twice_the_digits(automatic):
    plan = RunPlan(QRSchedule("steps", automatic), observer=Counting(), sum_rule=True)
    rule = lambda n, x, args: jnp.stack([2 * x[0], 0.25 * x[1]])  # noqa: E731
    carry, interval, spread = stepped(rule, np.eye(2), plan=plan)
    assert_allclose(carry.growth, 0.25 + np.log([2.0, 0.25]), rtol=1e-15)
    assert_allclose(carry.log_volume, np.log(0.5), rtol=1e-15)
    assert_array_equal(carry.x, [2.0, 0.25])
    assert (float(carry.s), int(carry.budget), int(carry.status)) == (4.0, 8, RUNNING)
    assert (interval, spread) == (1.0 if automatic else 4.0, 0.5)
    assert int(carry.observer.count) == 1


def test_a_frame_that_is_not_orthonormal_becomes_so_first():
    carry, _, spread = stepped(lambda n, x, args: 3 * x, np.diag(np.exp([2.0, -1.0])), since=0.5)
    assert_allclose(carry.growth, np.array([2.25, -0.75]) + np.log(3.0), rtol=1e-14)
    assert_allclose(spread, 3.0, rtol=1e-15)
    assert (int(carry.observer.count), float(carry.observer.times)) == (2, 10.0 + 11.0)


@pytest.mark.slow
def test_what_is_lost_for_certain_and_what_is_only_rounding():
    """0.1 · 2.1 − 0.3 · 0.7 is zero, or rounding of these numbers: then the spread says that nobody knows."""
    carry, _, spread = stepped(lambda n, x, args: jnp.stack([2 * x[0], 0 * x[1]]), np.eye(2))
    assert_allclose(carry.growth, 0.25 + np.log([2.0, 1.0]), rtol=1e-15)
    assert_array_equal(carry.losses, [0, 1])
    assert_array_equal(carry.first_loss, [np.nan, 11.0])
    assert spread == 0.5
    rounded = lambda n, x, args: jnp.stack([0.1 * x[0] + 0.3 * x[1], 0.7 * x[0] + 2.1 * x[1]])  # noqa: E731
    carry, _, spread = stepped(rounded, np.eye(2), plan=RunPlan(AUTOMATIC, sum_rule=True))
    assert_array_equal(carry.losses, [0, 1])
    assert spread == np.inf
    assert carry.log_volume == -np.inf


@pytest.mark.parametrize("name", ["undefined", "too large"])
def test_a_derivative_that_is_no_number_changes_no_sum(name):
    """Of all columns, or of the second one alone."""
    if name == "undefined":
        carry, *_ = stepped(lambda n, x, args: jnp.stack([x[0], jnp.sqrt(x[1])]), np.eye(2), x=[1.0, 0.0])
    else:
        carry, *_ = stepped(lambda n, x, args: jnp.stack([x[0], 1e200 * x[1] * 1e200]), np.eye(2), x=[1.0, 0.0])
    assert int(carry.status) == STATUS.nonfinite
    assert_array_equal(carry.growth, 0.25)
