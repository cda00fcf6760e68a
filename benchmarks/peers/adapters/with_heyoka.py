"""heyoka: variational equations by `var_ode_sys`, Taylor series of adaptive order, QR by NumPy between."""

import functools

import heyoka
import numpy as np

from benchmarks.peers.adapters import Bound
from benchmarks.peers.workloads import Workload

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-15)
COMPACT = 20  # more equations than so many: compact mode, without which LLVM takes minutes


def variables(n: int) -> list:
    return [heyoka.expression(f"x{i}") for i in range(n)]


def system(workload: Workload):
    """With the derivatives with respect to the first k variables; the state is x, then (n, k) of them by rows."""
    x = variables(workload.n)
    rates = workload.formula(heyoka)(heyoka.time, x, workload.parameters)
    equations = [(one, heyoka.expression(rate)) for one, rate in zip(x, rates, strict=True)]
    return heyoka.var_ode_sys(equations, x[: workload.frame.shape[1]], order=1)


def bound(workload: Workload, **events) -> Bound:
    start = np.concatenate([workload.start, workload.frame.ravel()])
    (n, k), every = workload.frame.shape, workload.every
    equations = system(workload)

    @functools.cache
    def integrator(tolerance):
        compact = n * (k + 1) > COMPACT
        return heyoka.taylor_adaptive(equations, start, tol=tolerance, compact_mode=compact, **events)

    def run(tolerance, length):
        integrate = integrator(tolerance)
        integrate.time, integrate.state[:], growth = 0.0, start, np.zeros(k)
        if events:
            integrate.reset_cooldowns()
        columns = integrate.state[n:].reshape(n, k)  # a view
        for i in range(round(length / every)):
            integrate.propagate_until((i + 1) * every)
            columns[:], r = np.linalg.qr(columns)
            growth += np.log(np.abs(np.diagonal(r)))
        return growth / length

    return Bound({f"taylor {tolerance:.0e}": tolerance for tolerance in TOLERANCES}, run, typical=3)


def impact(workload: Workload) -> Bound:
    """The wall is a terminal event; its callback multiplies by the saltation matrix."""
    zeta, omega, restitution = workload.parameters

    def rebound(integrate, d_sgn):
        state, before = integrate.state, integrate.state[1]
        drive = np.cos(omega * integrate.time)
        state[0], state[1] = 0.0, -restitution * before
        accelerations = [drive - 2.0 * zeta * v for v in (before, state[1])]
        columns = state[2:].reshape(2, 2)
        turned = (accelerations[1] + restitution * accelerations[0]) / before
        columns[1] = turned * columns[0] - restitution * columns[1]
        columns[0] *= -restitution
        return True

    wall = heyoka.t_event(variables(1)[0], direction=heyoka.event_direction.positive, callback=rebound)
    return bound(workload, t_events=[wall])


KINDS = {"flow": bound, "impact": impact}
