"""Bifurcation diagrams and Poincaré sections against what is known exactly, and against single runs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid import plots
from lyaphybrid.analysis.diagrams import attractors
from lyaphybrid.engine import waiting
from lyaphybrid.engine.host import devices, lanes

LOGISTIC = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
UNIT = [[0.01], [0.99]]


def _duffing(t, x, args):
    return jnp.stack([x[1], x[0] - x[0] ** 3 - 0.3 * x[1] + args["force"] * jnp.cos(1.2 * t)])


DUFFING = lh.Flow(_duffing)
PERIOD = 2 * np.pi / 1.2
RK4 = lh.RungeKutta("rk4", dt=PERIOD / 100)


def logistic(values, **options):
    return lh.bifurcation_diagram(LOGISTIC, UNIT, {"r": 0.0}, over={"r": values}, **options)


# --- against what is known ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_period_doublings_of_the_logistic_map():
    found = logistic([2.95, 3.4, 3.5, 3.55, 3.83, 3.86, 4.0], t1=4000)
    assert found.attractors() == ["P1w0:4", "P2w0:4", "P4w0:4", "P8w0:4", "P3w0:4", "chaos:4", "chaos:4"]
    exact = {0: np.log(abs(2 - 2.95)), 1: np.log(abs(4 + 2 * 3.4 - 3.4**2)) / 2, 6: np.log(2)}
    for i, value in exact.items():
        error = np.maximum(found.stderr[i, :, 0], 1e-3)
        assert np.all(np.abs(found.exponents[i, :, 0] - value) < 5 * error)
        assert np.all(error < 0.02)


@pytest.mark.slow
def test_period_two_begins_at_three_and_four_at_one_plus_root_six():
    doublings = np.array([3.0, 1 + np.sqrt(6)])
    found = logistic(np.concatenate([doublings - 0.002, doublings + 0.002]), transient=20_000, starts=2)
    assert found.attractors() == ["P1w0:2", "P2w0:2", "P2w0:2", "P4w0:2"]


@pytest.mark.slow
def test_a_motion_still_on_its_way_to_a_shorter_period_is_not_taken_for_a_longer_one():
    """At the doubling x_{j+2} - x_j falls like j^(-3/2): it is small long before x_{j+1} - x_j, like j^(-1/2), is."""
    found = logistic([3.0], transient=5000)
    assert found.attractors() == ["aperiodic/slow:4"]


@pytest.mark.slow
def test_continuations_alone_begin_at_one_start():
    """Where nothing is drawn x0 is one state, as everywhere; x² + r has the cycle 0, −1 at r = −1."""
    square = lh.Map(lambda n, x, args: x**2 + args["r"])
    found = lh.bifurcation_diagram(square, [0.1], {"r": 0.0}, over={"r": [-0.9, -1.0]}, directions=("up", "down"))
    assert found.attractors() == ["P2w0:2"] * 2
    np.testing.assert_allclose(np.sort(found.points[1, 0, -2:, 0]), [-1.0, 0.0], atol=1e-12)


def test_up_and_down_differ_between_the_folds():
    """Of x' = a + x - x³ two equilibria are stable for |a| < 2/(3√3) = 0.3849."""
    cubic = lh.Flow(lambda t, x, args: args["a"] + x - x**3)
    values = np.linspace(-0.6, 0.6, 61)
    method = lh.RungeKutta("rk4", dt=0.05)
    found = lh.bifurcation_diagram(
        cubic,
        [[-2.0], [2.0]],
        {"a": 0.0},
        over={"a": values},
        period=1.0,
        starts=6,
        transient=60,
        t1=64,
        method=method,
    )
    assert set(found.labels.ravel()) == {"P1w0"}
    up, down = found.points[:, -2, -1, 0], found.points[:, -1, -1, 0]
    assert found.kinds[-2:] == ("up", "down")
    fold = 2 / (3 * np.sqrt(3))
    np.testing.assert_array_equal(np.abs(up - down) > 0.5, np.abs(values) < fold)
    np.testing.assert_allclose(values + up - up**3, 0.0, atol=1e-6)
    np.testing.assert_allclose(found.exponents[:, -2, 0], 1 - 3 * up**2, atol=1e-4)
    both = np.ptp(found.points[:, :6, -1, 0], axis=1) > 0.5
    assert not np.any(both[np.abs(values) > fold])
    assert np.mean(both[np.abs(values) < 0.2]) > 0.8


