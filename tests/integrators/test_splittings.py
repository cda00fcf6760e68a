"""Splittings: order where parts depend on time, flows that are not those of the field, several modes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import lyaphybrid as lh

# The pendulum that is driven by 0.5 cos 3t, and a drift that depends on time.


def driven(t, x, a):
    """With the drift x₀' = (1 + 0.3 sin 2t) x₁, so that both parts depend on time."""
    return jnp.stack([(1 + 0.3 * a * jnp.sin(2 * t)) * x[1], -jnp.sin(x[0]) + 0.5 * jnp.cos(3 * t)])


def driven_drift(dt, t, x, a):
    """Exact from t to t + dt, ∫ (1 + 0.3 sin 2s) ds."""
    length = dt - 0.15 * a * (jnp.cos(2 * (t + dt)) - jnp.cos(2 * t))
    return jnp.stack([x[0] + length * x[1], x[1]])


def driven_kick(dt, t, x, a):
    """At a time held fixed."""
    return jnp.stack([x[0], x[1] + dt * (-jnp.sin(x[0]) + 0.5 * jnp.cos(3 * t))])


def half_of_it(dt, t, x, a):
    return driven_kick(0.5 * dt, t, x, a)


BEGIN, LENGTH = 0.7, 3.1


def driven_by_scipy(a):
    """State and tangent map after LENGTH, from the equations written with NumPy."""

    def rate(t, y):
        x, frame, drift = y[:2], y[2:].reshape(2, 2), 1 + 0.3 * a * np.sin(2 * t)
        slope = np.array([[0.0, drift], [-np.cos(x[0]), 0.0]])
        dx = [drift * x[1], -np.sin(x[0]) + 0.5 * np.cos(3 * t)]
        return np.concatenate([dx, (slope @ frame).ravel()])

    span, y = (BEGIN, BEGIN + LENGTH), np.concatenate([[1.0, 0.0], np.eye(2).ravel()])
    y = scipy.integrate.solve_ivp(rate, span, y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return y[:2], y[2:].reshape(2, 2)


TWO, THREE = (driven_drift, driven_kick), (driven_drift, half_of_it, half_of_it)


@pytest.mark.slow_cases(all_but=("ForestRuth-4-two-drift",))
@pytest.mark.parametrize("a", [0.0, 1.0], ids=["kick", "drift"])
@pytest.mark.parametrize(
    ("scheme", "order", "flows"),
    [
        pytest.param(scheme, order, flows, id=f"{scheme}-{order}-{name}")
        for name, flows in (("two", TWO), ("three", THREE))
        for scheme, order in (("leapfrog", 2), ("ForestRuth", 4), ("Yoshida6", 6))
    ]
    + [pytest.param("BlanesMoan4", 4, TWO, id="BlanesMoan4-4-two"), pytest.param("SABA3", 2, TWO, id="SABA3-2-two")],
)
def test_schemes_keep_their_order_where_parts_depend_on_time(scheme, order, flows, a):
    """Time moves with the first part; with that of the step's start in all parts every scheme had order 1."""
    x, matrix = driven_by_scipy(a)
    errors = []
    for pieces in (31, 62):
        method = lh.Splitting(flows, scheme, dt=LENGTH / pieces)
        found = lh.tangent_map(lh.Flow(driven), [1.0, 0.0], a, t0=BEGIN, t1=LENGTH, method=method)
        errors.append([np.max(np.abs(found.x - x)), np.max(np.abs(found.matrix - matrix))])
    orders = np.log2(np.divide(*errors))
    print(errors, orders)
    assert np.all(np.abs(orders - order) < 0.4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "order"), [("ForestRuth", 4), ("SBAB2C", 4), ("SRKN11b", 6), ("Yoshida6", 6), ("SuzukiUmeno8", 8)]
)
def test_time_is_one_more_coordinate_of_a_hamiltonian(scheme, order):
    x, _ = driven_by_scipy(0.0)
    system = lh.Hamiltonian(
        lambda p, a: p[0] ** 2 / 2 + p[1], lambda q, a: -jnp.cos(q[0]) - 0.5 * q[0] * jnp.cos(3 * q[1])
    )
    errors = []
    for pieces in (16, 32):
        method = lh.Symplectic(scheme, dt=LENGTH / pieces)
        end = lh.trajectory(system, [1.0, BEGIN, 0.0, 0.0], t1=LENGTH, n=1, method=method).x[-1]
        errors.append(np.max(np.abs(end[np.array([0, 2])] - x)))
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.4, errors


def free(dt, t, x, a):
    return jnp.stack([x[0] + dt * x[1], x[1]])


def pulled(dt, t, x, a):
    return jnp.stack([x[0], x[1] - dt * jnp.sin(x[0])])


def moving_kick(dt, t, x, a):
    """Exact from t to t + dt."""
    return jnp.stack([x[0], x[1] - dt * jnp.sin(x[0]) + (jnp.sin(3 * (t + dt)) - jnp.sin(3 * t)) / 6])


def resting_drift(dt, t, x, a):
    return jnp.stack([x[0] + dt * (1 + 0.3 * a * jnp.sin(2 * t)) * x[1], x[1]])


def damped(t, x, a):
    return jnp.stack([x[1], -jnp.sin(x[0]) - 0.2 * x[1]])


def slightly_off(dt, t, x, a):
    return jnp.stack([x[0], x[1] - dt * (1 + 3e-6) * jnp.sin(x[0])])


