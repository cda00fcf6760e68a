"""Lanes: the same as single runs, however they are shared out."""

import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.engine.host import devices, lanes
from lyaphybrid.native.bridge import programs as _programs


def orbit(r, lane):
    """So many steps of the logistic map; a lane that leaves the interval is marked and holds nan."""
    steps, x = lane
    x = jax.lax.fori_loop(0, steps, lambda _, x: r * x * (1 - x), x)
    failed = ~(jnp.abs(x) < 2)
    return jnp.where(failed, jnp.nan, x), failed


def add(shared, total, lane):
    """Hands on a running total."""
    total = shared * total + lane
    return total, total


STEPS = np.arange(150) % 37
STARTS = np.linspace(0.05, 0.95, 150)


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [1, 7, 150])
def test_lanes_are_single_runs_exactly(threads, count):
    (x, failed), done = lanes.map_lanes(orbit, jnp.asarray(3.9), (STEPS[:count], STARTS[:count]), threads=threads)
    single = jax.jit(orbit)
    expected = [single(jnp.asarray(3.9), lane)[0] for lane in zip(STEPS[:count], STARTS[:count], strict=True)]
    assert done.all()
    assert not failed.any()
    np.testing.assert_array_equal(x, np.array(expected))


def test_the_order_of_lanes_does_not_matter():
    order = np.random.default_rng(1).permutation(150)
    (x, _), _ = lanes.map_lanes(orbit, jnp.asarray(3.9), (STEPS, STARTS))
    (y, _), _ = lanes.map_lanes(orbit, jnp.asarray(3.9), (STEPS[order], STARTS[order]))
    np.testing.assert_array_equal(x[order], y)


def test_a_lane_that_fails_leaves_its_neighbours_alone():
    outside = np.where(np.arange(150) == 70, 30.0, STARTS)
    steps = np.full(150, 36)
    (x, failed), _ = lanes.map_lanes(orbit, jnp.asarray(3.9), (steps, STARTS))
    (y, other), _ = lanes.map_lanes(orbit, jnp.asarray(3.9), (steps, outside))
    assert not failed.any()
    assert np.flatnonzero(other).tolist() == [70]
    assert np.isnan(y[70])
    np.testing.assert_array_equal(np.delete(x, 70), np.delete(y, 70))


@pytest.mark.parametrize("side_by_side", [False, True])
def test_a_lane_of_a_chain_begins_where_the_one_before_has_ended(monkeypatch, side_by_side):
    monkeypatch.setattr(devices, "are_wanted", lambda: side_by_side)
    chains = [(0.0, np.arange(200.0)), (100.0, np.arange(3.0)), (1.0, np.ones(200))]
    results, done = lanes.run_sequences(add, jnp.asarray(1.0), chains)
    assert all(each.all() for each in done)
    np.testing.assert_array_equal(results[0], np.cumsum(np.arange(200.0)))
    np.testing.assert_array_equal(results[1], [100.0, 101.0, 103.0])
    np.testing.assert_array_equal(results[2], 2.0 + np.arange(200.0))


def test_side_by_side_is_one_after_the_other(monkeypatch):
    (x, _), _ = lanes.map_lanes(orbit, jnp.asarray(3.7), (STEPS, STARTS))
    monkeypatch.setattr(devices, "are_wanted", lambda: True)
    monkeypatch.setattr(devices, "SEQUENCES_PER_CALL", 64)
    (y, _), done = lanes.map_lanes(orbit, jnp.asarray(3.7), (STEPS, STARTS))
    assert done.all()
    np.testing.assert_allclose(x, y, atol=1e-6)  # other kernels round otherwise; 36 steps of chaos amplify it


def test_a_chain_is_traced_once():
    traced = []

    def noted(shared, total, lane):
        traced.append(threading.get_ident())
        return add(shared, total, lane)

    lanes.run_sequences(noted, jnp.asarray(1.0), [(np.zeros(()), np.arange(3.0))])
    assert traced == [threading.get_ident()]


def test_it_is_compiled_once():
    traced = []

    def noted(shared, lane):
        traced.append(threading.get_ident())
        return shared * lane

    lanes.map_lanes(noted, jnp.asarray(2.0), np.arange(100.0), threads=4)
    once = len(traced)
    assert set(traced) == {threading.get_ident()}
    lanes.map_lanes(noted, jnp.asarray(3.0), np.arange(11.0), threads=2)
    assert len(traced) == once