@pytest.mark.slow
def test_a_continuation_keeps_the_mode():
    """A relay: on, x' = a + 1 - x, until x falls below -1/2; off, x' = a - 1 - x, until it rises above 1/2."""
    relay = lh.Hybrid(
        {"on": lambda t, x, args: args["a"] + 1.0 - x, "off": lambda t, x, args: args["a"] - 1.0 - x},
        [
            lh.Transition(lambda t, x, args: x[0] + 0.5, source="on", target="off"),
            lh.Transition(lambda t, x, args: x[0] - 0.5, source="off", target="on", direction=1),
        ],
    )
    values = np.linspace(-2.05, 2.05, 42)
    options = {"period": 1.0, "transient": 30, "t1": 32, "samples": 4, "method": lh.RungeKutta("rk4", dt=0.1)}
    found = lh.bifurcation_diagram(
        relay, [[-1.0], [0.0]], {"a": 0.0}, over={"a": values}, mode="off", starts=1, **options
    )
    end = found.points[:, :, -1, 0] - values[:, None]
    np.testing.assert_allclose(end[:, 1], np.where(values > 1.5, 1.0, -1.0), atol=1e-6)
    np.testing.assert_allclose(end[:, 2], np.where(values < -1.5, -1.0, 1.0), atol=1e-6)
    np.testing.assert_allclose(found.exponents, -1.0, atol=1e-6)


@pytest.mark.slow
def test_directions_that_are_lost():
    """Once a unit of time the second component is forgotten."""
    forgetful = lh.Hybrid(
        lambda t, x, args: jnp.stack([-args["a"] * x[0], -0.01 * x[1]]),
        lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: jnp.stack([x[0], 0.0 * x[1]])),
    )
    method = lh.RungeKutta("rk4", dt=0.1)
    box = [[0.5, 0.5], [1.0, 1.0]]
    found = lh.bifurcation_diagram(
        forgetful, box, {"a": 0.0}, over={"a": [0.1, 0.2]}, starts=2, period=1.0, t1=100, transient=10, method=method
    )
    np.testing.assert_allclose(found.exponents[..., 0], [[-0.1] * 4, [-0.2] * 4], atol=1e-6)
    assert np.isneginf(found.exponents[..., 1]).all()
    np.testing.assert_allclose(found.losses[..., 1], found.time)  # one a unit of time
    assert not found.losses[..., 0].any()


def _open_tent():
    """Leaves [0, 1] where it exceeds 1; what is out is drawn to -1, the slope there being a half."""

    def rule(n, x, args):
        inside = (x >= 0) & (x <= 1)
        outside = 0.5 * x - jnp.where(x > 1, 1.5, 0.5)
        return jnp.where(inside, args["slope"] * (0.5 - jnp.abs(x - 0.5)), outside)

    return lh.Map(rule)


@pytest.mark.slow
def test_the_escape_rate_of_an_open_tent_map():
    """The density stays uniform, and of each unit of it 1 - 2/slope leaves at every iteration."""
    tent = _open_tent()
    slope = np.array([2.0 + 1e-4, 2.01, 2.05])
    found = lh.bifurcation_diagram(
        tent,
        UNIT,
        {"slope": 0.0},
        over={"slope": slope},
        starts=400,
        directions=("random",),
        t1=400,
        transient=20,
        escape=True,
    )
    mean, error = found.mean_lifetimes()
    exact = 1 / (1 - 2 / slope)
    assert np.all(np.abs(mean[1:] - exact[1:]) < 5 * error[1:])
    assert np.all(error[1:] < 0.12 * exact[1:])
    assert np.sum(found.escaped[0]) < 40
    assert found.escaped[2].mean() > 0.99
    assert found.attractors()[2].startswith("P1w0:")


@pytest.mark.slow
def test_exponents_of_a_run_that_has_settled_are_those_of_its_cycle():
    """What chaos came before does not count: the slope at the fixed point -1 of the open tent map is a half."""
    tent = _open_tent()
    found = lh.bifurcation_diagram(
        tent,
        UNIT,
        {"slope": 0.0},
        over={"slope": [2.05]},
        starts=20,
        directions=("random",),
        t1=500,
        transient=1,
        escape=True,
    )
    assert np.max(found.lifetimes) > 50
    np.testing.assert_allclose(found.exponents, np.log(0.5), atol=1e-12)
    np.testing.assert_allclose(found.time, 501 - np.maximum(found.lifetimes, 1))


