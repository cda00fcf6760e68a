"""The same numbers under jit and vmap as without; derivatives as central differences; compiled once."""

import collections
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from examples import (
    BALL,
    BALL_BLOCKS,
    BALL_LANES,
    BALL_METHOD,
    HENON,
    LOGISTIC,
    TABLE,
    TABLE_ARGS,
    TABLE_METHOD,
    ball_args,
    ball_lane,
    ball_spectrum,
)
from lyaphybrid import STATUS

COMPARED = ("exponents", "stderr", "time", "jumps", "upper", "lower", "x", "t", "frame", "losses", "status_code")


@functools.cache
def single(i: int) -> lh.Spectrum:
    return ball_lane(ball_args(**BALL_LANES[i][0]))


def assert_same(one, other, atol=1e-12):
    """Two results agree in everything that is compared; the scale of a value is its own size."""
    for name in COMPARED:
        a, b = np.asarray(getattr(one, name), float), np.asarray(getattr(other, name), float)
        np.testing.assert_allclose(a, b, rtol=atol, atol=atol, err_msg=name)
    np.testing.assert_allclose(one.history.exponents, other.history.exponents, rtol=atol, atol=atol)


def assert_same_lane(one, i):
    """As `assert_same`, but up to the last block where an escape or an accumulation amplifies rounding without end."""
    other = single(i)
    if BALL_LANES[i][1] not in (STATUS.zeno, STATUS.nonfinite):
        assert_same(one, other)
        return
    assert int(one.status_code) == int(other.status_code)
    before = np.isfinite(other.history.time).sum() - 1
    for name in ("time", "exponents", "growth"):
        a, b = (np.asarray(getattr(run.history, name)) for run in (one, other))
        np.testing.assert_allclose(a[:before], b[:before], rtol=1e-12, atol=1e-12)
        assert np.array_equal(np.isnan(a), np.isnan(b))
    np.testing.assert_allclose(one.t, other.t, rtol=1e-7)


@pytest.mark.parametrize("i", range(len(BALL_LANES)))
def test_the_lanes_do_what_their_parameters_say(i):
    _, status, jumps = BALL_LANES[i]
    assert single(i).status is status
    assert jumps is None or single(i).jumps == jumps


@pytest.mark.slow
def test_vmap_equals_a_loop():
    args = [ball_args(**changes) for changes, *_ in BALL_LANES]
    stacked = {name: jnp.asarray([a[name] for a in args]) for name in args[0]}
    batch = jax.vmap(ball_lane)(stacked)
    for i in range(len(BALL_LANES)):
        assert_same_lane(jax.tree.map(lambda leaf, i=i: leaf[i], batch), i)


@pytest.mark.slow
def test_jit_equals_eager_and_reports_the_status():
    jitted = jax.jit(ball_lane)
    for i in (1, 4, 5):
        assert_same_lane(jitted(jax.tree.map(jnp.asarray, ball_args(**BALL_LANES[i][0]))), i)


@pytest.mark.slow
def test_starts_of_shape_m_n_are_m_runs():
    """One of them escapes: it has its own status, and the whole the gravest."""
    starts = jnp.asarray([[0.3], [1.3], [0.4]])
    together, *alone = (lh.lyapunov_spectrum(LOGISTIC, x, 4.0, t1=64, blocks=8, throw=False) for x in (starts, *starts))
    assert together.status_code.tolist() == [0, int(STATUS.nonfinite), 0]
    assert together.status is STATUS.nonfinite
    assert [int(run.status) for run in alone] == together.status_code.tolist()
    np.testing.assert_allclose(together.replicates, [run.exponents for run in alone], rtol=1e-13)
    np.testing.assert_allclose(together.x, [run.x for run in alone], rtol=0, atol=1e-13)


