"""The tangent map of a run that a terminal transition ends: the derivative of that end, whose time moves."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import STATUS


def falling(t, x, args):
    return jnp.stack([x[1], -1.0 + 0 * x[0]])


def swinging(t, x, args):
    return jnp.stack([x[1], jnp.cos(1.3 * t) - x[0] - 0.1 * x[1]])


def floor(t, x, args):
    return x[0]


def moving(t, x, args):
    return x[0] + 0.6 - 0.2 * jnp.sin(2 * t)


def bounce(t, x, args):
    return jnp.stack([x[0], -0.5 * x[1]])


def timed(t, x, args):
    return jnp.stack([x[0] + 0.1 * t**2, jnp.sin(t) - 0.5 * x[1] * x[0]])


def upper(t, x, args):
    return x[0] - 0.5


METHODS = [lh.RungeKutta(), lh.RungeKutta("rk4", dt=0.01), lh.DiffraxEvents(diffrax.Dopri8(), rtol=1e-10, atol=1e-12)]


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=["adaptive", "fixed", "diffrax"])
def test_a_ball_that_ends_at_the_floor(method):
    """The speed after is u/2 with u² = v² + 2h: its derivatives are 1/2u and v/2u; the height is always 0."""
    ball = lh.Hybrid(falling, lh.Transition(floor, bounce, terminal=True))
    found = lh.tangent_map(ball, [0.5, 0.3], t1=3.0, method=method)
    u = np.sqrt(0.3**2 + 2 * 0.5)
    assert found.status is STATUS.terminated
    assert_allclose(found.matrix, [[0.0, 0.0], [0.5 / u, 0.3 * 0.5 / u]], rtol=0, atol=1e-8)
    assert "whose time may move with the start" in str(found)


ENDS = {
    "guard and reset depend on the time": [lh.Transition(moving, timed, terminal=True)],
    "no reset": [lh.Transition(moving, terminal=True)],
    "after other jumps": [lh.Transition(upper, bounce, direction=1), lh.Transition(moving, timed, terminal=True)],
    "by the jump of another guard": [
        lh.Transition(moving, lambda t, x, args: timed(t, x, args) + jnp.stack([3.0 + 0 * t, 0 * t])),
        lh.Transition(lambda t, x, args: 1.5 - x[0], timed, terminal=True),
    ],
    "at a tick": [lh.Transition(upper, bounce, direction=1), lh.Transition(every=2.7, reset=timed, terminal=True)],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ENDS)
def test_the_matrix_is_the_derivative_of_the_end(name):
    """Against central differences of the end, and against JAX's derivative of it."""
    system, start, method = lh.Hybrid(swinging, ENDS[name]), np.array([0.2, 0.9]), lh.RungeKutta(rtol=1e-12, atol=1e-13)

    def end(x):
        return lh.tangent_map(system, x, t1=9.0, method=method).x

    found, h = lh.tangent_map(system, start, t1=9.0, method=method), 1e-5
    assert found.status is STATUS.terminated
    differences = [(end(start + h * e) - end(start - h * e)) / (2 * h) for e in np.eye(2)]
    assert_allclose(found.matrix, np.transpose(differences), rtol=0, atol=1e-7)
    assert_allclose(found.matrix, jax.jacfwd(end)(jnp.asarray(start)), rtol=0, atol=1e-8)


def test_a_run_that_ends_before_has_the_derivative_at_its_time():
    """At t1, whatever transitions would come later: that of a fall, [[1, t], [0, 1]]."""
    ball = lh.Hybrid(falling, lh.Transition(floor, bounce, terminal=True))
    assert_allclose(lh.tangent_map(ball, [0.5, 0.0], t1=0.5).matrix, [[1.0, 0.5], [0.0, 1.0]], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_an_end_on_a_surface_that_moves():
    """In a mode of which the tangent space is known: the end of a neighbour is on the surface at another time."""
    moves = lh.Hybrid(
        {"free": lambda t, x, args: jnp.stack([1.0 + 0 * x[0], 0 * x[0]]), "held": lambda t, x, args: 0 * x},
        lh.Transition(
            lambda t, x, args: 1.0 - x[0],
            lambda t, x, args: jnp.stack([t, x[1]]),
            source="free",
            target="held",
            terminal=True,
        ),
        {"held": lambda t, x, args, dx: dx.at[0].set(0.0)},  # x₀ = t
    )
    found = lh.tangent_map(moves, [0.25, 0.7], t1=3.0, mode="free")
    assert_allclose(found.x, [0.75, 0.7], rtol=0, atol=1e-12)
    assert_allclose(found.matrix, [[-1.0, 0.0], [0.0, 1.0]], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_exponents_are_those_at_a_fixed_time():
    """The flow goes on for neighbours that are late: det of the last jump and of its shift, r², over the fall."""
    ball = lh.Hybrid(falling, lh.Transition(floor, bounce, terminal=True))
    found = lh.lyapunov_spectrum(ball, [0.5, 0.0], t1=3.0)
    assert found.status is STATUS.terminated
    assert_allclose(np.sum(found.exponents), 2 * np.log(0.5), rtol=0, atol=1e-7)  # over the time 1
