"""How memory and time of a sweep grow with its points: ``python -m benchmarks.sweep_sizes [--store]``.

Each size runs in a process of its own, whose peak memory is given above that of the import. What a sweep returns is
part of it; all else is bounded by the chunk.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import time

SIZES = (1_000, 10_000, 100_000)
T1 = 20.0  # of each impact oscillator


def measure(points: int, stored: bool) -> dict[str, float]:
    """One sweep, in this process."""
    import jax
    import numpy as np

    import lyaphybrid as lh
    from benchmarks.harness import peak_memory
    from lyaphybrid.sweeps import sweeping

    jax.config.update("jax_enable_x64", True)
    made, make = [], sweeping.LaneProgram
    sweeping.LaneProgram = lambda *given: made.append(1) or make(*given)  # type: ignore[assignment, misc]
    problem, before = lh.zoo.impact_oscillator(), peak_memory()

    def run(args):
        return problem.spectrum(args=args, t1=T1, transient=0.0, blocks=4)

    values = np.linspace(0.3, 0.9, points)
    with tempfile.TemporaryDirectory() as folder:
        store = pathlib.Path(folder) / "sweep.zarr" if stored else None
        lh.sweep(run, {"restitution": values[:2]}, args=problem.args, progress=False)
        small, start = peak_memory(), time.perf_counter()
        found = lh.sweep(run, {"restitution": values}, args=problem.args, progress=False, store=store)
        seconds = time.perf_counter() - start
    return {
        "points": points,
        "seconds": seconds,
        "dataset_mb": found.nbytes / 1e6,
        "two_points_mb": small - before,
        "peak_mb": peak_memory() - before,
        "compilations": len(made) - 1,  # less that of the two points
    }


def main() -> None:
    """Print a line for each size."""
    parser = argparse.ArgumentParser("python -m benchmarks.sweep_sizes", description=__doc__.split("\n")[0])
    parser.add_argument("--store", action="store_true", help="into a zarr store")
    parser.add_argument("--points", type=int, help="one size, as JSON")
    options = parser.parse_args()
    if options.points:
        print(json.dumps(measure(options.points, options.store)))
        return
    print("   points  seconds  dataset MB  peak MB above import  (a sweep of two points)  compilations")
    for points in SIZES:
        command = [
            sys.executable,
            "-m",
            "benchmarks.sweep_sizes",
            "--points",
            str(points),
            *["--store"] * options.store,
        ]
        row = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True).stdout)
        print(
            f"{row['points']:9d}  {row['seconds']:7.1f}  {row['dataset_mb']:10.2f}  {row['peak_mb']:20.1f}"
            f"  {row['two_points_mb']:23.1f}  {row['compilations']:12d}"
        )


if __name__ == "__main__":
    main()