@pytest.mark.slow
def test_several_runs_have_the_mean_and_its_error():
    starts = jnp.asarray([[0.1, 0.1], [0.2, 0.1], [-0.3, 0.2]])
    together = lh.lyapunov_spectrum(HENON, starts, 1.4, t1=1000)
    alone = np.array([lh.lyapunov_spectrum(HENON, x, 1.4, t1=1000).exponents for x in starts])
    np.testing.assert_allclose(together.replicates, alone, rtol=0, atol=1e-13)
    np.testing.assert_allclose(together.exponents, alone.mean(axis=0), rtol=0, atol=1e-13)
    np.testing.assert_allclose(together.stderr, alone.std(axis=0, ddof=1) / np.sqrt(3), rtol=1e-10)
    assert together.error_kind == "replicates"


# --- derivatives -------------------------------------------------------------------------------------------------

# What is varied: the start, every parameter (of field, guard, reset and clock), the length of the run.
POINT = {"x0": jnp.asarray([1.0, 0.2]), "args": jax.tree.map(jnp.asarray, TABLE_ARGS), "t1": jnp.asarray(6.0)}


def path_end(p):
    return lh.trajectory(TABLE, p["x0"], p["args"], t1=p["t1"], n=2, method=TABLE_METHOD).x[-1]


def end_and_matrix(p):
    end = lh.tangent_map(TABLE, p["x0"], p["args"], t1=p["t1"], method=TABLE_METHOD)
    return jnp.concatenate([end.x, end.matrix.ravel()])


def exponents(p):
    run = lh.lyapunov_spectrum(TABLE, p["x0"], p["args"], t1=p["t1"], blocks=2, every=3, method=TABLE_METHOD)
    return run.exponents


@pytest.mark.slow
@pytest.mark.parametrize("function", [end_and_matrix, exponents, path_end], ids=lambda function: function.__name__)
def test_jvp_equals_central_differences(function):
    """Each direction by itself; with a fixed step the numerical motion is smooth, so that six digits agree."""
    tangent = jax.jit(lambda p, dp: jax.jvp(function, (p,), (dp,))[1])
    leaves, tree = jax.tree.flatten(POINT)
    eps = 1e-5
    for i, leaf in enumerate(leaves):
        for j in range(leaf.size):
            unit = jnp.zeros(leaf.size).at[j].set(1.0).reshape(leaf.shape)
            direction = jax.tree.unflatten(tree, [unit if i == m else jnp.zeros_like(o) for m, o in enumerate(leaves)])

            def moved(step, direction=direction):
                return function(jax.tree.map(lambda a, d: a + step * d, POINT, direction))

            difference = (moved(eps) - moved(-eps)) / (2 * eps)
            slope = tangent(POINT, direction)
            assert np.isfinite(slope).all()  # nothing leaks out of branches that are not taken
            np.testing.assert_allclose(slope, difference, rtol=1e-6, atol=1e-6 * np.max(np.abs(difference)))


def test_the_varied_run_has_ticks_and_impacts():
    short = POINT | {"t1": jnp.asarray(0.2)}  # no tick, no impact
    assert np.any(end_and_matrix(POINT) != end_and_matrix(short))
    with_kicks = end_and_matrix(POINT)
    without = end_and_matrix(POINT | {"args": POINT["args"] | {"kick": jnp.asarray(0.0)}})
    assert np.max(np.abs(with_kicks - without)) > 1e-3
    run = lh.tangent_map(TABLE, POINT["x0"], POINT["args"], t1=POINT["t1"], method=TABLE_METHOD)
    assert run.jumps > 8  # seven ticks, and impacts


@pytest.mark.slow
def test_the_tangent_map_is_the_jacobian_of_the_trajectory():
    jacobian = jax.jacfwd(lambda x0: path_end(POINT | {"x0": x0}))(POINT["x0"])
    np.testing.assert_allclose(end_and_matrix(POINT)[2:].reshape(2, 2), jacobian, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_no_nan_from_branches_that_are_not_taken():
    """A field at rest, where the error estimate is zero; a frame that is lost."""
    still = lh.Flow(lambda t, x, a: a * x)
    _, slope = jax.jvp(
        lambda a: lh.lyapunov_spectrum(still, jnp.zeros(2), a, t1=1.0, blocks=2).exponents,
        (jnp.asarray(-0.5),),
        (jnp.asarray(1.0),),
    )
    np.testing.assert_allclose(slope, [1.0, 1.0], rtol=0, atol=1e-9)

    forget = lh.Map(lambda n, x, r: jnp.stack([2.0 * x[0] + r, r * x[1]]))

    def lost(r):
        run = lh.lyapunov_spectrum(forget, jnp.zeros(2), r, t1=8, blocks=4)
        return run.finite_exponents, run.x, run.frame

    values, tangents = jax.jvp(lost, (jnp.asarray(0.0),), (jnp.asarray(1.0),))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((values, tangents)))


