"""Where a run ended before its time, and how: in results and in messages, of one run and of several."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from examples import BALL_BLOCKS, ENDLESS_CASCADE, LOGISTIC, ball_spectrum
from lyaphybrid import STATUS
from lyaphybrid.engine.host import driver

ESCAPE = lh.Flow(lambda t, x, args: args * x * x)


def failure(call, *args, **options):
    """The error of a run that fails; nothing in it may be nan but a state that is."""
    with pytest.raises(lh.RunFailedError) as caught:
        call(*args, **options)
    assert "t = nan" not in str(caught.value)
    return caught.value


def interrupt(fraction):
    """Ctrl-C after the first block."""
    if fraction > 0:
        raise KeyboardInterrupt


@pytest.mark.parametrize("transient", [0.0, 64.0])
def test_an_interrupted_run_says_so(transient):
    with pytest.warns(UserWarning, match="interrupted"):
        spectrum = lh.lyapunov_spectrum(
            LOGISTIC, [0.3], 4.0, t1=50_000_000, blocks=4096, transient=transient, progress=interrupt
        )
    assert spectrum.status is STATUS.interrupted
    assert not spectrum.status.failed
    assert "status interrupted: Ctrl-C" in str(spectrum)
    assert "reached its end" not in str(spectrum)
    assert 0 < float(spectrum.time) < 50_000_000


def test_interrupted_within_the_transient(monkeypatch):

    def stop(loop_state, blocks):
        raise KeyboardInterrupt

    monkeypatch.setattr(driver, "_finished", stop)
    with pytest.warns(UserWarning, match="interrupted"):
        spectrum = lh.lyapunov_spectrum(LOGISTIC, [0.3], 4.0, t1=1000, transient=10_000_000)
    assert spectrum.status is STATUS.interrupted
    assert float(spectrum.time) == 0
    assert np.isnan(spectrum.exponents).all()


def test_the_place_where_attempts_are_spent():
    """x' = 1: the state is the time, also within a block."""
    clock = lh.Flow(lambda t, x, args: jnp.ones_like(x))
    method = lh.RungeKutta("dopri5", max_step=0.01)
    options = {"t1": 100.0, "t0": 2.0, "blocks": 2, "method": method, "max_steps": 700}
    spectrum = lh.lyapunov_spectrum(clock, [2.0], throw=False, **options)
    assert spectrum.status is STATUS.max_steps
    assert 8 < float(spectrum.t) < 10
    assert float(spectrum.t) == pytest.approx(float(spectrum.x[0]), rel=1e-12)
    error = failure(lh.lyapunov_spectrum, clock, [2.0], **options)
    assert f"t = {float(spectrum.t):.10g}, x = [{float(spectrum.x[0]):.6g}]" in str(error)
    for call in (lh.trajectory, lh.tangent_map):
        error = failure(call, clock, [2.0], t1=100.0, t0=2.0, method=method, max_steps=700)
        assert re.search(r"t = (8\.\d+), x = \[\1\]|t = 9, x = \[9\]", str(error))


def test_the_place_and_the_mode_of_a_failure():
    system = lh.Hybrid(
        {"rest": lambda t, x, args: jnp.ones_like(x), "escape": lambda t, x, args: x * x},
        lh.Transition(lambda t, x, args: 1 - x[0], target="escape", source="rest"),
    )
    error = failure(lh.lyapunov_spectrum, system, [0.0], t1=10.0, mode="rest")
    assert error.status is STATUS.nonfinite
    assert re.search(r"t = (1\.9999\d*|2), x = \[[\d.e+]+\], mode 'escape'", str(error))


def test_several_runs_are_told_apart():
    """x' = x² from 1 escapes at t = 1, from 1/2 at 2; from -1 it does not."""
    starts = [[-1.0], [1.0], [-2.0], [0.5]]
    error = failure(lh.lyapunov_spectrum, ESCAPE, starts, 1.0, t1=4.0, blocks=8)
    assert re.search(r"Of 4 runs: 2 ok, 2 nonfinite\. Run 1 stood at t = (0\.9999\d*|1), x = ", str(error))
    assert "of the runs: 2 ok, 2 nonfinite" in str(error.result)
    assert error.result.status is STATUS.nonfinite