# --- the same as single runs --------------------------------------------------------------------------------------


def test_a_lane_is_a_single_run():
    starts = np.array([[0.3, 0.1], [-1.1, 0.2], [0.8, -0.4]])
    values = np.array([0.1, 0.2, 0.5])  # periodic, periodic, chaotic
    options = {"period": PERIOD, "method": RK4, "transient": 100, "t1": 64, "samples": 16, "directions": ("random",)}

    def diagram(values, starts):
        return lh.bifurcation_diagram(
            DUFFING, starts[0], {"force": 0.0}, over={"force": values}, starts=starts, **options
        )

    found = diagram(values, starts)
    for i in range(3):
        for j in range(3):
            alone = diagram(values[i : i + 1], starts[j : j + 1])
            for name in ("exponents", "stderr", "points", "time"):
                np.testing.assert_array_equal(getattr(found, name)[i, j], getattr(alone, name)[0, 0])
    np.testing.assert_allclose(np.sum(found.exponents, axis=-1), -0.3, atol=1e-6)
    assert found.time == pytest.approx(64 * PERIOD)


def test_a_lane_agrees_with_the_verbs_for_single_runs():
    start, args = np.array([0.3, 0.1]), {"force": 0.2}
    options = {"period": PERIOD, "method": RK4}
    found = lh.bifurcation_diagram(
        DUFFING, start, args, over={"force": [0.2]}, starts=start[None], transient=100, t1=64, samples=16, **options
    )
    points = lh.poincare_section(DUFFING, start, args, n=16, transient=148, **options)
    np.testing.assert_allclose(found.points[0, 0], points.x, atol=1e-9)
    whole = lh.lyapunov_spectrum(DUFFING, start, args, t1=64 * PERIOD, transient=100 * PERIOD, method=RK4)
    np.testing.assert_allclose(found.exponents[0, 0], whole.exponents, atol=1e-6)


