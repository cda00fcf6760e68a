"""Sweeps: the same as single runs, point by point, however they are cut, kept and taken up again."""

import json
import os
import shutil
import threading
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
import zarr
from numpy.testing import assert_allclose

import lyaphybrid as lh
from examples import BALL_LANES, LOGISTIC, ball_args, ball_lane
from lyaphybrid.engine.host import lanes
from lyaphybrid.sweeps import sweeping
from lyaphybrid.sweeps.plans import plan


def logistic(r, x0=(0.3,)):
    return lh.lyapunov_spectrum(LOGISTIC, jnp.asarray(x0), r, t1=64, transient=10, blocks=8)


DECAY = lh.Flow(lambda t, x, args: -x)
RATES = np.linspace(3.0, 4.2, 25)  # beyond 4 the motion escapes


def swept(**keywords):
    return lh.sweep(logistic, {"args": RATES}, args=3.0, **{"chunk": 4, "progress": False} | keywords)


@pytest.fixture(scope="module")
def whole():
    return swept()


# --- points --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_point_is_a_single_run(whole):
    for r, point in zip(RATES, whole.transpose("args", ...).exponents.values, strict=True):
        alone = lh.lyapunov_spectrum(LOGISTIC, [0.3], r, t1=64, transient=10, blocks=8, throw=False)
        assert int(whole.status.sel(args=r)) == int(alone.status)
        if alone.status is lh.STATUS.ok:
            assert_allclose(point, alone.exponents, atol=1e-10)
            assert_allclose(whole.stderr.sel(args=r), alone.stderr, atol=1e-10)
        else:
            assert np.isnan(point)
    assert set(np.unique(whole.status)) == {int(lh.STATUS.ok), int(lh.STATUS.nonfinite)}


@pytest.mark.slow
def test_points_that_fail_in_every_way_leave_their_neighbours_alone():
    cases = [ball_args(**changes) for changes, *_ in BALL_LANES]
    points = {name: np.array([float(case[name]) for case in cases]) for name in cases[0]}
    found = lh.sweep(ball_lane, points=points, args=ball_args(), progress=False)
    assert found.status.dims == ("point",)
    for i, (changes, status, jumps) in enumerate(BALL_LANES):
        alone = ball_lane(ball_args(**changes))
        assert int(found.status[i]) == int(status) == int(alone.status)
        if status.failed:
            assert np.all(np.isnan(found.exponents[i]))
        else:
            assert_allclose(found.exponents[i], alone.exponents, atol=1e-10)
            assert jumps == found.jumps[i]


def test_grids_are_products_in_the_order_given():
    def area(args, x0):
        return {"area": args["sides"][0] * args["sides"][1] + args["deep"]["z"] * x0[0], "start": x0}

    args = {"sides": np.array([2.0, 3.0]), "deep": {"z": 0.0}}
    starts = np.array([[1.0, 0.0], [2.0, 5.0]])
    over = {"sides[1]": np.array([1.0, 2.0, 3.0]), "x0": starts}
    found = lh.sweep(area, over, points={"deep.z": np.array([0.0, 10.0])}, args=args, progress=False, chunk=5)
    assert found.area.dims == ("sides[1]", "x0", "point")
    by_hand = 2 * over["sides[1]"][:, None, None] + starts[None, :, None, 0] * np.array([0.0, 10.0])
    assert_allclose(found.area, by_hand)
    assert_allclose(found["sides[1]"], over["sides[1]"])
    assert_allclose(found["deep.z"], [0.0, 10.0])
    assert_allclose(found["x0_value"], starts)


def test_a_vector_is_an_axis_with_numbers():
    vectors = np.arange(6.0).reshape(3, 2)
    found = lh.sweep(lambda args: jnp.sum(args["a"]), {"a": vectors}, args={"a": np.zeros(2)}, progress=False)
    assert_allclose(found["value"], vectors.sum(axis=1))
    assert_allclose(found["a_value"], vectors)


