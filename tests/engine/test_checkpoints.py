"""Runs that stop and go on: bit by bit what they would have been."""

import functools
import io
import os
import tracemalloc
import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.engine.host import checkpoints, driver

LORENZ, DISKS, IMPACTS = lh.zoo.lorenz63(), lh.zoo.hard_disks(n=4), lh.zoo.impact_oscillator()
FIXED = lh.RungeKutta("rk4", dt=0.01)
RUNS = {
    "flow": lambda **more: lh.lyapunov_spectrum(
        LORENZ.system, LORENZ.x0, LORENZ.args, t1=30.0, transient=10.0, method=FIXED, **more
    ),
    "impacts": lambda **more: lh.lyapunov_spectrum(
        IMPACTS.system, IMPACTS.x0, IMPACTS.args, t1=60.0, transient=20.0, **more
    ),
    "map": lambda **more: lh.zoo.henon_map().spectrum(t1=3000, transient=500, **more),
    "disks": lambda **more: DISKS.spectrum(
        t1=30.0, transient=10.0, replicates=3, key=jax.random.key(1), **{"blocks": 16} | more
    ),
    "target_stderr": lambda **more: lh.lyapunov_spectrum(
        LORENZ.system, LORENZ.x0, LORENZ.args, t1=10.0, k=1, method=FIXED, target_stderr=0.05, **more
    ),
}


def same(one, other) -> bool:
    """All fields, bit by bit."""
    a, b = jax.tree.leaves(one), jax.tree.leaves(other)
    return len(a) == len(b) and all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True))


@pytest.fixture
def short_calls(monkeypatch):
    """Calls of few attempts, each of which is written."""
    monkeypatch.setattr(checkpoints, "SECONDS_BETWEEN_WRITES", 0.0)
    monkeypatch.setattr(driver, "FIRST_ATTEMPTS", 150)
    monkeypatch.setattr(driver, "MOST_ATTEMPTS", 400)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:interrupted")
@pytest.mark.parametrize("name", RUNS)
def test_after_ten_interruptions_it_is_the_same(name, tmp_path, short_calls, monkeypatch):
    whole, advance, path = RUNS[name](), driver._advance, tmp_path / "run.npz"
    interruptions = 0
    for left in (3, 1, 2, 4, 1, 2, 3, 1, 2, 2):
        calls = iter(range(left))

        @functools.wraps(advance)
        def some(*given, calls=calls):
            if next(calls, None) is None:
                raise KeyboardInterrupt
            return advance(*given)

        monkeypatch.setattr(driver, "_advance", some)
        try:
            found = RUNS[name](checkpoint=path, resume=True, throw=False)
            interruptions += "interrupted" in found.notes
        except KeyboardInterrupt:  # nothing of this part is there yet
            interruptions += 1
    monkeypatch.setattr(driver, "_advance", advance)
    assert interruptions == 10
    assert same(RUNS[name](checkpoint=path, resume=True), whole)


def test_what_is_finished_is_not_computed_again(tmp_path, monkeypatch):
    path = tmp_path / "run.npz"
    first = RUNS["flow"](checkpoint=path)
    computed = []
    real = jax.block_until_ready
    monkeypatch.setattr(jax, "block_until_ready", lambda x: computed.append(1) or real(x))
    assert same(RUNS["flow"](checkpoint=path, resume=True), first)
    assert not computed


def flow(t1, **more):
    return lh.lyapunov_spectrum(LORENZ.system, LORENZ.x0, LORENZ.args, t1=t1, method=FIXED, blocks=20, **more)


@pytest.mark.slow
def test_a_longer_run_goes_on(tmp_path):
    path = tmp_path / "run.npz"
    short = flow(20.0, checkpoint=path)
    long = flow(50.0, checkpoint=path, resume=True)
    assert float(long.time) == 50.0
    np.testing.assert_allclose(np.diff(np.concatenate([[0.0], long.history.time])), 1.0, rtol=1e-12)
    np.testing.assert_array_equal(long.history.growth[:20], short.history.growth)
    straight = flow(50.0)  # in other blocks, and so another program, which rounds otherwise
    np.testing.assert_allclose(long.exponents.sum(), straight.exponents.sum(), atol=1e-5)  # RK4's own error: 1e-4
    again = flow(50.0, checkpoint=path, resume=True)
    assert same(again, long)
    assert float(flow(60.0, checkpoint=path, resume=True).time) == 60.0
    with pytest.raises(ValueError, match="longer than 50"):
        flow(50.0, checkpoint=path, resume=True)


