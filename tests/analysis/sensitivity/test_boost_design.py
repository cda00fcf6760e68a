"""The slope compensation of a boost converter in current mode, by design, against exact flows.

On: L i' = V, C v' = −v/R; off: L i' = V − v, C v' = i − v/R. A clock puts the switch on every T; it goes off where the
current reaches the reference less the ramp, i = I − m τ with the time τ since the tick. Without a ramp the period
doubles, for one multiplier is below −1.

J. H. B. Deane, IEEE Trans. Circuits Syst. I 39 (1992) 680, doi:10.1109/81.168922.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import brentq

import lyaphybrid as lh
from lyaphybrid._jax.engines import compilations

CIRCUIT = {"voltage": 10.0, "inductance": 1e-3, "capacitance": 12e-6, "resistance": 20.0, "period": 1e-4}
ARGS = CIRCUIT | {"reference": 3.0, "slope": 3000.0}
PERIOD = CIRCUIT["period"]


def _capacitor(x, args, current):
    return (current - x[0] / args["resistance"]) / args["capacitance"]


def _charge(t, x, args):
    return jnp.stack([_capacitor(x, args, 0 * x[1]), args["voltage"] / args["inductance"] + 0 * x[1]])


def _conduct(t, x, args):
    return jnp.stack([_capacitor(x, args, x[1]), (args["voltage"] - x[0]) / args["inductance"]])


def _reaches(parity):
    """Of even periods or of odd ones: the time since the tick must not jump where it is asked for."""

    def guard(t, x, args):
        periods = t / args["period"] - parity
        since = args["period"] * (periods - 2 * jnp.round((periods - 0.5) / 2))
        return x[1] + args["slope"] * since - args["reference"]

    return guard


def _two(args):
    return 2 * args["period"]


def _one(args):
    return args["period"]


BOOST = lh.Hybrid(
    {"on_even": _charge, "on_odd": _charge, "off": _conduct},
    [
        lh.Transition(_reaches(0), source="on_even", target="off", direction=+1),
        lh.Transition(_reaches(1), source="on_odd", target="off", direction=+1),
        lh.Transition(every=_two, target="on_even"),
        lh.Transition(every=_two, phase=_one, target="on_odd"),
    ],
)


def matrices(args):
    """Both linear systems as 3 × 3 matrices of (v, i, 1)."""
    v, ind, c, r = (args[name] for name in ("voltage", "inductance", "capacitance", "resistance"))
    charge = np.array([[-1 / (r * c), 0, 0], [0, 0, v / ind], [0, 0, 0]])
    return charge, np.array([[-1 / (r * c), 1 / c, 0], [-1 / ind, 0, v / ind], [0, 0, 0]])


def multipliers(slope, args=CIRCUIT, reference=3.0):
    """Those of the cycle with one pulse a period, from exact flows: x* by a linear equation for each duty ratio."""
    charge, conduct = matrices(args)
    turn = args["period"]

    def cycle(on):
        first, second = expm(charge * on), expm(conduct * (turn - on))
        whole = second @ first
        start = np.linalg.solve(np.eye(2) - whole[:2, :2], whole[:2, 2])
        switch = first @ np.append(start, 1)
        return switch[1] + slope * on - reference, switch, first, second

    on = brentq(lambda on: cycle(on)[0], 0.3 * turn, 0.9 * turn, xtol=1e-18, rtol=1e-14)
    _, switch, first, second = cycle(on)
    before, after = (charge @ switch)[:2], (conduct @ switch)[:2]
    saltation = np.eye(2) + np.outer(after - before, [0, 1]) / (slope + before[1])
    return np.linalg.eigvals(second[:2, :2] @ saltation @ first[:2, :2])


def designed(mu, **changes):
    """The slope at which the leading multiplier is mu."""
    return lh.design(
        BOOST, [25.0, 2.3], ARGS | changes, np.log(abs(mu)) / PERIOD, t1=100 * PERIOD, transient=200 * PERIOD,
        over={"slope": (0.0, 2e4)}, algorithm="implicit", period=_two, mode="on_even",
    )  # fmt: skip


@pytest.fixture(scope="module")
def found():
    return designed(-0.8)


@pytest.mark.slow
def test_the_slope_of_a_multiplier(found):
    exact = brentq(lambda slope: np.min(multipliers(slope).real) + 0.8, 2500, 6000, xtol=1e-9, rtol=1e-14)
    assert (found.converged, found.trust) == (True, True), found
    assert_allclose(found.parameters["slope"], exact, rtol=1e-9)
    assert_allclose(np.sort(multipliers(found.parameters["slope"]).real)[0], -0.8, rtol=1e-10)


@pytest.mark.slow
def test_the_slope_at_a_reference_of_2_5_amperes():
    """An independent computation gave 2777.2735."""
    found = designed(-0.8, reference=2.5)
    assert (found.converged, found.trust) == (True, True), found
    assert abs(found.parameters["slope"] - 2777.2735) < 1e-4


def test_the_exact_flows_against_values_from_elsewhere():
    """The reference at which the period doubles without a ramp, and the slope for −0.8 at 2.5 A."""
    doubling = brentq(lambda reference: np.min(multipliers(0.0, reference=reference).real) + 1, 1.5, 2.0, xtol=1e-13)
    assert abs(doubling - 1.70598249061) < 1e-10
    slope = brentq(lambda slope: np.min(multipliers(slope, reference=2.5).real) + 0.8, 2000, 4000, xtol=1e-9)
    assert abs(slope - 2777.2735) < 5e-5


@pytest.mark.slow
def test_a_second_design_compiles_nothing(found):
    before = compilations()
    again = designed(-0.7, slope=4000.0, reference=3.1)
    assert compilations() == before
    exact = multipliers(again.parameters["slope"], reference=3.1)
    assert_allclose(np.min(exact.real), -0.7, rtol=1e-9)


def test_without_a_ramp_the_period_doubles():
    assert np.min(multipliers(0.0).real) < -1
