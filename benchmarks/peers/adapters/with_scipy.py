"""SciPy as its users write it: `solve_ivp` of the variational equation, NumPy's QR between, events by `events=`."""

import math

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.peers import disks, events
from benchmarks.peers.adapters import Bound
from benchmarks.peers.converged import variational_equation
from benchmarks.peers.workloads import Workload

TOLERANCES = {"RK45": (1e-4, 1e-6), "DOP853": (1e-5, 1e-7, 1e-9, 1e-11)}
LADDER = {f"{method} {rtol:.0e}": (method, rtol) for method, rtols in TOLERANCES.items() for rtol in rtols}

IMPLICIT = {f"{method} {rtol:.0e}": (method, rtol) for method in ("Radau", "LSODA") for rtol in (1e-4, 1e-7, 1e-10)}


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


def stiff(workload: Workload) -> Bound:
    """Implicit, with the Jacobian of the variational equation by differences."""
    return flow(workload)._replace(ladder=IMPLICIT, typical=1)


def iterated(workload: Workload) -> Bound:
    rule, jacobian, p = workload.formula(math), workload.jacobian(math), workload.parameters

    def run(_, length):
        x, q, growth = workload.start, workload.frame, np.zeros(workload.n)
        for _ in range(round(length)):
            q = orthonormalised(np.array(jacobian(0, x, p)) @ q, growth)
            x = rule(0, x, p)
        return growth / length

    return Bound({"exact": None}, run)


def with_events(workload: Workload) -> Bound:
    """A flight ends at the event, or after ten units of time; then QR."""
    event, (n, k), longest = workload.event, workload.frame.shape, 10.0
    rhs = events.variational_equation(workload, k)

    def run(setting, length):
        method, rtol = setting
        t, growth, y = 0.0, np.zeros(k), np.concatenate([workload.start, workload.frame.ravel()])
        last = workload.last

        def reached(t, y, last):
            return y[event.guard]

        reached.terminal = True
        while t < length:
            reached.direction = -last if event.flips else 1
            how = {"events": reached, "rtol": rtol, "atol": 1e-2 * rtol, "args": (last,)}
            flight = solve_ivp(rhs, (t, min(t + longest, length)), y, method, **how)
            t, y = flight.t[-1], flight.y[:, -1]
            columns = y[n:].reshape(n, k)
            if flight.status == 1:
                before = rhs(t, y, last)[:n]
                y[event.guard] = 0.0
                y[:n] *= event.reset
                last = event.beyond(last)
                columns = events.crossed(columns, before, rhs(t, y, last)[:n], event)
            y[n:] = orthonormalised(columns, growth).ravel()
        return growth / length

    return Bound(LADDER, run, typical=4)


def four_disks(workload: Workload) -> Bound:
    def orthonormalise(columns):
        q, r = np.linalg.qr(columns)
        return q, np.diagonal(r)

    def run(_, length):
        return disks.growth(np.array(workload.start), workload.frame, length, orthonormalise) / length

    return Bound({"exact": None}, run)


KINDS = {
    "flow": flow,
    "map": iterated,
    "stiff": stiff,
    "impact": with_events,
    "friction": with_events,
    "disks": four_disks,
}