def test_keys():
    keys = jax.random.split(jax.random.key(0), 5)
    found = lh.sweep(lambda args, key: args * jax.random.normal(key), {"key": keys}, args=2.0, progress=False)
    assert_allclose(found["value"], 2 * jax.vmap(jax.random.normal)(keys))
    assert found.sizes == {"key": 5, "key_0": 2}


@pytest.mark.slow
def test_a_problem_of_the_zoo_by_its_args():
    problem = lh.zoo.henon_map()
    found = lh.sweep(problem, {"a": np.array([1.0, 1.2, 1.4])}, progress=False)
    for a in (1.0, 1.4):
        alone = lh.zoo.henon_map(a=a).spectrum()
        assert_allclose(found.exponents.sel(a=a), alone.exponents, atol=1e-10)
    assert found.attrs["run"] == "henon_map"


def test_numbers_keep_their_kind():
    found = lh.sweep(lambda args: args["n"] + 1, {"n": np.arange(4)}, args={"n": 0}, progress=False)
    assert found["value"].dtype.kind == "i"


@pytest.mark.parametrize(
    ("keywords", "says"),
    [
        ({}, "Nothing to sweep"),
        ({"over": {"rho": [1.0]}}, r"'rho' is no entry of args: args has a, b\[0\]|no entry of args"),
        ({"over": {"a": []}}, "at least one value"),
        ({"over": {"a": 3.0}}, "at least one value"),
        ({"over": {"a": ["x"]}}, "array of numbers"),
        ({"over": {"a": [np.nan]}}, "must be finite"),
        ({"over": {"b": [1.0, 2.0]}}, r"b has the shape \(2,\)"),
        ({"over": {"a": [1.0]}, "points": {"a": [1.0]}}, "are in over and in points"),
        ({"points": {"a": [1.0], "b[0]": [1.0, 2.0]}}, "one length"),
        ({"over": {"a": [1.0]}, "chunk": 0}, "chunk must be an integer of at least 1"),
        ({"over": {3: [1.0]}}, "are strings"),
        ({"over": np.array([1.0, 2.0])}, "over must be a dict"),
        ({"points": 0.5}, "points must be a dict"),
        ({"over": {"a": [1.0]}, "args": {"a": 10**400}}, "args holds .* an integer that does not fit"),
        ({"over": {"a": [1.0]}, "run": 5}, "run must be a function"),
    ],
)
def test_bad_arguments(keywords, says):
    args = {"a": 1.0, "b": np.zeros(2)}
    with pytest.raises(ValueError, match=says):
        lh.sweep(**{"run": lambda args: args["a"], "args": args, "progress": False} | keywords)


# --- how it is computed --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_chunks_change_nothing(whole):
    for chunk in (1, 7, 1000, None):
        assert swept(chunk=chunk).equals(whole)


def test_it_is_compiled_once(monkeypatch):
    made = []
    monkeypatch.setattr(sweeping, "LaneProgram", lambda *given, make=lanes.LaneProgram: made.append(1) or make(*given))
    traces = []

    def run(args):
        traces.append(1)
        return args**2

    lh.sweep(run, {"args": np.arange(100.0)}, args=0.0, chunk=3, progress=False)
    assert len(made) == 1
    assert len(traces) <= 4  # for shapes, for the hash, and for the program


@pytest.mark.slow
def test_plain_vmap_stays_right(whole):
    good = RATES[RATES <= 4]
    assert_allclose(jax.vmap(logistic)(good).exponents, whole.exponents.sel(args=good), atol=1e-10)


@pytest.mark.slow
def test_progress_is_told():
    seen = []
    swept(progress=seen.append)
    assert seen[-1] == 1.0
    assert seen == sorted(seen)


