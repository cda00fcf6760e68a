"""Derivatives of a sample that lies at the very time of an event: that of the sample does not move with the event."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from examples import alone, between_walls, wall_ahead

# Position and velocity of a ball that a wall at `args` reflects: x₀ + v t before, 2 args - x₀ - v t after.
STEPPED = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], jnp.zeros_like(x[1])]),
    lh.Transition(lambda t, x, args: args - x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
)
EXACT = lh.EventDriven(
    lambda dt, t, x, args: jnp.stack([x[0] + x[1] * dt, x[1]]),
    lambda t, x, args: (jnp.where(x[1] > 0, (args - x[0]) / x[1], jnp.inf), jnp.asarray(0, jnp.int32)),
    lambda t, x, args, which: jnp.stack([x[0], -x[1]]),
    lambda t, x, args, which: args - x[0],
)
TICKING = lh.Hybrid(
    lambda t, x, args: jnp.ones_like(x), lh.Transition(every=lambda args: args, reset=lambda t, x, args: 2 * x)
)
ROWS = lh.EventDriven(
    lambda dt, y, args: jnp.stack([y[:, 0] + dt * y[:, 1], y[:, 1]], axis=1),
    None,
    lambda t, rows, args, which: jnp.stack([rows[:, 0] + 2 * t * rows[:, 1], -rows[:, 1]], axis=1),
    between_walls,
    schedule=alone(wall_ahead),
)


def final(system, x0, args, t1):
    return lh.trajectory(system, x0, args, t1=t1, n=1, throw=False).x[-1]


@pytest.mark.parametrize("system", [STEPPED, EXACT], ids=["steps", "closed form"])
@pytest.mark.slow
def test_a_wall_that_is_met_at_the_end(system):
    start, along = jnp.array([0.0, 2.0]), (jnp.array([0.3, 0.7]), 1.1)
    x, dx = jax.jvp(lambda x0, wall: final(system, x0, wall, 5.0), (start, 10.0), along)
    assert_allclose(x, [10.0, -2.0], rtol=1e-14)
    assert_allclose(dx, [2 * 1.1 - 0.3 - 5 * 0.7, -0.7], rtol=1e-12)  # one side's, as a little later


@pytest.mark.slow
def test_a_clock_that_ticks_at_the_end():
    """x = 1 + t doubles at T: 2 (1 + T) + t - T afterwards."""
    assert_allclose(jax.jvp(lambda period: final(TICKING, jnp.ones(1), period, 1.0), (1.0,), (1.0,)), [[4.0], [1.0]])


@pytest.mark.slow
def test_a_wall_that_one_of_several_bodies_meets_at_the_end():
    """Walls at 0 and 1: from 0.25 by v = 0.25 the wall is met at t = 3; x = 2 - x₀ - v t afterwards."""
    start = jnp.array([[0.25, 0.25], [0.5, -0.125]])
    along = jnp.array([[0.3, 0.7], [0.2, 0.1]])
    x, dx = jax.jvp(lambda x0: final(ROWS, x0, None, 3.0), (start,), (along,))
    assert_allclose(x, [[1.0, -0.25], [0.125, -0.125]], rtol=1e-14)
    assert_allclose(dx, [[-0.3 - 3 * 0.7, -0.7], [0.2 + 3 * 0.1, 0.1]], rtol=1e-12)


@pytest.mark.slow
def test_samples_around_the_event():
    """The sample at the event is before or after it, with that side's derivative; the others are as they were."""
    x, dx = jax.jvp(
        lambda wall: lh.trajectory(STEPPED, jnp.array([0.0, 2.0]), wall, t1=7.0, n=7, throw=False).x, (10.0,), (1.0,)
    )
    assert_allclose(x[:, 0], [2, 4, 6, 8, 10, 8, 6], rtol=1e-14)
    assert_allclose(dx[:, 0], np.where(np.asarray(x[:, 1]) > 0, 0.0, 2.0), rtol=0, atol=1e-12)


# x' = x (1 - x), halved or doubled at the ticks of clocks: flow and its derivative in closed form.
GROWING = lh.Hybrid(
    lambda t, x, args: x * (1 - x),
    [
        lh.Transition(every=lambda args: args[0], reset=lambda t, x, args: 0.5 * x),
        lh.Transition(every=lambda args: args[1], reset=lambda t, x, args: 1.5 * x),
    ],
)


