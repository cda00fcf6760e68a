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
    """``rhs(t, y, out)`` of the state and the columns (n, k) by rows, from the formulas."""
    field, jacobian = numba.njit(workload.formula(math)), numba.njit(workload.jacobian(math))
    (n, k), p = workload.frame.shape, workload.parameters

    @numba.njit
    def rhs(t, y, out):
        rates, matrix = field(t, y, p), jacobian(t, y, p)
        for i in range(n):
            out[i] = rates[i]
            for c in range(k):
                out[n + i * k + c] = 0.0
                for j in range(n):
                    out[n + i * k + c] += matrix[i][j] * y[n + j * k + c]

    return rhs


def rk4(rhs, size: int):
    """``step(t, y, h, new) -> 0``: no error is known."""

    @numba.njit
    def step(t, y, h, new, rtol, stages):
        rhs(t, y, stages[0])
        for i in range(size):
            new[i] = y[i] + h / 2 * stages[0, i]
        rhs(t + h / 2, new, stages[1])
        for i in range(size):
            new[i] = y[i] + h / 2 * stages[1, i]
        rhs(t + h / 2, new, stages[2])
        for i in range(size):
            new[i] = y[i] + h * stages[2, i]
        rhs(t + h, new, stages[3])
        for i in range(size):
            new[i] = y[i] + h / 6 * (stages[0, i] + 2 * stages[1, i] + 2 * stages[2, i] + stages[3, i])
        return 0.0

    return step


def dopri5(rhs, size: int):
    """``step(t, y, h, new) -> error``, in units of the tolerance; the first stage is the last one of before."""

    @numba.njit
    def step(t, y, h, new, rtol, stages):
        rhs(t, y, stages[0])
        for s in range(1, 7):
            for i in range(size):
                new[i] = y[i]
            for r in range(s):
                for i in range(size):
                    new[i] += h * STAGES[s, r] * stages[r, i]
            rhs(t + NODES[s] * h, new, stages[s])
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
    """``run(y, rtol, h, count) -> growth``: `count` intervals, QR after each."""
    (n, k), every = workload.frame.shape, workload.every
    size = n * (k + 1)
    step, orthonormalise = method(slopes(workload), size), gram_schmidt(n, k)

    @numba.njit
    def run(y, rtol, h, count):
        growth, new, stages, fixed = np.zeros(k), np.empty(size), np.empty((7, size)), h
        for interval in range(count):
            t, end = interval * every, (interval + 1) * every
            while t < end - 1e-12:
                taken = min(h, end - t)
                error = step(t, y, taken, new, rtol, stages)
                if error <= 1.0:
                    t += taken
                    y[:] = new
                if error > 1.0 or taken == h:
                    h = next_step(taken, error, fixed)
            orthonormalise(y, growth)
        return growth

    return run


def with_impacts(workload: Workload, method):
    """The same with a wall at zero, v → -r v: a step that ends behind it is shortened until it ends there."""
    zeta, omega, restitution = workload.parameters
    rhs, every, size = slopes(workload), workload.every, 6
    step, orthonormalise = method(rhs, size), gram_schmidt(2, 2)

    @numba.njit
    def land(t, y, h, new, rtol, stages):
        """The length of the step that ends at the wall, by the secant method kept within a bracket."""
        low, high, below, above = 0.0, h, y[0], new[0]
        taken = h
        for _ in range(60):
            taken = low - below * (high - low) / (above - below)
            step(t, y, taken, new, rtol, stages)
            if abs(new[0]) < 1e-15 or high - low < 1e-15:
                break
            if new[0] > 0.0:
                high, above, below = taken, new[0], below / 2
            else:
                low, below, above = taken, new[0], above / 2
        return taken

    @numba.njit
    def rebound(t, y, before, after):
        rhs(t, y, before)
        y[0], y[1] = 0.0, -restitution * y[1]
        rhs(t, y, after)
        turned = (after[1] + restitution * before[1]) / before[0]
        for c in range(2):
            y[4 + c] = turned * y[2 + c] - restitution * y[4 + c]
            y[2 + c] *= -restitution

    @numba.njit
    def run(y, rtol, h, count):
        growth, new, stages, fixed = np.zeros(2), np.empty(size), np.empty((7, size)), h
        for interval in range(count):
            t, end = interval * every, (interval + 1) * every
            while t < end - 1e-12:
                taken = min(h, end - t)
                error = step(t, y, taken, new, rtol, stages)
                if error > 1.0:
                    h = next_step(taken, error, fixed)
                elif new[0] > 0.0 and y[0] == 0.0:  # from the wall to behind it: a flight within the step
                    h = taken / 2
                elif new[0] > 0.0:
                    t += land(t, y, taken, new, rtol, stages)
                    y[:] = new
                    rebound(t, y, stages[0], stages[1])
                    orthonormalise(y, growth)
                else:
                    t += taken
                    y[:] = new
                    if taken == h:
                        h = next_step(taken, error, fixed)
            orthonormalise(y, growth)
        return growth

    return run
