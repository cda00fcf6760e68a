"""The stages of a step, and what a run makes of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid._jax.engines import compiled
from lyaphybrid.engine.evolvers.stepping import Stepping, are_nonlinear

T, H, X = 0.7, 0.1, np.array([0.3, -0.4])


def lorenz96(t, x, args):
    """Each component takes three of its neighbours."""
    return (jnp.roll(x, -1) - jnp.roll(x, 2)) * jnp.roll(x, 1) - x + 8.0


def forced(t, x):
    """A linear oscillator under a force."""
    return jnp.stack([x[1], jnp.cos(t) - 0.1 * x[1] - x[0]])


def textbook(field, t, x, h):
    """One step of the classical Runge–Kutta method."""
    k1 = field(t, x)
    k2 = field(t + h / 2, x + h / 2 * k1)
    k3 = field(t + h / 2, x + h / 2 * k2)
    k4 = field(t + h, x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_step_is_the_step_of_the_textbook(n):
    x, h, t = jnp.linspace(7.0, 9.0, n), 0.01, 0.3

    def field(t, x):
        return lorenz96(t, x, None) + jnp.sin(t)

    got = lh.RungeKutta("rk4", dt=h).step(field, t, x, field(t, x), h)
    np.testing.assert_allclose(got.x, textbook(field, t, x, h), rtol=1e-15)


def test_a_state_alone_steps_too():
    x, h = jnp.array([8.0, 8.1, 7.9, 8.2, 7.7]), 0.01
    found = lh.trajectory(lh.Flow(lorenz96), x, t1=20 * h, n=20, method=lh.RungeKutta("rk4", dt=h))
    for _ in range(20):
        x = textbook(lambda t, x: lorenz96(t, x, None), 0.0, x, h)
    np.testing.assert_allclose(found.x[-1], x, rtol=1e-13)


def test_curvature_is_seen():
    x = jnp.array([0.1, 0.2])
    assert not are_nonlinear([forced], 0.0, x)
    assert are_nonlinear([forced, lambda t, x: forced(t, x) * x[0]], 0.0, x)
    assert are_nonlinear([lambda t, x: lorenz96(t, x, None)], 0.0, jnp.ones(5))


def test_a_rejected_stage_that_is_no_number_ends_nothing():
    def field(t, x, args):
        return jnp.stack([jnp.where(x[0] > 0, -1.0, jnp.nan), x[0] * x[2], -x[0] * x[1]])  # no way beyond x0 = 0

    reached = [1.0]
    for attempts in range(1, 40):
        found = lh.lyapunov_spectrum(
            lh.Flow(field), jnp.array([1.0, 1.0, 0.0]), t1=2.0, transient=0.0, blocks=2, max_steps=attempts, throw=False
        )
        assert found.status == lh.STATUS.max_steps
        assert np.all(np.isfinite(found.x))
        reached.append(float(found.x[0]))
    assert 0.0 in np.diff(reached)  # a step was rejected


def wells(steepness):
    return lambda t, x, args: jnp.stack([x[1], 0.3 * jnp.cos(t) - steepness * jnp.sin(x[0]) - 0.1 * x[1]])


def spectrum_of_three_modes(method):
    """A new system each time, so that it is compiled anew."""
    system = lh.Hybrid(
        {"left": wells(1.0), "middle": wells(0.2), "right": wells(1.5)},
        [
            lh.Transition(lambda t, x, args: x[0] + 0.4, source="left", target="middle", direction=1),
            lh.Transition(lambda t, x, args: x[0] + 0.4, source="middle", target="left", direction=-1),
            lh.Transition(lambda t, x, args: 0.4 - x[0], source="middle", target="right", direction=-1),
            lh.Transition(lambda t, x, args: x[0] - 0.4, source="right", target="middle", direction=-1),
        ],
    )
    found = lh.lyapunov_spectrum(system, [0.1, 1.2], t1=30.0, transient=0.0, blocks=3, method=method, mode="middle")
    assert found.jumps > 10
    return found


@pytest.mark.slow
def test_a_loop_for_each_mode_is_one_loop_with_a_switch(monkeypatch):
    method = lh.RungeKutta("rk4", dt=0.05)
    loops = spectrum_of_three_modes(method)
    monkeypatch.setattr(Stepping, "in_each_mode", lambda evolver: (evolver,))
    switch = spectrum_of_three_modes(method)
    assert loops.jumps == switch.jumps
    np.testing.assert_allclose(loops.x, switch.x, rtol=1e-11)
    np.testing.assert_allclose(loops.exponents, switch.exponents, rtol=1e-10)


@pytest.mark.slow
def test_tangents_at_known_points_are_those_of_the_steps_of_a_run(monkeypatch):
    method = lh.RungeKutta("dopri5")
    known = spectrum_of_three_modes(method)
    monkeypatch.setattr(Stepping, "revisits", property(lambda evolver: False))
    derived = spectrum_of_three_modes(method)
    assert known.jumps == derived.jumps
    np.testing.assert_allclose(known.x, derived.x, rtol=1e-10)
    np.testing.assert_allclose(known.exponents, derived.exponents, rtol=1e-9)


def test_no_step_is_longer_than_is_allowed():
    """A pulse after a long rest is missed by steps that have grown, and seen by steps that may not."""
    pulse = lh.Flow(lambda t, x, args: jnp.exp(-(((t - 37.3) / 0.05) ** 2)) + 0 * x)
    area = 0.05 * np.sqrt(np.pi)
    missed = lh.trajectory(pulse, [0.0], t1=100.0, n=2).x[-1, 0]
    seen = lh.trajectory(pulse, [0.0], t1=100.0, n=2, method=lh.RungeKutta(max_step=0.1)).x[-1, 0]
    assert abs(missed) < 1e-3 * area
    assert abs(seen - area) < 1e-8


# --- tangents at the points of a trial ------------------------------------------------------------------------------


def pendulum(t, x):
    return jnp.stack([x[1], jnp.cos(t) - jnp.sin(x[0]) * (1 + 0.1 * jnp.cos(2 * t)) - 0.1 * x[1]])


def swung(t, x):
    return jnp.sin(jnp.roll(x, 1) * t) * x - jnp.tan(0.1 * x)


def cubed(t, x):
    return x - x**3


METHODS = [lh.RungeKutta("rk4", dt=H), *(lh.RungeKutta(tableau) for tableau in ("dopri5", "tsit5", "dopri8", "dop853"))]


@pytest.mark.slow_cases("pendulum-2-dop853", "pendulum-2-dopri8", "swung-3-dopri8")
@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.tableau)
@pytest.mark.parametrize(("field", "n"), [(pendulum, 2), (swung, 3), (cubed, 3)])
def test_the_tangent_at_known_points_is_the_derivative_of_the_step(method, field, n):
    t, h, frame = jnp.asarray(T), jnp.asarray(H), jnp.cos(jnp.arange(4.0 * n).reshape(n, 4))

    @compiled()
    def tangents(x):
        way = method.step(field, t, x, field(t, x), h).stage_points
        assert len(way) == method.stage_count
        ways = method.tangent(field, t, x, h, frame, way), method.rare_tangent(field, t, x, h, frame, way)
        found = *ways, method.tangent(field, t, x, h, frame)
        return [(one.frame, one.errors, method.divergence(field, one.nodes, h)) for one in found]

    *ours, derived = tangents(jnp.linspace(0.3, -0.4, n))
    for found in ours:
        for a, b in zip(found, derived, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-14)


def test_the_points_on_the_way_depend_on_the_start():
    """Differentiated once more, the tangent at known points is still that of the step."""
    method, t, h = METHODS[0], jnp.asarray(T), jnp.asarray(H)

    def frame(x, known):
        way = method.step(pendulum, t, x, pendulum(t, x), h).stage_points if known else ()
        return method.tangent(pendulum, t, x, h, jnp.eye(2), way).frame

    ours, plain = (compiled()(jax.jacfwd(frame))(jnp.asarray(X), known) for known in (True, False))
    np.testing.assert_allclose(ours, plain, rtol=1e-13, atol=1e-14)
    assert jnp.max(jnp.abs(plain)) > 1e-3
