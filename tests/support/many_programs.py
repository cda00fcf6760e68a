"""Random programs, compiled natively and by XLA. `python tests/support/many_programs.py 20000` runs many."""

import functools
import random
import sys
import time
from collections.abc import Callable

import jax
import numpy as np

from lyaphybrid.native import Compiled
from lyaphybrid.native.lowering.costs import Options
from random_programs import random_program

WAYS = (
    dict(plan=Options(1, 2)), dict(plan=Options(8, 2)), dict(), dict(plan=Options(8, 0), checked=True),
    dict(plan=Options(1, 0), checked=True),
)  # fmt: skip


def _by_xla(program, operands) -> list:
    return jax.jit(jax.extend.core.jaxpr_as_fun(program))(*operands)


def _differs(expected, got) -> bool:
    expected = np.asarray(expected)
    if expected.dtype.kind == "f":
        return not np.allclose(got, expected, 1e-7, 1e-7)
    return not np.array_equal(got, expected)


def wrong_results(program, operands, ways=WAYS) -> list[str]:
    """Which ways of compiling give which results otherwise than XLA."""
    results = [Compiled(program, **way)(*operands) for way in ways]

    def wrong(expected):
        places = [[i for i, (x, y) in enumerate(zip(expected, got, strict=True)) if _differs(x, y)] for got in results]
        return [f"{way}: results {place}" for way, place in zip(ways, places, strict=True) if place]

    # XLA is not always right (one wrong program was seen): then it is asked for one equation after the other.
    return wrong(_by_xla(program, operands)) and wrong(jax.core.eval_jaxpr(program.jaxpr, program.consts, *operands))


def of_seed(seed: int):
    """The program of a seed, and its operands."""
    return random_program(functools.partial(random.Random(seed).randrange))


def in_two_ways(seed: int) -> list[str]:
    """What is wrong with the program of a seed, compiled in two of the ways."""
    return wrong_results(*of_seed(seed), [WAYS[seed % len(WAYS)], WAYS[(seed + 2) % len(WAYS)]])


def each_seed(look: Callable[[int], list[str]], count: int, first: int = 0) -> int:
    """Look at the seeds first, first + 1, …: what `look` finds wrong is printed; for how many that is something."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_disable_most_optimizations", True)  # XLA compiles faster
    clock, different = time.time(), 0
    for seed in range(first, first + count):
        try:
            wrong = look(seed)
        except Exception as error:
            wrong = [f"{type(error).__name__}: {error}"[:300]]
        if wrong:
            different += 1
            print(f"seed {seed}: {'; '.join(wrong)}", flush=True)
        if (seed + 1) % 200 == 0:
            jax.clear_caches()
            print(f"{seed + 1 - first} run, {different} different, {time.time() - clock:.0f} s", flush=True)
    print(f"{count} programs run from seed {first}, {different} different")
    return different


if __name__ == "__main__":
    sys.exit(bool(each_seed(in_two_ways, *map(int, sys.argv[1:]))))
