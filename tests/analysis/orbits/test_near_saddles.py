"""Orbits that stretch much and contract as much: M alone does not tell a contraction from a loss."""

import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh

TURNED = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])


def test_what_a_saddle_stretches_hides_no_multiplier():
    """A saddle that is driven along its motion, R diag(15, −15) Rᵀ x (1 + ½ cos 2πt): over one period exp(±15)."""
    field = TURNED @ np.diag([15.0, -15.0]) @ TURNED.T
    saddle = lh.Flow(lambda t, x, args: field @ x * (1 + 0.5 * jnp.cos(2 * jnp.pi * t)))
    found = lh.floquet(saddle, [0.0, 0.0], period=1.0)
    np.testing.assert_allclose(np.log(np.abs(found.multipliers)), [15.0, -15.0], atol=1e-6)


def test_what_a_jump_destroys_has_the_multiplier_0():
    field = TURNED @ np.diag([15.0, -15.0]) @ TURNED.T
    forgets = lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: jnp.stack([x[0], 0.3 * x[0]]))
    saddle = lh.Hybrid(lambda t, x, args: field @ x, forgets)
    found = lh.floquet(saddle, [0.0, 0.0], period=1.0)
    assert abs(found.multipliers[0]) > 1e6
    assert found.multipliers[1] == 0