def grown(x, dt):
    return x * jnp.exp(dt) / (1 + x * (jnp.exp(dt) - 1))


def with_ticks(x, periods, t, count):
    """x(t) after `count` ticks of both clocks, which have the same period at the point of interest."""
    last = 0.0
    for tick in range(1, count + 1):
        x = 0.5 * grown(x, tick * periods[0] - last)
        x = 1.5 * grown(x, tick * (periods[1] - periods[0]))
        last = tick * periods[1]
    return grown(x, t - last)


EACH_METHOD = [lh.RungeKutta(rtol=1e-11, atol=1e-13), lh.RungeKutta("rk4", dt=0.01)]


@pytest.mark.slow
@pytest.mark.parametrize("method", EACH_METHOD, ids=["adaptive", "fixed"])
def test_samples_at_every_tick_of_two_clocks(method):
    """Each such sample is after both ticks; derivatives by both periods, the start and the times, either way."""
    point = jnp.array([0.3]), (jnp.asarray(0.5), jnp.asarray(0.5)), jnp.asarray(2.0)

    def samples(x0, periods, t1):
        return lh.trajectory(GROWING, x0, periods, t1=t1, n=8, method=method, throw=False).x[:, 0]

    def exact(x0, periods, t1):
        return jnp.stack([with_ticks(x0[0], periods, t1 * i / 8, i // 2) for i in range(1, 9)])

    rng = np.random.default_rng(0)
    along = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), point)
    found, known = jax.jvp(samples, point, along), jax.jvp(exact, point, along)
    assert_allclose(found[0], known[0], rtol=1e-9)
    assert_allclose(found[1], known[1], rtol=1e-8)
    weights = jnp.asarray(rng.normal(size=8))
    found, known = jax.vjp(samples, *point)[1](weights), jax.vjp(exact, *point)[1](weights)
    jax.tree.map(lambda one, other: assert_allclose(one, other, rtol=1e-8), found, known)


@pytest.mark.slow
def test_an_exponent_whose_run_ends_at_a_tick():
    def exponent(period):
        run = lh.lyapunov_spectrum(GROWING, jnp.array([0.3]), (period, period), t1=2.0, throw=False)
        return run.exponents[0]

    def exact(period):
        return jnp.log(jax.grad(with_ticks)(0.3, (period, period), 2.0, 4)) / 2.0

    assert_allclose(jax.jvp(exponent, (0.5,), (1.0,)), jax.jvp(exact, (0.5,), (1.0,)), rtol=1e-7)


BOUNCING = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], -jnp.ones_like(x[1])]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -args * x[1]]), direction=-1),
)


@pytest.mark.slow
def test_a_bouncing_ball_sampled_at_its_impacts():
    """From height h to the floor at T = √(2 h), up with e T, down again at T + 2 e T: before, at and after impacts."""
    times = np.array([0.5, 1.0, 1.8, 2.6, 3.0])

    def exact(h, e, after):
        fall = jnp.sqrt(2 * h)
        starts = jnp.stack([-fall, fall, fall + 2 * e * fall])
        speeds = jnp.stack([fall, e * fall, e**2 * fall])
        since = times - starts[after]
        return jnp.stack([speeds[after] * since - since**2 / 2, speeds[after] - since], axis=1)

    def samples(h, e):
        return lh.trajectory(BOUNCING, jnp.stack([h, 0.0 * h]), e, t1=3.0, times=times, throw=False).x

    point, along = (jnp.asarray(0.5), jnp.asarray(0.8)), (1.3, -0.4)
    x, dx = jax.jvp(samples, point, along)
    after = np.array([0, int(x[1, 1] > 0), 1, 1 + int(x[3, 1] > 0), 2])
    known, moved = jax.jvp(lambda h, e: exact(h, e, after), point, along)
    assert_allclose(x, known, rtol=0, atol=1e-9)
    assert_allclose(dx, moved, rtol=0, atol=1e-8)
    weights = jnp.asarray(np.random.default_rng(0).normal(size=x.shape))
    by_both = jax.vjp(samples, *point)[1](weights)
    assert_allclose(along[0] * by_both[0] + along[1] * by_both[1], jnp.sum(weights * moved), rtol=1e-8)