@pytest.mark.slow
def test_threads_and_chunks_change_nothing(monkeypatch):
    values = np.linspace(3.5, 4.0, 9)
    first = logistic(values)
    monkeypatch.setattr(lanes.os, "cpu_count", lambda: 1)
    monkeypatch.setattr(lanes, "SECONDS_PER_CALL", 1e-6)
    second = logistic(values)
    for name in ("exponents", "stderr", "points", "labels", "status"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


@pytest.mark.slow
def test_side_by_side_finds_the_same(monkeypatch):
    values = np.array([2.8, 3.2, 3.5])
    options = {"starts": 2, "directions": ("random",), "samples": 16}
    first = logistic(values, **options)
    monkeypatch.setattr(devices, "are_wanted", lambda: True)
    second = logistic(values, **options)
    assert (first.labels == second.labels).all()
    np.testing.assert_allclose(first.exponents, second.exponents, atol=1e-9)


@pytest.mark.slow
def test_runs_that_fail_hold_their_status_and_nan():
    found = logistic([3.2, 5.0, 3.3], directions=("random", "up", "down"))
    assert found.attractors() == ["P2w0:4", "nonfinite:4", "P2w0:4"]
    assert (found.labels[1] == "nonfinite").all()
    assert (found.labels[[0, 2], -2:] == "P2w0").all()  # up and down go on from their own start
    assert np.isnan(found.exponents[1]).all()
    assert np.isnan(found.points[1]).all()
    alone = logistic([3.2, 3.25, 3.3], directions=("random", "up", "down"))
    np.testing.assert_array_equal(found.exponents[[0, 2], :4], alone.exponents[[0, 2], :4])
    assert "4 failed" not in str(alone)
    assert "6 failed" in str(found)


@pytest.mark.slow
def test_too_few_steps_are_a_status():
    found = lh.bifurcation_diagram(
        DUFFING, UNIT * np.ones(2), {"force": 0.0}, over={"force": [0.3]}, period=PERIOD, method=RK4, max_steps=500
    )
    assert found.attractors() == ["max_steps:4"]


# --- options ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_angles_turn():
    """Half a turn in each period of π: without being told so the first component never repeats."""
    turning = lh.Flow(lambda t, x, args: jnp.stack([1.0 + 0.0 * x[0], args["rate"] * (jnp.sin(2 * t) - x[1])]))
    options = {"period": np.pi, "method": lh.RungeKutta("rk4", dt=0.1), "transient": 50}
    found = lh.bifurcation_diagram(
        turning, [[-3.0, 0.0], [3.0, 1.0]], {"rate": 0.0}, over={"rate": [1.0]}, angles=(0,), **options
    )
    assert found.attractors() == ["P2w1:4"]
    assert np.ptp(found.points[0, 0, :, 0]) == pytest.approx(63 * np.pi)
    free = lh.bifurcation_diagram(turning, [[-3.0, 0.0], [3.0, 1.0]], {"rate": 0.0}, over={"rate": [1.0]}, **options)
    assert free.attractors() == ["aperiodic/slow:4"]


@pytest.mark.slow
def test_a_section_counts_crossings():
    """The van der Pol oscillator has one limit cycle, of period 6.6633 at μ = 1."""
    van_der_pol = lh.Flow(lambda t, x, args: jnp.stack([x[1], args["mu"] * (1 - x[0] ** 2) * x[1] - x[0]]))
    box = [[0.5, 0.5], [2.0, 2.0]]
    options = {"section": lambda t, x, args: x[0], "transient": 20, "t1": 40, "samples": 16}
    method = lh.RungeKutta("rk4", dt=0.05)
    found = lh.bifurcation_diagram(
        van_der_pol, box, {"mu": 0.0}, over={"mu": [1.0]}, starts=2, method=method, directions=("random",), **options
    )
    assert found.attractors() == ["P1w0:2"]
    assert found.time == pytest.approx(40 * 6.663286859, rel=1e-6)
    assert np.max(np.abs(found.points[..., 0])) < 1e-9


@pytest.mark.slow
def test_parameters_within_parameters():
    nested = lh.Map(lambda n, x, args: args["a"]["r"] * x * (1 - x))
    found = lh.bifurcation_diagram(nested, UNIT, {"a": {"r": 1, "s": 2.0}}, over={"a.r": [3.2]})
    assert found.attractors() == ["P2w0:4"]


@pytest.mark.slow
def test_the_key_draws_the_starts():
    first, second = (logistic([4.0], key=jax.random.key(i), t1=64).points for i in (1, 2))
    assert not np.any(first == second)
    np.testing.assert_array_equal(first, logistic([4.0], key=jax.random.key(1), t1=64).points)


# --- labels -------------------------------------------------------------------------------------------------------


def labelled(points, exponent=-0.1, error=0.01, length=1000.0, angles=()):
    points = np.asarray(points, float)[None]
    given = (np.array([v]) for v in (0, exponent, error, length))
    status, *numbers = given
    return attractors.labels(points, angles, status, *numbers)[0]


def test_labels():
    steps = np.arange(64.0)[:, None]
    assert labelled(np.zeros((64, 1))) == "P1w0"
    assert labelled(np.cos(np.pi * steps)) == "P2w0"
    assert labelled(np.cos(2 * np.pi * steps / 24)) == "P24w0"
    assert labelled(np.cos(2 * np.pi * steps / 25)) == "aperiodic/slow"
    assert labelled(np.cos(steps), 0.1) == "chaos"
    assert labelled(np.cos(steps), 0.1, error=0.03) == "aperiodic/slow"
    assert labelled(np.cos(steps), 0.1, length=200.0) == "aperiodic/slow"
    assert labelled(2 * np.pi * 5 / 3 * steps, angles=(0,)) == "P3w5"
    assert labelled(-2 * np.pi * 5 / 3 * steps) == "aperiodic/slow"


def test_narrow_bands_of_chaos_are_not_periodic():
    """Points that nearly repeat while motions part; a run on a cycle that repels repeats to rounding."""
    bands = np.cos(np.pi * np.arange(64.0))[:, None] + 1e-6 * np.random.default_rng(0).uniform(size=(64, 1))
    assert labelled(bands) == labelled(bands, 1e-5, error=1e-7) == "P2w0"  # the growth is e^0.01
    assert labelled(bands, 0.002, error=0.0005) == "P2w0"
    assert labelled(bands, 0.002, error=0.0003) == "aperiodic/slow"
    assert labelled(bands, 0.05, error=0.001) == "chaos"
    assert labelled(np.cos(np.pi * np.arange(64.0))[:, None], 0.05, error=0.001) == "P2w0"


@pytest.mark.slow
def test_the_current_of_a_converter_whose_map_expands():
    """Peak-current control: i + (24 − V)/2, or 5 − (1 − t) V/2 after t = 2 (5 − i)/(24 − V) < 1. The slope is 1 or
    −V/(24 − V): no cycle attracts for V > 12, and bands are narrow just above."""

    def current(n, i, args):
        up = (24.0 - args["V"]) / 2
        return jnp.where(5.0 - i >= up, i + up, 5.0 - args["V"] / 2 * (1 - (5.0 - i) / up))

    over = {"V": [9.0, 11.9, 12.02, 12.05, 12.1, 13.0]}
    found = lh.bifurcation_diagram(lh.Map(current), [[3.0], [4.9]], {"V": 9.0}, over=over)
    assert found.attractors()[:2] == ["P1w0:4", "P1w0:4"]
    np.testing.assert_allclose(found.exponents[:2, 0, 0], np.log([9 / 15, 11.9 / 12.1]), rtol=1e-6)
    assert not any(label.startswith("P") for label in found.labels[2:].flat), found.labels
    assert np.all(found.labels[5] == "chaos")


def test_lifetimes():
    wild = np.random.default_rng(0).uniform(-1, 1, (100, 1))
    cycle = 0.5 * np.cos(np.pi * np.arange(200.0))[:, None]
    points = np.concatenate([wild, [[-0.9]], cycle])
    turns = attractors.turns_of(1, ())
    assert attractors.lifetime(np, points, np.arange(1, len(points) + 1), turns, 64) == 101
    assert np.isnan(attractors.lifetime(np, wild, np.arange(1, 101), turns, 64))


# --- Poincaré sections --------------------------------------------------------------------------------------------

BALL = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], jnp.full_like(x[0], -1.0)]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
)


