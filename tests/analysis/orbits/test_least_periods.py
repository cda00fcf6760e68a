"""Of an orbit whose period is not given the least period is found, not one of its multiples."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid.analysis.orbits.motion.motions import Motion, Node
from lyaphybrid.analysis.orbits.motion.returns import least_period
from lyaphybrid.engine import preparation


def _loop_filter(pump):
    """Phases of the reference and of the oscillator, and the voltages of the loop's filter."""

    def field(t, x, args):
        return jnp.stack([1.2 + 0 * x[0], 1 + 0.5 * x[2], (0.3 * pump - (x[2] - x[3])) / 0.1, x[2] - x[3]])

    return field


def _edge(phase, source, target):
    return lh.Transition(
        lambda t, x, args: 1 - x[phase], lambda t, x, args: x.at[phase].add(-1.0), source=source, target=target
    )


LOCKED = lh.Hybrid(
    {"up": _loop_filter(1.0), "idle": _loop_filter(0.0), "down": _loop_filter(-1.0)},
    [
        *(_edge(0, *modes) for modes in (("up", "up"), ("idle", "up"), ("down", "idle"))),
        *(_edge(1, *modes) for modes in (("up", "idle"), ("idle", "down"), ("down", "down"))),
    ],
)


@pytest.mark.parametrize("transient", [200.0, 203.3, 60.0])
def test_the_least_period_where_both_phases_meet_at_one_instant(transient):
    """A phase-locked loop in lock: after a transient the nearest of many returns came 2, 6 and 14 turns later."""
    orbit = lh.floquet(LOCKED, [0.0, 0.3, 0.0, 0.0], mode="idle", transient=transient)
    assert_allclose(orbit.period, 1 / 1.2, rtol=1e-11)
    assert orbit.jumps == 2


@pytest.mark.parametrize("number", [2, 3, 10, 13])
def test_a_multiple_of_the_least_period(number):
    oscillator = lh.Flow(_van_der_pol)
    orbit = lh.floquet(oscillator, [2.0, 0.0], 1.0)
    method = lh.RungeKutta(rtol=1e-12, atol=1e-14)
    flow = Motion(preparation.prepare(oscillator, orbit.x0, 1.0, 0.0, method, None)[0])
    piece = flow.piece(Node(0.0, orbit.x0, 0), number * orbit.period)
    found = least_period(flow, [piece], number * orbit.period, np.ones(2))
    assert_allclose(found, orbit.period, rtol=1e-12)


def _van_der_pol(t, x, mu):
    return jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]])
