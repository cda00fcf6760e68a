"""A mass that hops on a massless leg: its periodic orbits must close in their mode, and their velocity with them.

The fields of flight and stance go on beyond the guards that end them, and there motions meet themselves in another
mode: a flight that begins below the height at which the leg touches the ground, and a push of the leg.
"""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from numpy.testing import assert_allclose

import lyaphybrid as lh

G = 9.81
ARGS = {"k": 205.0, "damping": 2.0, "thrust": 12.0}


def leg(x, args):
    return args["k"] * (1 - x[0]) - args["damping"] * x[1]


HOPPER = lh.Hybrid(
    {
        "flight": lambda t, x, args: jnp.stack([x[1], -G + 0 * x[0]]),
        "down": lambda t, x, args: jnp.stack([x[1], leg(x, args) - G]),
        "up": lambda t, x, args: jnp.stack([x[1], leg(x, args) + args["thrust"] - G]),
    },
    [
        lh.Transition(lambda t, x, args: x[0] - 1, source="flight", target="down"),
        lh.Transition(lambda t, x, args: x[1], source="down", target="up", direction=1),
        lh.Transition(lambda t, x, args: 1 - x[0], source="up", target="flight"),
    ],
)


def hop(height, args):
    """Height of the next apex, and the time till then: parabolas, and matrix exponentials of the stance."""

    def stance(state, push, ends, longest):
        matrix = np.array([[0, 1, 0], [-args["k"], -args["damping"], args["k"] + push - G], [0, 0, 0]])
        after = lambda t: scipy.linalg.expm(matrix * t) @ state  # noqa: E731
        time = scipy.optimize.brentq(lambda t: ends @ after(t), 1e-3, longest, xtol=1e-15)
        return after(time), time

    fall = np.sqrt(2 * (height - 1) / G)
    lowest, squeezed = stance(np.array([1, -G * fall, 1]), 0.0, np.array([0, 1, 0]), 0.15)
    off, pushed = stance(lowest, args["thrust"], np.array([1, 0, -1]), 0.2)
    return 1 + off[1] ** 2 / (2 * G), fall + squeezed + pushed + off[1] / G


def cycle(args, least=1.3):
    """The orbit's apex, its period and the multiplier across it."""
    apex = scipy.optimize.brentq(lambda height: hop(height, args)[0] - height, least, 3.0, xtol=1e-14)
    return apex, hop(apex, args)[1], (hop(apex + 1e-5, args)[0] - hop(apex - 1e-5, args)[0]) / 2e-5


def rate(args, least=1.3):
    _, period, multiplier = cycle(args, least)
    return np.log(multiplier) / period


# Off the orbit, in all modes. Without the condition on the mode the first four of these led to 0.865 and 0.888, of
# complex multipliers and "stable", 0.699 and 0.673.
STARTS = [
    ([1.0, -3.0], "down", 3.0),
    ([0.95, -3.0], "down", 3.0),
    ([1.0, 3.742462682863841], "flight", 0.0),
    ([0.8, 1.0], "up", 0.0),
    ([1.2, 0.0], "flight", 0.0),
    ([0.95, 4.0], "up", 3.0),
]


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 3])
def test_the_orbit_closes_in_its_mode(segments):
    _, period, multiplier = cycle(ARGS)
    assert period == pytest.approx(0.99289, abs=5e-6)
    for x0, mode, transient in STARTS:
        orbit = lh.floquet(HOPPER, x0, ARGS, mode=mode, transient=transient, segments=segments)
        assert orbit.period == pytest.approx(period, abs=1e-10), (x0, mode)
        assert_allclose(orbit.multipliers, [1.0, multiplier], atol=1e-8)
        assert orbit.jumps == 3


@pytest.mark.slow
def test_where_the_period_is_given_the_motion_leads_to_the_orbit_too():
    apex, period, _ = cycle(ARGS)
    orbit = lh.floquet(HOPPER, [0.957, 3.24], ARGS, mode="flight", period=period)
    y, v = np.asarray(orbit.base[1])
    energies = {0: G * (y - apex) + v**2 / 2}  # in flight
    assert_allclose(energies[orbit.base[2]], 0.0, atol=1e-6)