def test_progress_rises_to_one():
    seen = []
    lanes.map_lanes(orbit, jnp.asarray(3.9), (STEPS, STARTS), progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


@pytest.mark.slow
def test_an_interrupted_map_says_what_it_has(monkeypatch):
    monkeypatch.setattr(lanes, "SECONDS_PER_CALL", 1e-6)  # pieces of one lane

    seen = []

    def interrupt(fraction):
        seen.append(fraction)
        if len(seen) == 5:
            raise KeyboardInterrupt

    lane = (np.full(600, 30_000_000), np.linspace(0.1, 0.9, 600))
    begun = time.perf_counter()
    with pytest.warns(UserWarning, match="interrupted"):
        (x, _), done = lanes.map_lanes(orbit, jnp.asarray(3.9), lane, progress=interrupt)
    assert time.perf_counter() - begun < 5.0
    assert 0 < done.sum() < 600
    assert np.all(x[done] != 0)
    assert np.all(x[~done] == 0)


def test_an_error_of_the_function_comes_out():
    def wrong(shared, lane):
        raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        lanes.map_lanes(wrong, None, np.arange(3.0))


def test_threads_have_the_precision_of_their_caller():
    with jax.enable_x64(False):
        (found, _), _ = lanes.map_lanes(orbit, jnp.asarray(3.9), (STEPS.astype("int32"), STARTS.astype("float32")))
    assert found.dtype == np.float32
    assert np.all(np.isfinite(found))


def exponents_of(problem, name, **keywords):
    """A run of a problem of the zoo, as a lane whose value is one of its args."""

    def run(shared, value):
        del shared
        return problem.spectrum(args=problem.args | {name: value}, throw=False, **keywords).exponents

    return run


RK4 = lh.RungeKutta("rk4", dt=0.01)


@pytest.mark.slow_cases(all_but=("problem2-c-values2-keywords2-True",))
@pytest.mark.parametrize(
    ("problem", "name", "values", "keywords", "together"),
    [
        (lh.zoo.lorenz63(), "rho", (26.0, 30.0), {"method": RK4, "every": 10}, True),
        (lh.zoo.lorenz63(), "rho", (26.0, 30.0), {"method": lh.RungeKutta("dopri5")}, True),
        (lh.zoo.rossler(), "c", (4.0, 9.0), {"method": RK4}, True),
        (lh.zoo.impact_oscillator(), "restitution", (0.7, 0.8), {"method": RK4}, False),
    ],
)
def test_lanes_that_seldom_part_go_in_the_vectors_of_the_cpu(problem, name, values, keywords, together):
    run = exponents_of(problem, name, t1=20.0, transient=1.0, blocks=4, **keywords)
    values = np.linspace(*values, 19)  # not a whole number of vectors
    program = lanes.LaneProgram(lanes._Alone(run), None, ((), values))
    assert (program.at_once > 1) == together
    found, done = lanes.map_lanes(run, None, values)
    assert done.all()
    single = np.array([run(None, jnp.asarray(value)) for value in values])
    adaptive = keywords["method"].tableau == "dopri5"  # its steps hang on the last digits of an error estimate
    np.testing.assert_allclose(found, single, rtol=1e-3 if adaptive else 1e-9)


@pytest.mark.slow
def test_lanes_that_surely_part_are_not_lowered_to_find_out(monkeypatch):
    """For a pendulum with dry friction that took seconds, and was thrown away."""
    made, original = [], _programs.Compiled
    monkeypatch.setattr(
        _programs, "Compiled", lambda *given, **options: made.append(options) or original(*given, **options)
    )
    run = exponents_of(lh.zoo.friction_pendulum(), "beta", t1=1.0, transient=0.0)
    assert lanes.LaneProgram(lanes._Alone(run), None, ((), np.linspace(0.02, 0.03, 9))).at_once == 1
    assert made
    assert all(options.get("lanes", 1) == 1 for options in made)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "key", "values"), [("logistic_map", "r", (3.1, 3.4)), ("henon_map", "a", (0.4, 0.8))])
def test_maps_go_in_the_vectors_of_the_cpu(name, key, values):
    problem = lh.zoo.get(name)()

    def run(shared, value):
        del shared
        args = problem.args | {key: value}
        return lh.lyapunov_spectrum(problem.system, problem.x0, args, t1=1000, throw=False).exponents

    values = np.linspace(*values, 19)
    assert lanes.LaneProgram(lanes._Alone(run), None, ((), values)).at_once > 1
    found, _ = lanes.map_lanes(run, None, values)
    single = np.array([run(None, jnp.asarray(value)) for value in values])
    np.testing.assert_allclose(found, single, rtol=1e-9)


@pytest.mark.slow
def test_directions_that_are_short_or_lost_in_the_vectors_of_the_cpu():
    """Of a turned diag(2, d): lanes look at them with care where they need it, and each has what a single run has."""
    turn = jnp.array([[0.8, -0.6], [0.6, 0.8]])
    turned = lh.Map(lambda n, x, d: turn @ (jnp.stack([2.0 + 0 * d, d]) * (turn.T @ x)))

    def run(shared, d):
        del shared
        return lh.lyapunov_spectrum(turned, [0.0, 0.0], d, t1=20, transient=60, throw=False).exponents

    values = np.array([0.5, 1e-14, 0.0, 1e-20, 1e-3, 1e-16, 0.25, 1e-15, 0.0])
    assert lanes.LaneProgram(lanes._Alone(run), None, ((), values)).at_once > 1
    found, _ = lanes.map_lanes(run, None, values)
    single = np.array([run(None, jnp.asarray(value)) for value in values])
    np.testing.assert_array_equal(np.isneginf(found), np.isneginf(single))
    np.testing.assert_allclose(found, single, rtol=1e-12)
    np.testing.assert_allclose(found[values > 0, 1], np.log(values[values > 0]), rtol=1e-10)
    np.testing.assert_array_equal(found[values == 0, 1], -np.inf)
