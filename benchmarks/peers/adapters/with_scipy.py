"""SciPy as its users write it: `solve_ivp` of the variational equation, NumPy's QR between, events by `events=`."""

import math

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.peers.adapters import Bound
from benchmarks.peers.converged import variational_equation
from benchmarks.peers.workloads import Workload

TOLERANCES = {"RK45": (1e-4, 1e-6), "DOP853": (1e-5, 1e-7, 1e-9, 1e-11)}
LADDER = {f"{method} {rtol:.0e}": (method, rtol) for method, rtols in TOLERANCES.items() for rtol in rtols}


def orthonormalised(columns, growth):
    """Q; ln R_ii is added to the growth."""
    q, r = np.linalg.qr(columns)
    growth += np.log(np.abs(np.diagonal(r)))
    return q


def flow(workload: Workload) -> Bound:
    (n, k), every = workload.frame.shape, workload.every
    variational = variational_equation(workload, k)

    def run(setting, length):
        method, rtol = setting
        growth, y = np.zeros(k), np.concatenate([workload.start, workload.frame.ravel()])
        for i in range(round(length / every)):
            y = solve_ivp(variational, (i * every, (i + 1) * every), y, method, rtol=rtol, atol=1e-2 * rtol).y[:, -1]
            y[n:] = orthonormalised(y[n:].reshape(n, k), growth).ravel()
        return growth / length

    return Bound(LADDER, run, typical=4)


def iterated(workload: Workload) -> Bound:
    rule, jacobian, p = workload.formula(math), workload.jacobian(math), workload.parameters

    def run(_, length):
        x, q, growth = workload.start, workload.frame, np.zeros(workload.n)
        for _ in range(round(length)):
            q = orthonormalised(np.array(jacobian(0, x, p)) @ q, growth)
            x = rule(0, x, p)
        return growth / length

    return Bound({"exact": None}, run)


def impact(workload: Workload) -> Bound:
    """A flight ends at the wall, or after ten units of time; then QR."""
    zeta, omega, restitution = workload.parameters
    variational, reset, longest = variational_equation(workload, 2), np.diag([1.0, -restitution]), 10.0

    def wall(t, y):
        return y[0]

    wall.terminal, wall.direction = True, 1

    def run(setting, length):
        method, rtol = setting
        t, growth, y = 0.0, np.zeros(2), np.concatenate([workload.start, workload.frame.ravel()])
        while t < length:
            span = (t, min(t + longest, length))
            flight = solve_ivp(variational, span, y, method, events=wall, rtol=rtol, atol=1e-2 * rtol)
            t, y = flight.t[-1], flight.y[:, -1]
            columns = y[2:].reshape(2, 2)
            if flight.status == 1:
                before = variational(t, y)[:2]
                y[:2] = 0.0, -restitution * y[1]
                jump = variational(t, y)[:2] - reset @ before
                columns = reset @ columns + np.outer(jump, columns[0]) / before[0]
            y[2:] = orthonormalised(columns, growth).ravel()
        return growth / length

    return Bound(LADDER, run, typical=4)


KINDS = {"flow": flow, "map": iterated, "impact": impact}