@pytest.mark.slow
def test_crossings_of_a_circle():
    circle = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0]]))
    for direction, first, step in ((1, 1.5, 2.0), (0, 0.5, 1.0)):
        found = lh.poincare_section(circle, [1.0, 0.0], section=lambda t, x, args: x[0], n=5, direction=direction)
        np.testing.assert_allclose(found.t, np.pi * (first + step * np.arange(5)), atol=1e-7)
        assert np.max(np.abs(found.x[:, 0])) < 1e-12
        assert found.status == lh.STATUS.ok
    later = lh.poincare_section(circle, [1.0, 0.0], section=lambda t, x, args: x[0], n=2, transient=3)
    np.testing.assert_allclose(later.t, np.pi * np.array([6.5, 8.5]), atol=1e-7)  # falling: direction=-1


@pytest.mark.slow
def test_a_section_on_a_guard_of_the_system_shows_the_state_before_the_jump():
    found = lh.poincare_section(BALL, [0.5, 0.0], section=lambda t, x, args: x[0], n=4)
    np.testing.assert_allclose(found.t, [1.0, 3.0, 5.0, 7.0], atol=1e-9)
    np.testing.assert_allclose(found.x[:, 1], -1.0, atol=1e-9)


@pytest.mark.slow
def test_a_jump_on_the_far_side_of_a_section_is_no_crossing():
    """The floor is below the section: h < 0 at every bounce, where the section used to fire again and again."""
    for direction, times in ((-1, [0.5, 2.5, 4.5]), (1, [1.5, 3.5, 5.5])):
        found = lh.poincare_section(
            BALL, [0.5, 0.0], section=lambda t, x, args: x[0] - 0.375, n=3, direction=direction, max_steps=1000
        )
        np.testing.assert_allclose(found.t, times, atol=1e-9)
        np.testing.assert_allclose(found.x, [[0.375, 0.5 * direction]] * 3, atol=1e-9)


@pytest.mark.slow
def test_a_jump_across_the_section_is_no_crossing():
    """The velocity falls through zero at the top, and jumps from below to above at the floor."""
    found = lh.poincare_section(
        BALL, [0.5, 0.1], section=lambda t, x, args: x[1], n=3, direction=1, max_steps=1000, throw=False
    )
    assert np.isnan(found.t).all()
    assert found.status == lh.STATUS.max_steps
    both = lh.poincare_section(BALL, [0.5, 0.1], section=lambda t, x, args: x[1], n=3, direction=0)
    assert float(both.t[0]) == pytest.approx(0.1)
    np.testing.assert_allclose(np.diff(both.t), 2 * np.sqrt(1.01), atol=1e-9)


