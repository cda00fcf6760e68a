"""Events that fall on the tick of a clock, as in a converter: corners of branches, and their curves in two parameters.

A switch is closed at each tick, and opened where the current reaches its peak I. In an orbit over two ticks it stays
closed for one of them, where the current does not reach I in time: at the border it does so at the tick.
"""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.optimize

import lyaphybrid as lh

pytestmark = pytest.mark.slow


def converter(on, off, peak, phase=0.0):
    return lh.Hybrid(
        {"on": on, "off": off},
        [
            lh.Transition(peak, lambda t, x, args, *which: x, source="on", target="off"),
            lh.Transition(
                every=lambda args: args["T"], phase=phase, reset=lambda t, x, args: x, source="off", target="on"
            ),
        ],
    )


def two_ticks(args):
    return 2 * args["T"]


# --- one current, with closed forms -----------------------------------------------------------------------------------

CURRENT = converter(
    lambda t, x, args: jnp.stack([args["V"] - args["R"] * x[0]]),
    lambda t, x, args: jnp.stack([args["V"] - args["E"] - args["S"] * x[0]]),
    lambda t, x, args: args["I"] - x[0],
)
PERSISTS = {"V": 1.0, "E": 2.4, "R": 0.3, "S": 0.8, "I": 1.4, "T": 1.0}
TURNS_BACK = PERSISTS | {"S": 0.15}


def decays(args):
    return np.exp(-args["R"] * args["T"]), np.exp(-args["S"] * args["T"])


def voltage_at_border(args):
    """From I at a tick: open until the next one, closed until I is reached at that after it."""
    closed, opened = decays(args)
    r, s = (1 - closed) / args["R"], closed * (1 - opened) / args["S"]
    return (args["I"] * (1 - closed * opened) + s * args["E"]) / (r + s)


def rates(args):
    """Of the current where it reaches I: closed, open."""
    return args["V"] - args["R"] * args["I"], args["V"] - args["E"] - args["S"] * args["I"]


def multipliers_at_border(args):
    """Of orbits that pass I once and three times, for the switch is open for two short times on one side."""
    there = args | {"V": voltage_at_border(args)}
    ratio = rates(there)[1] / rates(there)[0]
    return np.prod(decays(there)) * ratio, np.prod(decays(there)) * ratio**2


def doubling_of_one_tick(args):
    """The voltage at which the orbit over one tick has the multiplier −1."""

    def orbit(v):
        there = args | {"V": v}
        r, s = args["R"], args["S"]

        def closes(share):  # open for this share of T, from I, then closed until I
            low = (v - args["E"]) / s + (args["I"] - (v - args["E"]) / s) * np.exp(-s * share * args["T"])
            return v / r + (low - v / r) * np.exp(-r * (1 - share) * args["T"]) - args["I"]

        share = scipy.optimize.brentq(closes, 1e-6, 1 - 1e-6, xtol=1e-15)
        closed, opened = rates(there)
        return np.exp(-(s * share + r * (1 - share)) * args["T"]) * opened / closed + 1

    border = voltage_at_border(args)
    return scipy.optimize.brentq(orbit, 0.95 * border, 1.05 * border, xtol=1e-15)


@pytest.fixture(scope="module", params=[PERSISTS, TURNS_BACK], ids=["persists", "turns back"])
def branch(request):
    args, border = request.param, voltage_at_border(request.param)
    found = lh.continuation(
        CURRENT, [1.0], args | {"V": 0.97 * border}, over={"V": (0.95 * border, 1.1 * border)},
        period=two_ticks, transient=400.0, mode="on",
    )  # fmt: skip
    return args, found


def test_a_branch_goes_round_its_corners(branch):
    """To the doubling of the orbit over one tick, and back to the same orbits, a tick later."""
    args, found = branch
    border, (once, three_times) = voltage_at_border(args), multipliers_at_border(args)
    assert found.ends == ("range", "range")
    corners = [special.parameter for special in found.of_kind("grazing")]
    assert corners == pytest.approx([border, border], abs=1e-8)
    turn = found.of_kind("pitchfork")[0].parameter
    assert turn == pytest.approx(doubling_of_one_tick(args), abs=1e-9)
    assert (turn > border) == (three_times < 1)
    multipliers = np.array([orbit.multipliers[0].real for orbit in found.orbits])
    near = np.abs(found.values - border) < 1e-4
    assert np.any(near & (multipliers < 0))
    assert np.any(near & (multipliers > 0))
    np.testing.assert_allclose(multipliers[near], np.where(multipliers[near] < 0, once, three_times), atol=2e-3)


@pytest.mark.parametrize(("second", "low", "high"), [("T", 0.6, 1.5), ("E", 1.5, 4.0)])
def test_the_border_in_closed_form(branch, second, low, high):
    """The time of the tick depends on T."""
    args, found = branch
    border = voltage_at_border(args)
    over = {"V": (0.5 * border, 2 * border), second: (low, high)}
    curve = lh.bifurcation_curve(CURRENT, found.of_kind("grazing")[0], args, over=over, period=two_ticks, mode="on")
    assert curve.kind == "edge"
    assert curve.ends == ("range", "range")
    voltages, others = curve.values.T
    assert np.ptp(others) == pytest.approx(high - low)
    exact = [voltage_at_border(args | {second: other}) for other in others]
    np.testing.assert_allclose(voltages, exact, rtol=1e-12)


# --- current and voltage ----------------------------------------------------------------------------------------------