# --- compiled once -----------------------------------------------------------------------------------------------

COMPILED = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, *_, **__: COMPILED.append(name) if name.endswith("backend_compile_duration") else None
)


@pytest.mark.slow
def test_numbers_change_without_compiling_or_tracing_again():
    traced = []

    def field(t, x, args):
        traced.append("field")
        return -args["rate"] * x

    def reset(t, x, args):
        traced.append("reset")
        return 0.5 * x + args["gain"]

    system = lh.Hybrid(field, lh.Transition(lambda t, x, args: x[0] - 0.5, reset))

    def run(i):
        s = 1 + 0.1 * i
        args = {"rate": s, "gain": s}
        method = lh.RungeKutta("tsit5", rtol=1e-8 / s, atol=1e-10 / s)
        lh.lyapunov_spectrum(system, [s], args, t0=s, t1=3 * s, transient=s, every=s, blocks=4, method=method)
        fixed = lh.RungeKutta("rk4", dt=0.1 * s)
        lh.tangent_map(system, [s], args, t0=s, t1=s, method=fixed)

    run(0)
    assert set(traced) == {"field", "reset"}
    compilations, tracings = len(COMPILED), len(traced)
    assert compilations > 0
    run(1)
    assert len(COMPILED) == compilations
    assert len(traced) == tracings


@pytest.mark.slow
@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.grad])
def test_derivatives_of_runs_with_a_transient_compile_once(derivative):
    system = lh.Hybrid(
        lambda t, x, args: -args * x, lh.Transition(lambda t, x, args: x[0] - 0.5, lambda t, x, args: 0.5 * x + args)
    )

    def exponent(rate):
        return lh.lyapunov_spectrum(system, jnp.array([1.0]), rate, t1=3.0, transient=1.0).exponents[0]

    slope = derivative(exponent)
    slope(1.0)
    compilations = len(COMPILED)
    slopes = [slope(rate) for rate in (1.1, 1.2)]
    assert len(COMPILED) == compilations
    assert np.all(np.isfinite(slopes))


def test_any_number_of_events_compiles_once():
    """Logs of other lengths, emptied once or several times, cost no compilation."""
    bounce = lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]]))
    ball = lh.Hybrid(lambda t, x, args: jnp.stack([x[1], -jnp.ones_like(x[1])]), bounce)

    def count(t1):
        return len(lh.trajectory(ball, [0.5, 0.0], t1=t1, n=4, method=lh.RungeKutta("rk4", dt=0.1)).events)

    assert count(4.5) == 2
    compilations = len(COMPILED)
    assert [count(t1) for t1 in (0.5, 10.5, 2100.5)] == [0, 5, 1050]
    assert len(COMPILED) == compilations


