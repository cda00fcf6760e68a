"""Basins, and shares along a parameter, that are cut off and go on: what a run that never stopped gives."""

import importlib
import shutil
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import lyaphybrid as lh
from lyaphybrid.analysis.basins import sampling
from lyaphybrid.engine.host import checkpoints

TILTED = lh.Flow(lambda t, x, args: x - x**3 + args["tilt"])
SLOW = lh.Flow(lambda t, x, args: args["rate"] * (x - x**3))  # motions arrive late, some after a longer run
VALUES = [-0.2, 0.0, 0.2, 0.45]
BOX = [[-1.5], [1.5]]


def shares(values=VALUES, **more: Any):
    how: dict[str, Any] = {"t1": 60.0, "starts": 60, "key": jax.random.key(3)} | more
    return lh.basin_shares(TILTED, BOX, {"tilt": 0.0}, over={"tilt": values}, **how)


def slow_basins(**more):
    return lh.basins(SLOW, [[-1.5], [1.4]], {"rate": 0.1}, shape=(50,), t1=30.0, **more)


RUNS = {"shares": shares, "basins": slow_basins}


@pytest.fixture
def small_steps(monkeypatch):
    """Steps of few starts, each of which is written."""
    module = importlib.import_module("lyaphybrid.analysis.basins.basins")  # a function of the package has its name
    monkeypatch.setattr(module, "STARTS_OF_STEP", 16)
    monkeypatch.setattr(checkpoints, "SECONDS_BETWEEN_WRITES", 0.0)


def same(one, other):
    """All arrays, bit by bit, and all names."""
    assert one.names == other.names
    a, b = jax.tree.leaves(one), jax.tree.leaves(other)
    assert len(a) == len(b)
    for here, there in zip(a, b, strict=True):
        assert_array_equal(here, there)


class Calls:
    """Runs of starts, counted; Ctrl-C falls into one of them, or the checkpoint is copied before it."""

    def __init__(self, monkeypatch, stop=None, copied=None):
        self.run, self.count, self.stop, self.copied = sampling.map_lanes, 0, stop, copied
        monkeypatch.setattr(sampling, "map_lanes", self)

    def __call__(self, *given, **how):
        self.count += 1
        if self.copied and self.count == self.copied[0]:
            shutil.copy(*self.copied[1:])
        results, done = self.run(*given, **how)
        return results, done & (self.count != self.stop)


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_after_ctrl_c_anywhere_it_goes_on(name, tmp_path, small_steps, monkeypatch):
    """Each try gets one run of starts further, and does not begin another one after Ctrl-C."""
    whole, path = RUNS[name](), tmp_path / "kept.npz"
    with monkeypatch.context() as patch:
        needed = Calls(patch)
        same(RUNS[name](checkpoint=tmp_path / "other.npz"), whole)
    found, tries = None, 0
    while tries < 1 or calls.count == 2:
        tries += 1
        with monkeypatch.context() as patch:
            calls = Calls(patch, stop=2)
            try:
                found = RUNS[name](checkpoint=path, resume=True)
            except (KeyboardInterrupt, UserWarning):  # nothing to return; some values: warnings are errors in tests
                found = None
        if name == "basins":
            assert ("interrupted" in found.names) == (calls.count == 2)
    assert (calls.count, tries) == (1, needed.count)
    same(found, whole)
    with monkeypatch.context() as patch:
        none = Calls(patch)
        same(RUNS[name](checkpoint=path, resume=True), whole)
    assert none.count == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_from_the_file_that_a_killed_process_leaves(name, tmp_path, small_steps, monkeypatch):
    path, left = tmp_path / "kept.npz", tmp_path / "left.npz"
    with monkeypatch.context() as patch:
        calls = Calls(patch, copied=(5, path, left))
        whole = RUNS[name](checkpoint=path)
    with monkeypatch.context() as patch:
        rest = Calls(patch)
        same(RUNS[name](checkpoint=left, resume=True), whole)
    assert rest.count == calls.count - 4


@pytest.mark.slow
def test_further_values_are_added(tmp_path):
    path = tmp_path / "kept.npz"
    shares(VALUES[:2], checkpoint=path)
    same(shares(checkpoint=path, resume=True), shares())
    same(shares(VALUES[:3], checkpoint=path, resume=True), shares(VALUES[:3]))  # of more that are known
    with pytest.raises(ValueError, match=r"number 1 of tilt is 0 there, and 0.1 here"):
        shares([-0.2, 0.1], checkpoint=path, resume=True)


@pytest.mark.slow
def test_that_of_another_run_is_refused(tmp_path):
    path = tmp_path / "kept.npz"
    shares(VALUES[:1], checkpoint=path)
    with pytest.raises(ValueError, match="resume=True goes on with it"):
        shares(VALUES[:1], checkpoint=path)
    changes: list[tuple[dict[str, Any], str]] = [
        ({"values": [0.1]}, "another system, args or method"),
        ({"t1": 61.0}, "another t1, period or max_steps"),
        ({"key": jax.random.key(4)}, "another box, shape, starts or key"),
        ({"method": lh.RungeKutta(rtol=1e-6)}, "another system, args or method"),
    ]
    for change, words in changes:
        with pytest.raises(ValueError, match=words):
            shares(**{"values": VALUES[:1], "checkpoint": path, "resume": True} | change)
    with pytest.raises(ValueError, match="resume must be True or False"):
        shares(checkpoint=path, resume=3)


@pytest.mark.slow
def test_attractors_in_several_modes_are_kept(tmp_path, small_steps):
    """A thermostat: two modes, cycles whose points are in both."""
    heater = lh.Hybrid(
        {"on": lambda t, x, a: a["power"] - x, "off": lambda t, x, a: -x},
        [
            lh.Transition(lambda t, x, a: 1.2 - x[0], source="on", target="off"),
            lh.Transition(lambda t, x, a: x[0] - 0.8, source="off", target="on"),
        ],
    )
    how = {"over": {"power": [2.0, 3.0]}, "t1": 20.0, "starts": 20, "key": jax.random.key(0), "mode": "on"}
    path = tmp_path / "kept.npz"
    whole = lh.basin_shares(heater, [[0.9], [1.1]], {"power": 2.0}, **how)
    assert len({int(mode) for one in whole.basins[0].attractors for mode in one.modes}) == 2
    same(lh.basin_shares(heater, [[0.9], [1.1]], {"power": 2.0}, checkpoint=path, **how), whole)
    same(lh.basin_shares(heater, [[0.9], [1.1]], {"power": 2.0}, checkpoint=path, resume=True, **how), whole)
    assert jnp.all(jnp.asarray(whole.basins[0].starts) > 0.9)
    assert np.all(np.isfinite(whole.shares))
