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
