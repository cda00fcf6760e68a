"""Exponents of stiff flows by explicit and by implicit steps: ``python -m benchmarks.stiff [--only NAME …]``.

CPU seconds of second calls, the shortest of six, and how often a step was tried. All at the tolerance 1e-8.
"""

import argparse
import contextlib
import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh
from lyaphybrid.engine.host import driver

ROUNDS = 6  # the first ones may run code that LLVM has only translated


def van_der_pol(t, x, args):
    """With μ = 1000."""
    return jnp.stack([x[1], 1000.0 * (1 - x[0] ** 2) * x[1] - x[0]])


def oregonator(t, x, args):
    """R. J. Field & R. M. Noyes, J. Chem. Phys. 60 (1974) 1877, doi:10.1063/1.1681288."""
    a, b, c = x
    return jnp.stack([77.27 * (b - a * b + a - 8.375e-6 * a**2), (c - b - a * b) / 77.27, 0.161 * (a - c)])


def robertson(t, x, args):
    """E. Hairer & G. Wanner, Solving ODEs II (1996), (IV.1.4), doi:10.1007/978-3-642-05221-7."""
    slow, fast = 0.04 * x[0] - 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
    return jnp.stack([-slow, slow - fast, fast])


FLOWS = {  # field, start, length
    "van_der_pol": (lh.Flow(van_der_pol), [2.0, 0.0], 3000.0),
    "oregonator": (lh.Flow(oregonator), [1.0, 2.0, 3.0], 320.0),
    "robertson": (lh.Flow(robertson), [1.0, 0.0, 0.0], 100.0),
}
IMPLICIT = {"Radau IIA": lh.RadauIIA(1e-8), "ESDIRK54b": lh.ESDIRK("esdirk54b", 1e-8)}


class Measured(NamedTuple):
    """One method on one flow."""

    seconds: float  # of CPU time
    attempts: int
    exponents: np.ndarray  # (k,)


def methods(k: int) -> dict[str, lh.RungeKutta | lh.RadauIIA | lh.ESDIRK | lh.ContinuousQR]:
    """What is compared for k exponents."""
    implicit = IMPLICIT if k == 1 else {f"continuous, {name}": lh.ContinuousQR(one) for name, one in IMPLICIT.items()}
    return {"explicit": lh.RungeKutta(rtol=1e-8, atol=1e-8), **implicit}


@contextlib.contextmanager
def counted() -> Iterator[list[int]]:
    """The attempts of each call of the compiled loop within."""
    advance, counts = driver._advance, []

    class Counting:
        ahead, ended = staticmethod(advance.ahead), staticmethod(advance.ended)

        def __call__(self, problem, plan, loop_state, ends, last_jumps, budget):
            found = advance(problem, plan, loop_state, ends, last_jumps, budget)
            counts.append(int(budget) - int(found[0].carry.budget))
            return found

    driver._advance = Counting()
    try:
        yield counts
    finally:
        driver._advance = advance


def measure(name: str, k: int, method) -> Measured:
    """A method on a flow."""
    system, start, length = FLOWS[name]

    def run():
        return lh.lyapunov_spectrum(system, start, t1=length, k=k, method=method, blocks=2)

    with counted() as counts:
        found = run()
    taken = []
    for _ in range(ROUNDS):
        before = time.process_time()
        run()
        taken.append(time.process_time() - before)
    return Measured(min(taken), sum(counts), np.asarray(found.exponents))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=FLOWS, default=list(FLOWS))
    chosen = parser.parse_args().only
    jax.config.update("jax_enable_x64", True)
    print(f"{'flow':12} {'k':>2} {'method':22} {'CPU s':>8} {'attempts':>9}  exponents")
    for name in chosen:
        for k in (1, len(FLOWS[name][1])):
            for label, method in methods(k).items():
                found = measure(name, k, method)
                values = " ".join(f"{value:.10g}" for value in found.exponents)
                print(f"{name:12} {k:2} {label:22} {found.seconds:8.3f} {found.attempts:9}  {values}", flush=True)


if __name__ == "__main__":
    main()