@pytest.mark.slow
def test_what_has_failed_comes_before_what_has_been_ended():
    """One run escapes, the other spends its attempts, whose code is the larger or the smaller."""
    with pytest.warns(UserWarning, match="interrupted"):
        spectrum = lh.lyapunov_spectrum(
            lh.Map(lambda n, x, args: args * x * (1 - x)), [[0.3], [1.3]], 4.0, t1=50_000_000, blocks=4096,
            progress=interrupt, throw=False,
        )  # fmt: skip
    assert spectrum.status is STATUS.nonfinite
    assert "1 nonfinite, 1 interrupted" in str(spectrum)


@pytest.mark.slow
def test_an_accumulation_is_told_where_it_is_known():
    error = failure(lh.lyapunov_spectrum, ENDLESS_CASCADE, [0.5, 1.0], t1=2.2, k=1, blocks=2)
    assert error.status is STATUS.zeno
    assert "seem to accumulate" not in str(error)
    assert "nan" not in str(error)
    error = failure(ball_spectrum, (1.0, 0.0), restitution=0.8, throw=True)
    assert "seem to accumulate at t = 12.7279" in str(error)


def test_a_time_of_flight_that_is_no_number_leaves_the_time_as_it_was():
    broken = lh.EventDriven(
        flow=lambda dt, t, x, args: x - dt,
        next_event=lambda t, x, args: (jnp.where(t < 2.5, x[0], jnp.nan), 0),
        jump=lambda t, x, args, which: x + 1.0,
        guard=lambda t, x, args, which: x[0],
    )
    error = failure(lh.lyapunov_spectrum, broken, [1.0], t1=8.0, blocks=BALL_BLOCKS)
    assert error.status is STATUS.nonfinite
    assert float(error.result.t) == pytest.approx(3.0, abs=1e-12)


@pytest.mark.slow_cases(all_but=("gali", "section"))
@pytest.mark.parametrize(
    "call",
    [
        lambda: lh.gali(ESCAPE, [1.0, 1.0], 1.0, t1=2.0),
        lambda: lh.poincare_section(ESCAPE, [1.0, 1.0], 1.0, section=lambda t, x, args: x[0] + 1, n=3),
        lambda: lh.two_trajectories(ESCAPE, [1.0, 1.0], 1.0, t1=2.0),
        lambda: lh.covariant_vectors(ESCAPE, [1.0, 1.0], 1.0, t1=2.0),
    ],
    ids=["gali", "section", "two trajectories", "covariant vectors"],
)
def test_others_tell_the_place_too(call):
    error = failure(call)
    assert error.status is STATUS.nonfinite
    assert re.search(r"t = (0\.999\d*|1(\.0\d*)?), x = \[", str(error))


@pytest.mark.slow
def test_two_trajectories_that_get_nowhere_are_given_up():
    """The field jumps, and steps are as short as its error asks: the rest would take hours."""
    jumping = lh.Flow(lambda t, x, args: jnp.stack([-jnp.sign(x[0]), -x[1]]))
    error = failure(lh.two_trajectories, jumping, [1e-9, 0.3], t1=10.0)
    assert error.status is STATUS.stalled
    assert "Such short steps are those of a field" in str(error)
    assert 0 < float(error.result.t) < 1


def test_a_field_that_is_undefined_just_beyond_ends_a_run_where_nobody_looks():
    """Steps far below the rounding of t = 2 are accepted for ever: a compiled run alone must see that."""
    root = lh.Flow(lambda t, x, args: jnp.stack([args + 0 * x[0], jnp.sqrt(2 - x[0])]))
    run = jax.jit(lambda a: lh.lyapunov_spectrum(root, jnp.zeros(2), a, t1=10.0, blocks=4, throw=False))
    spectrum = run(1.0)
    assert int(spectrum.status_code) == STATUS.nonfinite
    assert float(spectrum.t) == pytest.approx(2.0, rel=1e-12)


