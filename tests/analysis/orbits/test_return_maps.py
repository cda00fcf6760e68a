"""Return maps where further jumps follow a firing at once."""

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import lyaphybrid as lh


def field(t, x, args):
    return jnp.stack([1.5 - x[0] - 0.2 * x[1], -0.1 * x[1]])


# A neuron whose adaptation is released as soon as a spike brings it beyond 1.
SPIKE = lh.Transition(lambda t, x, a: 1 - x[0], lambda t, x, a: jnp.stack([0 * x[0], x[1] + 0.5]))
RELEASE = lh.Transition(lambda t, x, a: 1 - x[1], lambda t, x, a: jnp.stack([x[0], x[1] - 0.8]))
NEURON = lh.Hybrid(field, [SPIKE, RELEASE])


def after_spikes(w, count):
    """The adaptation after each spike and what follows at once, by SciPy."""
    found = []
    for _ in range(count):

        def threshold(t, x):
            return 1 - x[0]

        threshold.terminal, threshold.direction = True, -1
        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
        run = solve_ivp(
            lambda t, x: [1.5 - x[0] - 0.2 * x[1], -0.1 * x[1]], (0, 50), [0, w], events=threshold, **options
        )
        w = run.y[1, -1] + 0.5
        w = w - 0.8 if w > 1 else w
        found.append(w)
    return np.array(found)


def test_jumps_that_follow_at_once_belong_to_the_firing():
    returns = lh.return_map(NEURON, 0)
    orbit = lh.trajectory(returns, [0.0, 0.3], t1=12, n=12).x
    np.testing.assert_allclose(orbit[:, 1], after_spikes(0.3, 12), atol=1e-9)


def test_its_orbit_has_the_multiplier_of_that_of_the_flow():
    """Two spikes, of which one releases; by the map and by the flow."""
    returns = lh.return_map(NEURON, 0)
    settled = lh.trajectory(returns, [0.0, 0.3], t1=100, n=1).x[-1]
    by_map = lh.floquet(returns, settled, period=2)
    by_flow = lh.floquet(NEURON, settled, transient=1.0)
    assert by_flow.jumps == 3
    np.testing.assert_allclose(np.abs(by_map.multipliers[0]), np.abs(by_flow.multipliers[1]), rtol=1e-6)


def test_the_own_guard_may_fire_again_at_once():
    """A kick of 2.2 fires a threshold at 1, which takes 1 away, twice: one iterate."""
    fires = lh.Transition(lambda t, x, a: 1 - x[0], lambda t, x, a: jnp.stack([x[0] - 1, x[1], x[2] + 1]))
    kick = lh.Transition(lambda t, x, a: 1 - x[1], lambda t, x, a: jnp.stack([x[0] + 2.2, 0 * x[1], x[2]]))
    burst = lh.Hybrid(lambda t, x, a: jnp.stack([-0.5 * x[0], 1 + 0 * x[1], 0 * x[2]]), [fires, kick])
    orbit = lh.trajectory(lh.return_map(burst, 0), [0.2, 0.0, 2.0], t1=3, n=3).x
    rest, expected = 0.2, []
    for count in (4.0, 6.0, 8.0):
        rest = rest * np.exp(-0.5) + 2.2 - 2
        expected.append([rest, 0.0, count])
    np.testing.assert_allclose(orbit, expected, atol=1e-9)


def test_where_the_instant_ends_in_another_mode_there_is_no_iterate():
    up = lh.Transition(
        lambda t, x, a: 1 - x[0], lambda t, x, a: jnp.stack([0 * x[0], x[1] + 1]), source="a", target="a"
    )
    away = lh.Transition(lambda t, x, a: 2.5 - x[1], source="a", target="b")
    moves = {"a": lambda t, x, a: jnp.stack([1 + 0 * x[0], 0 * x[1]]), "b": lambda t, x, a: -x}
    system = lh.Hybrid(moves, [up, away], initial_mode=lambda t, x, a: 0)
    rule = lh.return_map(system, 0).rule
    assert rule(0.0, jnp.array([0.0, 0.0]), None).tolist() == [0.0, 1.0]
    assert np.all(np.isnan(rule(0.0, jnp.array([0.0, 2.0]), None)))
