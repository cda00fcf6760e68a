"""Scheduled systems end, and lose directions, by the rules of all event-driven ones."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from examples import alone, between_walls, wall_ahead


def bouncing_balls():
    """Rows (q, v) above a floor, gravity 1, dv⁺ = -r dv⁻; where a ball bounces is forgotten."""

    def ahead(t, y):
        """Of comoving rows, which have been at q + v t - t²/2 since the last rebasing."""
        q, v = y[:, 0] + t * y[:, 1] - 0.5 * t**2, y[:, 1] - t
        return t + v + jnp.sqrt(jnp.maximum(v**2 + 2 * q, 0.0))

    def jump(t, rows, r, which):
        v = t - r * (rows[:, 1] - t)
        return jnp.stack([0.5 * t**2 - t * v, v], axis=1)

    return lh.EventDriven(
        lambda dt, y, r: jnp.stack([y[:, 0] + dt * y[:, 1] - 0.5 * dt**2, y[:, 1] - dt], axis=1),
        None,
        jump,
        lambda t, rows, r, which: rows[0, 0] + t * rows[0, 1] - 0.5 * t**2,
        schedule=alone(ahead),
    )


FRAME = jnp.array([[1.0, 0.0], [-1.0, 1.0]])


def bounces(restitution, t1, x0=((0.0, 1.0),), **keywords):
    return lh.lyapunov_spectrum(
        bouncing_balls(), np.array(x0), restitution, t1=t1, clock="jumps", throw=False, **keywords
    )


@pytest.mark.slow
@pytest.mark.parametrize(("restitution", "reached"), [(0.9, 3000), (0.5, 450)])
def test_bounces_go_on_to_the_end_of_double_precision(restitution, reached):
    """As without a schedule (test_short_or_lost.py), where each bounce is followed by a rebasing."""
    known, turned = np.array([0, 2 * math.log(restitution)]), math.log(2) / 2 * np.array([-1, 1])
    spectrum = bounces(restitution, reached, frame=FRAME, every=1)
    assert spectrum.status is lh.STATUS.ok
    assert spectrum.jumps == reached
    assert_allclose(spectrum.exponents, known + turned / reached, atol=1e-10)
    end = bounces(restitution, 10 * reached, frame=FRAME, every=1)
    assert end.status is lh.STATUS.zeno
    assert end.jumps >= reached
    assert_allclose(end.exponents, known + turned / int(end.jumps), atol=1e-10)


@pytest.mark.slow
def test_bounces_that_the_time_since_a_rebasing_hides_end_before_they_are_wrong():
    """Comoving coordinates know a flight only to the rounding of the time since the rebasing."""
    spectrum = bounces(0.5, 2000, frame=FRAME, every=400, blocks=2)
    jumps = int(spectrum.jumps)
    assert spectrum.status is lh.STATUS.zeno
    assert math.log(1e-6) / math.log(0.5) < jumps < math.log(1e-9) / math.log(0.5)
    assert_allclose(spectrum.x[0, 1], 0.5**jumps, rtol=0.05)


@pytest.mark.slow
def test_in_time_they_accumulate():
    system = bouncing_balls()
    spectrum = lh.lyapunov_spectrum(system, np.array([[0.0, 1.0]]), 0.5, t1=5.0, throw=False)
    assert spectrum.status is lh.STATUS.zeno


def forgetful_balls():
    """Rows (q, v, w) between two walls; a wall multiplies w by args."""

    def jump(t, rows, args, which):
        mixed = args * (rows[:, 2] + 0.3 * rows[:, 1])
        return jnp.stack([rows[:, 0] + 2 * t * rows[:, 1], -rows[:, 1], mixed], axis=1)

    return lh.EventDriven(
        lambda dt, y, args: jnp.stack([y[:, 0] + dt * y[:, 1], y[:, 1], y[:, 2]], axis=1),
        None,
        jump,
        between_walls,
        schedule=alone(wall_ahead),
    )


STARTS = np.array([[0.5, 1.0, 0.2], [0.25, -0.7, 0.1], [0.1, 0.3, 0.4]])


@pytest.mark.slow
def test_an_event_that_destroys_a_direction_of_one_body():
    """At speeds 1, 0.7 and 0.3 three w are forgotten at 2 walls a unit of time in all."""
    spectrum = lh.lyapunov_spectrum(forgetful_balls(), STARTS, 0.0, t1=200.0)
    assert_allclose(spectrum.exponents[:6], 0.0, atol=0.06)  # ln t / t
    assert np.all(np.isneginf(spectrum.exponents[6:]))
    assert "rank_lost" in spectrum.notes
    assert int(spectrum.losses.sum()) == int(spectrum.jumps)


@pytest.mark.slow
def test_one_that_only_shortens_it_does_not():
    spectrum = lh.lyapunov_spectrum(forgetful_balls(), STARTS, 1e-3, t1=200.0)
    assert "rank_lost" not in spectrum.notes
    known = np.log(1e-3) * np.array([0.3, 0.7, 1.0])
    assert_allclose(spectrum.exponents[6:], known, rtol=0.02)
