"""A wall that an oscillator reaches, or just does not: whether there is an impact is right, or the result says so.

A motion x'' = -x has the amplitude √(x² + v²) of its start, so rational numbers tell whether it meets the wall.
"""

from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

SYSTEM = lh.Hybrid(
    lambda t, x, wall: jnp.stack([x[1], -x[0]]),
    lh.Transition(lambda t, x, wall: wall - x[0], lambda t, x, wall: jnp.stack([x[0], -x[1]])),
)
METHODS = {
    "default": lh.RungeKutta(),
    "dopri5 loose": lh.RungeKutta("dopri5", rtol=1e-6, atol=1e-8),
    "rk4 long": lh.RungeKutta("rk4", dt=0.1),
    "dopri5 steps": lh.RungeKutta("dopri5", dt=0.25),
}
LENGTH = 3.1  # one extremum
CASES = 60


def cases(kind):
    """Starts and walls: the wall lies up to 1e-3 before or behind the amplitude, as close as the type tells."""
    draw = np.random.default_rng(3)
    for _ in range(CASES):
        phase, exponent = draw.uniform(0.6, 2.5), draw.uniform(-8 if kind is np.float32 else -13, -3)
        start = np.array([np.cos(phase), np.sin(phase)], kind)
        yield start, kind(np.hypot(*start.astype(float)) + draw.choice([-1, 1]) * 10.0**exponent)


def meets(start, wall) -> bool:
    return Fraction(float(wall)) ** 2 < sum(Fraction(float(one)) ** 2 for one in start)


@pytest.mark.filterwarnings("ignore:x0 is float32")
@pytest.mark.slow
@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("name", METHODS)
def test_an_impact_that_is_missed_or_made_is_noted(name, kind):
    mistaken, silent = 0, []
    for start, wall in cases(kind):
        found = lh.lyapunov_spectrum(
            SYSTEM, start, wall, t1=LENGTH, transient=0.0, blocks=2, method=METHODS[name], throw=False
        )
        is_right = (int(found.jumps) > 0) == meets(start, wall)
        mistaken += not is_right
        if not is_right and "grazing" not in found.notes:
            silent.append((start, wall))
    assert silent == []
    assert (mistaken > 0) == ((name, kind) != ("default", np.float64))  # else the cases would show nothing


def test_an_impact_that_is_far_from_grazing_is_not_noted():
    for wall in (0.9, 0.99, 1.01, 1.1):
        found = lh.lyapunov_spectrum(SYSTEM, [0.0, 1.0], wall, t1=LENGTH, transient=0.0, blocks=2)
        assert int(found.jumps) == int(wall < 1)
        assert "grazing" not in found.notes