def its_change(dt, t, x, a):
    return jnp.stack([0 * x[0], -dt * jnp.sin(x[0])])


def pendulum(t, x, a):
    return jnp.stack([x[1], -jnp.sin(x[0])])


SUM = "are not those of parts of this field"
NOT_ITS_FLOWS = {
    "a part twice": (pendulum, (free, pulled, pulled), [1.0, 0.0], SUM),
    "seen a step later only": (damped, (free, pulled), [1.0, 0.0], SUM + ".* at t = 0.1 "),
    "by three in a million": (pendulum, (free, slightly_off), [1.0, 0.5], SUM),
    "the change": (pendulum, (free, its_change), [1.0, 0.5], "Flow 1 of lh.Splitting moves the state in no time"),
    "in small units": (
        lambda t, x, a: jnp.stack([x[1], -1.01 * x[0]]), (free, lambda dt, t, x, a: x.at[1].add(-dt * x[0])),
        [1e-9, 1.0], SUM,
    ),
    "a kick that moves with the time": (driven, (free, moving_kick), [1.0, 0.0], "Flow 1 of lh.Splitting moves with"),
    "a drift at rest": (driven, (resting_drift, driven_kick), [1.0, 0.5], "Flow 0 of lh.Splitting holds the time"),
    "the order of parts": (driven, (driven_kick, driven_drift), [1.0, 0.5], "Flow 1 of lh.Splitting moves with"),
}  # fmt: skip


@pytest.mark.parametrize("what", NOT_ITS_FLOWS)
def test_flows_that_are_not_those_of_the_field_are_refused(what):
    field, flows, x0, says = NOT_ITS_FLOWS[what]
    a = 0.0 if field is driven and flows[0] is free else 1.0
    for start in (x0, [x0, x0]):
        with pytest.raises(ValueError, match=says):
            lh.lyapunov_spectrum(lh.Flow(field), start, a, t1=1.0, method=lh.Splitting(flows, "leapfrog", dt=0.1))


def newton(dt, t, x, a):
    """p' = −p³, solved in closed form by an iteration that ends where it has converged: at dt = 0 at once."""

    def goes_on(p):
        return jnp.abs(1 / p**2 - 1 / x[1] ** 2 - 2 * dt) > 1e-12

    def better(p):
        return p + 0.5 * p**3 * (1 / p**2 - 1 / x[1] ** 2 - 2 * dt)

    return jnp.stack([x[0], jax.lax.while_loop(goes_on, better, x[1])])


def turned(dt, t, x, a):
    c, s = jnp.cos(300 * dt), jnp.sin(300 * dt)
    return jnp.stack([c * x[0] + s * x[1], c * x[1] - s * x[0]])


def pulled_otherwise(dt, t, x, a):
    return jnp.stack([x[0], x[1] + dt * jnp.cos(x[0] + np.pi / 2)])


FLOWS_OF_FIELDS = {
    "at rest": (pendulum, (free, pulled), [np.pi, 0.0]),
    "written otherwise": (pendulum, (free, pulled_otherwise), [np.pi, 0.0]),
    "in small units": (pendulum, (free, pulled), [1e-12, 1e-200]),
    "an iteration": (lambda t, x, a: jnp.stack([x[1], -(x[1] ** 3)]), (free, newton), [0.0, 1.0]),
    "many turns in a step": (
        lambda t, x, a: jnp.stack([300 * x[1], -300 * x[0] - x[0] ** 3]),
        (turned, lambda dt, t, x, a: x.at[1].add(-dt * x[0] ** 3)),
        [1.0, 0.0],
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", FLOWS_OF_FIELDS)
def test_flows_of_the_field_are_taken(what):
    field, flows, x0 = FLOWS_OF_FIELDS[what]
    method = lh.Splitting(flows, "leapfrog", dt=0.1)
    assert lh.trajectory(lh.Flow(field), x0, t1=1.0, n=1, method=method).status.name == "ok"


@pytest.mark.slow
def test_a_splitting_is_for_one_mode():
    """It would move both modes by the same flows."""
    down = lh.Transition(lambda t, x, a: x[0], source="one", target="other")
    up = lh.Transition(lambda t, x, a: x[0], source="other", target="one", direction=1)
    method = lh.Splitting((free, pulled), "ABA864", dt=0.02)
    system = lh.Hybrid({"one": pendulum, "other": damped}, [down, up])
    for call in (
        lambda: lh.trajectory(system, [1.0, 0.0], t1=1.0, mode="one", method=method),
        lambda: lh.tangent_map(system, [1.0, 0.0], t1=1.0, mode="one", method=method),
        lambda: lh.return_map(system, 0, method=method),
    ):
        with pytest.raises(ValueError, match="those of the 2 modes of this system differ: take lh.RungeKutta"):
            call()
    with pytest.raises(ValueError, match="lh.Splitting with the flows of its parts if it is the only mode"):
        lh.trajectory(system, [1.0, 0.0], t1=1.0, mode="one", method=lh.Symplectic("ABA864", dt=0.02))
    wall = lh.Transition(lambda t, x, a: x[0], lambda t, x, a: jnp.stack([x[0], -x[1]]))
    assert len(lh.trajectory(lh.Hybrid(pendulum, wall), [1.0, 0.0], t1=6.0, method=method).events) == 2
