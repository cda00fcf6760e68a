"""Runs of 10⁸ steps and of 10⁷ events: no time is lost, and memory does not grow."""

import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

WIDTH = np.pi / 3  # a turn takes as long, which no float64 is a multiple of
MEMORY = 80e6  # bytes: what code that is made on the way takes


def drift(t, x, rate):
    return jnp.stack([jnp.ones_like(x[0]), rate * x[1]])


TURNING = lh.Hybrid(  # after each turn the height is what it was at its beginning
    drift,
    lh.Transition(
        lambda t, x, rate: WIDTH - x[0], lambda t, x, rate: jnp.stack([x[0] - WIDTH, x[1] * jnp.exp(-rate * WIDTH)])
    ),
)


def turning(t1, **more):
    method = lh.RungeKutta("rk4", dt=0.5)
    return lh.lyapunov_spectrum(TURNING, [0.25, 1.0], 0.1, t1=t1, transient=0.0, method=method, **more)


def lorenz(t1):
    return lh.zoo.lorenz63().spectrum(t1=t1, transient=0.0, every=10, method=lh.RungeKutta("rk4", dt=0.01))


def resident() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read as Linux says it")
@pytest.mark.parametrize("run", [turning, lorenz])
def test_memory_does_not_grow_with_the_length(run):
    run(1e3)
    before = resident()
    found = run(1e6)
    assert resident() - before < MEMORY
    assert abs(float(found.time) - 1e6) <= 1e-12 * 1e6


@pytest.mark.slow
def test_no_time_is_lost_over_ten_million_events():
    """The phase at the end tells the sum of all flights. Within a block the time is one number, between them two."""
    t1 = 1e7
    found = turning(t1, blocks=500)
    assert int(found.jumps) == int((t1 + 0.25) // WIDTH)
    assert abs(float(found.x[0]) - (t1 + 0.25) % WIDTH) < 1e-12 * t1
    np.testing.assert_allclose(found.exponents, 0, atol=1e-7)


def test_no_time_is_lost_over_a_thousand_events():
    found = turning(1e3)
    assert int(found.jumps) == int((1e3 + 0.25) // WIDTH)
    assert abs(float(found.x[0]) - (1e3 + 0.25) % WIDTH) < 1e-12 * 1e3
