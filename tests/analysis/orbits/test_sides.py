"""Orbits beyond a guard: where Newton's method leaps over it, there is none."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import fsolve

import lyaphybrid as lh

# A boost converter with a comparator, in microseconds, volts and amperes.
ARGS = {"Vin": 8.0, "L": 220.0, "C": 47.0, "R": 15.0, "r": 0.12, "T": 20.0, "I": 5.0}


def coil(t, x, args):
    """Current, voltage; the switch, 1 where the coil is charged."""
    i, v, charges = x
    rate = (args["Vin"] - args["r"] * i - (1 - charges) * v) / args["L"]
    return jnp.stack([rate, ((1 - charges) * i - v / args["R"]) / args["C"], 0 * i])


def reached(t, x, args):
    return args["I"] - x[0]


TICK = lh.Transition(every=lambda args: args["T"], reset=lambda t, x, args: x.at[2].set(1.0))
OPENS = lh.Transition(reached, lambda t, x, args: x.at[2].set(0.0), when=lambda t, x, args: x[2] > 0.5)
IN_MODES = lh.Hybrid(
    {
        "on": lambda t, x, args: coil(t, x.at[2].set(1.0), args),
        "off": lambda t, x, args: coil(t, x.at[2].set(0.0), args),
    },
    [
        lh.Transition(every=lambda args: args["T"], reset=lambda t, x, args: x.at[2].set(1.0), target="on"),
        lh.Transition(reached, source="on", target="off"),
    ],
)


def by_hand(args):
    """State at a tick, and multipliers, by matrix exponentials."""
    charging = np.array([[-args["r"] / args["L"], 0.0], [0.0, -1 / (args["R"] * args["C"])]])
    discharging = charging + np.array([[0.0, -1 / args["L"]], [1 / args["C"], 0.0]])
    drive = np.array([args["Vin"] / args["L"], 0.0])

    def after(matrix, x, t):
        joined = np.zeros((3, 3))
        joined[:2, :2], joined[:2, 2] = matrix, drive
        whole = expm(joined * t)
        return whole[:2, :2] @ x + whole[:2, 2], whole[:2, :2]

    def missed(z):
        top, _ = after(charging, z[:2], z[2])
        end, _ = after(discharging, top, args["T"] - z[2])
        return [*(end - z[:2]), top[0] - args["I"]]

    z = fsolve(missed, [args["I"] - 0.5, 22.0, 13.0], xtol=1e-13)
    top, first = after(charging, z[:2], z[2])
    before, behind = charging @ top + drive, discharging @ top + drive
    saltation = np.eye(2) + np.outer(behind - before, [1.0, 0.0]) / before[0]
    return z[:2], np.linalg.eigvals(expm(discharging * (args["T"] - z[2])) @ saltation @ first)


@pytest.mark.parametrize("transient", [300, 301, 333])
@pytest.mark.parametrize("system", ["when", "modes"])
def test_no_orbit_lies_where_the_switch_never_opens(system, transient):
    """The motion is chaotic; without the comparator the current would rise to Vin/r = 67 A, and that repeats, too."""
    x, multipliers = by_hand(ARGS)
    built, more = (lh.Hybrid(coil, [TICK, OPENS]), {}) if system == "when" else (IN_MODES, {"mode": "on"})
    found = lh.floquet(built, [2.0, 15.0, 1.0], ARGS, period=20.0, transient=transient * 20.0, throw=False, **more)
    if found.status is lh.STATUS.ok:
        np.testing.assert_allclose(found.x0[:2], x, rtol=1e-8)
        np.testing.assert_allclose(np.sort(np.abs(found.multipliers))[-2:], np.sort(np.abs(multipliers)), rtol=1e-6)
        assert found.notes == frozenset()
    else:
        assert found.status is lh.STATUS.no_orbit
        assert found.stability == "unknown"


def test_it_is_said_which_guard_was_leapt_over():
    """From which points of the chaotic motion Newton's method leaps hangs on rounding: from one of ten it does."""
    errors = [failure_of(transient) for transient in range(300, 310)]
    assert any("over the guard of transition 1" in str(error) and error.result.x0[0] > 60 for error in errors if error)


def failure_of(transient):
    """The error of a search that begins so many periods later, or None."""
    try:
        lh.floquet(IN_MODES, [2.0, 15.0, 1.0], ARGS, period=20.0, transient=transient * 20.0, mode="on")
    except lh.NoPeriodicOrbitError as error:
        return error
    return None


@pytest.mark.parametrize("fired", [True, False])
def test_a_start_beyond_a_guard_with_a_condition_is_said_too(fired):
    """Here the motion itself begins above the comparator, and stays there."""
    start = [2.0, 15.0, 1.0] if fired else [60.0, 1.0, 1.0]
    found = lh.floquet(
        lh.Hybrid(coil, [TICK, OPENS]), start, ARGS | {"I": 3.0, "Vin": 12.0}, period=20.0, transient=4000.0
    )
    assert (found.notes == {"beyond_guard"}) == (not fired)
    assert found.jumps == (2 if fired else 1)


@pytest.mark.slow
@pytest.mark.parametrize(("low", "high", "t0"), [(0.05, 0.9, 0.0), (0.05, 0.9, 3.0), (0.12, 0.16, 0.0)])
def test_a_branch_on_which_an_event_passes_the_start_of_the_period(low, high, t0):
    """A stop passes t = 0 at μ = 0.1332: a step over it found a motion beyond the guard, and a touch that is none.

    The touches are where a block stops twice more in a period, as its motions from anywhere do.
    """

    def slides(sign):
        return lambda t, x, args: jnp.stack([x[1], -x[0] - 0.05 * x[1] - sign * args["mu"] + jnp.cos(args["w"] * t)])

    system, w = lh.filippov(slides(1.0), slides(-1.0), lambda t, x, args: x[1]), 0.4
    turn = 2 * np.pi / w
    args = {"mu": 0.15 if high < 0.2 else 0.3, "w": w}
    found = lh.continuation(system, [0.5, 1.0], args, over={"mu": (low, high)}, period=turn, transient=30 * turn, t0=t0)
    assert found.ends == ("range", "range")
    assert [special.kind for special in found.specials] == ["grazing", "grazing"]
    places = [special.parameter for special in found.specials]
    assert_allclose(places, [0.130741094, 0.154163853], atol=2e-9)
    for place, counts in zip(places, [(2, 6), (6, 4)], strict=True):
        for mu, count in zip((place - 1e-4, place + 1e-4), counts, strict=True):
            motion = lh.trajectory(system, [0.5, 1.0], {"mu": mu, "w": w}, t1=60 * turn, n=2)
            assert np.sum(np.asarray(motion.events.t) > 40 * turn) == 20 * count
