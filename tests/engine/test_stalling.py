"""Runs that stall where no host looks on: under jit and vmap, and in sweeps; each ends soon, and says so."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from examples import alone, between_walls
from hostile import CIRCLE, FRICTION, MOD, STIFF, WHERE
from lyaphybrid import STATUS
from lyaphybrid.engine import stalling

LONG = 1e4
STALLING = {
    "friction by sign": (FRICTION, [1.0, 0.0]),
    "field by where": (WHERE, [1.0, 1.0]),
    "guard by mod": (MOD, [0.1, 0.2]),
    "stiff": (STIFF, [1.0, 1.0]),
    "far end": (lh.Flow(lambda t, x, args: 1e12 * CIRCLE.field(t, x, args)), [1.0, 0.0]),
}


@pytest.fixture
def short_windows(monkeypatch):
    """Of fewer attempts. What is traced meanwhile keeps them: no system of another test may be run."""
    monkeypatch.setattr(stalling, "ATTEMPTS_OF_WINDOW", stalling.ATTEMPTS_OF_WINDOW // 20)


@functools.cache
def again(name):
    """The system with functions of its own."""
    return jax.tree.map(lambda leaf: functools.partial(leaf) if callable(leaf) else leaf, STALLING[name][0])


@pytest.mark.slow
@pytest.mark.parametrize("name", STALLING)
def test_a_compiled_run_that_stalls_ends(name):
    system, start = STALLING[name]
    run = jax.jit(lambda x: lh.trajectory(system, x, t1=LONG, n=4, throw=False).status)
    assert int(run(jnp.asarray(start))) in (STATUS.stalled, STATUS.step_underflow)


@pytest.mark.slow
@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("name", ["field by where", "friction by sign", "guard by mod", "stiff"])
def test_derivatives_through_a_run_that_stalls_end(name, derivative, short_windows):
    """They are finite, those of the motion so far, and the status tells that the end was not reached."""
    system, start = again(name), STALLING[name][1]

    def reached(x):
        run = lh.trajectory(system, x, t1=LONG, n=1, throw=False)
        return run.x[0], (run.status, run.ended)

    def exponents(x):
        spectrum = lh.lyapunov_spectrum(system, x, t1=LONG, blocks=2, throw=False)
        return spectrum.exponents, spectrum.status_code

    matrix, (status, ended) = derivative(reached, has_aux=True)(jnp.asarray(start))
    assert int(status) in (STATUS.stalled, STATUS.step_underflow)
    assert np.all(np.isfinite(matrix))
    if name in ("field by where", "stiff"):  # the second component decays by itself
        np.testing.assert_allclose(matrix[1], [0.0, np.exp(-ended)], rtol=1e-6, atol=1e-12)
    slope, code = derivative(exponents, has_aux=True)(jnp.asarray(start))
    assert int(code) in (STATUS.stalled, STATUS.step_underflow)
    assert np.all(np.isfinite(slope))


@pytest.mark.slow
def test_of_runs_side_by_side_only_those_end_that_have_stalled():
    """Where the second component is zero nothing moves, and the run reaches its end."""
    sliding = lh.Flow(lambda t, x, args: x[1] * WHERE.field(t, x, args))

    def run(x):
        spectrum = lh.lyapunov_spectrum(sliding, x, t1=LONG, throw=False)
        return spectrum.status_code, spectrum.t

    codes, times = jax.jit(jax.vmap(run))(jnp.array([[1.0, 1.0], [1.0, 0.0]]))
    assert codes.tolist() == [STATUS.stalled, STATUS.ok]
    assert float(times[1]) == pytest.approx(LONG, rel=1e-12)


@pytest.mark.slow
def test_a_sweep_goes_on_where_a_point_has_stalled(short_windows):
    sliding = lh.Flow(lambda t, x, args: args["speed"] * WHERE.field(t, x, args))
    found = lh.sweep(
        lambda args: lh.lyapunov_spectrum(sliding, jnp.array([1.0, 1.0]), args, t1=LONG, blocks=4),
        {"speed": [0.0, 1.0, 2.0]},
        args={"speed": 0.0},
        progress=False,
    )
    assert found.status.values.tolist() == [STATUS.ok, STATUS.stalled, STATUS.stalled]


@pytest.mark.slow
def test_who_gives_max_steps_decides_alone():
    most = 4 * stalling.ATTEMPTS_OF_WINDOW
    run = jax.jit(lambda x: lh.trajectory(WHERE, x, t1=LONG, n=4, max_steps=most, throw=False).status)
    assert int(run(jnp.array([1.0, 1.0]))) == STATUS.max_steps


@pytest.mark.slow
def test_a_long_run_of_many_windows_reaches_its_end():
    """Ten windows and more, with the value that it has in one piece on the host."""
    rotor = lh.Map(lambda n, x, args: jnp.mod(x + args, 1.0))
    iterations = 10 * stalling.ATTEMPTS_OF_WINDOW + 7
    run = jax.jit(lambda x: lh.trajectory(rotor, x, 0.25, t1=iterations, n=3, throw=False))(jnp.array([0.1]))
    alone = lh.trajectory(rotor, [0.1], 0.25, t1=iterations, n=3)
    assert int(run.status) == STATUS.ok
    np.testing.assert_array_equal(run.x, alone.x)
    np.testing.assert_array_equal(run.t, alone.t)


@pytest.mark.parametrize(
    ("moved", "end", "jumped", "last", "expected"),
    [
        (1e-3, 1e4, 0, None, True),  # 1e7 windows
        (10.0, 1e4, 0, None, False),  # a thousand
        (0.0, 1e4, 0, None, True),
        (0.0, np.inf, 0, 1000, True),
        (0.0, np.inf, 5, 1000, False),
        (1.0, np.inf, 0, 1000, False),  # `waiting` knows
        (1e-3, 1e4, 5, 1000, False),  # the jumps end it
    ],
)
def test_when_a_window_is_hopeless(moved, end, jumped, last, expected):
    left = jnp.asarray(stalling.FOREVER, jnp.int32)
    window = stalling.Window(left, jnp.asarray(1.0), jnp.asarray(3, jnp.int32), jnp.asarray(1, jnp.int32))
    times = jnp.asarray(1.0 + moved), jnp.asarray(float(end))
    last = None if last is None else jnp.asarray(last, jnp.int32)
    budget, after = stalling._next_window(window, left, times, jnp.asarray(3 + jumped, jnp.int32), last)
    assert int(budget) == stalling.ATTEMPTS_OF_WINDOW
    assert int(after.left) == stalling.FOREVER - stalling.ATTEMPTS_OF_WINDOW
    assert int(after.hopeless) == (2 if expected else 0)


# --- event-driven motion without events, orthonormalised at times ---------------------------------------------------

RESTING = {
    "no schedule": lh.EventDriven(
        lambda dt, t, x, args: x * jnp.exp(dt * jnp.array([1e-9, -1e-9])),
        lambda t, x, args: (jnp.full_like(t, jnp.inf), 0),
        lambda t, x, args, which: x,
        lambda t, x, args, which: x[0],
    ),
    "schedule": lh.EventDriven(
        lambda dt, y, args: jnp.stack([y[:, 0] + dt * y[:, 1], y[:, 1]], axis=1),
        None,
        lambda t, rows, args, which: rows,
        between_walls,
        schedule=alone(lambda t, y: jnp.full_like(y[:, 0], jnp.inf)),
    ),
}
AT_REST = {"no schedule": np.array([1.0, 1.0]), "schedule": np.zeros((8, 2))}


def at_times(name, interval, **more):
    system, x0 = RESTING[name], AT_REST[name]
    return lh.lyapunov_spectrum(system, x0, t1=1e9, k=2, every=("time", interval), throw=False, **more)


@pytest.mark.slow
@pytest.mark.parametrize("name", RESTING)
def test_flights_are_attempts(name):
    """Each ends at an orthonormalisation; of 1e13 of them a thousand are made, and not one more."""
    found = at_times(name, 1e-4, max_steps=1000)
    assert found.status is STATUS.max_steps
    np.testing.assert_allclose(found.t, 1000e-4, rtol=1e-9)


@pytest.mark.slow_cases("schedule-0.0001")
@pytest.mark.parametrize("interval", [1e-4, 1e-20])
@pytest.mark.parametrize("name", RESTING)
def test_flights_that_lead_nowhere_end(name, interval):
    """A time that never moves, or that would need 1e13 of them."""
    assert at_times(name, interval).status is STATUS.stalled


@pytest.mark.slow
@pytest.mark.parametrize("name", RESTING)
def test_flights_that_lead_nowhere_end_where_they_are_compiled(name):
    assert int(jax.jit(lambda: at_times(name, 1e-4, blocks=2).status_code)()) == STATUS.stalled


@pytest.mark.parametrize("name", RESTING)
def test_flights_can_be_interrupted(name):
    def interrupt(fraction):
        raise KeyboardInterrupt

    with pytest.warns(UserWarning, match="interrupted"):
        found = at_times(name, 1e-4, progress=interrupt)
    assert found.status is STATUS.interrupted