def _clock_beside(reset):
    """x' = 1 with a tick every 1: t is known exactly, and jumps never end."""
    return lh.Hybrid(lambda t, x, args: jnp.ones_like(x), lh.Transition(every=1.0, reset=reset))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "x0", "section", "times"),
    [
        # crossed once, and left for good
        (_clock_beside(lambda t, x, args: x), [0.0], lambda t, x, args: x[0] - 3.25, [3.25]),
        # each tick carries the state over it, and the flow never
        (_clock_beside(lambda t, x, args: x - 1.0), [-0.5], lambda t, x, args: x[0] + 1.0, []),
    ],
    ids=["left", "jumped over"],
)
def test_a_section_that_is_not_crossed_again_ends_the_run_though_jumps_go_on(system, x0, section, times, monkeypatch):
    monkeypatch.setattr(waiting, "MOST_ATTEMPTS_WITHOUT_JUMP", 3_000)
    found = lh.poincare_section(system, x0, section=section, n=3, direction=1, throw=False)
    assert found.status is lh.STATUS.no_more_jumps
    np.testing.assert_allclose(found.t, times + [np.nan] * (3 - len(times)), atol=1e-9)
    with pytest.raises(lh.RunFailedError, match="crossings of a section"):
        lh.poincare_section(system, x0, section=section, n=3, direction=1)


@pytest.mark.slow
def test_many_jumps_between_crossings_do_not_end_a_wait(monkeypatch):
    """A thousand ticks between two crossings, five thousand in all: each crossing begins another wait."""
    monkeypatch.setattr(waiting, "MOST_ATTEMPTS_WITHOUT_JUMP", 4_000)
    system = _clock_beside(lambda t, x, args: 1.0 * x)
    found = lh.poincare_section(
        system, [0.25], section=lambda t, x, args: jnp.sin(jnp.pi * x[0] / 1e3), n=5, direction=0
    )
    np.testing.assert_allclose(found.t, 1e3 * np.arange(1, 6) - 0.25, atol=1e-7)


@pytest.mark.slow
def test_the_section_does_not_change_the_motion():
    modes = lh.poincare_section(BALL, [0.5, 0.0], section=lambda t, x, args: x[0] - 0.25, n=40, direction=0)
    plain = lh.trajectory(BALL, [0.5, 0.0], t1=float(modes.t[-1]), n=1)
    np.testing.assert_allclose(modes.x[-1], plain.x[-1], atol=1e-8)
    assert modes.mode_names == BALL.mode_names


@pytest.mark.slow
def test_once_a_period():
    found = lh.poincare_section(BALL, [0.5, 0.0], period=lambda args: args["T"], args={"T": 2.0}, n=3, transient=1)
    np.testing.assert_allclose(found.t, [4.0, 6.0, 8.0])
    np.testing.assert_allclose(found.x, [[0.5, 0.0]] * 3, atol=1e-9)
    orbit = lh.poincare_section(LOGISTIC, [0.3], {"r": 3.2}, period=2, n=5, transient=500)
    assert np.ptp(orbit.x) < 1e-9


@pytest.mark.slow
def test_a_terminal_transition_ends_the_points():
    floor = lh.Hybrid(BALL.fields[0], lh.Transition(lambda t, x, args: x[0] + 10.0, terminal=True))
    found = lh.poincare_section(floor, [0.5, 0.0], section=lambda t, x, args: x[0], n=2)
    assert found.status == lh.STATUS.terminated
    assert np.isfinite(found.t).tolist() == [True, False]


# --- bad arguments ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"over": {"r": [1.0], "s": [2.0]}}, "one parameter"),
        ({"over": {"r": [[1.0]]}}, "finite numbers"),
        ({"over": {"r": [np.nan]}}, "finite numbers"),
        ({"over": {"s": [1.0]}}, "'s' is no entry of args: args has r"),
        ({"x0": [0.1]}, "two corners of a box"),
        ({"starts": 0}, "at least 1"),
        ({"starts": [[0.1, 0.2]], "x0": [0.1]}, r"points \(m, n\)"),
        ({"t1": 10}, "samples must be at most t1"),
        ({"t1": 10.5}, "integer"),
        ({"directions": "up"}, "directions must be some of"),
        ({"directions": ("left",)}, "directions must be some of"),
        ({"section": lambda t, x, args: x[0]}, "A map has no section"),
        ({"period": 0.5}, "whole"),
        ({"angles": (3,)}, "angles"),
        ({"max_steps": 0}, "max_steps"),
        ({"k": 3}, "k must be at most"),
    ],
)
def test_bad_arguments(changed, message):
    given = {"over": {"r": [3.2]}, "x0": UNIT, "args": {"r": 0.0}} | changed
    with pytest.raises(ValueError, match=message):
        lh.bifurcation_diagram(LOGISTIC, **given)


