"""Systems with one event, a component that passes zero; and the pendulum with dry friction, converged."""

import math

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.peers.workloads import Event, Workload

RTOL, ATOL, NEWTON = 1e-13, 1e-15, 4


def crossed(columns: np.ndarray, before, after, event: Event) -> np.ndarray:
    """The columns (n, k) after the event, by the saltation matrix; `before` and `after` are the rates of the state."""
    reset = np.array(event.reset)
    jump = np.array(after) - reset * before
    return reset[:, None] * columns + np.outer(jump, columns[event.guard]) / before[event.guard]


def variational_equation(workload: Workload, k: int):
    """``rhs(t, y, last)`` of state and columns as one vector."""
    field, jacobian, n, p = workload.formula(math), workload.jacobian(math), workload.n, workload.parameters

    def rhs(t, y, last):
        x, args = y[:n].tolist(), (*p, last)
        return np.concatenate([field(t, x, args), (np.array(jacobian(t, x, args)) @ y[n:].reshape(n, k)).ravel()])

    return rhs


def friction_growth(workload: Workload, columns: np.ndarray) -> np.ndarray:
    """Σ ln R_ii over the short length; the velocity only passes zero (it must not stick)."""
    (n, k), event, sign = columns.shape, workload.event, workload.last
    rhs, t, growth = variational_equation(workload, k), 0.0, np.zeros(k)
    x = np.array(workload.start)
    while t < workload.short:
        begun, y = t, np.concatenate([x, columns.ravel()])
        t = _event_time(rhs, workload, begun, y, sign)
        y = _flown(rhs, begun, y, sign, t)
        x, columns = y[:n], y[n:].reshape(n, k)
        if t < workload.short:
            x[event.guard] = 0.0
            before, after = (rhs(t, y, s)[:n] for s in (sign, -sign))
            assert before[event.guard] * after[event.guard] > 0.0, "it sticks"
            columns, sign = crossed(columns, before, after, event), -sign
        columns, r = np.linalg.qr(columns)
        growth += np.log(np.abs(np.diagonal(r)))
    return growth


def _flown(rhs, t, y, sign, end):
    return solve_ivp(rhs, (t, end), y, "DOP853", rtol=RTOL, atol=ATOL, args=(sign,)).y[:, -1] if end > t else y


def _event_time(rhs, workload: Workload, t, y, sign) -> float:
    """When the guard passes zero, or the end: first by dense output, then by Newton's method on the flow itself."""
    guard = workload.event.guard

    def event(t, y, sign):
        return y[guard]

    event.terminal, event.direction = True, -sign
    flight = solve_ivp(rhs, (t, workload.short), y, "DOP853", events=event, rtol=RTOL, atol=ATOL, args=(sign,))
    if flight.status != 1:
        return workload.short
    end = float(flight.t[-1])
    for _ in range(NEWTON):
        there = _flown(rhs, t, y, sign, end)
        end -= there[guard] / rhs(end, there, sign)[guard]
    return end
