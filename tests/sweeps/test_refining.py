"""Refined sweeps: borders as sharp as those of a fine grid, from few points."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from numpy.testing import assert_allclose

import lyaphybrid as lh
from examples import LOGISTIC
from lyaphybrid.sweeps import refining, sweeping

AXES = {"x": np.linspace(-1.0, 1.0, 9), "y": np.geomspace(0.5, 4.0, 7)}
START = {"x": 0.0, "y": 1.0}


def lens(args):
    """A round border, and a corner that it does not reach."""
    x, y = args["x"], args["y"]
    return {"inside": (x - 0.2) ** 2 + (y - 1.7) ** 2 < 0.55, "far": (x > 0.93) & (y > 3.8)}


def classes(dataset):
    return dataset.inside.values + 2 * dataset.far.values


def refined(**keywords):
    grid = lh.sweep(lens, AXES, args=START, progress=False)
    return lh.refine(grid, lens, args=START, **{"classify": classes, "progress": False, "levels": 3} | keywords)


def test_the_border_is_that_of_the_fine_grid():
    found = refined()
    fine = {
        name: np.interp(np.arange(8 * len(axis) - 7) / 8, np.arange(len(axis)), axis) for name, axis in AXES.items()
    }
    whole = lh.sweep(lens, fine, args=START, progress=False)
    there = {(x, y): inside for x, y, inside in zip(found.x.values, found.y.values, found.inside.values, strict=True)}
    for (i, j), inside in np.ndenumerate(whole.inside.values):
        here = whole.inside.values[max(0, i - 1) : i + 2, max(0, j - 1) : j + 2]
        place = (fine["x"][i], fine["y"][j])
        if here.any() and not here.all() and 0 < i < 64 and 0 < j < 48:  # next to the border
            assert any(
                (fine["x"][a], fine["y"][b]) in there
                for a in range(max(0, i - 1), min(65, i + 2))
                for b in range(max(0, j - 1), min(49, j + 2))
            )
        if place in there:
            assert there[place] == inside
    assert found.attrs["points_of_grid"] == whole.inside.size == 65 * 49
    assert found.point.size < 0.35 * whole.inside.size
    assert len(there) == found.point.size  # none twice
    assert found.level.values.min() == 0
    assert found.level.values.max() == 3


def test_what_is_far_from_a_border_stays_coarse():
    found = refined()
    lonely = found.where((found.x < -0.8) & (found.level > 0), drop=True)
    assert lonely.point.size == 0


@pytest.mark.slow
def test_a_border_in_one_parameter_is_halved_each_time():
    def run(r):
        return lh.lyapunov_spectrum(LOGISTIC, jnp.array([0.3]), r, t1=4000, transient=1000, blocks=16)

    grid = lh.sweep(run, {"args": np.linspace(3.5, 4.25, 4)}, args=3.0, progress=False)  # at 4 the motion escapes
    found = lh.refine(grid, run, args=3.0, levels=6, progress=False)
    failed = found.status.values == int(lh.STATUS.nonfinite)
    r = found.args.values
    assert 4.0 < r[failed].min() <= r[r <= 4.0].max() + 0.25 / 64
    assert np.all(np.isnan(found.exponents.values[failed]))
    assert_allclose(found.exponents.sel(point=r == 4.0).values[0, 0], np.log(2), atol=0.02)


def test_it_is_compiled_once_more(monkeypatch):
    made = []
    real = sweeping.LaneProgram
    monkeypatch.setattr(sweeping, "LaneProgram", lambda *given: made.append(1) or real(*given))
    refined()
    assert len(made) == 2  # once for the grid, once for all that is added


def test_it_is_taken_up_from_its_stores(tmp_path, monkeypatch):
    first = refined(store=tmp_path / "steps")
    assert len(list((tmp_path / "steps").glob("*.zarr"))) >= 3
    computed = []
    real = sweeping.run_sequences
    monkeypatch.setattr(sweeping, "run_sequences", lambda *given, **named: computed.append(1) or real(*given, **named))
    again = refined(store=tmp_path / "steps")
    assert len(computed) == 1  # for the grid
    assert again.equals(first)


@pytest.mark.slow
def test_classes_of_spectra():
    def run(args):
        return lh.lyapunov_spectrum(LOGISTIC, jnp.array([0.3]), args, t1=4000, transient=1000, blocks=16)

    found = lh.sweep(run, points={"args": np.array([3.2, 3.9, 4.2, 3.4])}, args=3.0, progress=False)
    assert refining.chaotic(found).tolist() == [-1, -2, int(lh.STATUS.nonfinite), -1]


GRID = {"x": np.array([0.0, 1.0]), "y": np.array([1.0, 2.0])}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"levels": 0}, "levels must be an integer of at least 1"),
        ({"run": lambda args: {"inside": args["x"] > 0, "far": args["y"] > 0}}, "another run"),
        ({"args": {"x": 0.0, "y": 1.0, "z": 2.0}}, "another run"),
        ({"classify": lambda dataset: 1}, "one class for each of 4 points"),
        ({"over": {"x": np.array([0.0])}}, "two or more along each axis"),
        ({"points": {"x": np.array([0.0, 1.0])}}, "this one has a list of points"),
        ({"attrs": {}}, "lost its attribute 'dims'"),
        ({"classify": 3}, "classify must be a function"),
        ({"dataset": [1.0]}, "dataset must be one that lh.sweep returned; got a list"),
    ],
)
def test_bad_arguments(change, says):
    how = {"over": change.get("over", GRID)} if "points" not in change else {"points": change["points"]}
    grid = lh.sweep(lens, args=START, progress=False, **how)
    grid.attrs = change.get("attrs", grid.attrs)
    keywords = {"levels": change.get("levels", 1), "classify": change.get("classify", classes)}
    keywords["args"] = change.get("args", START)
    with pytest.raises(ValueError, match=says):
        lh.refine(change.get("dataset", grid), change.get("run", lens), progress=False, **keywords)


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("level", [2.5, 3.0, 3.7], "a variable of the name level"),
        ("point", [2.5, 3.0, 3.7], 'is called "point"'),
        ("r", [2, 3, 4], "between the values of r, which are integers"),
    ],
)
def test_names_that_are_taken_and_whole_numbers(name, values, says):
    """Before, the values of a parameter of the name level were replaced without a word."""
    logistic = lh.Map(lambda n, x, args: args[name] * x * (1 - x))

    def run(args):
        return lh.lyapunov_spectrum(logistic, [0.3], args, t1=100)

    grid = lh.sweep(run, {name: np.array(values)}, args={name: 3.0}, progress=False)
    with pytest.raises(ValueError, match=says):
        lh.refine(grid, run, args={name: 3.0}, progress=False)


def test_a_sweep_is_written_to_a_file_and_refined_from_it(tmp_path):
    """With SciPy's writer, which takes no attribute that is a list of words."""
    grid = lh.sweep(lens, AXES, args=START, progress=False)
    grid.to_netcdf(tmp_path / "grid.nc", engine="scipy")
    with xarray.open_dataset(tmp_path / "grid.nc", engine="scipy") as read:
        again = lh.refine(read.load(), lens, args=START, classify=classes, progress=False, levels=1)
    xarray.testing.assert_equal(again, refined(levels=1))
