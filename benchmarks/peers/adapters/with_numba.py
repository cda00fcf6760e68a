"""numba: loops written by hand (`numba_loops`), compiled at the first call."""

import functools
import math

import numba
import numpy as np

from benchmarks.peers.adapters import Bound, numba_disks, numba_loops
from benchmarks.peers.workloads import Workload

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


def stepping(workload: Workload, loop) -> Bound:
    """`loop` makes the compiled function of a method."""
    compiled, every = functools.cache(lambda method: loop(workload, method)), workload.every

    def run(setting, length):
        method, rtol, steps = setting
        y = np.concatenate([workload.start, workload.frame.ravel()])
        return compiled(method)(y, workload.last or 0.0, rtol, every / steps, round(length / every)) / length

    ladder = {f"rk4 1/{steps}": (numba_loops.rk4, 0.0, steps) for steps in workload.steps}
    ladder |= {f"dopri5 {rtol:.0e}": (numba_loops.dopri5, rtol, 1000) for rtol in TOLERANCES}
    return Bound(ladder, run, typical=len(workload.steps) + 3)


def swept(loop):
    """Points on all threads."""

    def swept(workload: Workload) -> Bound:
        single, every, k = stepping(workload, loop), workload.every, workload.frame.shape[1]
        count, start = round(workload.sweep.t1 / every), np.concatenate([workload.start, workload.frame.ravel()])

        @functools.cache
        def compiled(method):
            one = loop(workload, method)

            @numba.njit(parallel=True)
            def all_points(values, rtol, h):
                found = np.empty((len(values), k))
                for i in numba.prange(len(values)):
                    found[i] = one(start.copy(), values[i], rtol, h, count)
                return found

            return all_points

        def run(setting, count):
            method, rtol, steps = setting
            found = compiled(method)(workload.sweep.values(count), rtol, every / steps)
            return found.ravel() / workload.sweep.t1

        return single._replace(run=run)

    return swept


def flow(workload: Workload) -> Bound:
    return stepping(workload, numba_loops.smooth)


def with_events(workload: Workload) -> Bound:
    return stepping(workload, numba_loops.with_events)


def iterated(workload: Workload) -> Bound:
    rule, jacobian = numba.njit(workload.formula(math)), numba.njit(workload.jacobian(math))
    (n, k), p = workload.frame.shape, workload.p
    orthonormalise = numba_loops.gram_schmidt(n, k)

    @numba.njit
    def growth(x, columns, count):
        y, total = np.empty(n + n * k), np.zeros(k)
        for _ in range(count):
            matrix = jacobian(0, x, p)
            for i in range(n):
                for c in range(k):
                    y[n + i * k + c] = 0.0
                    for j in range(n):
                        y[n + i * k + c] += matrix[i][j] * columns[j, c]
            orthonormalise(y, total)
            columns[:] = y[n:].reshape(n, k)
            x = rule(0, x, p)
        return total

    def run(_, length):
        return growth(workload.start, workload.frame.copy(), round(length)) / length

    return Bound({"exact": None}, run)


def disks(workload: Workload) -> Bound:
    loop = numba_disks.loop(workload.frame.shape[1])

    def run(_, length):
        return loop(np.concatenate([workload.start, workload.frame.ravel()]), length) / length

    return Bound({"exact": None}, run)


KINDS = {
    "flow": flow,
    "stiff": flow,
    "map": iterated,
    "impact": with_events,
    "friction": with_events,
    "flow_sweep": swept(numba_loops.smooth),
    "impact_sweep": swept(numba_loops.with_events),
    "disks": disks,
}
