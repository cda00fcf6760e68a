"""Bodies that touch: a jump of one contact sends the state through another one, which may have fired at this instant.

Collisions of two bodies each, in turn, until none approaches another: so it is where the gaps are small, too.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

# --- beads on a line ----------------------------------------------------------------------------------------------


def beads(masses):
    def gaps(t, x, args):
        return x[1:3] - x[:2]

    reset = lh.impact(np.diag(masses), gaps, 1.0)
    return lh.Hybrid(lambda t, x, args: jnp.concatenate([x[3:], 0 * x[3:]]), lh.Transition(gaps, reset))


def struck(masses, v):
    """The velocities after all collisions of beads that touch, and how many there are."""
    v, count = np.array(v, float), 0
    while True:
        approach = [i for i in (0, 1) if v[i] > v[i + 1] + 1e-14]
        if not approach:
            return v, count
        i = approach[0]
        m, together = masses[i : i + 2], masses[i] * v[i] + masses[i + 1] * v[i + 1]
        v[i : i + 2] = 2 * together / sum(m) - v[i : i + 2]
        count += 1


@pytest.mark.parametrize("masses", [[1.0, 1.0, 1.0], [1.0, 0.5, 1.0], [2.0, 0.3, 1.0], [1.0, 1.0, 5.0]])
def test_beads_in_a_row_that_touch(masses):
    run = lh.trajectory(beads(masses), [-1.0, 0.0, 0.0, 1.0, 0.0, 0.0], t1=5.0)
    velocities, count = struck(masses, [1.0, 0.0, 0.0])
    assert len(run.events.t) == count
    assert_allclose(run.x[-1], np.concatenate([4 * velocities, velocities]), atol=1e-12)


@pytest.mark.slow
def test_beads_that_touch_have_the_tangents_of_those_that_nearly_do():
    touching, apart = (
        lh.tangent_map(beads([1.0, 0.5, 1.0]), [-1.0, 0.0, gap, 1.0, 0.0, 0.0], t1=5.0).matrix for gap in (0.0, 1e-9)
    )
    assert_allclose(touching, apart, atol=1e-6)
    assert np.linalg.det(touching) == pytest.approx(1.0)


# --- a ball on a ball -----------------------------------------------------------------------------------------------

STACK = lh.Hybrid(
    lambda t, x, m: jnp.stack([x[1], -1.0 + 0 * x[0], x[3], -1.0 + 0 * x[0]]),
    [
        lh.Transition(lambda t, x, m: x[0], lambda t, x, m: x.at[1].multiply(-1)),
        lh.Transition(
            lambda t, x, m: x[2] - x[0],
            lambda t, x, m: x.at[1].set(((m - 1) * x[1] + 2 * x[3]) / (m + 1)).at[3].set(
                (2 * m * x[1] + (1 - m) * x[3]) / (m + 1)
            ),
        ),
    ],
)  # fmt: skip


def energy(x, m):
    return m * (x[1] ** 2 / 2 + x[0]) + x[3] ** 2 / 2 + x[2]


@pytest.mark.parametrize("m", [1.5, 2.0, 2.7, 4.0])
@pytest.mark.parametrize("above", [0.0, 0.35, 1.7])
def test_two_balls_that_reach_the_floor_together(m, above):
    """The upper one may start on the lower one, or higher and faster."""
    x0 = np.array([1.0, 0.0, 1.0 + above, -above / np.sqrt(2)])
    run = lh.trajectory(STACK, x0, m, t1=50.0, n=500)
    assert np.min(run.x[:, 0]) > -1e-9
    assert np.min(run.x[:, 2] - run.x[:, 0]) > -1e-9
    assert_allclose(energy(np.asarray(run.x).T, m), energy(x0, m), rtol=1e-9)


@pytest.mark.parametrize("m", [2.0, 3.5, 4.0])
def test_tangents_of_a_stack_are_those_of_balls_that_nearly_touch(m):
    stack, apart = (lh.tangent_map(STACK, [1.0, 0.0, 1.0 + gap, 0.0], m, t1=1.9).matrix for gap in (0.0, 1e-9))
    assert_allclose(stack, apart, atol=1e-6)
    assert np.linalg.det(stack) == pytest.approx(1.0)


def test_a_ball_that_is_put_to_rest_on_the_floor_ends_the_run():
    """With m = 3 the lower one has no velocity after the collision: it has no way on but to rest."""
    run = lh.trajectory(STACK, [1.0, 0.0, 1.0, 0.0], 3.0, t1=5.0, throw=False)
    assert run.status is lh.STATUS.deadlock
    assert_allclose(run.events.x_after[-1], [0.0, 0.0, 0.0, np.sqrt(8.0)], atol=1e-9)


def test_collisions_without_end_are_no_way_through():
    """Beads that lose nearly all of their approach at each collision collide for ever."""

    def gaps(t, x, args):
        return x[1:3] - x[:2]

    dull = lh.Hybrid(
        lambda t, x, args: jnp.concatenate([x[3:], 0 * x[3:]]), lh.Transition(gaps, lh.impact(np.eye(3), gaps, 0.05))
    )
    run = lh.trajectory(dull, [-1.0, 0.0, 0.0, 1.0, 0.0, 0.0], t1=5.0, throw=False)
    assert run.status in (lh.STATUS.zeno, lh.STATUS.deadlock)
    assert np.nanmin(np.diff(np.asarray(run.x)[:, :3], axis=1)) > -1e-9


# --- corners -----------------------------------------------------------------------------------------------------

SIXTY = np.array([np.sin(np.pi / 3), -np.cos(np.pi / 3)])
WEDGE = lh.Hybrid(
    lambda t, x, args: jnp.concatenate([x[2:], 0 * x[2:]]),
    [
        lh.Transition(lambda t, x, args: x[1], lambda t, x, args: x.at[3].multiply(-1)),
        lh.Transition(lambda t, x, args: x[:2] @ SIXTY, lambda t, x, args: x.at[2:].add(-2 * (x[2:] @ SIXTY) * SIXTY)),
    ],
)


@pytest.mark.slow_cases("0.1")
@pytest.mark.parametrize("angle", [0.1, 0.2, 0.3, 0.4, 0.6])
def test_into_the_corner_of_a_wedge_and_out_again(angle):
    """Three mirrors at 60°: it leaves at the mirrored angle."""
    x0 = [np.cos(angle), np.sin(angle), -np.cos(angle), -np.sin(angle)]
    found = np.asarray(lh.lyapunov_spectrum(WEDGE, x0, t1=2.0).x)
    back = np.pi / 3 - angle
    assert_allclose(found, [np.cos(back), np.sin(back), np.cos(back), np.sin(back)], atol=1e-12)
