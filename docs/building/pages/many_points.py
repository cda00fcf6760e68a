"""The page of very large sweeps, from what `python -m benchmarks.many_points --record` has kept."""

import json
from pathlib import Path

from benchmarks.many_points import LENGTH, POINTS

PRICE = 0.04  # euros an hour of a rented core: an assumption, said on the page
TEXT = """# A thousand million points

What a sweep of 10⁹ points would take, on paper: from costs that `python -m benchmarks.many_points --record` measured on
{date}, commit {commit}: {machine}; load at the beginning: {load}. Nobody has run it.

## What a point costs

`lh.sweep` on one core, all exponents over t = {length:g}, compiled before. A core is taken to cost {price} € an hour,
which is an assumption: put in your own price.

| problem | points a second and core | core hours for 10⁹ | points for a euro |
|---|---|---|---|
{points}
Points whose flows seldom part, without events, go side by side in the vectors of the processor. Many starts, an axis
`"x0"`, cost the same as parameters.

## What a cluster adds

With `client=` a chunk of points is a task of dask. Its scheduler took {task:.1f} ms for a task that does nothing, and
the one process that writes the store {writes}. Both go one after the other, whatever the number of workers. A
simulation of 10⁹ points of the impact oscillator, in which chunks differ by a tenth in their time and a worker lives
for a day on average:

| points a chunk | workers | hours | part of the workers' time that is used |
|---|---|---|---|
{rows}
A chunk that is too small leaves most workers waiting for the writer; `chunk=` chooses it. With more workers than one
writer serves, make several sweeps.

## What one process can hold

Results lie in the memory of the process that asked, {memory:.0f} bytes a point of two exponents: {total:.0f} GB in all.
So let each job of the cluster do a sweep of its own, with its own store; none waits for another, and the same job
again goes on where it ended:

```{{code-block}} python
import sys

import numpy as np

import lyaphybrid as lh

job, jobs = int(sys.argv[1]), 1000  # as job number `job` of an array of SLURM
oscillator = lh.zoo.impact_oscillator()
omega = np.linspace(2.0, 4.0, 31_623)[job::jobs]
grid = {{"omega": omega, "restitution": np.linspace(0.3, 0.9, 31_623)}}
lh.sweep(oscillator, grid, store=f"impacts_{{job}}.zarr", chunk=16_384)
```

Numbers of accelerators stand in [Sweeps](../howto/results/sweeps.md).
"""


def pages(root: Path) -> dict[str, str]:
    """The one page."""
    found = json.loads((root / "benchmarks/many_points.json").read_text())
    points = "".join(
        f"| [`{name}`](../reference/api/lyaphybrid.zoo.{name}.rst) | {1 / seconds:.0f} "
        f"| {seconds * POINTS / 3600:.0f} | {3600 / seconds / PRICE / 1e6:.0f} million |\n"
        for name, seconds in found["points"].items()
    )
    rows = "".join(
        f"| {row['chunk']} | {row['workers']} | {row['hours']:.1f} | {row['efficiency']:.0%} |\n"
        for row in found["rows"]
    )
    writes = ", ".join(f"{1e3 * one['write']:.0f} ms for {chunk} points" for chunk, one in found["writes"].items())
    memory = next(iter(found["writes"].values()))["memory"]
    return {
        "evidence/many_points.md": TEXT.format(
            **{name: found[name] for name in ("date", "commit", "machine", "load")},
            price=PRICE,
            length=LENGTH,
            points=points,
            task=1e3 * found["task"],
            writes=writes,
            rows=rows,
            memory=memory,
            total=memory * POINTS / 1e9,
        )
    }
