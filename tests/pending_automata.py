"""The 400 random automata against 84-digit truth: order, times, states, tangent maps, exponents, lost directions."""

import pytest

import automata
from references import load_automata


def missed(shape: str, families=automata.FAMILIES, batch: str = "map") -> str:
    """The table of one shape if anything was missed, else nothing."""
    data = load_automata()
    found = automata.run(data, automata.members(data, shape, families), batch=batch)
    cyclic = automata.members(data, shape, tuple(f for f in ("h", "i") if f in families))
    found += automata.exponents(data, cyclic) if cyclic else []
    text, count = automata.table(found)
    return text if count else ""


def test_planar_automata_with_one_mode_are_all_right():
    """Starts on a guard, roots 1e-9 apart, dips, grazing, clocks, cycles, rank loss."""
    assert missed("2_1_1", ("a", "b", "c", "d", "f", "h", "i")) == ""


@pytest.mark.slow
@pytest.mark.parametrize("shape", sorted(load_automata()["groups"]))
def test_automata_of_every_shape_are_all_right(shape):
    """One compiled function per shape."""
    assert missed(shape) == ""


@pytest.mark.slow
def test_lanes_together_are_as_right_as_lanes_alone():
    """The same under vmap, where every lane computes every case."""
    assert missed("2_1_2", batch="vmap") == ""
