"""Derivatives through events that users of other projects found wrong, missing or impossible.

Each test names the public thread that it comes from, and holds what the thread says to be right: a value or a
derivative in closed form. README.md lists them all.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import STATUS

METHOD = lh.RungeKutta(rtol=1e-10)
AWAY = 1e6  # a floor, a wall or a partner that is never met

# --- two balls on a line, with a floor under the first and a wall beyond the second ---------------------------------


def _swapped(t, x, args):
    return jnp.stack([x[0], x[3], x[2], x[1]])


BALLS = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], -args["gravity"], x[3], 0 * x[3]]),
    [
        lh.Transition(lambda t, x, args: x[0] - args["floor"], lambda t, x, args: x.at[1].multiply(-args["bounce"])),
        lh.Transition(lambda t, x, args: x[2] - x[0] - args["contact"], _swapped),
        lh.Transition(lambda t, x, args: args["wall"] - x[2], lambda t, x, args: x.at[3].multiply(-1.0)),
    ],
)


def balls(**changes):
    """Without forces, and nothing to meet, but for the changes."""
    usual = {"gravity": 0.0, "floor": -AWAY, "bounce": 1.0, "contact": -AWAY, "wall": AWAY}
    return {name: jnp.asarray(value) for name, value in (usual | changes).items()}


def _final(x0, args, t1):
    return lh.trajectory(BALLS, x0, args, t1=t1, n=1, method=METHOD, throw=False).x[-1]


FINAL = jax.jit(_final)
FORWARD = jax.jit(lambda x0, args, t1, along: jax.jvp(lambda x0, args: _final(x0, args, t1), (x0, args), along)[1])
REVERSE = jax.jit(lambda x0, args, t1, weights: jax.vjp(lambda x0, args: _final(x0, args, t1), x0, args)[1](weights))


@pytest.mark.slow
def test_two_equal_balls_give_the_whole_of_their_motion():
    """https://github.com/keenon/nimblephysics/issues/97: (0.75, 0.25, 0.91, 0.08) was found.

    x₁ = 0 with v = 1 hits x₂ = 0.52 at rest, both of radius 0.1, elastically: x₂(T) = v₁ T + x₁ + 2r, T = 1.
    """
    start, args = jnp.array([0.0, 1.0, 0.52, 0.0]), balls(contact=0.2)
    assert_allclose(FINAL(start, args, 1.0)[2], 1.2, rtol=0, atol=1e-14)
    by_start, by_parameter = REVERSE(start, args, 1.0, jnp.array([0.0, 0, 1, 0]))
    assert_allclose(by_start[jnp.array([0, 2, 1, 3])], [1, 0, 1, 0], rtol=0, atol=1e-13)  # by x₁, x₂, v₁, v₂
    assert_allclose(by_parameter["contact"], 1.0, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_the_higher_a_ball_starts_the_lower_it_ends():
    """https://github.com/google/brax/issues/317: the final height jumped, and its derivatives had the wrong sign.

    Downwards at speed 4 from 2.9 to 3 for one second without gravity: it ends at 4 - height, whatever the height.
    """
    heights, args = np.linspace(2.9, 3.0, 21), balls(floor=0.0)
    for height in heights:
        start = jnp.array([height, -4.0, 0.0, 0.0])
        assert_allclose(FINAL(start, args, 1.0)[0], 4.0 - height, rtol=0, atol=1e-13)
        along = (jnp.array([1.0, 0, 0, 0]), jax.tree.map(jnp.zeros_like, args))
        assert_allclose(FORWARD(start, args, 1.0, along)[0], -1.0, rtol=0, atol=1e-13)
    assert_allclose(REVERSE(start, args, 1.0, jnp.array([1.0, 0, 0, 0]))[0][0], -1.0, rtol=0, atol=1e-13)


def _bouncing(h, g, e, t):
    """Height at t of a ball dropped from h, which keeps e of its speed, in its first three flights after the fall."""
    speed = np.sqrt(2 * g * h)
    landed = np.sqrt(2 * h / g)
    for _ in range(4):
        speed = e * speed
        if t < np.real(landed + 2 * speed / g):
            break
        landed = landed + 2 * speed / g
    return speed * (t - landed) - g * (t - landed) ** 2 / 2


@pytest.mark.slow
def test_reverse_derivatives_of_a_bouncing_ball():
    """https://github.com/SciML/ModelingToolkit.jl/issues/5018: none for any system with a continuous event.

    Gravity 9.81, 0.8 of the speed is kept: the height after two seconds by start, gravity and restitution.
    """
    start = jnp.array([1.0, 0.0, 0.0, 0.0])
    args = balls(gravity=9.81, floor=0.0, bounce=0.8)
    assert_allclose(FINAL(start, args, 2.0)[0], _bouncing(1.0, 9.81, 0.8, 2.0), rtol=0, atol=1e-12)
    by_start, by_parameter = REVERSE(start, args, 2.0, jnp.array([1.0, 0, 0, 0]))
    found = [by_start[0], by_parameter["gravity"], by_parameter["bounce"]]
    point, steps = np.array([1.0, 9.81, 0.8]), 1e-30j * np.eye(3)  # along the imaginary axis: exact derivatives
    exact = [_bouncing(*(point + step), 2.0).imag / 1e-30 for step in steps]
    assert_allclose(found, exact, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("after", [0.0, 1.0, 5.0])
def test_an_event_at_the_very_time_of_a_sample(after):
    """https://github.com/SciML/SciMLSensitivity.jl/issues/1447: 7 % off where an event falls on a sample.

    x₁ falls from 50 and rebounds; x₂ = 2 t comes to the wall at 10 at t = 5, where a sample lies (or 1, 5 later).
    """
    start, args = jnp.array([50.0, 0.0, 0.0, 2.0]), balls(gravity=9.8, floor=0.0, wall=10.0)
    weights = jnp.array([0.0, 0.0, 1.0, 0.0])
    by_start, by_parameter = REVERSE(start, args, 5.0 + after, weights)
    if after:  # x₂ = 2 wall - x₂(0) - v₂ t
        assert_allclose(by_start[2:], [-1.0, -(5 + after)], rtol=0, atol=1e-12)
        assert_allclose(by_parameter["wall"], 2.0, rtol=0, atol=1e-12)
    else:  # on the wall: the derivative from one side or from the other
        one, other = [1.0, 5.0, 0.0], [-1.0, -5.0, 2.0]
        found = [*by_start[2:], by_parameter["wall"]]
        assert np.allclose(found, one, atol=1e-12) or np.allclose(found, other, atol=1e-12)
    rng = np.random.default_rng(0)
    along = (rng.normal(size=4), {name: rng.normal() for name in args})
    forward = weights @ FORWARD(start, args, 5.0 + after, along)
    reverse = along[0] @ by_start + sum(along[1][name] * by_parameter[name] for name in args)
    assert_allclose(forward, reverse, rtol=1e-12)


@pytest.mark.slow
def test_balls_side_by_side_each_with_its_own_events():
    """https://github.com/rtqichen/torchdiffeq/issues/201 and 282: a batch stopped at the first event of any.

    Seven balls from different heights under `jax.vmap`: none to four bounces, as one by one; derivatives too.
    """
    heights = jnp.array([0.05, 0.3, 0.8, 1.0, 2.0, 4.0, 30.0])
    starts = jnp.stack([heights, 0 * heights, 0 * heights, 0 * heights], axis=1)
    args = balls(gravity=9.81, floor=0.0, bounce=0.9)
    along = (jnp.array([1.0, 0, 0, 0]), jax.tree.map(jnp.zeros_like, args))
    together = jax.jit(jax.vmap(lambda x0: jax.jvp(lambda x0, args: _final(x0, args, 0.75), (x0, args), along)))(starts)
    for i, start in enumerate(starts):
        assert_allclose(together[0][i], FINAL(start, args, 0.75), rtol=0, atol=1e-12)
        assert_allclose(together[1][i], FORWARD(start, args, 0.75, along), rtol=0, atol=1e-11)
    exact = [_bouncing(h, 9.81, 0.9, 0.75) if 9.81 * 0.75**2 / 2 > h else h - 9.81 * 0.75**2 / 2 for h in heights[1:]]
    assert_allclose(together[0][1:, 0], exact, rtol=0, atol=1e-12)


# --- instants ---------------------------------------------------------------------------------------------------------

LEVEL = lh.Hybrid(
    lambda t, x, args: jnp.ones_like(x),
    lh.Transition(lambda t, x, args: args - x[0], terminal=True),
)


@pytest.mark.slow
@pytest.mark.parametrize("tableau", ["tsit5", pytest.param("dopri8", marks=pytest.mark.slow)])
def test_the_derivative_of_an_event_time(tableau):
    """https://github.com/SciML/OrdinaryDiffEq.jl/issues/4388: up to 1e-5 off, more for higher orders.

    u' = 1 from 0: u = q at T = q, dT/dq = 1.
    """

    def instant(q):
        return lh.trajectory(LEVEL, jnp.zeros(1), q, t1=10.0, n=1, method=lh.RungeKutta(tableau)).events.t[0]

    derivative = jax.jit(lambda q: jax.jvp(instant, (q,), (1.0,)))
    for q in np.linspace(0.05, 9.9, 23):
        assert_allclose(derivative(q), (q, 1.0), rtol=1e-14, atol=0)


SWITCHED = lh.Hybrid(
    {"on": lambda t, x, args: jnp.ones_like(x), "off": lambda t, x, args: jnp.zeros_like(x)},
    lh.Transition(lambda t, x, args: args - t, source="on", target="off"),
)


@pytest.mark.slow
@pytest.mark.parametrize("switch", [0.98, 1.0, 0.1 + 0.2])
def test_a_state_after_an_event_by_the_time_of_the_event(switch):
    """https://github.com/patrick-kidger/diffrax/issues/729: wrong, and dependent on the controller of steps.

    y' = 1 until T and 0 from then on: y(2) = T, dy(2)/dT = 1, forward and in reverse.
    """

    def final(switch):
        return lh.trajectory(SWITCHED, jnp.zeros(1), switch, t1=2.0, n=1, mode="on", throw=False).x[-1, 0]

    assert_allclose(jax.jvp(final, (switch,), (1.0,)), (switch, 1.0), rtol=1e-14)
    assert_allclose(jax.grad(final)(switch), 1.0, rtol=1e-14)


@pytest.mark.slow
def test_a_rate_that_an_event_turns_off():
    """https://github.com/SciML/SciMLSensitivity.jl/issues/4: dy/da was 0.

    x' = -a, y' = b until x = 0, and then y rests: y(1) = b x(0)/a = 1/2 and dy/da = -1/4 for a = 2, b = 1.
    """
    stopped = lh.Hybrid(
        {"flow": lambda t, x, args: jnp.stack([-args, 1.0 + 0 * args]), "rest": lambda t, x, args: 0 * x},
        lh.Transition(lambda t, x, args: x[0], source="flow", target="rest"),
    )

    def final(a):
        return lh.trajectory(stopped, jnp.array([1.0, 0.0]), a, t1=1.0, n=1, mode="flow", throw=False).x[-1, 1]

    assert_allclose(jax.jvp(final, (2.0,), (1.0,)), (0.5, -0.25), rtol=1e-13)


def test_status_of_the_balls():
    """What the tests above ask without `throw` has run to its end."""
    run = lh.trajectory(BALLS, [1.0, 0, 0, 0], balls(gravity=9.81, floor=0.0, bounce=0.8), t1=2.0, n=1, method=METHOD)
    assert run.status == STATUS.ok
    assert len(run.events) == 3
