"""A thousand million points, on paper and by simulation: ``python -m benchmarks.many_points [--record]``.

Measured here: points a second of one core, what a chunk costs the cluster's scheduler and the store, memory of a point.
From that a simulated cluster: workers take chunks, die now and then, and hand results to the one process that writes.
"""

import argparse
import heapq
import json
import shutil
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

import lyaphybrid as lh
from benchmarks.machine import here

DATA = Path(__file__).parent / "many_points.json"
POINTS = 10**9
LANES = 2048  # points that are timed
LENGTH = 100.0  # units of time of each run
SWEPT = {  # an entry of args, from, to
    "lorenz63": ("rho", 26.0, 32.0),
    "impact_oscillator": ("restitution", 0.3, 0.9),
    "friction_pendulum": ("beta", 0.4, 0.6),
}
SIMULATED = "impact_oscillator"
WORKERS, CHUNKS = (16, 256, 4096), (256, 2048, 16384)
LIFETIME = 24 * 3600.0  # seconds until a worker dies, on average
TASKS = 2000


def seconds_a_point(name: str) -> float:
    """A sweep on one core, compiled before."""
    entry, low, high = SWEPT[name]
    problem = lh.zoo.get(name)()

    def run(args):
        return problem.spectrum(args=args, t1=LENGTH, transient=0.0, blocks=8, throw=False)

    def timed(count: int) -> float:
        start = time.perf_counter()
        lh.sweep(run, {entry: np.linspace(low, high, count)}, args=problem.args, progress=False, chunk=count)
        return time.perf_counter() - start  # one chunk is computed by one thread

    timed(8)
    return (min(timed(LANES) for _ in range(3)) - min(timed(LANES // 4) for _ in range(3))) / (LANES - LANES // 4)


def seconds_a_write(chunk: int) -> tuple[float, float, float]:
    """A chunk into a store: seconds, bytes a point in memory and on disk. The run is a map of two steps."""
    step = lh.Map(lambda n, x, r: r * x)

    def run(r):
        return lh.lyapunov_spectrum(step, [1.0, 1.0], r, t1=2.0, blocks=2)

    folder = Path(tempfile.mkdtemp())
    values = np.linspace(0.5, 1.0, 64 * chunk)

    def timed(**how):
        start = time.perf_counter()
        found = lh.sweep(run, {"args": values}, args=1.0, progress=False, chunk=chunk, **how)
        return time.perf_counter() - start, found

    try:
        timed()
        (bare, found), (kept, _) = timed(), timed(store=folder / "sweep.zarr")
        size = sum(one.stat().st_size for one in folder.rglob("*") if one.is_file())
    finally:
        shutil.rmtree(folder)
    return max(kept - bare, 0.0) / 64, found.nbytes / len(values), size / len(values)


def seconds_a_task() -> float:
    """What a scheduler of dask needs for a task that does nothing and returns little."""
    from distributed import Client, as_completed

    with Client(n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        client.gather(client.map(len, [""] * 10, pure=False))
        start = time.perf_counter()
        futures = client.map(len, [""] * TASKS, pure=False)
        for future in as_completed(futures):
            future.result()
        return (time.perf_counter() - start) / TASKS


def simulated(point: float, task: float, write: float, workers: int, chunk: int) -> float:
    """Seconds until all points are written.

    The scheduler hands out one chunk after another, the writer writes one after another; chunks differ by a tenth in
    their time; what a worker was computing when it dies is computed again by another, and a new worker takes its place.

    Args:
        point: seconds of a point.
        task: of the scheduler, for each chunk.
        write: of the writer, for each chunk.
        workers: their number.
        chunk: points of each.
    """
    draw, pieces = np.random.default_rng(0), -(-POINTS // chunk)
    handed, written = 0.0, 0.0
    free = [(0.0, worker) for worker in range(workers)]
    while pieces:
        ready, worker = heapq.heappop(free)
        handed = max(ready, handed) + task
        took = point * chunk * max(0.5, 1 + 0.1 * draw.standard_normal())
        dies = draw.exponential(LIFETIME)
        if dies < took:
            heapq.heappush(free, (handed + dies, worker))
            continue
        pieces -= 1
        written = max(written, handed + took) + write
        heapq.heappush(free, (handed + took, worker))
    return written


def main() -> None:
    """Measure, simulate, print, and keep."""
    parser = argparse.ArgumentParser("python -m benchmarks.many_points", description=__doc__.splitlines()[0])
    parser.add_argument("--record", action="store_true", help="write benchmarks/many_points.json")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    points = {name: seconds_a_point(name) for name in SWEPT}
    for name, seconds in points.items():
        print(f"{name}, t = {LENGTH:g}: {1 / seconds:.0f} points a second and core", flush=True)
    task = seconds_a_task()
    print(f"a task: {1e3 * task:.2f} ms of the scheduler", flush=True)
    rows, measured = [], {}
    for chunk in CHUNKS:
        write, memory, stored = measured[chunk] = seconds_a_write(chunk)
        print(
            f"{chunk} points a chunk: {1e3 * write:.1f} ms to write, {memory:.0f} bytes a point, {stored:.0f} on disk"
        )
        for workers in WORKERS:
            hours = simulated(points[SIMULATED], task, write, workers, chunk) / 3600
            perfect = points[SIMULATED] * POINTS / workers / 3600
            rows.append({"chunk": chunk, "workers": workers, "hours": hours, "efficiency": perfect / hours})
            print(f"  {workers} workers: {hours:.2f} hours, {perfect / hours:.0%} of them used", flush=True)
    if options.record:
        writes = {
            str(chunk): dict(zip(("write", "memory", "stored"), one, strict=True)) for chunk, one in measured.items()
        }
        results = here() | {"points": points, "task": task, "writes": writes, "rows": rows}
        DATA.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