@pytest.mark.slow
def test_what_closes_in_another_mode_is_no_orbit():
    """A switch that is thrown in each unit of time: after 1 all is as before, but for the switch."""
    clock = {
        "guard": lambda t, x, args: 1 - x[1],
        "reset": lambda t, x, args: jnp.stack([x[0], x[1] - 1]),
    }
    system = lh.Hybrid(
        {
            "on": lambda t, x, args: jnp.stack([1 - x[0], 1 + 0 * x[1]]),
            "off": lambda t, x, args: jnp.stack([-1 - x[0], 1 + 0 * x[1]]),
        },
        [lh.Transition(**clock, source="on", target="off"), lh.Transition(**clock, source="off", target="on")],
    )
    with pytest.raises(lh.NoPeriodicOrbitError, match=r"in mode '(on|off)' where it should be in '(on|off)'") as caught:
        lh.floquet(system, [0.9, 0.5], period=1.0, mode="on")
    assert np.isinf(caught.value.result.residual)
    assert np.isinf(lh.floquet(system, [0.9, 0.5], period=1.0, mode="on", throw=False).residual)
    orbit = lh.floquet(system, [0.9, 0.5], mode="on")
    assert orbit.period == pytest.approx(2.0, abs=1e-10)
    assert_allclose(orbit.multipliers, [1.0, np.exp(-2)], atol=1e-9)


def test_an_equilibrium_is_no_orbit():
    """A weakly damped oscillator comes back close to where it was; Newton's method then finds where it rests."""
    damped = lh.Flow(lambda t, x, rate: jnp.stack([x[1], -x[0] - rate * x[1]]))
    with pytest.raises(lh.NoPeriodicOrbitError, match="an equilibrium") as caught:
        lh.floquet(damped, [1.0, 0.0], 0.02)
    assert np.isinf(caught.value.result.residual)
    assert np.max(np.abs(caught.value.result.x0)) < 1e-9


@pytest.mark.slow
def test_a_branch_stays_in_its_mode():
    branch = lh.continuation(
        HOPPER, [1.0, -3.0], ARGS, over={"k": (150.0, 250.0)}, mode="down", transient=3.0, step=0.2
    )
    assert branch.ends == ("range", "range")
    assert branch.specials == ()
    for k, period, multipliers in zip(branch.values, branch.period, branch.multipliers, strict=True):
        _, wanted, multiplier = cycle(ARGS | {"k": k})
        assert period == pytest.approx(wanted, abs=1e-9)
        assert_allclose(multipliers, [1.0, multiplier], atol=1e-7)


@pytest.mark.slow
def test_derivatives_are_of_that_orbit():
    found = lh.lyapunov_gradient(
        HOPPER, [1.0, -3.0], ARGS, t1=10.0, over=("thrust",), mode="down", transient=3.0, algorithm="implicit"
    )
    slope = (rate(ARGS | {"thrust": 12.01}) - rate(ARGS | {"thrust": 11.99})) / 0.02
    assert_allclose(found.value, [0.0, rate(ARGS)], atol=1e-8)
    assert_allclose(found.gradient["thrust"], [0.0, slope], atol=1e-5)
    assert found.trust


@pytest.mark.slow
def test_the_thrust_of_a_rate_by_design():
    """The first step of Newton's method would lead to a thrust of −2, where the hopper comes to rest."""
    found = lh.design(
        HOPPER,
        [1.2, 0.0],
        ARGS,
        [0.0, -0.5],
        t1=50.0,
        transient=20.0,
        over="thrust",
        mode="flight",
        algorithm="implicit",
    )
    assert (found.converged, found.trust) == (True, True), found
    assert_allclose(rate(ARGS | found.parameters, least=1.05), -0.5, rtol=1e-8)