def test_a_search_for_an_orbit_returns_nothing_where_the_motion_fails():
    found = lh.floquet(ESCAPE, [1.0, 1.0], 1.0, throw=False)
    assert found.residual == np.inf
    assert found.stability == "unknown"
    assert np.isnan(found.multipliers).all()
    error = failure(lh.floquet, ESCAPE, [1.0, 1.0], 1.0)
    assert error.result.x0.tolist() == [1.0, 1.0]


@pytest.mark.slow
def test_a_derivative_of_a_run_that_fails():
    """Asked for by name, and by the first method that applies: nothing is known, and why."""
    for method in ("auto", "implicit", "birkhoff", "equilibrium"):
        with pytest.raises(lh.NoDerivativeError, match="nonfinite") as caught:
            lh.lyapunov_gradient(ESCAPE, [1.0, 1.0], 1.0, t1=10.0, transient=2.0, algorithm=method)
        found = caught.value.result
        assert not found.trust
        assert np.isnan(found.value).all()
        assert "nonfinite" in found.reasons[0]


def test_a_design_that_comes_to_where_the_motion_fails_keeps_what_it_has():
    """λ = ln|2 − r| of the logistic map, which has no motion beyond r = 4."""
    logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
    found = lh.design(logistic, [0.3], {"r": 2.9}, 0.0, over={"r": (2.8, 4.6)}, t1=200, optimiser="bisection")
    assert not found.trust
    assert "not known" in found.reasons[0]
    assert len(found.history) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("target", [2, -1])
def test_a_target_that_is_no_mode(target):
    """It was taken for the nearest mode, without a word."""
    ball = lh.Hybrid(
        {"down": lambda t, x, args: jnp.stack([x[1], -1.0]), "up": lambda t, x, args: jnp.stack([x[1], -1.0])},
        lh.Transition(
            lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]]), target=lambda t, x, args: args
        ),
    )
    for call in (lh.trajectory, lh.lyapunov_spectrum):
        error = failure(call, ball, [0.5, 0.0], target, t1=3.0, mode="down")
        assert error.status is STATUS.deadlock
        assert f"mode {target}, which is none of ['down', 'up']" in str(error)
        assert "t = 1," in str(error)


BALL = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], -1.0 + 0 * x[0]]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -args * x[1]])),
)
NUMBERS = {
    "exponents": lambda r, **how: lh.lyapunov_spectrum(BALL, [1.0, 0.0], r, t1=20.0, blocks=4, **how).exponents,
    "a tangent map": lambda r, **how: lh.tangent_map(BALL, [1.0, 0.0], r, t1=20.0, **how).matrix,
    "two trajectories": lambda r, **how: lh.two_trajectories(BALL, [1.0, 0.0], r, t1=20.0, **how).exponent,
}


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("ways", ["vmap", "sweep"])
def test_a_number_that_is_taken_from_a_failed_run_is_nan(name, ways):
    """A ball that loses half its speed at each impact comes to rest: of the status nothing is left in a number."""
    number = NUMBERS[name]

    def found(**how):
        one = lambda r: number(r, **how)  # noqa: E731
        if ways == "vmap":
            return np.asarray(jax.vmap(one)(jnp.array([0.5, 1.0])))
        return lh.sweep(one, {"args": [0.5, 1.0]}, args=1.0, progress=False).value.values

    raised, kept = found(), found(throw=False)
    assert np.all(np.isnan(raised[0]))
    assert np.all(np.isfinite(kept))  # who asks for what there is gets it
    np.testing.assert_array_equal(raised[1], kept[1])
    np.testing.assert_allclose(raised[1], np.asarray(number(1.0)), rtol=1e-9, atol=1e-12)