@pytest.mark.slow
def test_attributes(whole):
    assert whole.attrs["lyaphybrid"] == lh.__version__
    assert whole.attrs["seconds"] > 0
    assert "3: zeno" in whole.attrs["statuses"]
    assert json.loads(whole.attrs["dims"]) == ["args"]
    assert whole.attrs["system"] == "Map"
    assert whole.attrs["method"] == ""
    assert whole.exponent.values.tolist() == [1]


@pytest.mark.slow
def test_attributes_come_from_the_spectra_among_what_is_returned():
    found = lh.sweep(lambda r: {"of": logistic(r), "r": r}, {"args": RATES[:2]}, args=3.0, progress=False)
    assert found.attrs["system"] == "Map"
    assert (
        lh.sweep(lambda r: logistic(r).exponents, {"args": RATES[:2]}, args=3.0, progress=False).attrs["system"] == ""
    )


def test_what_was_run_decides_nothing_about_compiling():
    loose, tight = (lh.lyapunov_spectrum(DECAY, [1.0], t1=1.0, method=lh.RungeKutta(rtol=tol)) for tol in (1e-6, 1e-9))
    assert loose.about.system == "Flow"
    assert "1e-06" in loose.about.method
    assert "1e-09" in tight.about.method
    assert jax.tree.structure(loose) == jax.tree.structure(tight)


@pytest.mark.slow
def test_attributes_of_a_problem():
    problem = lh.zoo.friction_pendulum()

    def short(args):
        return problem.spectrum(args=args, t1=1.0, transient=0.0)

    found = lh.sweep(short, {"beta": np.array([0.1])}, args=problem.args, progress=False)
    assert found.attrs["system"] == "Hybrid with the modes plus, minus, sliding"
    assert found.attrs["method"].startswith("RungeKutta(")


# --- stores --------------------------------------------------------------------------------------------------------


@pytest.fixture
def counted(monkeypatch):
    """How many points are computed."""
    computed = []

    def run_sequences(function, shared, chains, **keywords):
        computed.extend(len(rows["args"]) for _, rows in chains)
        return lanes.run_sequences(function, shared, chains, **keywords)

    monkeypatch.setattr(sweeping, "run_sequences", run_sequences)
    return computed


@pytest.mark.slow
def test_a_store_holds_all_and_is_taken_up(whole, tmp_path, counted):
    store = tmp_path / "deep" / "sweep.zarr"
    assert swept(store=store).equals(whole)
    assert sum(counted) == 25
    assert swept(store=store).equals(whole)
    assert sum(counted) == 25
    assert swept(store=str(store), chunk=9).equals(whole)  # it keeps the chunks it was made with
    assert sum(counted) == 25


