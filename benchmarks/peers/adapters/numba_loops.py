"""Loops as users of numba write them: one step of the variational equation, steps to a time, QR by Gram–Schmidt."""

import math

import numba
import numpy as np

from benchmarks.peers.workloads import Workload

NODES = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
STAGES = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
ERROR = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


def slopes(workload: Workload):
    """``rhs(t, y, last, out)`` of the state and the columns (n, k) by rows, from the formulas."""
    (n, k), p = workload.frame.shape, workload.parameters
    if workload.forms:
        loop = numba.njit(workload.forms.loop(n, k, p))
        return numba.njit(lambda t, y, last, out: loop(t, y, out))
    field, jacobian = numba.njit(workload.formula(math)), numba.njit(workload.jacobian(math))

    longer = workload.last is not None

    @numba.njit
    def rhs(t, y, last, out):
        args = p + (last,) if longer else p
        rates, matrix = field(t, y, args), jacobian(t, y, args)
        for i in range(n):
            out[i] = rates[i]
            for c in range(k):
                out[n + i * k + c] = 0.0
                for j in range(n):
                    out[n + i * k + c] += matrix[i][j] * y[n + j * k + c]

    return rhs


def rk4(rhs, size: int):
    """``step(t, y, h, new, …) -> 0``: no error is known."""

    @numba.njit
    def step(t, y, h, new, rtol, last, stages):
        rhs(t, y, last, stages[0])
        for i in range(size):
            new[i] = y[i] + h / 2 * stages[0, i]
        rhs(t + h / 2, new, last, stages[1])
        for i in range(size):
            new[i] = y[i] + h / 2 * stages[1, i]
        rhs(t + h / 2, new, last, stages[2])
        for i in range(size):
            new[i] = y[i] + h * stages[2, i]
        rhs(t + h, new, last, stages[3])
        for i in range(size):
            new[i] = y[i] + h / 6 * (stages[0, i] + 2 * stages[1, i] + 2 * stages[2, i] + stages[3, i])
        return 0.0

    return step


def dopri5(rhs, size: int):
    """``step(t, y, h, new, …) -> error``, in units of the tolerance; the first stage is the last one of before."""

    @numba.njit
    def step(t, y, h, new, rtol, last, stages):
        rhs(t, y, last, stages[0])
        for s in range(1, 7):
            for i in range(size):
                new[i] = y[i]
            for r in range(s):
                for i in range(size):
                    new[i] += h * STAGES[s, r] * stages[r, i]
            rhs(t + NODES[s] * h, new, last, stages[s])
        square = 0.0
        for i in range(size):
            error = 0.0
            for s in range(7):
                error += ERROR[s] * stages[s, i]
            square += (h * error / (rtol * (1e-2 + max(abs(y[i]), abs(new[i]))))) ** 2
        return math.sqrt(square / size)

    return step


def gram_schmidt(n: int, k: int):
    """``orthonormalise(y, growth)``: the columns in place, ln of their lengths added."""

    @numba.njit
    def orthonormalise(y, growth):
        for c in range(k):
            for b in range(c):
                dot = 0.0
                for i in range(n):
                    dot += y[n + i * k + b] * y[n + i * k + c]
                for i in range(n):
                    y[n + i * k + c] -= dot * y[n + i * k + b]
            square = 0.0
            for i in range(n):
                square += y[n + i * k + c] ** 2
            length = math.sqrt(square)
            growth[c] += math.log(length)
            for i in range(n):
                y[n + i * k + c] /= length

    return orthonormalise


@numba.njit
def next_step(h, error, fixed):
    """The usual controller of a method of order five; without an error the step is fixed."""
    if error == 0.0:
        return fixed
    return h * min(5.0, max(0.2, 0.9 * error ** (-0.2)))


def smooth(workload: Workload, method):
    """``run(y, last, rtol, h, count) -> growth``: `count` intervals, QR after each."""
    (n, k), every = workload.frame.shape, workload.every
    size = n * (k + 1)
    step, orthonormalise = method(slopes(workload), size), gram_schmidt(n, k)

    @numba.njit
    def run(y, last, rtol, h, count):
        growth, new, stages, fixed = np.zeros(k), np.empty(size), np.empty((7, size)), h
        for interval in range(count):
            t, end = interval * every, (interval + 1) * every
            while t < end - 1e-12:
                taken = min(h, end - t)
                error = step(t, y, taken, new, rtol, last, stages)
                if error <= 1.0:
                    t += taken
                    y[:] = new
                if error > 1.0 or taken == h:
                    h = next_step(taken, error, fixed)
            orthonormalise(y, growth)
        return growth

    return run


def with_events(workload: Workload, method):
    """The same with an event: a step that ends behind it is shortened until it ends there."""
    (n, k), every = workload.frame.shape, workload.every
    guard, reset, flips = workload.event.guard, np.array(workload.event.reset), workload.event.flips
    rhs, size = slopes(workload), n * (k + 1)
    step, orthonormalise = method(rhs, size), gram_schmidt(n, k)

    @numba.njit
    def land(t, y, h, new, rtol, last, stages):
        """The length of the step that ends at the event, by the secant method kept within a bracket."""
        low, high, below, above, taken = 0.0, h, y[guard], new[guard], h
        for _ in range(60):
            taken = low - below * (high - low) / (above - below)
            step(t, y, taken, new, rtol, last, stages)
            if abs(new[guard]) < 1e-15 or high - low < 1e-15:
                break
            if new[guard] * above > 0.0:
                high, above, below = taken, new[guard], below / 2
            else:
                low, below, above = taken, new[guard], above / 2
        return taken

    @numba.njit
    def cross(t, y, last, before, after):
        rhs(t, y, last, before)
        y[guard] = 0.0
        for i in range(n):
            y[i] *= reset[i]
        rhs(t, y, -last if flips else last, after)
        for c in range(k):
            at_guard = y[n + guard * k + c] / before[guard]
            for i in range(n):
                at = n + i * k + c
                y[at] = reset[i] * y[at] + (after[i] - reset[i] * before[i]) * at_guard

    @numba.njit
    def run(y, last, rtol, h, count):
        growth, new, stages, fixed = np.zeros(k), np.empty(size), np.empty((7, size)), h
        for interval in range(count):
            t, end = interval * every, (interval + 1) * every
            while t < end - 1e-12:
                taken, side = min(h, end - t), -last if flips else 1.0
                error = step(t, y, taken, new, rtol, last, stages)
                if error > 1.0:
                    h = next_step(taken, error, fixed)
                elif new[guard] * side > 0.0 and y[guard] == 0.0:  # a flight within the step
                    h = taken / 2
                elif new[guard] * side > 0.0:
                    t += land(t, y, taken, new, rtol, last, stages)
                    y[:] = new
                    cross(t, y, last, stages[0], stages[1])
                    last = -last if flips else last
                    orthonormalise(y, growth)
                else:
                    t += taken
                    y[:] = new
                    if taken == h:
                        h = next_step(taken, error, fixed)
            orthonormalise(y, growth)
        return growth

    return run
