"""The derivative-free exponent: against exact values, references and the tangent on the same orbit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid._jax.engines import compilations

BALL = lh.EventDriven(
    flow=lambda dt, t, x, g: jnp.stack([x[0] + x[1] * dt - 0.5 * g * dt**2, x[1] - g * dt]),
    next_event=lambda t, x, g: ((x[1] + jnp.sqrt(x[1] ** 2 + 2 * g * x[0])) / g, 0),
    jump=lambda t, x, g, which: jnp.stack([0 * x[0], -x[1]]),
    guard=lambda t, x, g, which: x[0],
)


def assert_within(result, value, stderr, gate):
    """Within five standard errors, after the standard error has passed a gate."""
    assert result.status == lh.STATUS.ok
    error = float(np.hypot(result.stderr, stderr))
    assert error < gate
    assert abs(float(result.exponent) - value) < 5 * error, str(result)


def run(problem, **keywords):
    return lh.two_trajectories(problem.system, problem.x0, problem.args, mode=problem.mode, **keywords)


# --- values


def forced_impacts(separation, turns):
    """λ1 of the impact oscillator over 400, begun after so many periods of its forcing."""
    problem = zoo.impact_oscillator()
    late = turns * 2 * np.pi / problem.args["omega"]
    return run(problem, t0=late, t1=400.0, transient=50.0, separation=separation), problem.reference.exponents[0]


@pytest.mark.slow
def test_a_separation_that_the_rounding_of_time_exceeds_is_noted():
    """At t = 1e5 time has a rounding of 1e-11: 1.64 came out for 0.158, and nothing was said."""
    with pytest.warns(UserWarning, match="not large against rounding"):
        found, exact = forced_impacts(1e-12, 50_000)
    assert float(found.exponent) > 5 * exact
    found, exact = forced_impacts(1e-6, 50_000)
    assert abs(float(found.exponent) - exact) < 5 * float(found.stderr)
    assert found.stderr < 0.03


def test_a_separation_that_the_rounding_of_a_growing_state_exceeds_is_noted():
    def spiral(n, x, args):
        return jnp.stack([x[0] + 1.0, 4.0 * x[1] * (1 - x[1])])

    with pytest.warns(UserWarning, match=r"of the state \(up to 2e\+04\)"):
        lh.two_trajectories(lh.Map(spiral), [0.0, 0.3], t1=20_000, separation=1e-11)


@pytest.mark.slow
def test_henon_is_what_the_tangent_gives_on_the_same_orbit():
    problem = zoo.henon_map()
    found = run(problem, t1=50_000, transient=100)
    tangent = lh.lyapunov_spectrum(problem.system, problem.x0, problem.args, t1=50_000, transient=100, k=1)
    assert_allclose(found.x, tangent.x, rtol=1e-12)
    assert abs(float(found.exponent - tangent.exponents[0])) < 1e-5
    assert found.skipped == 0
    assert_within(found, 0.41919054, 3.7e-5, gate=0.003)


@pytest.mark.slow
def test_lorenz():
    assert_within(run(zoo.lorenz63(), t1=2000.0, transient=20.0), 0.905873, 1.5e-4, gate=0.025)


@pytest.mark.slow
def test_impact_oscillator():
    problem = zoo.impact_oscillator()
    found = run(problem, t1=10_000.0, transient=100.0)
    assert_within(found, problem.reference.exponents[0], problem.reference.stderr[0], gate=0.006)
    assert int(found.skipped) < 0.01 * int(found.intervals)


@pytest.mark.slow
def test_hard_disks():
    problem = zoo.hard_disks(n=4, density=0.7)
    assert_within(run(problem, t1=400.0, transient=10.0), 4.88239, 1e-3, gate=0.06)


@pytest.mark.slow
def test_two_modes_exactly():
    """The fundamental matrix over a turn is e^μ times the identity, whatever the separation."""
    problem = zoo.conewise_linear(sigma_right=0.1, sigma_left=-0.3)
    growth, turn = np.pi * (0.1 - 0.15), np.pi * 1.5
    found = run(problem, t1=10 * turn)
    assert_allclose(found.exponent, growth / turn, atol=1e-7)
    assert found.skipped == 0


@pytest.mark.slow
def test_an_expanding_clock():
    problem = zoo.beta_clock()
    assert_allclose(run(problem, t1=500.0, transient=50.0).exponent, problem.reference.exponents[0], atol=1e-3)


@pytest.mark.slow
def test_slow_decay_and_fast_decay():
    """The choice of the interval has no scale of its own."""
    for rate in (1e-4, 1.0, 1e6):
        flow = lh.Flow(lambda t, x, rate: -rate * jnp.array([1.0, 3.0]) * x)
        found = lh.two_trajectories(flow, [1.0, 1.0], rate, t1=5 / rate, transient=10 / rate)
        assert_allclose(found.exponent, -rate, rtol=1e-4)


def test_an_elastic_ball():
    """Separations grow linearly: the exponent is 0 like ln t / t."""
    found = lh.two_trajectories(BALL, [0.5, 0.0], 1.0, t1=1000.0, transient=100.0)
    assert abs(float(found.exponent)) < 0.01


def test_trajectories_that_meet():
    found = lh.two_trajectories(lh.Map(lambda n, x, args: 0 * x + 0.3), [0.1], t1=10)
    assert found.exponent == -np.inf
    assert found.status == lh.STATUS.ok


@pytest.mark.slow
def test_a_fixed_interval_and_another_separation():
    problem = zoo.henon_map()
    automatic = run(problem, t1=5000)
    assert_allclose(run(problem, t1=5000, renormalise_every=3).exponent, automatic.exponent, atol=1e-4)
    assert_allclose(run(problem, t1=5000, separation=1e-7).exponent, automatic.exponent, atol=1e-4)
    other = run(problem, t1=5000, key=jax.random.key(1))
    assert other.exponent != automatic.exponent
    assert_allclose(other.exponent, automatic.exponent, atol=1e-3)


# --- the result


def test_history_and_print():
    found = run(zoo.henon_map(), t1=640, blocks=8)
    assert_allclose(found.history.time, 80.0 * np.arange(1, 9))
    assert_allclose(found.history.exponents[-1], found.exponent)
    assert_allclose(np.sum(found.history.growth), found.exponent * found.time)
    assert str(found).startswith("λ1 0.4")
    assert "per iteration, from two trajectories 1e-08 apart" in str(found)
    assert "0 of them skipped; status ok" in str(found)
    assert jax.jit(lambda: jnp.asarray(len(str(run(zoo.henon_map(), t1=64)))))() > 0


@pytest.mark.slow
def test_jit_and_vmap():
    problem = zoo.henon_map()

    def exponent(x0):
        return lh.two_trajectories(problem.system, x0, problem.args, t1=500).exponent

    starts = jnp.stack([problem.x0, problem.x0 + 0.01])
    eager = [exponent(x0) for x0 in starts]
    assert_allclose(jax.jit(exponent)(starts[0]), eager[0], rtol=1e-12)
    assert_allclose(jax.vmap(exponent)(starts), eager, rtol=1e-12)


def test_jit_and_vmap_with_events():
    def exponent(x0):
        return lh.two_trajectories(BALL, x0, 1.0, t1=20.0, blocks=2).exponent

    starts = jnp.array([[0.5, 0.0], [0.1, 0.3], [3.0, 4.0]])
    assert_allclose(jax.jit(jax.vmap(exponent))(starts), [exponent(x0) for x0 in starts], atol=1e-7)


def test_a_first_call_waits_for_few_programs():
    """Each function of JAX outside compiled code would be a program of its own, compiled by XLA: there were over 40."""
    jax.clear_caches()
    before = compilations()
    run(zoo.logistic_map(), t1=50.0, transient=10.0, blocks=5)
    assert 0 < compilations() - before <= 12


# --- statuses and warnings


@pytest.mark.slow
def test_a_run_that_fails_keeps_what_it_found():
    escape = lh.Flow(lambda t, x, args: x**2)
    with pytest.raises(lh.RunFailedError, match="stood at t") as caught:
        lh.two_trajectories(escape, [1.0], t1=2.0)
    found = lh.two_trajectories(escape, [1.0], t1=2.0, throw=False)
    assert found.status == caught.value.result.status
    assert found.status in (lh.STATUS.nonfinite, lh.STATUS.step_underflow)
    assert np.isnan(found.history.time[-1])
    assert found.exponent > 0


def test_intervals_that_are_too_long_are_told():
    with pytest.warns(UserWarning, match="intervals did not count.*shorten renormalise_every"):
        run(zoo.henon_map(), t1=4000, renormalise_every=40)


@pytest.mark.slow
def test_jumps_of_one_trajectory_alone_do_not_count():
    """The first one passes above a guard that touches zero, the second one dips below, once a period."""
    passing = lh.Hybrid(
        lambda t, x, args: 0 * x, lh.Transition(lambda t, x, args: x[0] - 127 + jnp.cos(t), lambda t, x, args: x)
    )
    keys = [key for key in map(jax.random.key, range(8)) if jax.random.normal(key, (1,))[0] < 0]
    assert keys
    periods = 20
    with pytest.warns(UserWarning, match=f"^{periods} of .* the motion often grazes"):
        found = lh.two_trajectories(
            passing, [128 + 2.0**-11], t1=2 * np.pi * periods, separation=2.0**-10, renormalise_every=0.5, key=keys[0]
        )
    assert found.exponent == 0
    assert found.skipped == periods
    assert found.time < 2 * np.pi * periods


# --- bad arguments

LOGISTIC = lh.Map(lambda n, x, r: r * x * (1 - x))


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"t1": -1}, "t1 must be positive and finite; got -1"),
        ({"separation": 0.0}, "separation must be positive and finite; got 0.0"),
        ({"separation": 1e-16}, r"separation must be large against the rounding of x0.*got 1e-16"),
        ({"renormalise_every": np.inf}, "renormalise_every must be positive and finite; got inf"),
        ({"transient": -2.0}, "transient, a length, must not be negative; got -2.0"),
        ({"blocks": 1}, "blocks must be an integer of at least 2; got 1"),
        ({"method": lh.RungeKutta()}, "A map is iterated"),
        ({"x0": [[0.3]]}, r"x0 must have shape \(n,\) here; got \(1, 1\)"),
    ],
)
def test_bad_arguments(keywords, message):
    keywords = {"x0": [0.3], "t1": 100} | keywords
    with pytest.raises(ValueError, match=message):
        lh.two_trajectories(LOGISTIC, keywords.pop("x0"), 4.0, **keywords)


@pytest.mark.parametrize("scale", [1e-9, 1e-6, 1e9])
def test_small_units_need_a_smaller_separation_and_say_so(scale):
    """Hénon's map in other units: λ1 is the same, and where the default separation is too large a warning says so."""

    def rule(n, x, s):
        a, b = x / s
        return s * jnp.stack([1 - 1.4 * a**2 + b, 0.3 * a])

    start, how = scale * np.array([0.1, 0.1]), {"t1": 4000, "transient": 100}
    if scale < 1e-8:
        with (
            pytest.warns(UserWarning, match="not small against the motion"),
            pytest.warns(UserWarning, match="did not count"),
        ):
            lh.two_trajectories(lh.Map(rule), start, scale, **how)
    found = lh.two_trajectories(lh.Map(rule), start, scale, separation=1e-8 * scale, **how)
    same = lh.two_trajectories(lh.Map(rule), [0.1, 0.1], 1.0, **how)
    assert_allclose(found.exponent, same.exponent, rtol=0, atol=0.02)


def test_a_separation_that_falls_to_rounding_is_said():
    """x' = −x/10 over intervals in which the separation shrinks to 1e-17; it read −0.037(7) without a word."""
    decay = lh.Flow(lambda t, x, a: -0.1 * x)
    with pytest.warns(UserWarning, match="in 2 of 2 intervals the separation falls to .*: shorten renormalise_every"):
        lh.two_trajectories(decay, [1.0, 2.0], t1=1000.0, renormalise_every=1000.0)
    shorter = lh.two_trajectories(decay, [1.0, 2.0], t1=1000.0, renormalise_every=50.0)
    assert_allclose(shorter.exponent, -0.1, rtol=1e-5)


def test_an_interval_is_no_longer_than_the_run():
    """After a transient it did not end in minutes."""
    with pytest.raises(ValueError, match=r"renormalise_every must be at most t1 = 100; got 1000000000\.0"):
        lh.two_trajectories(LOGISTIC, [0.3], 4.0, t1=100, transient=10, renormalise_every=1e9)
