"""Bifurcation diagrams by a section: continued, and of systems that jump too, a clock in closed form among them."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

ZETA = 0.1
OMEGA = np.sqrt(1 - ZETA**2)
LEFT = np.exp(-2 * np.pi * ZETA / OMEGA)  # what is left of the speed after a turn
TOP = np.exp(-ZETA * np.arctan2(OMEGA, ZETA) / OMEGA)  # the first maximum, per speed after the kick

# A pendulum clock: x'' + 2ζx' + x = 0, and a kick where x rises through zero. Between them a jump that only changes
# the mode and one that changes nothing.
CLOCK = lh.Hybrid(
    dict.fromkeys(("up", "down"), lambda t, x, args: jnp.stack([x[1], -x[0] - 2 * ZETA * x[1]])),
    [
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: x + jnp.stack([0.0, args["kick"]]), direction=1),
        lh.Transition(lambda t, x, args: x[0] - 0.1, source="up", target="down"),
        lh.Transition(lambda t, x, args: x[0] - 0.1, source="down", target="up", direction=1),
        lh.Transition(lambda t, x, args: x[1] - 0.2, direction=0),
    ],
)
KICKS = [0.5, 1.0, 2.0]
HOW = {"over": {"kick": KICKS}, "starts": 2, "t1": 40, "transient": 60, "samples": 8, "mode": "up"}


@pytest.mark.slow
def test_a_continuation_starts_on_the_section_and_goes_on():
    """Each run starts where the last one ended, on the section up to rounding: that crossing is at its very start."""
    van_der_pol = lh.Flow(lambda t, x, args: jnp.stack([x[1], args["mu"] * (1 - x[0] ** 2) * x[1] - x[0]]))
    options = {"section": lambda t, x, args: x[0], "transient": 20, "t1": 40, "samples": 16, "starts": 1}
    found = lh.bifurcation_diagram(
        van_der_pol, [[0.5, 0.5], [2.0, 2.0]], {"mu": 0.0}, over={"mu": [1.0, 1.0, 1.0]}, directions=("up",), **options
    )
    assert found.attractors() == ["P1w0:1"] * 3
    assert_allclose(found.time, 40 * 6.663286859, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("section", ["apart", "on the guard"])
def test_the_limit_cycle_of_a_clock(section):
    """The speed after the kick is p / (1 - q), q being what is left of it after a turn; the exponents are 0 and -ζ."""
    speed = np.array(KICKS) / (1 - LEFT)
    surface, exact = {
        "apart": (lambda t, x, args: x[1], np.stack([speed * TOP, 0 * speed], axis=-1)),
        "on the guard": (lambda t, x, args: -x[0], np.stack([0 * speed, speed * LEFT], axis=-1)),
    }[section]
    found = lh.bifurcation_diagram(CLOCK, [[0.2, 1.0], [0.3, 2.0]], {"kick": 0.0}, section=surface, **HOW)
    assert found.attractors() == ["P1w0:2"] * len(KICKS)
    assert_allclose(found.points, np.broadcast_to(exact[:, None, None], found.points.shape), rtol=0, atol=1e-9)
    assert_allclose(found.time, HOW["t1"] * 2 * np.pi / OMEGA, rtol=1e-10)
    assert_allclose(found.exponents, np.broadcast_to([0.0, -ZETA], found.exponents.shape), rtol=0, atol=1e-4)


def _roessler(t, x, args):
    return jnp.stack([-x[1] - x[2], x[0] + 0.2 * x[1], 0.2 + x[2] * (x[0] - args["c"])])


@pytest.mark.slow
def test_jumps_that_change_nothing_but_the_mode_change_no_diagram():
    """The Rössler system whole, and in two modes with a border between them."""
    sides = lh.Hybrid(
        dict.fromkeys(("left", "right"), _roessler),
        [
            lh.Transition(lambda t, x, args: x[0] + 1, source="right", target="left"),
            lh.Transition(lambda t, x, args: x[0] + 1, source="left", target="right", direction=1),
        ],
    )
    how = {"over": {"c": [2.5, 3.5, 4.0, 5.7]}, "section": lambda t, x, args: x[1], "t1": 300, "directions": ("up",)}
    how |= {"starts": np.array([[2.0, 1.0, 0.1]]), "transient": 400}
    whole, parts = (
        lh.bifurcation_diagram(system, [2.0, 1.0, 0.1], {"c": 0.0}, **how, **more)
        for system, more in ((lh.Flow(_roessler), {}), (sides, {"mode": "right"}))
    )
    assert whole.attractors() == parts.attractors()
    assert whole.attractors()[:3] == ["P1w0:1", "P2w0:1", "P4w0:1"]
    assert_allclose(parts.points[:3], whole.points[:3], rtol=0, atol=1e-6)
    assert_allclose(parts.exponents[:3], whole.exponents[:3], rtol=0, atol=1e-4)
    apart = np.abs(parts.exponents[3] - whole.exponents[3])
    assert np.all(apart < 5 * np.hypot(parts.stderr[3], whole.stderr[3]) + 1e-3)


@pytest.mark.slow
def test_a_motion_that_never_crosses_says_so():
    """It jumps again and again, but does not come to the section: the attempts end, not the run of the program."""
    found = lh.bifurcation_diagram(
        CLOCK, [[0.2, 1.0], [0.3, 2.0]], {"kick": 0.0}, section=lambda t, x, args: x[0] - 10.0, max_steps=500, **HOW
    )
    assert found.attractors() == ["max_steps:2"] * len(KICKS)
    assert np.all(np.isnan(found.points))


@pytest.mark.parametrize("system", [CLOCK, lh.Flow(lambda t, x, args: jnp.stack([x[1], args["kick"] - x[0] - x[1]]))])
def test_a_section_that_is_not_met_again_soon_ends_the_run(system):
    """Without max_steps it is given up after a number of steps, not after that for all crossings that are wanted."""
    how = HOW | {"mode": "up" if system is CLOCK else None, "over": {"kick": [0.5]}, "t1": 20_000}
    found = lh.bifurcation_diagram(
        system, [[0.2, 1.0], [0.3, 2.0]], {"kick": 0.0}, section=lambda t, x, args: x[0] - 10.0, **how
    )
    assert found.attractors() == ["no_more_jumps:2"]
    assert "counted: the 2 random starts, not those that follow up and down" in str(found)


def test_a_threshold_that_moves_over_a_state_makes_no_hysteresis():
    """V' = I − V and a spike to 0 at V = θ < I: a state above a lower θ would rise to I and never fire again."""
    neuron = lh.Hybrid(
        lambda t, v, args: args["I"] - v,
        lh.Transition(lambda t, v, args: args["theta"] - v[0], lambda t, v, args: 0 * v),
    )
    thresholds = [0.5, 0.7, 0.9, 1.1]
    found = lh.bifurcation_diagram(
        neuron,
        [0.0],
        {"I": 1.5, "theta": 0.5},
        over={"theta": thresholds},
        period=0.3,
        directions=("up", "down"),
        t1=64,
    )
    assert np.all(found.points[..., 0] <= np.reshape(thresholds, (4, 1, 1)))
    from_random = lh.lyapunov_spectrum(neuron, [0.0], {"I": 1.5, "theta": 0.5}, t1=64 * 0.3, transient=60.0)
    assert_allclose(found.exponents[0, 1], from_random.exponents, atol=0.05)  # nearly 0, and −1 without spikes


