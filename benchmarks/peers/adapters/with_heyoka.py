"""heyoka: variational equations by `var_ode_sys`, Taylor series of adaptive order, QR by NumPy between."""

import functools

import heyoka
import numpy as np

from benchmarks.peers import events
from benchmarks.peers.adapters import Bound
from benchmarks.peers.workloads import Workload

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-15)
COMPACT = 20  # more equations than so many: compact mode, without which LLVM takes minutes


def variables(n: int) -> list:
    return [heyoka.expression(f"x{i}") for i in range(n)]


def system(workload: Workload):
    """With the derivatives with respect to the first k variables; the state is x, then (n, k) of them by rows."""
    x = variables(workload.n)
    sign = (heyoka.par[0],) if workload.event else ()
    rates = workload.formula(heyoka)(heyoka.time, x, (*workload.parameters, *sign))
    equations = [(one, heyoka.expression(rate)) for one, rate in zip(x, rates, strict=True)]
    return heyoka.var_ode_sys(equations, x[: workload.frame.shape[1]], order=1)


def bound(workload: Workload, **how) -> Bound:
    start = np.concatenate([workload.start, workload.frame.ravel()])
    (n, k), every = workload.frame.shape, workload.every
    equations = system(workload)

    @functools.cache
    def integrator(tolerance):
        compact = n * (k + 1) > COMPACT
        return heyoka.taylor_adaptive(equations, start, tol=tolerance, compact_mode=compact, **how)

    def run(tolerance, length):
        integrate = integrator(tolerance)
        integrate.time, integrate.state[:], growth = 0.0, start, np.zeros(k)
        if workload.event:
            integrate.pars[:] = workload.sign
            integrate.reset_cooldowns()
        columns = integrate.state[n:].reshape(n, k)  # a view
        for i in range(round(length / every)):
            integrate.propagate_until((i + 1) * every)
            columns[:], r = np.linalg.qr(columns)
            growth += np.log(np.abs(np.diagonal(r)))
        return growth / length

    return Bound({f"taylor {tolerance:.0e}": tolerance for tolerance in TOLERANCES}, run, typical=3)


def with_events(workload: Workload) -> Bound:
    """A terminal event; its callback multiplies by the saltation matrix. The sign is a parameter of the integrator."""
    event, (n, k) = workload.event, workload.frame.shape
    rhs = events.variational_equation(workload, k)

    def cross(integrate, d_sgn):
        t, state, sign = integrate.time, integrate.state, integrate.pars[0] if event.flips else 0.0
        before = rhs(t, state, sign)[:n]
        state[event.guard] = 0.0
        state[:n] *= event.reset
        state[n:] = events.crossed(state[n:].reshape(n, k), before, rhs(t, state, -sign)[:n], event).ravel()
        integrate.pars[:] *= -1.0
        return True

    direction = heyoka.event_direction.any if event.flips else heyoka.event_direction.positive
    crossing = heyoka.t_event(variables(n)[event.guard], direction=direction, callback=cross)
    return bound(workload, t_events=[crossing])


KINDS = {"flow": bound, "stiff": bound, "impact": with_events, "friction": with_events}
