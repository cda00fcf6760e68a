"""heyoka: variational equations by `var_ode_sys`, Taylor series of adaptive order, QR by NumPy between."""

import functools
import types

import heyoka
import numpy as np

from benchmarks.peers import events
from benchmarks.peers.adapters import Bound
from benchmarks.peers.workloads import Workload

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-15)
LARGE = 100  # components
COMPACT = 20  # more equations than so many: compact mode, without which LLVM takes minutes


def variables(n: int) -> list:
    return [heyoka.expression(f"x{i}") for i in range(n)]


def system(workload: Workload):
    """With the derivatives with respect to the first k variables; the state is x, then (n, k) of them by rows."""
    x = variables(workload.n)
    last = () if workload.last is None else (heyoka.par[0],)
    rates = workload.formula(heyoka)(heyoka.time, x, (*workload.parameters, *last))
    equations = [(one, heyoka.expression(rate)) for one, rate in zip(x, rates, strict=True)]
    if workload.forms and workload.forms.dense:
        return equations + by_hand(workload, x)
    return heyoka.var_ode_sys(equations, x[: workload.frame.shape[1]], order=1)


def mean(a: np.ndarray, axis=None):
    """Of symbols (n,), or of each column of (n, k)."""
    return heyoka.sum(list(a)) / len(a) if axis is None else np.array([mean(column) for column in a.T])


def by_hand(workload: Workload, x: list) -> list:
    """The variational equation where its sums are worth more than `var_ode_sys`, which multiplies them out."""
    functions = {name: np.vectorize(getattr(heyoka, name), otypes=[object]) for name in ("sin", "cos")}
    symbols = types.SimpleNamespace(mean=mean, **functions)
    n, k = workload.frame.shape
    columns = np.array(heyoka.make_vars(*(f"v{i}" for i in range(n * k)))).reshape(n, k)
    rates = workload.forms.tangent(symbols)(heyoka.time, np.array(x), workload.p, columns)
    return list(zip(columns.ravel(), rates.ravel(), strict=True))


def bound(workload: Workload, **how) -> Bound:
    start = np.concatenate([workload.start, workload.frame.ravel()])
    (n, k), every = workload.frame.shape, workload.every
    equations = system(workload)

    @functools.cache
    def integrator(tolerance):
        compact = n * (k + 1) > COMPACT
        return heyoka.taylor_adaptive(equations, start, tol=tolerance, compact_mode=compact, **how)

    def run(tolerance, length, last=workload.last):
        integrate = integrator(tolerance)
        integrate.time, integrate.state[:], growth = 0.0, start, np.zeros(k)
        integrate.pars[:] = last
        if workload.event:
            integrate.reset_cooldowns()
        columns = integrate.state[n:].reshape(n, k)  # a view
        for i in range(round(length / every)):
            integrate.propagate_until((i + 1) * every)
            columns[:], r = np.linalg.qr(columns)
            growth += np.log(np.abs(np.diagonal(r)))
        return growth / length

    chosen = TOLERANCES if n < LARGE else TOLERANCES[1::2]  # each compiles, for seconds
    return Bound({f"taylor {tolerance:.0e}": tolerance for tolerance in chosen}, run, typical=len(chosen) // 2)


def with_events(workload: Workload) -> Bound:
    """A terminal event; its callback multiplies by the saltation matrix."""
    event, (n, k) = workload.event, workload.frame.shape
    rhs = events.variational_equation(workload, k)

    def cross(integrate, d_sgn):
        t, state, last = integrate.time, integrate.state, integrate.pars[0]
        before = rhs(t, state, last)[:n]
        state[event.guard] = 0.0
        state[:n] *= event.reset
        state[n:] = events.crossed(
            state[n:].reshape(n, k), before, rhs(t, state, event.beyond(last))[:n], event
        ).ravel()
        integrate.pars[0] = event.beyond(last)
        return True

    direction = heyoka.event_direction.any if event.flips else heyoka.event_direction.positive
    crossing = heyoka.t_event(variables(n)[event.guard], direction=direction, callback=cross)
    return bound(workload, t_events=[crossing])


def flow_sweep(workload: Workload) -> Bound:
    """As many points at once as its batch mode recommends, one batch after the other."""
    equations, width, sweep, every = system(workload), heyoka.recommended_simd_size(), workload.sweep, workload.every
    (n, k), start = workload.frame.shape, np.concatenate([workload.start, workload.frame.ravel()])

    @functools.cache
    def integrator(tolerance):
        state = np.repeat(start[:, None], width, axis=1)
        return heyoka.taylor_adaptive_batch(equations, state, tol=tolerance, pars=np.zeros((1, width)))

    def run(tolerance, count):
        integrate, values, found = integrator(tolerance), sweep.values(count), []
        for i in range(0, len(values), width):
            integrate.set_time(0.0)
            integrate.state[:], growth = start[:, None], np.zeros((width, k))
            integrate.pars[:] = np.resize(values[i : i + width], width)
            for j in range(round(sweep.t1 / every)):
                integrate.propagate_until((j + 1) * every)
                columns = integrate.state[n:].reshape(n, k, width)
                q, r = np.linalg.qr(np.moveaxis(columns, 2, 0))
                columns[:] = np.moveaxis(q, 0, 2)
                growth += np.log(np.abs(np.diagonal(r, axis1=1, axis2=2)))
            found.append(growth / sweep.t1)
        return np.concatenate(found)[: len(values)].ravel()

    return Bound({f"taylor {tolerance:.0e}": tolerance for tolerance in TOLERANCES}, run, typical=3)


def impact_sweep(workload: Workload) -> Bound:
    """A run after the other."""
    single, sweep = with_events(workload), workload.sweep

    def run(tolerance, count):
        return np.concatenate([single.run(tolerance, sweep.t1, value) for value in sweep.values(count)])

    return single._replace(run=run)


KINDS = {
    "flow": bound,
    "stiff": bound,
    "impact": with_events,
    "friction": with_events,
    "flow_sweep": flow_sweep,
    "impact_sweep": impact_sweep,
}
