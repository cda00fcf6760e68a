"""Events of guards, walls and clocks soon after each other: none is lost, none comes twice; against exact fractions."""

from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import STATUS

# A point on a line. It counts levels that it passes: those of the first row upwards, of the second either way, of the
# third downwards; at walls and at ticks its velocity is multiplied.
LEVELS, WALLS = 3, 2
WAYS = (-1, 0, 1)  # the directions in which the guards level - x pass through zero


def _counts(row):
    def reset(t, x, args, which):
        return x.at[2 + LEVELS * row + which].add(1.0)

    return lh.Transition(lambda t, x, args: args["levels"][row] - x[0], reset, direction=WAYS[row])


def _moving(t, x, args):
    return jnp.zeros_like(x).at[0].set(x[1])


LINE = lh.Hybrid(
    _moving,
    [
        *(_counts(row) for row in range(3)),
        lh.Transition(
            lambda t, x, args: args["walls"] - x[0],
            lambda t, x, args, which: x.at[1].multiply(args["factors"][which]),
            direction=-1,
        ),
        lh.Transition(every=lambda args: args["period"], reset=lambda t, x, args: x.at[1].multiply(args["kick"])),
    ],
)


def exactly(args, velocity, t1):
    """Counts (3, LEVELS), the final position and velocity: flights from event to event in fractions."""
    levels, walls = [[Fraction(float(v)) for v in row] for row in args["levels"]], args["walls"]
    t, x, v, ticks, counts = Fraction(0), Fraction(0), Fraction(velocity), 1, np.zeros((3, LEVELS))
    period, kick = Fraction(float(args["period"])), Fraction(float(args["kick"]))
    passed = None  # the event that has just been: the point stands on its level
    while True:
        due = [(ticks * period - t, "tick", 0, 0), (Fraction(t1) - t, "end", 0, 0)]
        for row in range(3):
            for i, level in enumerate(levels[row]):
                due.append(((level - x) / v, "level", row, i))
        for i, wall in enumerate(walls):
            due.append(((Fraction(float(wall)) - x) / v, "wall", 0, i))
        due = [one for one in due if one[0] > 0 or (one[0] == 0 and one[1] in ("tick", "end"))]
        due = [one for one in due if one[1:] != passed or one[0] > 0]
        dt, kind, row, i = min(due, key=lambda one: one[0])
        t, x, passed = t + dt, x + v * dt, (kind, row, i)
        if kind == "end":
            return counts, float(x), float(v)
        if kind == "tick":
            ticks, v = ticks + 1, v * kick
        elif kind == "level":
            counts[row, i] += WAYS[row] == 0 or (WAYS[row] == -1) == (v > 0)
        elif v > 0:
            v = v * Fraction(float(args["factors"][i]))


def drawn(seed):
    """Levels a little before or after walls, places of ticks, and each other; from 1e-12 to 1e-3 apart."""
    rng = np.random.default_rng(seed)
    walls = rng.uniform(0.5, 2.0, WALLS)
    places = np.concatenate([walls, rng.uniform(0.2, 2.0, 2), [0.4, 0.8]])
    apart = rng.choice([-1, 1], (3, LEVELS)) * 10.0 ** -rng.uniform(3, 12, (3, LEVELS))
    return {
        "levels": rng.choice(places, (3, LEVELS)) + apart,
        "walls": walls,
        "factors": rng.choice([-1.0, -0.5, 0.5, 2.0], WALLS),
        "period": rng.choice([0.4, 0.8]),
        "kick": rng.choice([1.0, 1.0, -1.0, 0.5, 2.0]),
    }


def compared(seeds, method=None):
    for seed in seeds:
        args = drawn(seed)
        counts, x, v = exactly(args, 1.0, 3.0)
        start = jnp.zeros(2 + 3 * LEVELS).at[1].set(1.0)
        run = lh.trajectory(LINE, start, args, t1=3.0, n=1, method=method, throw=False)
        assert run.status == STATUS.ok, (seed, args)
        assert_allclose(run.x[-1, 2:].reshape(3, LEVELS), counts, rtol=0, atol=0, err_msg=f"seed {seed}")
        assert_allclose(run.x[-1, :2], [x, v], rtol=0, atol=1e-9, err_msg=f"seed {seed}")


@pytest.mark.slow
def test_a_few_lines():
    compared(range(20))


@pytest.mark.slow
@pytest.mark.parametrize("method", [None, lh.RungeKutta("rk4", dt=0.11)], ids=["adaptive", "fixed"])
def test_many_lines(method):
    compared(range(20, 200), method)


# --- each case alone ------------------------------------------------------------------------------------------------


def ticking(direction, target):
    """A point of unit speed that counts a level and the ticks, each 0.1; a tick may lead to another mode."""

    def field(t, x, args):
        return jnp.stack([1 + 0 * x[0], 0 * x[1], 0 * x[2]])

    return lh.Hybrid(
        {"one": field, "two": field},
        [
            lh.Transition(lambda t, x, args: args - x[0], lambda t, x, args: x.at[1].add(1.0), direction=direction),
            lh.Transition(every=0.1, reset=lambda t, x, args: x.at[2].add(1.0), target=target),
        ],
    )


NEAR = [0.0, *(sign * 10.0**-power for power in (8, 10, 12, 13, 14, 15, 16) for sign in (1, -1))]


@pytest.mark.parametrize("target", [None, "two"], ids=["one mode", "another mode"])
@pytest.mark.parametrize("direction", WAYS)
@pytest.mark.slow
def test_a_level_that_is_passed_at_a_tick(direction, target):
    """A level of both directions was lost in half of the cases; one upwards was counted again at each later tick."""
    system, expected = ticking(direction, target), 0 if direction == 1 else 1
    for tick in (0.1, 0.3, 0.7, 1.0, 1.9):
        for apart in NEAR:
            level = jnp.asarray(tick + apart)
            run = lh.trajectory(system, jnp.zeros(3), level, t1=2.05, n=1, mode="one", throw=False)
            assert run.status == STATUS.ok
            assert run.x[-1, 1:].tolist() == [expected, 20], (tick, apart)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e3, 1e6, -1e3, -1e6])
def test_a_level_near_a_wall_that_makes_the_point_fast(factor):
    """The level is told from the wall, though the point passes both in a time that no step resolves afterwards."""
    line = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1], 0 * x[1]]),
        [
            lh.Transition(lambda t, x, args: args - x[0], lambda t, x, args: x.at[2].add(1.0), direction=0),
            lh.Transition(lambda t, x, args: 1 - x[0], lambda t, x, args: x.at[1].multiply(factor), direction=-1),
        ],
    )
    for apart in (sign * 10.0**-power for power in range(6, 14) for sign in (1, -1)):
        run = lh.trajectory(line, [0.0, 1.0, 0.0], jnp.asarray(1 + apart), t1=1.5, n=1)
        expected = 1 if factor > 0 else 2 * (apart < 0)
        assert run.x[-1, 2] == expected, apart
