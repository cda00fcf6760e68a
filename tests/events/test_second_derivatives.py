"""Second derivatives through events, against closed forms and differences of first ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

# A ball falls from the height h with the acceleration 1; the floor leaves 0.8 of its speed.
DROPPED = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], 0 * x[0] - 1]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]])),
)
CLOSED = lh.EventDriven(
    lambda dt, t, x, args: jnp.stack([x[0] + dt * x[1] - dt**2 / 2, x[1] - dt]),
    lambda t, x, args: (x[1] + jnp.sqrt(x[1] ** 2 + 2 * x[0]), 0),
    lambda t, x, args, which: jnp.stack([x[0], -0.8 * x[1]]),
    lambda t, x, args, which: x[0],
)


def second(function, at):
    return jax.jacfwd(jax.jacfwd(function))(at)


def by_differences(function, at, step=1e-5):
    slope = jax.jacfwd(function)
    return (slope(at + step) - slope(at - step)) / (2 * step)


@pytest.mark.parametrize("system", [DROPPED, CLOSED])
def test_a_ball_that_is_dropped(system):
    def run(h):
        return lh.trajectory(system, jnp.stack([h, 0 * h]), t1=2.5, n=1)

    def height(h):  # 0.8 v (2.5 − v) − (2.5 − v)²/2 with v = √(2h), so −4.5 at h = 1/2
        return run(h).x[-1, 0]

    def entry(h):  # d(height)/dh
        return lh.tangent_map(system, jnp.stack([h, 0 * h]), t1=2.5).matrix[0, 0]

    assert_allclose(second(height, 0.5), -4.5, rtol=1e-12)
    assert_allclose(second(lambda h: run(h).events.t[0], 0.5), -1.0, rtol=1e-12)
    assert_allclose(jax.jacfwd(entry)(0.5), -4.5, rtol=1e-12)
    assert_allclose(second(entry, 0.5), 13.5, rtol=1e-12)


OSCILLATOR = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], jnp.cos(args * t) - 0.1 * x[1] - x[0]]),
    lh.Transition(lambda t, x, args: -x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]])),
)
# A switched circuit with a timer as a state: the guard's rate is constant, and the reset sets the timer back.
TIMED = lh.Hybrid(
    {
        "on": lambda t, x, args: jnp.stack([args - x[0] ** 2, 1 + 0 * x[1]]),
        "off": lambda t, x, args: jnp.stack([-args * jnp.sin(x[0]), 1 + 0 * x[1]]),
    },
    [
        lh.Transition(lambda t, x, args: args - x[0] - x[1], source="on", target="off"),
        lh.Transition(
            lambda t, x, args: 1 - x[1] * args,
            lambda t, x, args: jnp.stack([x[0], 0.0 * x[1]]),
            source="off",
            target="on",
        ),
    ],
)
CASES = {"oscillator": (OSCILLATOR, None, [0.0, -0.5], 2.8, 8.0), "timer": (TIMED, "on", [0.2, 0.0], 1.3, 4.0)}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_trajectories_tangent_maps_and_exponents(case):
    system, mode, x0, at, t1 = CASES[case]
    assert len(lh.trajectory(system, x0, at, t1=t1, mode=mode).events) > 2

    def found(args):
        start = jnp.stack([x0[0] + 0.1 * (args - at), jnp.asarray(x0[1])])
        tangent = lh.tangent_map(system, start, args, t1=t1, mode=mode)
        spectrum = lh.lyapunov_spectrum(system, start, args, t1=t1, mode=mode, transient=0.0, k=1)
        return jnp.concatenate([tangent.x, tangent.matrix.ravel(), spectrum.exponents])

    wanted = by_differences(found, at)
    assert np.sum(np.abs(wanted) > 1e-2) >= 4
    assert_allclose(second(found, at), wanted, rtol=1e-5, atol=1e-6)
