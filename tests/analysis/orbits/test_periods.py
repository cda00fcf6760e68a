"""A period that is given must be one of the system; a wrong one is refused with that which the system seems to have."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid.analysis.orbits.periods import check_period, depends_on_time

IMPACTS = zoo.impact_oscillator()
FORCED = (IMPACTS.system, IMPACTS.x0, IMPACTS.args)
TURN = 2 * np.pi / 2.8


def turn_of(args):
    return 2 * jnp.pi / args["omega"]


def still(t, x, args):
    return -x


def crossing(t, x, args):
    return x[0] - 0.5


def on_for_a_third(t, period):
    return jnp.where(jnp.mod(t, period) < period / 3, 1.0, 0.0)


def jumping(**parts):
    return lh.Hybrid({"a": still, "b": still}, [lh.Transition(**({"guard": crossing} | parts))])


def projected(t, x, args, dx):
    return dx * jnp.cos(2 * t)


def mixed(t, x, args):
    return jnp.stack([jnp.cos(3 * t) - x[0], 1e-3 * jnp.sin(2 * t + 1) * x[1]])


# What depends on time in a system of two components, its period, and what is to be called by name.
SYSTEMS = {
    "a sine": (lh.Flow(lambda t, x, args: -x + jnp.cos(2.8 * t)), TURN, "field"),
    "two sines": (lh.Flow(mixed), 2 * np.pi, "field"),
    "a parameter": (lh.Flow(lambda t, x, args: -x * jnp.cos(t)), 2 * np.pi, "field"),
    "a square wave": (lh.Flow(lambda t, x, args: on_for_a_third(t, 4e-4) - x), 4e-4, "field"),
    "a guard": (jumping(guard=lambda t, x, args: x[0] - jnp.sin(t) ** 2), np.pi, "guard of transition 0"),
    "a reset": (jumping(reset=lambda t, x, args: x + jnp.sin(t)), 2 * np.pi, "reset of transition 0"),
    "a target": (jumping(target=lambda t, x, args: jnp.asarray(t % 3.0 < 1, int)), 3.0, "target of transition 0"),
    "a condition": (jumping(when=lambda t, x, args: jnp.sin(t) > 0), 2 * np.pi, "when of transition 0"),
    "one of several resets": (
        jumping(guard=lambda t, x, args: x, reset=lambda t, x, args, i: x + jnp.where(i == 1, jnp.sin(t), 0.0)),
        2 * np.pi,
        "reset of transition 0",
    ),
    "a projection": (
        lh.Hybrid({"a": still}, lh.Transition(crossing), tangent={"a": projected}),
        np.pi,
        "tangent of mode 'a'",
    ),
    "a mode": (
        lh.Hybrid({"a": still, "b": lambda t, x, args: -x * jnp.cos(t)}, lh.Transition(crossing)),
        2 * np.pi,
        "field of mode 'b'",
    ),
    "a clock": (lh.Hybrid(still, lh.Transition(every=0.5, phase=0.1)), 0.5, "clock of transition 0"),
    "two clocks": (lh.Hybrid(still, [lh.Transition(every=0.5), lh.Transition(every=0.75)]), 1.5, "clock of transition"),
    "a map": (lh.Map(lambda n, x, args: x * jnp.cos(2 * np.pi * n / 6)), 6, "rule"),
    "constraints": (
        lh.DAE(
            lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
            lambda t, x, args: jnp.stack([-x[1], x[1] - jnp.sin(2 * t)]),
            1,
        ),
        np.pi,
        "residual of the field",
    ),
}


def seen(message: str) -> float:
    found = re.search(r"repeat after ([0-9.e+-]+):", message)
    assert found, message
    return float(found[1])


@pytest.mark.parametrize("what", SYSTEMS)
@pytest.mark.parametrize("x", [[0.0, 0.0], [0.3, -1.2]])
def test_a_wrong_period_is_refused_and_the_right_one_named(what, x):
    system, period, name = SYSTEMS[what]
    x = np.array(x)
    assert depends_on_time(system, x, None) or not np.any(x)
    for turns in (1, 2, 3, 7):
        check_period(system, turns * period, x, None)
        check_period(system, turns * period, x, None, t=5.0)
    wrong = (1, 4) if isinstance(period, int) else (0.5 * period, 1.37 * period, 1.0001 * period, 200 * period / 3)
    for other in wrong:
        with pytest.raises(ValueError, match=f"got {other:.9g}, but at the same state the {name}") as caught:
            check_period(system, other, x, None)
        assert seen(str(caught.value)) == pytest.approx(period, rel=3e-8)  # eight digits


@pytest.mark.parametrize(
    "call",
    [
        lambda period: lh.floquet(*FORCED, period=period),
        lambda period: lh.continuation(*FORCED, over={"omega": (2.7, 2.9)}, period=period),
        lambda period: lh.poincare_section(IMPACTS.system, IMPACTS.x0, args=IMPACTS.args, period=period, n=3),
        lambda period: lh.bifurcation_diagram(
            IMPACTS.system, [[-1.0, 0.0], [0.0, 1.0]], IMPACTS.args, over={"gap": [0.0, 0.1]}, period=period
        ),
        lambda period: lh.lyapunov_gradient(*FORCED, t1=100.0, period=period, key=jax.random.key(0)),
        lambda period: lh.lyapunov_gradient(*FORCED, t1=100.0, period=period, algorithm="implicit"),
        lambda period: lh.design(*FORCED, -0.1, t1=100.0, over="omega", period=period),
    ],
    ids=["floquet", "continuation", "section", "diagram", "gradient", "implicit", "design"],
)
@pytest.mark.parametrize("period", [1.0, lambda args: 1.0])
def test_wherever_a_period_is_given(call, period):
    with pytest.raises(ValueError, match="must be one after which all functions of time are as before") as caught:
        call(period)
    assert seen(str(caught.value)) == pytest.approx(TURN, rel=1e-7)


@pytest.mark.slow
def test_along_a_branch_the_period_is_that_of_the_parameters():
    """A number is the period at the start alone."""
    system = lh.Flow(lambda t, x, args: jnp.stack([x[1], jnp.cos(args["omega"] * t) - x[0] - 0.3 * x[1]]))
    branch = {"system": system, "x0": [0.0, 0.0], "args": {"omega": 2.0}, "over": {"omega": (1.5, 2.5)}}
    with pytest.raises(ValueError, match="period at omega = 1.5 must be one after which") as caught:
        lh.continuation(**branch, period=np.pi)
    assert seen(str(caught.value)) == pytest.approx(2 * np.pi / 1.5, rel=1e-7)
    assert lh.continuation(**branch, period=turn_of).ends == ("range", "range")


@pytest.mark.slow
def test_what_has_no_period_is_refused_but_by_a_stroboscope():
    two = lh.Flow(lambda t, x, args: jnp.cos(t) + jnp.cos(np.sqrt(2) * t) - x)
    with pytest.raises(ValueError, match="No period was found: .a. there are several frequencies"):
        lh.floquet(two, [0.0], period=2 * np.pi)
    assert lh.poincare_section(two, [0.0], period=2 * np.pi, n=3).x.shape == (3, 1)
    fading = lh.Flow(lambda t, x, args: jnp.exp(-t) - x)
    with pytest.raises(ValueError, match="No period was found"):
        lh.floquet(fading, [0.0], period=1.0)


def test_what_is_over_before_does_not_count():
    ramp, x = lh.Flow(lambda t, x, args: jnp.minimum(t / 10, 1.0) * jnp.cos(t) - x), np.ones(1)
    check_period(ramp, 2 * np.pi, x, None, t=10.0)
    with pytest.raises(ValueError, match="must be one after which"):
        check_period(ramp, 2 * np.pi, x, None, t=9.0)


def test_digits_that_were_left_out_do_no_harm():
    system, x = lh.Flow(lambda t, x, args: jnp.cos(t) - x), np.array([0.3])
    check_period(system, 6.283185307, x, None)
    for rounded in (6.28318, 6.2831852):
        with pytest.raises(ValueError, match="must be one after which"):
            check_period(system, rounded, x, None)
    check_period(system, np.float32(2 * np.pi), x.astype(np.float32), None)


def test_without_time_any_period_is_right():
    for system in (lh.Flow(still), jumping(), lh.Map(lambda n, x, args: 0.5 * x)):
        check_period(system, 3, np.ones(2), None)


def test_what_is_traced_is_not_looked_at():
    system = lh.Flow(lambda t, x, args: jnp.cos(args * t) - x)

    def asked(omega):
        check_period(system, 1.0, np.ones(1), omega)
        return omega

    assert jax.jit(asked)(2.0) == 2.0
    with pytest.raises(ValueError, match="must be one after which"):
        asked(2.0)


def test_the_rounding_of_forces_that_cancel_tells_nothing():
    block = zoo.block_on_plate()
    check_period(block.system, 2 * np.pi, block.x0, block.args)


def test_values_that_are_no_numbers_tell_nothing():
    system = lh.Flow(lambda t, x, args: jnp.log(x) * jnp.stack([jnp.cos(t), 1.0]))
    check_period(system, 2 * np.pi, np.array([-1.0, 1.0]), None)
    with pytest.raises(ValueError, match="must be one after which"):
        check_period(system, 2.0, np.array([1.5, -1.0]), None)


def test_a_frequency_in_place_of_a_period_is_refused():
    """50 kHz is a multiple of 20 µs, too: a period with 2.5e9 ticks."""
    tick = lh.Transition(every=2e-5, reset=lambda t, x, args: 0.5 * x)
    sampled = lh.Hybrid(lambda t, x, args: -x, tick)
    with pytest.raises(ValueError, match=r"transition 0 ticks 2\.5e\+09 times \(every 2e-05\). Is it a frequency"):
        lh.floquet(sampled, [1.0], period=50e3)


def test_functions_are_checked_before_they_are_compared():
    walls = lh.Transition(lambda t, x, args: jnp.stack([x[0], 1 - x[0]]), lambda t, x, args: -x)
    with pytest.raises(ValueError, match=r"The reset of transition 0 is called with \(t, x, args, which\)"):
        lh.floquet(lh.Hybrid(lambda t, x, args: -x, walls), [0.5], period=1.0)


def test_a_period_given_for_a_system_that_does_not_depend_on_time():
    """The orbit may begin at any time: that is no family; along a branch the shift would be all that changes."""
    cycle = lh.Flow(lambda t, x, mu: jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]))
    free = lh.floquet(cycle, [2.0, 0.0], 1.0)
    given = lh.floquet(cycle, [2.0, 0.0], 1.0, period=free.period)
    assert (given.family, given.stability) == (0, "stable")
    np.testing.assert_allclose(given.multipliers, free.multipliers, atol=1e-11)
    with pytest.raises(lh.NoPeriodicOrbitError, match="leave period away"):
        lh.floquet(cycle, [2.0, 0.0], 1.0, period=free.period + 0.05)
    with pytest.raises(ValueError, match="leave period away"):
        lh.continuation(cycle, [2.0, 0.0], 1.0, over={"args": (0.5, 1.5)}, period=free.period)


def test_a_period_given_where_energy_is_conserved():
    """It chooses one of a pendulum's orbits; all of an oscillator's have it: their amplitude is free."""
    pendulum = lh.Flow(lambda t, x, args: jnp.stack([x[1], -jnp.sin(x[0])]))
    oscillator = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0]]))
    swing = lh.floquet(pendulum, [1.0, 0.0], period=7.0)
    assert swing.family == 0
    assert swing.stability in ("neutral", "elliptic")  # a double multiplier 1, known to √ε
    amplitude = np.max(np.abs(lh.trajectory(pendulum, swing.x0, t1=7.0, n=4001).x[:, 0]))
    np.testing.assert_allclose(4 * scipy.special.ellipk(np.sin(amplitude / 2) ** 2), 7.0, rtol=1e-6)
    assert lh.floquet(oscillator, [1.0, 0.0], period=2 * np.pi).family == 1
    assert lh.floquet(pendulum, [0.0, 0.0], period=7.0).stability == "elliptic"  # at rest nothing is shifted


@pytest.mark.parametrize("period", [1.0, 3.0, 0.77])
def test_the_period_named_for_two_clocks_is_their_least(period):
    system = lh.Hybrid(
        lambda t, x, args: -x,
        [
            lh.Transition(every=1.0, reset=lambda t, x, args: x + 1),
            lh.Transition(every=0.77, reset=lambda t, x, args: 0.9 * x),
        ],
    )
    with pytest.raises(ValueError, match="after 77: give that"):
        lh.floquet(system, [1.0], period=period)