@pytest.mark.slow
@pytest.mark.parametrize("harm", ["truncate", "flip", "delete", "forget"])
def test_a_chunk_that_is_not_sound_is_computed_again(harm, whole, tmp_path, counted):
    store = tmp_path / "sweep.zarr"
    swept(store=store)
    (file,) = store.glob("exponents/c/2/0") if harm != "forget" else store.glob("digest/c/2")
    content = file.read_bytes()
    if harm == "truncate":
        file.write_bytes(content[: len(content) // 2])
    elif harm == "flip":
        file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    else:
        file.unlink()
    counted.clear()
    assert swept(store=store).equals(whole)
    assert counted == [4]
    assert swept(store=store).equals(whole)
    assert counted == [4]


COMPRESSED = [
    {"name": "bytes", "configuration": {"endian": "little"}},
    {"name": "gzip", "configuration": {"level": 5}},
]


@pytest.mark.slow_cases("exponents-change0", "exponents-change1")
@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("exponents", {"shape": [10**12, 1]}),
        ("exponents", {"data_type": "complex128"}),
        ("status", {"chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [10**9]}}}),
        ("exponents", {"codecs": COMPRESSED}),
        ("", {"attributes": {"chunk": 0}}),
        ("", {"attributes": {"chunk": "many"}}),
    ],
)
def test_a_store_whose_arrays_are_others_is_refused(name, change, tmp_path):
    """Before anything of them is read: they could be of any size."""
    store = tmp_path / "sweep.zarr"
    swept(store=store)
    file = store / name / "zarr.json"
    about = json.loads(file.read_text())
    for key, value in change.items():
        about[key] = about[key] | value if key == "attributes" else value
    file.write_text(json.dumps(about))
    with pytest.raises(ValueError, match=r"sweep\.zarr is damaged: its arrays are not those of this sweep"):
        swept(store=store)


def test_a_store_is_a_dataset_by_itself(whole, tmp_path):
    store = tmp_path / "sweep.zarr"
    swept(store=store)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of metadata that are not gathered
        found = xarray.open_zarr(store)
    assert_allclose(found.args, RATES)
    assert "args" in found.coords
    assert_allclose(found.exponents, whole.exponents)
    assert found.attrs["statuses"] == whole.attrs["statuses"]


@pytest.mark.slow
def test_another_sweep_is_refused(tmp_path):
    store = tmp_path / "sweep.zarr"
    swept(store=store)
    with pytest.raises(ValueError, match="holds another sweep: its problem is"):
        lh.sweep(logistic, {"args": RATES + 1e-3}, args=3.0, store=store, progress=False)
    with pytest.raises(ValueError, match="holds another sweep"):
        lh.sweep(lambda r: logistic(r, (0.4,)), {"args": RATES}, args=3.0, store=store, progress=False)
    (tmp_path / "other").mkdir()
    with pytest.raises(ValueError, match="is there, and no store of a sweep"):
        swept(store=tmp_path / "other")


def test_a_second_process_is_refused(tmp_path):
    store = tmp_path / "sweep.zarr"
    go, there = threading.Event(), threading.Event()

    def slow(fraction):
        there.set()
        go.wait(30)

    first = threading.Thread(target=lambda: swept(store=store, progress=slow))
    first.start()
    there.wait(30)
    with pytest.raises(ValueError, match="in use by another process"):
        swept(store=store)
    go.set()
    first.join()


def test_where_nothing_can_be_written_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(lh.StoreFailedError, match="cannot be written"):
        swept(store=tmp_path / "file" / "sweep.zarr")


def test_a_store_that_fails_on_the_way_keeps_what_is_computed(whole, tmp_path, monkeypatch):
    store, written = tmp_path / "sweep.zarr", []
    put = zarr.storage.LocalStore.set

    async def full(self, key, value):
        if key.startswith("digest"):
            written.append(key)
        if len(written) > 6:
            raise OSError(28, "No space left on device")
        await put(self, key, value)

    monkeypatch.setattr(zarr.storage.LocalStore, "set", full)
    with pytest.raises(lh.StoreFailedError, match=f"{store}.*No space left") as failed:
        swept(store=store)
    monkeypatch.undo()
    partial = failed.value.dataset
    known = ~np.isnan(partial.time.values)
    assert 4 <= np.sum(known) < 25
    assert partial.isel(args=known).equals(whole.isel(args=known))
    assert swept(store=store).equals(whole)


@pytest.mark.slow
def test_what_is_interrupted_is_kept(tmp_path, counted):
    def slow(r):
        return jax.lax.fori_loop(0, 10_000_000, lambda _, x: r * x * (1 - x), 0.3)

    first = iter([True])

    def stop(fraction):
        if next(first, False):
            raise KeyboardInterrupt

    def of(progress):
        over = {"args": np.linspace(3.0, 4.0, 40)}
        return lh.sweep(slow, over, args=3.0, chunk=1, store=tmp_path / "sweep.zarr", progress=progress)

    with pytest.warns(UserWarning, match="points were not computed|interrupted"):
        partial = of(stop)
    known = ~np.isnan(partial["value"].values)
    assert 0 < np.sum(known) < 40
    counted.clear()
    complete = of(False)
    assert sum(counted) == 40 - np.sum(known)
    assert not np.any(np.isnan(complete["value"]))
    assert partial.isel(args=known).equals(complete.isel(args=known))


def test_a_result_that_is_called_as_an_axis_is_refused():
    def spectrum(args):
        return lh.lyapunov_spectrum(lh.Map(lambda n, x, args: args["exponent"] * x * (1 - x)), [0.3], args, t1=5)

    with pytest.raises(ValueError, match="returns exponent, which is the name of an axis"):
        lh.sweep(spectrum, {"exponent": np.array([3.7, 3.8])}, args={"exponent": jnp.asarray(3.7)})
    with pytest.raises(ValueError, match="returns a, which is the name of an axis"):
        lh.sweep(lambda args: args, {"a": np.arange(3.0)}, args={"a": 0.0}, progress=False)


def test_without_a_store_nothing_is_left(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    swept()
    assert os.listdir(tmp_path) == []


def test_a_store_can_be_moved(whole, tmp_path):
    swept(store=tmp_path / "one.zarr")
    shutil.move(tmp_path / "one.zarr", tmp_path / "two.zarr")
    assert swept(store=tmp_path / "two.zarr").equals(whole)


def test_rows_of_a_plan():
    grid = plan({"a": np.arange(3.0), "b": np.arange(2.0)}, None, {"a": 0.0, "b": 0.0})
    assert grid.rows(np.arange(6))["a"].tolist() == [0, 0, 1, 1, 2, 2]
    assert grid.rows(np.array([5, 0]))["b"].tolist() == [1, 0]


@pytest.mark.slow
def test_an_axis_that_the_run_ignores_is_named():
    """The second run forgets the args that it is given, the third one of two."""
    logistic = lh.Map(lambda n, x, r: r * x * (1 - x))

    def spectrum(r):
        return lh.lyapunov_spectrum(logistic, [0.3], r, t1=50, blocks=2)

    over = {"args": np.array([3.1, 3.2])}
    lh.sweep(spectrum, over, args=3.0, progress=False)
    with pytest.warns(UserWarning, match="The run does not depend on args: each point"):
        found = lh.sweep(lambda r: spectrum(3.5), over, args=3.0, progress=False)
    assert float(found.exponents[0, 0]) == float(found.exponents[1, 0])
    both = {"r": np.array([3.1, 3.2]), "b": np.array([0.1, 0.2, 0.3])}
    with pytest.warns(UserWarning, match="does not depend on b: each"):
        lh.sweep(lambda args: spectrum(args["r"]), both, args={"r": 3.0, "b": 0.0}, progress=False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bool", "int16", "int32", "int64", "float32"])
@pytest.mark.parametrize("entry", ["n", "n[1]"])
def test_whole_entries_take_values_that_are_not_whole(entry, kind):
    decay = lh.Flow(lambda t, x, args: -jnp.reshape(args["n"], -1)[-1].astype(x.dtype) * x)
    args = {"n": np.ones(() if entry == "n" else 2, kind)}
    values = np.array([0.25, 1.5, 2.75])
    run = lambda args: lh.lyapunov_spectrum(decay, [1.0], args, t1=10.0)  # noqa: E731
    found = lh.sweep(run, {entry: values}, args=args, progress=False)
    assert_allclose(found.exponents[:, 0], -values, rtol=1e-9)


class Study:
    """A run as a method, which reads attributes."""

    length = 20

    def run(self, args):
        return lh.lyapunov_spectrum(lh.Map(lambda n, x, args: args["r"] * x), [1.0], args, t1=self.length, blocks=4)


@pytest.mark.slow
def test_a_run_that_reads_something_else_than_before(tmp_path):
    """It was computed by the old program under the hash of the new one, in stores too."""
    study, over = Study(), {"r": np.array([0.5, 0.25])}
    for length in (20, 40):
        study.length = length
        found = lh.sweep(study.run, over, args={"r": 0.5}, store=tmp_path / str(length), progress=False)
        assert found.time.values.tolist() == [length, length]