def test_bad_arguments_of_flows():
    box = np.ones((2, 2))
    with pytest.raises(ValueError, match="exactly one of period"):
        lh.bifurcation_diagram(DUFFING, box, {"force": 0.0}, over={"force": [0.1]})
    with pytest.raises(ValueError, match="period must be positive"):
        lh.bifurcation_diagram(DUFFING, box, {"force": 0.0}, over={"force": [0.1]}, period=-1.0)
    table = lh.zoo.sinai_billiard().system
    with pytest.raises(ValueError, match="A section is crossed by a flow"):
        lh.bifurcation_diagram(table, box, {"force": 0.0}, over={"force": [0.1]}, section=lambda t, x, args: x[0])
    with pytest.raises(ValueError, match="escape=True"):
        logistic([3.2]).mean_lifetimes()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({}, "exactly one of section"),
        ({"period": 1.0, "section": lambda t, x, args: x[0]}, "exactly one of section"),
        ({"period": 0.0}, "period must be positive"),
        ({"period": 1.0, "n": 0}, "at least 1"),
        ({"period": 1.0, "transient": -1}, "at least 0"),
        ({"section": lambda t, x, args: x[0], "direction": 2}, "direction must be"),
    ],
)
def test_bad_arguments_of_sections(changed, message):
    with pytest.raises(ValueError, match=message):
        lh.poincare_section(BALL, [0.5, 0.0], **changed)


def test_a_map_has_no_section():
    with pytest.raises(ValueError, match="crossed by a flow"):
        lh.poincare_section(LOGISTIC, [0.3], {"r": 3.2}, section=lambda t, x, args: x[0])


# --- pictures -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_pictures():
    found = logistic([2.8, 3.2, 5.0, 3.5])
    upper, lower = found.plot()
    drawn = {line.get_label(): line.get_xydata() for line in upper.get_lines()}
    assert len(drawn["random starts"]) == 4 * 4 * 64
    assert len(drawn["followed up"]) == 4 * 64
    np.testing.assert_array_equal(drawn["followed down"][:, 1], found.points[:, -1, :, 0].ravel())
    crosses = [line for line in lower.get_lines() if line.get_marker() == "x"]
    assert crosses[0].get_xdata().tolist() == [5.0]
    lower.figure.canvas.draw()
    ax = plots.section(lh.poincare_section(BALL, [0.5, 0.0], period=0.3, n=20))
    assert len(ax.get_lines()[0].get_xdata()) == 20
    ax = lh.poincare_section(LOGISTIC, [0.3], {"r": 4.0}, period=1, n=20).plot()
    x, y = ax.get_lines()[0].get_data()
    np.testing.assert_allclose(y, 4 * x * (1 - x), atol=1e-12)


@pytest.mark.slow
def test_angles_are_drawn_within_one_turn():
    turning = lh.Flow(lambda t, x, args: args["rate"] + 0.0 * x)
    options = {"period": 1.0, "method": lh.RungeKutta("rk4", dt=0.1), "angles": (0,), "directions": ("up",)}
    found = lh.bifurcation_diagram(turning, [[0.0], [1.0]], {"rate": 0.0}, over={"rate": [1.0]}, **options)
    heights = plots.bifurcations(found).get_lines()[0].get_ydata()
    assert np.ptp(found.points) > 60
    assert -np.pi < np.min(heights) < -3
    assert 3 < np.max(heights) <= np.pi


def test_parameters_that_are_one_number_or_stand_in_a_list():
    """By the names that sweeps and branches have for them."""
    how = {"t1": 100, "transient": 50, "samples": 8}
    by_name = lh.bifurcation_diagram(LOGISTIC, [[0.1], [0.9]], {"r": 0.0}, over={"r": [2.8, 3.2]}, **how)
    bare = lh.Map(lambda n, x, r: r * x * (1 - x))
    listed = lh.Map(lambda n, x, args: args[1] * x * (1 - x))
    for system, args, name in ((bare, 0.0, "args"), (listed, [1.0, 0.0], "1")):
        found = lh.bifurcation_diagram(system, [[0.1], [0.9]], args, over={name: [2.8, 3.2]}, **how)
        np.testing.assert_array_equal(found.points, by_name.points)
