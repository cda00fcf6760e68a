"""How costs grow: ``python -m benchmarks.scaling [--only LAW …] [--record]``.

A law is the cost of a unit of work against a size: components, exponents, length, lanes, bodies. Two runs of different
length are subtracted, with them what both do once. Lengths are such that the long one takes `SECONDS`.
"""

import argparse
import functools
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from benchmarks import many_disks, ours, swept
from benchmarks.machine import here

DATA = Path(__file__).parent / "scaling.json"
SECONDS = 0.2
ROUNDS = 7
DISKS = 64  # of the runs with different columns
SITES = 256  # of the chain with different columns
LEADING = 10  # exponents, where the size is something else
LEADING_OF_DISKS = 16
STEP = 0.01
NEVER = 1e9  # collisions between two orthonormalisations

Run = Callable[[int], object]  # a run of so many units of work


class Law(NamedTuple):
    """What grows, of what a unit is counted, and how it is made."""

    title: str
    size: str
    unit: str
    sizes: tuple[int, ...]
    make: Callable[[int], Run]
    length: Callable[[int], int] | None = None  # units of the long run by the size; None: whatever takes `SECONDS`


def _spectrum(system, x0, args, **how) -> Callable[..., object]:
    run = functools.partial(lh.lyapunov_spectrum, system, jnp.asarray(x0), args, blocks=2, **how)
    return lambda t1, **more: np.asarray(run(t1=t1, **more).exponents)


def chain(n: int, k: int) -> Run:
    """Lorenz' chain of n sites with k columns, in steps of RK4."""
    problem, method = lh.zoo.lorenz96(n=n), lh.RungeKutta("rk4", dt=STEP)
    run = _spectrum(problem.system, problem.x0, problem.args, k=k, method=method, every=10)
    return lambda steps: run(steps * STEP)


def springs(n: int) -> Run:
    """The chain of Fermi, Pasta, Ulam and Tsingou, in steps."""
    problem = lh.zoo.fpu_beta(n=n)
    run = _spectrum(problem.system, problem.x0, problem.args, k=LEADING, method=problem.method, every=10)
    return lambda steps: run(steps * problem.method.dt)


def attractor(_: int) -> Run:
    """Lorenz' attractor, in steps of RK4."""
    problem, method = lh.zoo.lorenz63(), lh.RungeKutta("rk4", dt=STEP)
    run = _spectrum(problem.system, problem.x0, problem.args, method=method, every=10)
    return lambda steps: run(steps * STEP)


def impacts(_: int) -> Run:
    """The impact oscillator, in impacts."""
    problem = lh.zoo.impact_oscillator()
    run = _spectrum(problem.system, problem.x0, problem.args)
    return lambda count: run(float(count), clock="jumps")


def disks(n: int, k: int, every: float | None = None) -> Run:
    """Hard disks, in collisions."""
    x0, (width, height) = many_disks.lattice_start(n)
    problem = lh.zoo.hard_disks(n=n)
    args = problem.args | {"width": float(width), "height": float(height)}
    run = _spectrum(problem.system, x0, args, k=k, every=every)
    return lambda count: run(float(count), clock="jumps")


def disks_in_c(n: int, k: int) -> Run:
    """The same in C."""
    return lambda count: many_disks.run_many_disks(n, 0, collisions=count, k=k)


def neurons(n: int, model: str, current: float) -> Run:
    """A sparse network, in spikes."""
    problem = lh.zoo.sparse_network(n=n, model=model, current=current)
    run = _spectrum(problem.system, problem.x0, problem.args, k=LEADING)
    return lambda count: run(float(count), clock="jumps")


