"""What a collision of hard disks costs by their number and that of the columns: ``python -m benchmarks.scaling``.

Without orthonormalisation: two runs of different length are subtracted, with them what both do once (the first
predictions, the orthonormalisation at the end). The exponent of a power law is the slope in logarithms between the
smallest and the largest case.
"""

import functools
import math
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from benchmarks import many_disks

SIZES = (16, 36, 64, 144, 256)
COLUMNS = (16, 64, 256)
BODIES = 64  # of the runs with different columns
ROUNDS = 12
# Columns grow to e^600. After some 20 collisions a disk they are orthonormalised one by one: in both runs or in none.
LENGTHS = {16: 8000, 36: 8000, 64: 8000, 144: 1600, 256: 3000}


def ours(n: int, k: int) -> Callable[[int], object]:
    """A run of so many collisions without orthonormalisation on the way."""
    x0, (width, height) = many_disks.lattice_start(n)
    problem = lh.zoo.hard_disks(n=n)
    args = problem.args | {"width": float(width), "height": float(height)}
    spectrum = functools.partial(lh.lyapunov_spectrum, problem.system, jnp.array(x0), args, k=k, blocks=2)
    return lambda count: np.asarray(spectrum(t1=float(count), clock="jumps", every=1e9).exponents)


def c(n: int, k: int) -> Callable[[int], object]:
    """The same in C."""
    return lambda count: many_disks.run_many_disks(n, 0, collisions=count, k=k)


def cost(run: Callable[[int], object], count: int) -> float:
    """Seconds a collision: the fastest of several runs, less the fastest of runs a quarter as long."""

    def fastest(count: int) -> float:
        run(count)
        seconds = []
        for _ in range(ROUNDS):
            start = time.perf_counter()
            run(count)
            seconds.append(time.perf_counter() - start)
        return min(seconds)

    short = count // 4
    return (fastest(count) - fastest(short)) / (count - short)


def power(sizes: tuple[int, ...], costs: list[float]) -> float:
    """The exponent of size in the cost."""
    return math.log(costs[-1] / costs[0]) / math.log(sizes[-1] / sizes[0])


def main() -> None:
    """Both tables."""
    jax.config.update("jax_enable_x64", True)
    for name, side in (("ours", ours), ("C", c)):
        costs = [cost(side(n, 4 * n), LENGTHS[n]) for n in SIZES]
        shown = ", ".join(f"{n}: {1e9 * one:.0f}" for n, one in zip(SIZES, costs, strict=True))
        print(f"{name}, all columns, ns a collision by N: {shown}; ~ N^{power(SIZES, costs):.2f}", flush=True)
        costs = [cost(side(BODIES, k), LENGTHS[BODIES]) for k in COLUMNS]
        shown = ", ".join(f"{k}: {1e9 * one:.0f}" for k, one in zip(COLUMNS, costs, strict=True))
        print(f"{name}, N = {BODIES}, ns a collision by k: {shown}; ~ k^{power(COLUMNS, costs):.2f}", flush=True)


if __name__ == "__main__":
    main()
