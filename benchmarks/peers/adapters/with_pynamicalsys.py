"""pynamicalsys: `lyapunov` with QR, its own models where it has them, else functions compiled by numba."""

import numba
import numpy as np
import pynamicalsys
from pynamicalsys.common.linalg import qr

from benchmarks.peers.adapters import Bound
from benchmarks.peers.workloads import Workload

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
MODELS = {
    "lorenz": "lorenz system",
    "rossler": "rossler system",
    "henon_heiles": "henon heiles",
    "henon_map": "henon map",
    "standard_map": "standard map",
}
ORDER = {"lorenz": (0, 2, 1)}  # of its parameters, where it is another
SEED, SEED_OF_MAPS = 13, 1312  # the defaults; for maps it cannot be chosen


@numba.njit
def drawn(seed, n, k, low, high):
    """What `lyapunov` draws by this seed."""
    np.random.seed(seed)  # noqa: NPY002
    return qr(low + (high - low) * np.random.rand(n, k))[0]  # noqa: NPY002


def system_of(workload: Workload):
    """Its own model, or one by loops: its Jacobian is what they do to the identity."""
    if workload.forms is None:
        return pynamicalsys.ContinuousDynamicalSystem(model=MODELS[workload.formula.__name__])
    n, p = workload.n, workload.p
    alone, together = (numba.njit(workload.forms.loop(n, k, p)) for k in (0, n))

    @numba.njit
    def field(t, u, parameters):
        rates = np.empty(n)
        alone(t, u, rates)
        return rates

    @numba.njit
    def jacobian(t, u, parameters):
        y, rates = np.zeros(n + n * n), np.empty(n + n * n)
        y[:n] = u
        y[n :: n + 1] = 1.0
        together(t, y, rates)
        return rates[n:].reshape(n, n)

    how = {"system_dimension": n, "number_of_parameters": len(p)}
    return pynamicalsys.ContinuousDynamicalSystem(equations_of_motion=field, jacobian=jacobian, **how)


def flow(workload: Workload) -> Bound:
    (n, k), system, p = workload.frame.shape, system_of(workload), workload.p
    parameters = [p[i] for i in ORDER.get(workload.formula.__name__, range(len(p)))]

    def run(setting, length):
        system.integrator(setting[0], **setting[1])
        how = {"parameters": parameters or None, "num_exponents": k, "seed": SEED, "endpoint": False}
        return np.atleast_1d(system.lyapunov(workload.start, length, **how))

    ladder = {f"rk4 1/{steps}": ("rk4", {"time_step": workload.every / steps}) for steps in workload.steps}
    ladder |= {f"rk45 {rtol:.0e}": ("rk45", {"rtol": rtol, "atol": 1e-2 * rtol}) for rtol in TOLERANCES}
    return Bound(ladder, run, drawn(SEED, n, k, -1.0, 1.0), typical=len(workload.steps) // 2)


def iterated(workload: Workload) -> Bound:
    """It takes the derivative after it has moved on: its start is the point whose image is the start."""
    system = pynamicalsys.DiscreteDynamicalSystem(model=MODELS[workload.formula.__name__])
    start = workload.before(workload.start, workload.p)

    def run(method, length):
        return system.lyapunov(start, round(length), parameters=workload.p, method=method)

    return Bound({"QR": "QR"}, run, drawn(SEED_OF_MAPS, *workload.frame.shape, 0.0, 1.0))


KINDS = {"flow": flow, "map": iterated}