BOOST = converter(
    lambda t, x, args: jnp.stack([args["V"] - 0.1 * x[0], -x[1] / args["R"]]),
    lambda t, x, args: jnp.stack([args["V"] - 0.1 * x[0] - x[1], x[0] - x[1] / args["R"]]),
    lambda t, x, args: jnp.stack([9.0 - x[1], args["I"] - x[0]]),  # the first entry stays positive
    phase=0.4,
)


def over_a_tick(args, opened):
    """Of x' = A x + b: the matrix and the shift over T."""
    matrix = np.array([[-0.1, -1.0 * opened, args["V"]], [1.0 * opened, -1 / args["R"], 0.0], [0.0, 0.0, 0.0]])
    return scipy.linalg.expm(matrix * args["T"])


def off_the_border(args):
    """I less the current after two ticks, of the orbit that is open for one and closed for the other."""
    both = over_a_tick(args, opened=False) @ over_a_tick(args, opened=True)
    fixed = np.linalg.solve(np.eye(2) - both[:2, :2], both[:2, 2])
    return args["I"] - fixed[0]


def test_the_border_of_a_boost_converter():
    """Two components, a guard of two entries, a clock with a phase; each point against matrix exponentials."""
    args = {"V": 1.0, "R": 3.0, "I": 1.5, "T": 1.2}
    border = scipy.optimize.brentq(lambda v: off_the_border(args | {"V": v}), 0.2, 3.0)
    branch = lh.continuation(
        BOOST, [1.0, 1.5], args | {"V": 0.98 * border}, over={"V": (0.8 * border, 1.2 * border)},
        period=two_ticks, transient=400.0, mode="on",
    )  # fmt: skip
    special = branch.of_kind("grazing")[0]
    assert special.parameter == pytest.approx(border, abs=1e-7)
    over = {"V": (0.3 * border, 3 * border), "R": (2.0, 5.0)}
    curve = lh.bifurcation_curve(BOOST, special, args, over=over, period=two_ticks, mode="on")
    assert curve.ends == ("range", "range")
    assert len(curve.values) > 10
    for v, r in curve.values:
        assert abs(off_the_border(args | {"V": v, "R": r})) < 1e-10


def normal_form(left, right):
    """The border-collision normal form of Nusse & Yorke with traces and determinants (t, d) on both sides of x = 0."""

    def rule(n, x, mu):
        trace, determinant = (jnp.where(x[0] < 0, one, other) for one, other in zip(left, right, strict=True))
        return jnp.stack([trace * x[0] + x[1] + mu, -determinant * x[0]])

    return lh.Map(rule)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ((0.5, 0.3), (-1.6, 0.4)),  # loses its stability to a doubling's multiplier
        ((0.5, 0.3), (-0.5, 1.4)),  # to a pair's, at a corner
        ((-2.0, 0.3), (0.5, 0.4)),
        ((1.9, 0.3), (0.5, 0.3)),  # both orbits are on one side of μ = 0: a fold
        ((-1.5, 0.3), (2.5, 0.4)),
    ],
)
def test_a_fixed_point_of_a_map_crosses_its_border_at_zero(left, right):
    system = normal_form(left, right)
    side = 1.0 if right[0] < 1 + right[1] else -1.0  # on which the orbit with x > 0 exists
    start = side * 0.5 / (1 - right[0] + right[1])
    found = lh.continuation(system, [start, -right[1] * start], side * 0.5, over={"args": (-1.0, 1.0)}, period=1)
    (special,) = found.specials
    assert special.kind == "border collision"
    assert found.ends == ("range", "range")
    assert abs(special.parameter) < 1e-12
    for i, (trace, determinant) in ((0, left), (-1, right)):
        orbits = [one for one in (found.orbits[0], found.orbits[-1]) if (float(one.x0[0]) < 0) == (i == 0)]
        (orbit,) = orbits
        x = found.values[0 if orbit is found.orbits[0] else -1] / (1 - trace + determinant)
        np.testing.assert_allclose(orbit.x0, [x, -determinant * x], atol=1e-10)
        expected = np.roots([1.0, -trace, determinant])
        np.testing.assert_allclose(np.sort(np.abs(orbit.multipliers)), np.sort(np.abs(expected)), atol=1e-9)


def test_no_curve_begins_at_a_border_without_its_function():
    system = normal_form((0.5, 0.3), (-1.6, 0.4))
    found = lh.continuation(system, [-0.6, 0.2], -0.5, over={"args": (-1.0, 1.0)}, period=1)
    with pytest.raises(ValueError, match="border="):
        lh.bifurcation_curve(system, found.specials[0], {"a": 1.0, "b": 0.0}, over={"a": (0, 1), "b": (0, 1)}, period=1)


@pytest.mark.parametrize("start", [1.8, 1.9])
def test_the_border_of_a_cycle_is_one_point(start):
    """The 3-cycle of the tent map r min(x, 1 − x) has a point on the kink at the golden ratio; a step comes over it."""
    tent = lh.Map(lambda n, x, r: r * jnp.where(x < 0.5, x, 1 - x))
    orbit = [start / (1 + start**3)]  # two points are below 1/2, one above
    found = lh.continuation(tent, orbit, start, over={"args": (1.55, 2.0)}, period=3)
    (special,) = found.specials
    assert special.kind == "border collision"
    assert abs(special.parameter - (1 + 5**0.5) / 2) < 1e-8