@pytest.mark.parametrize(("direction", "sign"), [(-1, 1.0), (1, -1.0), (0, 1.0)])
def test_only_a_surface_that_moves_over_a_state_begins_anew(direction, sign):
    """Two modes, x' = 1 − x and x' = 3 − x; the first ends where x rises to θ, whatever the sign of the guard."""
    relay = lh.Hybrid(
        {"low": lambda t, x, args: 1.0 - x, "high": lambda t, x, args: 3.0 - x},
        [
            lh.Transition(
                lambda t, x, args: sign * (args["theta"] - x[0]), source="low", target="high", direction=direction
            ),
            lh.Transition(lambda t, x, args: x[0] - 0.5, source="high", target="low"),
        ],
    )
    how = {"period": 1.0, "directions": ("down",), "transient": 40, "t1": 16, "samples": 4, "mode": "low"}
    found = lh.bifurcation_diagram(relay, [0.0], {"theta": 2.0}, over={"theta": [0.8, 0.9, 1.5, 2.0]}, **how)
    # With θ > 1 "low" rests at 1; θ = 0.9 passes that, and from x = 0 it now switches to "high", which rests at 3.
    assert_allclose(found.points[:, 0, -1, 0], [3.0, 3.0, 1.0, 1.0], atol=1e-6)


def test_a_condition_for_each_component_of_a_guard():
    """Of two neurons the second one never fires, so that its threshold may move over it."""
    spike = lh.Transition(
        lambda t, v, args: args["theta"] - v,
        lambda t, v, args, which: v.at[which].set(0.0),
        when=lambda t, v, args: jnp.array([True, False]),
    )
    pair = lh.Hybrid(lambda t, v, args: 1.5 - v, spike)
    how = {"over": {"theta": [0.7, 0.9]}, "period": 0.3, "directions": ("down",), "t1": 64, "transient": 100}
    found = lh.bifurcation_diagram(pair, [0.0, 0.0], {"theta": 0.7}, **how)
    assert np.all(found.points[:, 0, :, 0] <= np.reshape([0.7, 0.9], (2, 1)))
    assert_allclose(found.points[:, 0, -1, 1], 1.5, atol=1e-6)