def lanes(count: int) -> Run:
    """Sweeps of Lorenz' system on one thread, in points."""
    sweep, _ = swept.lorenz(1, count)()

    def run(points: int) -> None:
        for _ in range(max(1, points // count)):
            sweep()

    return run


# Columns of all disks grow to e^600. After some 20 collisions a disk they are orthonormalised one by one: in both runs
# or in none.
COLLISIONS = {16: 8000, 36: 8000, 64: 8000, 144: 1600, 256: 3000}.__getitem__
ALL, FEW = (16, 36, 64, 144, 256), (16, 64, 256)
LAWS = {
    "components": Law("Lorenz-96, ten exponents", "n", "step", (8, 16, 32, 64, 128, 256, 512, 1024),
                      lambda n: chain(n, min(n, LEADING))),
    "exponents": Law("Lorenz-96, n = 256", "k", "step", (1, 4, 16, 64, 256), lambda k: chain(SITES, k)),
    "springs": Law("FPU-β, ten exponents", "N", "step", (16, 64, 256, 1024, 4096, 10_000), springs),
    "time": Law("Lorenz, all exponents", "steps", "step", (10**4, 10**5, 10**6, 10**7), attractor, lambda steps: steps),
    "events": Law("impact oscillator, all exponents", "impacts", "impact", (10**3, 10**4, 10**5), impacts,
                  lambda count: count),
    "lanes": Law("sweep of Lorenz' system", "points", "point", (16, 128, 1024, 4096), lanes,
                 lambda count: 4 * count),
    "disks": Law("hard disks, all columns, no QR", "N", "collision", ALL, lambda n: disks(n, 4 * n, NEVER), COLLISIONS),
    "disks_c": Law("the same in C", "N", "collision", ALL, lambda n: disks_in_c(n, 4 * n), COLLISIONS),
    "columns": Law("64 hard disks, no QR", "k", "collision", FEW, lambda k: disks(DISKS, k, NEVER),
                   lambda _: COLLISIONS(DISKS)),
    "columns_c": Law("the same in C", "k", "collision", FEW, lambda k: disks_in_c(DISKS, k),
                     lambda _: COLLISIONS(DISKS)),
    "many_disks": Law("hard disks, 16 exponents", "N", "collision", (64, 256, 1024, 4096, 10_000),
                      lambda n: disks(n, LEADING_OF_DISKS), lambda n: max(8000, 4 * n)),
    "qif": Law("chaotic network, 50 synapses, ten exponents", "N", "spike", (10**3, 10**4, 10**5),
               lambda n: neurons(n, "qif", 1.0), lambda n: max(20_000, 8 * n)),
    "leaky": Law("network of leaky neurons, 50 synapses, ten exponents", "N", "spike", (10**3, 10**4, 10**5),
                 lambda n: neurons(n, "leaky", 8.0), lambda n: max(20_000, 8 * n)),
}  # fmt: skip


def _seconds(run: Run, count: int) -> float:
    start = time.perf_counter()
    run(count)
    return time.perf_counter() - start


def _long_enough(run: Run) -> int:
    """So many units that a run takes `SECONDS`."""
    count = 64
    while (took := _seconds(run, count)) < SECONDS:
        count = int(count * min(8.0, max(2.0, 1.2 * SECONDS / took)))
    return count


def cost(law: Law, size: int) -> float:
    """Seconds a unit: the fastest of several runs, less the fastest of runs a quarter as long."""
    run = law.make(size)
    count = law.length(size) if law.length else _long_enough(run)
    ours.with_best_code(lambda: run(count))
    if law.length is None:
        count = _long_enough(run)
    short = count // 4
    run(short)
    rounds = ROUNDS if _seconds(run, count) < 1 else 3
    pairs = [(_seconds(run, count), _seconds(run, short)) for _ in range(rounds)]
    long, brief = (min(each) for each in zip(*pairs, strict=True))
    return (long - brief) / (count - short)


def power(sizes: tuple[int, ...], costs: list[float]) -> float:
    """The exponent of the size in the cost, between the smallest and the largest."""
    return math.log(costs[-1] / costs[0]) / math.log(sizes[-1] / sizes[0])


def main() -> None:
    """Measure, print, and keep."""
    parser = argparse.ArgumentParser("python -m benchmarks.scaling", description=__doc__.splitlines()[0])
    parser.add_argument("--only", metavar="LAW", nargs="+", choices=list(LAWS), help=", ".join(LAWS))
    parser.add_argument("--record", action="store_true", help="write benchmarks/scaling.json, which has all laws")
    options = parser.parse_args()
    if options.record and options.only:
        parser.error("--record is one run of all laws: leave out --only.")
    jax.config.update("jax_enable_x64", True)
    results = here() | {"laws": {}}
    for name in options.only or LAWS:
        law = LAWS[name]
        costs = [cost(law, size) for size in law.sizes]
        shown = ", ".join(f"{size}: {1e9 * one:.0f}" for size, one in zip(law.sizes, costs, strict=True))
        grows = power(law.sizes, costs)
        print(f"{law.title}, ns for each {law.unit} by {law.size}: {shown}; ~ {law.size}^{grows:.2f}", flush=True)
        results["laws"][name] = {
            "title": law.title, "size": law.size, "unit": law.unit,
            "sizes": law.sizes, "seconds": costs, "power": grows,
        }  # fmt: skip
    if options.record:
        DATA.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
