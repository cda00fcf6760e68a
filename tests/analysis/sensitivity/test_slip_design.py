"""A runner on a damped leg whose hip holds a speed: derivatives and design of exponents, against strides by SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from numpy.testing import assert_allclose

import lyaphybrid as lh

G, LENGTH = 9.81, 1.0
ARGS = {"k": 250.0, "damping": 0.3, "drive": 0.6, "speed": 5.3, "angle": 1.187}
START = [0.0, 0.97, 5.0, 0.0]  # (x, y, x', y'): x from the foot, 0 in flight until the leg touches down


def stance(t, x, args):
    length = jnp.sqrt(x[0] ** 2 + x[1] ** 2)
    force = args["k"] * (LENGTH / length - 1) - args["damping"] * (x[0] * x[2] + x[1] * x[3]) / length**2
    return jnp.stack([x[2], x[3], force * x[0] + args["drive"] * (args["speed"] - x[2]), force * x[1] - G])


def flight(t, x, args):
    return jnp.stack([x[2], x[3], 0 * x[0], -G + 0 * x[0]])


RUNNER = lh.Hybrid(
    {"rise": flight, "fall": flight, "stance": stance},
    [
        lh.Transition(lambda t, x, args: x[3], source="rise", target="fall"),
        lh.Transition(
            lambda t, x, args: x[1] - LENGTH * jnp.sin(args["angle"]),
            lambda t, x, args: x.at[0].set(-LENGTH * jnp.cos(args["angle"])),
            source="fall",
            target="stance",
        ),
        lh.Transition(
            lambda t, x, args: LENGTH - jnp.sqrt(x[0] ** 2 + x[1] ** 2),
            lambda t, x, args: x.at[0].set(0.0),
            source="stance",
            target="rise",
        ),
    ],
)


def stride(apex, args):
    """From one apex (y, x') to the next; and the time between."""
    y, vx = apex
    k, damping, drive, speed, angle = args
    fall = np.sqrt(2 * (y - LENGTH * np.sin(angle)) / G)

    def field(t, x):
        length = np.hypot(x[0], x[1])
        force = k * (LENGTH / length - 1) - damping * (x[0] * x[2] + x[1] * x[3]) / length**2
        return [x[2], x[3], force * x[0] + drive * (speed - x[2]), force * x[1] - G]

    def off(t, x):
        return np.hypot(x[0], x[1]) - LENGTH if t > 1e-3 else -1.0

    off.terminal, off.direction = True, 1.0
    start = [-LENGTH * np.cos(angle), LENGTH * np.sin(angle), vx, -G * fall]
    run = scipy.integrate.solve_ivp(field, (0, 1), start, "DOP853", events=off, rtol=1e-13, atol=1e-14)
    _, y, vx, vy = run.y_events[0][0]
    return np.array([y + vy**2 / (2 * G), vx]), fall + run.t_events[0][0] + vy / G


def slope(function, h):
    """The derivative at 0, by differences of fourth order."""
    return (8 * (function(h) - function(-h)) - function(2 * h) + function(-2 * h)) / (12 * h)


def rates(args):
    """The two finite exponents of the orbit of one stride, from its map; the larger first."""
    args = np.array([args[name] for name in ARGS])
    apex = np.array([0.97, 5.0])
    for _ in range(100):  # it attracts
        apex, _ = stride(apex, args)
    apex = scipy.optimize.fsolve(lambda apex: stride(apex, args)[0] - apex, apex, xtol=1e-12)
    columns = [slope(lambda s, e=e: stride(apex + s * e, args)[0], 3e-5) for e in np.eye(2)]
    multipliers = np.linalg.eigvals(np.transpose(columns))
    return np.sort(np.log(np.abs(multipliers)))[::-1] / stride(apex, args)[1]


@pytest.fixture(scope="module")
def orbit():
    run = lh.lyapunov_spectrum(RUNNER, START, ARGS, t1=20.0, transient=40.0, mode="rise")
    assert run.status is lh.STATUS.ok
    return np.asarray(run.x), RUNNER.mode_names[int(run.mode)]


@pytest.mark.slow
def test_derivatives_of_the_exponents_of_a_runner(orbit):
    x, mode = orbit
    found = lh.lyapunov_gradient(RUNNER, x, ARGS, t1=20.0, mode=mode, algorithm="implicit")
    assert found.trust, found.reasons
    assert_allclose(found.value[1:3], rates(ARGS), rtol=1e-7)
    assert found.value[3] == -np.inf
    for name, value in ARGS.items():
        h = value * (2e-4 if name == "angle" else 1e-3)  # touchdown is 0.01 below the apex
        expected = slope(lambda h, name=name, value=value: rates(ARGS | {name: value + h}), h)
        print(name, found.gradient[name][1:3], expected)
        assert_allclose(found.gradient[name][1:3], expected, rtol=1e-5)


@pytest.mark.slow
def test_a_runner_that_comes_back_as_fast_as_it_is_to(orbit):
    x, mode = orbit
    found = lh.design(RUNNER, x, ARGS, [0.0, -0.5], over="drive", t1=20.0, mode=mode, algorithm="implicit")
    assert (found.converged, found.trust) == (True, True), found
    print(found.parameters, rates(ARGS | found.parameters))
    assert_allclose(rates(ARGS | found.parameters)[0], -0.5, rtol=1e-6)