# --- going on where a run ended ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_spectrum_goes_on_exactly_where_it_ended():
    """Steps of 1/16 and the same blocks of 16 steps: the two halves are the whole, to the last digits."""
    options = {"every": 1, "blocks": 4, "method": lh.RungeKutta("rk4", dt=1 / 16)}
    whole = lh.lyapunov_spectrum(TABLE, [1.0, 0.2], TABLE_ARGS, t1=8.0, **(options | {"blocks": 8}))
    first = lh.lyapunov_spectrum(TABLE, [1.0, 0.2], TABLE_ARGS, t1=4.0, **options)
    second = lh.lyapunov_spectrum(
        TABLE, first.x, TABLE_ARGS, t0=first.t, mode=first.mode, frame=first.frame, t1=4.0, **options
    )
    assert first.jumps + second.jumps == whole.jumps
    np.testing.assert_allclose(second.x, whole.x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(second.frame, whole.frame, rtol=0, atol=1e-12)
    assert float(second.t) == float(whole.t)
    # Each result lists its columns by its own exponents: the blocks are compared as sets.
    halves = np.concatenate([first.history.growth, second.history.growth])
    np.testing.assert_allclose(np.sort(halves), np.sort(whole.history.growth), rtol=0, atol=1e-12)


def test_a_map_goes_on_bitwise():
    whole = lh.lyapunov_spectrum(LOGISTIC, [0.3], 3.9, t1=128, blocks=4)
    first = lh.lyapunov_spectrum(LOGISTIC, [0.3], 3.9, t1=64, blocks=4)
    second = lh.lyapunov_spectrum(LOGISTIC, first.x, 3.9, t0=first.t, frame=first.frame, t1=64, blocks=4)
    assert second.x.tolist() == whole.x.tolist()
    assert float(second.t) == 128


# --- slow: the default method, chaos, on the engine's widest path --------------------------------------------------


@pytest.mark.slow
def test_vmap_of_a_chaotic_impact_oscillator_equals_a_loop():
    """Chatter amplifies rounding: there the two may differ by what rounding the start does, and not by more."""
    problem = lh.zoo.impact_oscillator()

    def run(omega, shake=0.0):
        args = {**problem.args, "omega": omega}
        start = problem.x0 * (1 + shake) + shake
        return lh.lyapunov_spectrum(problem.system, start, args, t1=30.0, blocks=8, throw=False)

    def numbers(spectrum):
        return {name: np.asarray(getattr(spectrum, name), float) for name in COMPARED}

    omegas = jnp.asarray([2.0, 2.8, 1e-3])  # the last one comes to rest on the wall
    batch = jax.vmap(run)(omegas)
    assert len(set(np.asarray(batch.jumps).tolist())) == 3
    for i, omega in enumerate(omegas):
        one, other = jax.tree.map(lambda leaf, i=i: leaf[i], batch), run(omega)
        if other.status is not STATUS.zeno:
            assert_same(one, other, atol=1e-8)
            continue
        lane, alone = numbers(one), numbers(other)
        shaken = [numbers(run(omega, shake)) for shake in (-1e-15, -2e-16, 2e-16, 1e-15)]
        for name in COMPARED:
            moved = max(float(np.max(np.abs(start[name] - alone[name]), initial=0.0)) for start in shaken)
            assert moved < 1e-6, f"{name} is too sensitive to compare"
            np.testing.assert_allclose(lane[name], alone[name], rtol=1e-8, atol=max(1e-8, moved), err_msg=name)


@pytest.mark.slow
def test_starts_of_a_hybrid_system_are_m_runs():
    starts = jnp.asarray([[0.5, 0.0], [0.4, 0.0], [2.0, 0.0]])
    args = ball_args(restitution=0.85)
    together = lh.lyapunov_spectrum(BALL, starts, args, t1=12.0, blocks=BALL_BLOCKS, method=BALL_METHOD, throw=False)
    alone = [ball_spectrum(x, t1=12.0, restitution=0.85) for x in starts]
    assert together.status_code.tolist() == [int(run.status) for run in alone]
    assert len(set(together.status_code.tolist())) == 2
    assert together.status is STATUS.zeno  # the gravest
    np.testing.assert_allclose(together.replicates, [run.exponents for run in alone], rtol=0, atol=1e-12)
    np.testing.assert_allclose(together.x, [run.x for run in alone], rtol=0, atol=1e-12)


def test_user_functions_are_traced_a_few_times():
    """Where arguments are checked, for the start of a run and for its loop, however many stages a step has."""
    calls = collections.Counter()

    def counted(name, function):
        def called(*args):
            calls[name] += 1
            return function(*args)

        return called

    field = counted("field", lambda t, x, args: jnp.stack([x[1], -1 + 0 * x[0]]))
    bounce = lh.Transition(
        counted("guard", lambda t, x, args: x[0]), reset=lambda t, x, args: x * jnp.array([0.0, -1.0])
    )
    lh.lyapunov_spectrum(lh.Hybrid(field, bounce), [1.0, 0.0], t1=10.0)
    assert calls["field"] <= 3
    assert calls["guard"] <= 3