def test_what_is_not_finished_is_finished_first(tmp_path, short_calls, monkeypatch):
    path = tmp_path / "run.npz"
    seen = iter([False, True])

    def interrupt(fraction):
        if next(seen, False):
            raise KeyboardInterrupt

    with pytest.warns(UserWarning, match="interrupted"):
        flow(20.0, checkpoint=path, progress=interrupt)
    with pytest.raises(ValueError, match="not finished"):
        flow(30.0, checkpoint=path, resume=True)
    assert same(flow(20.0, checkpoint=path, resume=True), flow(20.0))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({}, "resume=True goes on with it"),
        ({"resume": True, "args": LORENZ.args | {"rho": 29.0}}, "another system, args or method"),
        ({"resume": True, "method": lh.RungeKutta("rk4", dt=0.02)}, "another system, args or method"),
        ({"resume": True, "x0": jnp.array([1.0, 2.0, 3.0])}, "another start"),
        ({"resume": True, "transient": 3.0}, "another length or averaging"),
        ({"resume": True, "averaging": "birkhoff"}, "another length or averaging"),
        ({"resume": True, "t1": 1.0}, "longer than 1"),
    ],
)
def test_another_run_is_refused(tmp_path, change, says):
    path = tmp_path / "run.npz"

    def run(resume=False, x0=LORENZ.x0, args=LORENZ.args, **changed):
        keywords = {"t1": 2.0, "method": FIXED, "blocks": 2} | changed
        return lh.lyapunov_spectrum(LORENZ.system, x0, args, checkpoint=path, resume=resume, **keywords)

    run()
    before = path.read_bytes()
    with pytest.raises(ValueError, match=says):
        run(**change)
    assert path.read_bytes() == before


@pytest.mark.parametrize("harm", ["cut", "spoilt", "foreign"])
def test_a_damaged_file_is_refused(tmp_path, harm):
    path = tmp_path / "run.npz"
    flow(2.0, checkpoint=path)
    content = bytearray(path.read_bytes())
    if harm == "spoilt":
        content[len(content) // 2] ^= 255
    path.write_bytes({"cut": content[:-500], "spoilt": content, "foreign": b"no checkpoint"}[harm])
    with pytest.raises(ValueError, match=r"run\.npz is no checkpoint of a run, or it is damaged"):
        flow(2.0, checkpoint=path, resume=True)


def test_where_nothing_can_be_written_is_said(tmp_path):
    with pytest.raises(OSError, match=r"the checkpoint .*run\.npz cannot be written"):
        flow(2.0, checkpoint=tmp_path / "nowhere" / "run.npz")


def test_a_disk_that_fills_up_does_not_stop_the_run(tmp_path, short_calls, monkeypatch):
    written, savez = [], np.savez

    def full(file, **arrays):
        written.append(1)
        if len(written) > 2:
            raise OSError(28, "No space left on device")
        savez(file, **arrays)

    monkeypatch.setattr(checkpoints.np, "savez", full)
    with pytest.warns(UserWarning, match="No space left on device.*the run goes on"):
        found = flow(20.0, checkpoint=tmp_path / "run.npz")
    assert len(list(tmp_path.iterdir())) == 1
    monkeypatch.undo()
    assert same(found, flow(20.0))
    assert same(flow(20.0, checkpoint=tmp_path / "run.npz", resume=True), found)


def test_not_under_transformations(tmp_path):
    def run(x):
        how = {"t1": 1.0, "method": FIXED, "checkpoint": tmp_path / "run.npz"}
        return lh.lyapunov_spectrum(LORENZ.system, x, LORENZ.args, **how).exponents

    with pytest.raises(ValueError, match="not under jit, vmap or grad"):
        jax.vmap(run)(jnp.ones((2, 3)))


def entry(name, header=None, content=b""):
    """An entry of an archive of arrays whose header may promise more than it holds."""
    text = repr(header or {"descr": "<f8", "fortran_order": False, "shape": (len(content) // 8,)}).encode() + b"\n"
    return name, b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content


def changed(path, *entries, compression=zipfile.ZIP_STORED):
    """The same file, some entries replaced, added, or left out (None)."""
    with zipfile.ZipFile(path) as file:
        kept = {name: file.read(name) for name in file.namelist()}
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in (kept | dict(entries)).items():
            if content is not None:
                file.writestr(name, content)


def array_entry(name, array):
    into = io.BytesIO()
    np.save(into, array, allow_pickle=True)
    return name, into.getvalue()


HUGE = {"descr": "<f8", "fortran_order": False, "shape": (10**13,)}
HOSTILE = {
    "an array that promises more than it holds": lambda path: changed(path, entry("1.0.npy", HUGE)),
    "a small archive of a large array": lambda path: changed(
        path, array_entry("1.0.npy", np.zeros(40_000_000)), compression=zipfile.ZIP_DEFLATED
    ),
    "another type": lambda path: changed(path, array_entry("1.3.npy", np.array("a", "U7"))),
    "another shape": lambda path: changed(path, array_entry("1.3.npy", np.zeros((5, 5, 5)))),
    "pickled objects": lambda path: changed(path, array_entry("1.0.npy", np.array([{}, []], object))),
    "entries that are missing": lambda path: changed(path, ("1.2.npy", None)),
    "a name that leads elsewhere": lambda path: changed(path, array_entry("../../1.given.npy", np.array(3))),
    "no numbers in the stretches": lambda path: changed(path, array_entry("stretches.npy", np.zeros(3))),
    "a header without end": lambda path: changed(path, array_entry("header.npy", np.array("[" * 100_000))),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "a pipe": lambda path: (path.unlink(), os.mkfifo(path)),
}


@pytest.mark.slow_cases("a small archive of a large array", "a pipe")
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders on this platform")
@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_file_is_refused_in_little_memory(tmp_path, what):
    path = tmp_path / "deep" / "inside" / "run.npz"
    path.parent.mkdir(parents=True)
    flow(2.0, checkpoint=path)
    HOSTILE[what](path)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"run\.npz is no checkpoint of a run, or it is damaged"):
            flow(2.0, checkpoint=path, resume=True)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 50e6
    assert [*tmp_path.rglob("*.np[yz]")] == [path]
