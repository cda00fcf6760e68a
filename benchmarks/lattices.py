"""Disordered lattices in C: how `c/lattices.c` is called, from the start and with the method of the zoo's problem."""

import numpy as np

from benchmarks import references
from benchmarks.references import Result

NAMES = ("klein_gordon", "schroedinger_lattice")


def columns(n: int, k: int) -> np.ndarray:
    """(2n, k) orthonormal deviation vectors that see all sites."""
    return np.linalg.qr(np.random.default_rng(7).normal(size=(2 * n, k)))[0]


def run_lattice(name: str, n: int, k: int, every: int, t1: float) -> Result:
    """A lattice up to t1, with k columns that are orthonormalised after each `every` steps and at the end."""
    from lyaphybrid import zoo
    from lyaphybrid.integrators.hamiltonian.splittings import SCHEMES

    problem = zoo.get(name)(n=n)
    args, method = problem.args, problem.method
    x, frame, sums = np.array(problem.x0), np.ascontiguousarray(columns(n, k)), np.zeros(k)
    parts = SCHEMES[method.scheme].parts if name == "klein_gordon" else method.parts
    moves, shares = (np.array(row) for row in zip(*parts, strict=True))
    common = (n, k, round(t1 / method.dt), every, method.dt, len(parts))
    if name == "klein_gordon":
        site = (shares, args["stiffness"], 1 / args["disorder"], args["nonlinearity"])
        steps = references.library().klein_gordon(*common, *site, x, frame, sums)
    else:
        site = (moves, shares, args["disorder"] * args["levels"], args["nonlinearity"])
        steps = references.library().schroedinger(*common, *site, x, frame, sums)
    return Result(sums, x, steps * method.dt, steps, frame=frame)
