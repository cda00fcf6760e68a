"""Periodic orbits and jump sets of systems whose flow is known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo

GAP = 1.0
CENTRES = jnp.array([[-1 - GAP / 2, 0.0], [1 + GAP / 2, 0.0]])


def _distances(x):
    return jnp.sqrt(jnp.sum((x[None, :2] - CENTRES) ** 2, axis=1)) - 1


def _ahead(t, x, args):
    """To the circles of radius 1 about the centres, where they are approached."""
    away, v = x[None, :2] - CENTRES, x[2:]
    b, c, a = away @ v, jnp.sum(away**2, axis=1) - 1, v @ v
    square = b * b - a * c
    dt = (-b - jnp.sqrt(jnp.maximum(square, 0.0))) / a
    dt = jnp.where((b < 0) & (square > 0), dt, jnp.inf)
    return jnp.min(dt), jnp.argmin(dt)


def _reflected(t, x, args, which):
    normal = x[:2] - CENTRES[which]
    normal = normal / jnp.sqrt(normal @ normal)
    return jnp.concatenate([x[:2], x[2:] - 2 * (x[2:] @ normal) * normal])


BETWEEN = lh.EventDriven(
    lambda dt, t, x, args: jnp.concatenate([x[:2] + dt * x[2:], x[2:]]),
    _ahead,
    _reflected,
    lambda t, x, args, which: _distances(x)[which],
)


@pytest.mark.slow
def test_an_orbit_between_two_disks_has_the_multipliers_of_its_mirrors():
    """A flight of length d and a convex mirror of radius 1 make cosh μ = 1 + d of half a turn (normal incidence)."""
    orbit = lh.floquet(BETWEEN, [0.1, 1e-3, 1.0, -1e-3], conserve=lambda x, args: x[2:] @ x[2:])
    expanding = np.exp(2 * np.arccosh(1 + GAP))
    assert orbit.jumps == 2
    assert_allclose(orbit.x0[1::2], 0.0, atol=1e-9)
    assert_allclose(orbit.period, 2 * GAP / np.sqrt(1 + 1e-6), rtol=1e-9)  # at the speed of the start
    assert_allclose(np.real(orbit.multipliers), [expanding, 1.0, 1.0, 1 / expanding], rtol=1e-8)
    assert (orbit.stability, orbit.family) == ("unstable", 1)


def test_a_schedule_is_refused():
    disks = zoo.hard_disks()
    with pytest.raises(ValueError, match=r"has a schedule: write it without one, or take lh\.tangent_map"):
        lh.floquet(disks.system, disks.x0, disks.args)


@pytest.mark.parametrize(
    ("x", "where"),
    [
        ([0.0, 0.0, 1.0, 0.0], "C"),
        ([GAP / 2, 0.0, 1.0, 0.0], "both"),  # on the disk, and moving into it
        ([GAP / 2, 0.0, -1.0, 0.0], "C"),  # and away from it
        ([0.0, 5.0, 0.0, 1.0], "C"),  # nothing is ahead
    ],
)
def test_the_jump_set_is_where_the_next_event_is_now(x, where):
    assert BETWEEN.contains(x).where == where
