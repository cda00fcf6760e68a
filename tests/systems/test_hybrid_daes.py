"""DAEs that jump: constraints that switch, impacts on a constrained motion, and their periodic orbits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import lyaphybrid as lh
from lyaphybrid import zoo

PERIOD = 2 * np.pi


def conducting(resistance=10.0, on_resistance=1.0, capacitance=0.2):
    """For how long in a period the rectifier conducts, and its voltage where it begins to; by closed forms."""
    slow, fast = 1 / (resistance * capacitance), 1 / (resistance * capacitance) + 1 / (on_resistance * capacitance)

    def forced(t):
        return (fast * np.sin(t) - np.cos(t)) / (on_resistance * capacitance * (fast**2 + 1))

    def first(gap, start):
        times = np.linspace(start + 1e-6, start + PERIOD, 4001)
        i = np.flatnonzero((gap(times[:-1]) > 0) & (gap(times[1:]) <= 0))[0]
        return brentq(gap, times[i], times[i + 1], xtol=1e-15)

    t, v = 0.0, 0.5
    for _ in range(40):
        begin = first(lambda s, t=t, v=v: v * np.exp(-slow * (s - t)) - np.sin(s), t)
        u = v * np.exp(-slow * (begin - t))
        end = first(lambda s, b=begin, u=u: np.sin(s) - forced(s) - (u - forced(b)) * np.exp(-fast * (s - b)), begin)
        t, v = end, forced(end) + (u - forced(begin)) * np.exp(-fast * (end - begin))
    return end - begin, u, slow, fast


@pytest.mark.slow
def test_a_rectifier_in_closed_form():
    """Between the switchings q' = −q/RC, or with −q/rC besides; at them S = 1: the exponent is a mean of two rates."""
    problem = zoo.diode_circuit()
    duration, voltage, slow, fast = conducting()
    exact = -(slow + (fast - slow) * duration / PERIOD)
    s = problem.spectrum(t1=50 * PERIOD, transient=20 * PERIOD, blocks=50)
    assert_allclose(s.exponents, [exact], rtol=0, atol=1e-7)
    assert s.jumps == 100
    orbit = lh.floquet(problem.system, problem.x0, problem.args, period=PERIOD, mode="blocked", transient=5 * PERIOD)
    print(orbit)
    assert_allclose(orbit.exponents, [exact], rtol=0, atol=1e-10)
    assert orbit.multipliers.shape == (1,)
    assert orbit.stable
    assert orbit.jumps == 2
    path = lh.trajectory(problem.system, problem.x0, problem.args, t1=20 * PERIOD, n=400, mode="blocked")
    charge, v, current = path.x.T
    begins = path.events.transition == 1
    assert_allclose(path.events.x_before[begins][-1][1], voltage, atol=1e-9)
    # Constraints of the mode that is entered hold after each jump.
    assert_allclose(charge, 0.2 * v, atol=1e-12)
    assert_allclose(current[path.mode == 1], 0.0, atol=1e-12)
    assert_allclose(path.events.x_after[:, 0], 0.2 * path.events.x_after[:, 1], atol=1e-12)
    matrix = lh.saltation_matrix(
        problem.system, path.events.t[-1], path.events.x_before[-1], problem.args, transition=0, mode="conducting"
    )
    allowed = np.array([1.0, 5.0, -5.0])  # a change of the charge, and what the constraints make of it
    assert_allclose(matrix @ allowed, [1.0, 5.0, 0.0], atol=1e-9)


@pytest.mark.slow
def test_impacts_of_a_constrained_pendulum():
    """Against the same in its angle; the rod's length and its rate add the exponents 0 and (impacts/t) ln r."""
    problem, restitution = zoo.pendulum_dae(), 0.9
    wall = lh.Hybrid(
        problem.system,
        lh.Transition(
            lambda t, x, args: 0.3 - x[0],
            lambda t, x, args: x * jnp.array([1.0, 1.0, -restitution, -restitution, 1.0]),
        ),
    )

    def angle(t, y, args):
        drive = args["amplitude"] * jnp.cos(args["omega"] * t)
        return jnp.stack([y[1], -args["damping"] * y[1] - jnp.sin(y[0]) + drive])

    flat = lh.Hybrid(
        angle,
        lh.Transition(lambda t, y, args: 0.3 - jnp.sin(y[0]), lambda t, y, args: y * jnp.array([1.0, -restitution])),
    )
    t1 = 60.0
    short = lh.trajectory(wall, problem.x0, problem.args, t1=t1, n=1, method=lh.HalfExplicit(1e-12))
    same = lh.trajectory(flat, [0.2, 0.0], problem.args, t1=t1, n=1, method=lh.RungeKutta(rtol=1e-13, atol=1e-13))
    assert len(short.events) == len(same.events) > 10
    assert_allclose(short.events.t, same.events.t, atol=1e-8)
    assert_allclose(short.x[-1][:2], [np.sin(same.x[-1][0]), -np.cos(same.x[-1][0])], atol=1e-8)
    # The reset leaves the tension as it was: the constraint decides it anew.
    after = zip(short.events.t, short.events.x_after, strict=True)
    off = [problem.system.field.constraint(t, x, problem.args) for t, x in after]
    assert_allclose(off, 0.0, atol=1e-11)
    m, n = (
        lh.tangent_map(wall, problem.x0, problem.args, t1=t1, method=lh.HalfExplicit(1e-12)).matrix,
        lh.tangent_map(flat, [0.2, 0.0], problem.args, t1=t1, method=lh.RungeKutta(rtol=1e-13, atol=1e-13)).matrix,
    )
    before, after = _of_angle(0.2, 0.0), _of_angle(*same.x[-1])
    assert_allclose((m @ before)[:4], (after @ n)[:4], atol=1e-7)


