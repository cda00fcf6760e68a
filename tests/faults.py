"""What a sweep survives: `python tests/faults.py` kills, spoils and fills, and prints what came of it.

Each fault ends with a resume; the dataset must be identical to that of an uninterrupted sweep. Exit status 1 if any
is not. Full and read-only file systems are mounted in memory, which needs the right to do so.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh

LOGISTIC = lh.Map(lambda n, x, r: r * x * (1 - x))
POINTS, CHUNK = 400, 5


def run(r):
    """Some ten milliseconds; beyond r = 4 the motion escapes."""
    return lh.lyapunov_spectrum(LOGISTIC, jnp.array([0.3]), r, t1=1_000_000, transient=10, blocks=8)


def swept(**keywords):
    over = {"args": np.linspace(3.0, 4.1, POINTS)}
    return lh.sweep(run, over, args=3.0, **{"chunk": CHUNK, "progress": False} | keywords)


def whole_points(store: Path) -> int:
    """How many points a store holds."""
    import zarr

    if not store.exists():
        return 0
    return CHUNK * int(np.sum(np.asarray(zarr.open_group(str(store), mode="r")["digest"][:]) != 0))


def kills(folder: Path, expected, times: int) -> str:
    """SIGKILL at random moments, and resumes."""
    store, random_, survived = folder / "killed.zarr", random.Random(0), []
    for _ in range(times):
        child = subprocess.Popen([sys.executable, __file__, "--into", str(store)], stderr=subprocess.DEVNULL)
        before = whole_points(store)
        while whole_points(store) == before and child.poll() is None:
            time.sleep(0.01)
        time.sleep(random_.uniform(0.0, 0.2))
        child.send_signal(signal.SIGKILL)
        child.wait()
        survived.append(whole_points(store))
    assert survived == sorted(survived), "a chunk was lost"
    same(swept(store=store), expected)
    return f"points after each: {survived}"


def checkpoints(folder: Path, expected, times: int) -> str:
    """A long run with a checkpoint: SIGKILL at random moments."""
    del expected
    path, random_ = folder / "run.npz", random.Random(2)
    for _ in range(times):
        child = subprocess.Popen([sys.executable, __file__, "--checkpoint", str(path)])
        before = changed(path)
        while changed(path) == before and child.poll() is None:
            time.sleep(0.01)
        time.sleep(random_.uniform(0.0, 0.4))
        assert child.poll() is None, "it was finished too soon"
        child.send_signal(signal.SIGKILL)
        child.wait()
    found, whole = (jax.tree.leaves(long_run(**how)) for how in ({"checkpoint": path, "resume": True}, {}))
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(found, whole, strict=True)), "the spectra differ"
    return f"{times} kills, a file of {path.stat().st_size / 1e3:.0f} kB"


def changed(path: Path) -> int:
    """When a file was written."""
    return path.stat().st_mtime_ns if path.exists() else 0


def long_run(**keywords):
    """Some five seconds of an impact oscillator."""
    return lh.zoo.impact_oscillator().spectrum(t1=4e5, transient=1e4, **keywords)


def workers(folder: Path, expected, times: int) -> str:
    """One of two dask workers is killed."""
    from dask.distributed import Client, LocalCluster

    pids = []
    for i in range(times):
        with (
            LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            found = client.run(os.getpid)
            pid = list(found.values())[i % 2]

            def kill(fraction, pid=pid, left=iter([True])):  # noqa: B008  # once, on the way
                if fraction > 0.1 and next(left, False):
                    os.kill(pid, signal.SIGKILL)
                    pids.append(pid)

            same(swept(client=client, store=folder / f"workers-{i}.zarr", progress=kill), expected)
    assert len(pids) == times
    return f"{len(pids)} workers"


def corrupted(folder: Path, expected) -> str:
    """Files of chunks truncated, changed and deleted."""
    store = folder / "corrupted.zarr"
    swept(store=store)
    files = sorted(store.glob("*/c/**/*"))
    files = [file for file in files if file.is_file()]
    for i, file in enumerate(random.Random(1).sample(files, 30)):
        content = file.read_bytes()
        if i % 3 == 0:
            file.unlink()
        else:
            file.write_bytes(content[: len(content) // 2] if i % 3 == 1 else b"\0" + content[1:])
    same(swept(store=store), expected)
    return "30 files"


def read_only(folder: Path, expected) -> str:
    """A store on a file system that is mounted for reading only."""
    place = folder / "read-only"
    place.mkdir()
    with Mounted(place, "size=64m"):
        swept(store=place / "sweep.zarr")
        shutil.rmtree(place / "sweep.zarr" / "digest" / "c")
        subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)
        error = refused(place / "sweep.zarr")
        subprocess.run(["mount", "-o", "remount,rw", str(place)], check=True)
        same(swept(store=place / "sweep.zarr"), expected)
    return str(error)


def full(folder: Path, expected) -> str:
    """A file system that is full after some chunks."""
    place = folder / "full"
    place.mkdir()
    with Mounted(place, "size=1500k"):
        error = refused(place / "sweep.zarr")
        known = ~np.isnan(error.dataset.time.values)
        assert 0 < np.sum(known) < POINTS
        same(error.dataset.isel(args=known), expected.isel(args=known))
        subprocess.run(["mount", "-o", "remount,size=64m", str(place)], check=True)
        same(swept(store=place / "sweep.zarr"), expected)
    return f"{error}; {np.sum(known)} points kept"


def refused(store: Path) -> lh.StoreFailedError:
    """The error of a sweep into a store that cannot be written, which names it."""
    try:
        swept(store=store)
    except lh.StoreFailedError as error:
        if str(store) in str(error):
            return error
    raise AssertionError("nothing was said")


class Mounted:
    """A file system of memory."""

    def __init__(self, place: Path, options: str):
        self.place, self.options = place, options

    def __enter__(self):
        subprocess.run(["mount", "-t", "tmpfs", "-o", self.options, "tmpfs", str(self.place)], check=True)

    def __exit__(self, *error):
        subprocess.run(["umount", str(self.place)], check=False)


def both(folder: Path, expected) -> str:
    """Two processes on one store."""
    store = folder / "both.zarr"
    command = [sys.executable, __file__, "--into", str(store)]
    pair = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    errors = [child.communicate()[1] for child in pair]
    refused = [error.strip().splitlines()[-1] for error in errors if "in use by another process" in error]
    assert sorted(child.returncode != 0 for child in pair) == [False, bool(refused)]
    same(swept(store=store), expected)
    return f"refused: {refused}"


def same(found, expected) -> None:
    """Identical, to the last bit."""
    assert found.equals(expected), "the dataset differs"


def main() -> int:
    """All faults, or one sweep into a store."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--into")
    parser.add_argument("--checkpoint")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--workers", type=int, default=5)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if options.into:
        swept(store=options.into)
        return 0
    if options.checkpoint:
        from lyaphybrid.engine.host import checkpoints as files

        files.SECONDS_BETWEEN_WRITES = 0.2
        long_run(checkpoint=options.checkpoint, resume=True)
        return 0
    expected, failures = swept(), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for fault, arguments in (
            (kills, (options.kills,)), (workers, (options.workers,)), (corrupted, ()), (read_only, ()), (full, ()),
            (both, ()), (checkpoints, (10,)),
        ):  # fmt: skip
            start = time.perf_counter()
            try:
                verdict = f"identical; {fault(folder, expected, *arguments)}"
            except (AssertionError, subprocess.CalledProcessError) as error:
                verdict, failures = f"FAILED: {error}", failures + 1
            print(f"{fault.__doc__.splitlines()[0]:60s} {verdict} ({time.perf_counter() - start:.0f} s)", flush=True)
    return failures > 0


if __name__ == "__main__":
    sys.exit(main())
