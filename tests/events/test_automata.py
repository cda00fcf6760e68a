"""400 random hybrid automata whose motion is known to 84 digits: nothing may be missed."""

import numpy as np
import pytest

import automata as shapes
import lyaphybrid as lh

SHAPES = tuple(shapes.SIZES)


def missed(found) -> int:
    text, number = shapes.table(found)
    print(text)
    return number


def test_the_reference_is_complete(automata):
    sizes = {shape: len(shapes.members(automata, shape)) for shape in automata["groups"]}
    assert sizes == shapes.SIZES
    families = {f: sum(s["family"] == f for s in automata["systems"]) for f in shapes.FAMILIES}
    assert families == {"gen": 202} | dict.fromkeys("abcdefghi", 22)


@pytest.mark.slow
def test_every_event_in_order_and_the_tangent_map(automata):
    assert missed(shapes.run(automata, shapes.members(automata, "3_1_1"))) == 0


@pytest.mark.slow
@pytest.mark.parametrize("shape", [s for s in SHAPES if s != "3_1_1"])
def test_every_event_in_order_and_the_tangent_map_in_other_shapes(automata, shape):
    assert missed(shapes.run(automata, shapes.members(automata, shape))) == 0


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["2_1_1", "4_2_2"])  # the long ones; simultaneous events and cascades
def test_all_lanes_at_once(automata, shape):
    assert missed(shapes.run(automata, shapes.members(automata, shape), batch="vmap")) == 0


@pytest.mark.slow
def test_exponents_of_cycles_and_lost_directions(automata):
    assert missed(shapes.exponents(automata, shapes.members(automata, "3_1_1", ("h", "i")))) == 0


@pytest.mark.slow
@pytest.mark.parametrize("shape", [s for s in SHAPES if s != "3_1_1"])
def test_exponents_of_cycles_and_lost_directions_in_other_shapes(automata, shape):
    systems = shapes.members(automata, shape, ("h", "i"))
    if systems:
        assert missed(shapes.exponents(automata, systems)) == 0


# The comparison itself can fail.


def test_a_miss_is_counted_once_and_named():
    rows = [
        {"id": "P1", "family": "c", "order": True, "times": 0.5, "states": 0.1, "matrices": 0.2},
        {"id": "P2", "family": "c", "order": False, "times": np.nan, "states": np.nan, "matrices": 7.0},
        {"id": "P3", "family": "h", "order": True, "times": 0.5, "states": 1.5, "matrices": 0.2},
        {"id": "P3", "family": "h", "lost": True, "exponents": 3.0},
        {"id": "P4", "family": "i", "order": True, "times": 0.0, "states": 0.0, "matrices": 0.0},
        {"id": "P4", "family": "i", "lost": False, "exponents": np.nan},
    ]
    text, missed = shapes.table(rows)
    assert missed == 3
    assert "missed: 3 of 4" in text
    assert "P2 missed by order" in text
    assert "P3 missed by accuracy" in text
    assert "P4 missed by order, or by lost directions" in text
    assert "P1" not in text


@pytest.mark.slow
def test_long_fixed_steps_miss_events_and_short_ones_do_not(automata, tmp_path):
    systems = shapes.members(automata, "2_1_1", ("c", "gen", "h"))
    rates = shapes.draw(automata, tmp_path / "misses.png", tableaus=("rk4",), steps=(1e-3, 1.0), systems=systems)
    assert (tmp_path / "misses.png").stat().st_size > 10_000
    assert rates["rk4"]["c"][0] == rates["rk4"]["gen"][0] == 0
    assert rates["rk4"]["c"][1] > 0.5


@pytest.mark.slow
def test_a_coarse_tolerance_is_seen(automata):
    """Of the same systems the default settings miss none."""
    systems = shapes.members(automata, "3_1_1")
    found = shapes.run(automata, systems, method=lh.RungeKutta("dopri5", rtol=1e-4, atol=1e-6))
    assert shapes.table(found)[1] > len(systems) // 4