def _of_angle(a, w):
    """d(x, y, u, v, λ)/d(θ, θ'); the row of λ is not filled."""

    def place(y):
        a, w = y[0], y[1]
        return jnp.stack([jnp.sin(a), -jnp.cos(a), w * jnp.cos(a), w * jnp.sin(a), 0 * a])

    return np.asarray(jax.jacfwd(place)(jnp.array([float(a), float(w)])))


@pytest.mark.slow
def test_exponents_of_the_pendulum_with_a_wall():
    problem, restitution = zoo.pendulum_dae(), 0.9
    wall = lh.Hybrid(
        problem.system,
        lh.Transition(
            lambda t, x, args: 0.3 - x[0],
            lambda t, x, args: x * jnp.array([1.0, 1.0, -restitution, -restitution, 1.0]),
        ),
    )
    s = lh.lyapunov_spectrum(wall, problem.x0, problem.args, t1=4000.0, transient=200.0)
    print(s)
    spurious = float(s.jumps / s.time) * np.log(restitution)
    values = np.asarray(s.exponents)
    near = 5 * np.max(np.asarray(s.stderr))
    assert np.min(np.abs(values)) < 1e-3
    assert np.sum(np.abs(values - spurious) < near) >= 1
    # An impact multiplies area by r² in the plane of θ and θ', and the rate of the rod's length by r.
    assert_allclose(values.sum(), -0.5 + 3 * spurious, atol=1e-3)


@pytest.mark.slow
def test_a_jump_between_systems_of_different_degrees_of_freedom():
    """A mass that is caught by a support that moves as cos t: its velocity is then prescribed, nothing is free."""
    free = lambda t, x, args: jnp.stack([x[1], -1.0 + 0 * x[0], 0 * x[2]])  # noqa: E731
    carried = lh.DAE(
        lambda t, args: jnp.diag(jnp.array([1.0, 0.0, 0.0])),
        lambda t, x, args: jnp.stack([x[1], x[1] + 0.1 * jnp.sin(t), x[2] - x[0]]),
        n_differential=1,
    )
    system = lh.Hybrid(
        {"free": free, "carried": carried},
        lh.Transition(lambda t, x, args: x[0] - 0.1 * jnp.cos(t), source="free", target="carried"),
    )
    s = lh.lyapunov_spectrum(system, [1.0, 0.0, 0.0], t1=30.0, mode="free")
    assert s.status is lh.STATUS.ok
    assert_allclose(s.x[1], -0.1 * np.sin(30.0), atol=1e-9)
    assert "rank_lost" in s.notes
    assert int(np.sum(np.isneginf(np.asarray(s.exponents)))) >= 1


@pytest.mark.slow
def test_a_van_der_pol_cycle_with_an_algebraic_variable():
    def residual(t, x, mu):
        return jnp.stack([x[1], mu * x[2] * x[1] - x[0], x[2] - (1 - x[0] ** 2)])

    dae = lh.DAE(lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])), residual, 2)
    orbit = lh.floquet(dae, lh.consistent_start(dae, [2.0, 0.0, 0.0], 1.0), 1.0)
    plain = lh.floquet(lh.Flow(lambda t, x, mu: jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]])), [2.0, 0.0], 1.0)
    assert_allclose(orbit.period, plain.period, rtol=1e-10)
    assert_allclose(orbit.multipliers, plain.multipliers, atol=1e-9)
    assert orbit.stable


@pytest.mark.slow
def test_spectral_intervals_of_a_dae():
    """The sin-log system with the sum of its components as an algebraic variable: the metric changes, rates do not."""

    def residual(t, x, args):
        s = jnp.log(t + 1)
        return jnp.stack(
            [
                x[0] * (jnp.sin(s) + jnp.cos(s)),
                x[1] * (jnp.sin(s) - jnp.cos(s) - 5),
                x[2] - x[0] - x[1],
            ]
        )

    dae = lh.DAE(lambda t, args: jnp.diag(jnp.array([1.0, 1.0, 0.0])), residual, 2)
    method = lh.ContinuousQR(lh.HalfExplicit(1e-7))
    found = lh.spectral_intervals(dae, [0.0, 0.0, 0.0], t1=1e4, window=100.0, tau=100.0, method=method)
    print(found)
    assert found.separated
    assert_allclose(found.sacker_sell, [[-1.2262, 1.4138], [-6.4044, -3.5858]], atol=1e-3)
