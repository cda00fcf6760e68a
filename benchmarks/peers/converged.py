"""Converged exponents, by SciPy: DOP853 at 1e-13 and QR, Radau where stiff, closed form for impacts.

Exponents of a finite time depend on the columns at the start, not on when they are orthonormalised.
"""

import math

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.peers.disks import converged_growth
from benchmarks.peers.events import friction_growth
from benchmarks.peers.impacts import impact_growth
from benchmarks.peers.workloads import Workload

ATOL = 1e-15
METHODS = {"flow": ("DOP853", 1e-13), "stiff": ("Radau", 1e-12)}  # with the relative tolerance


def exponents(workload: Workload, columns: np.ndarray) -> np.ndarray:
    """Over the short length, from these columns (n, k); descending (k,); of a sweep those of all points."""
    if workload.sweep:
        each = [exponents(workload.at(value), columns) for value in workload.sweep.values(workload.short)]
        return np.sort(np.concatenate(each))[::-1]
    growth = GROWTH[workload.kind](workload, columns)
    return np.sort(growth / workload.short)[::-1]


def flow_growth(workload: Workload, columns: np.ndarray) -> np.ndarray:
    """Σ ln R_ii of the variational equation."""
    (n, k), count = columns.shape, round(workload.short / workload.every)
    variational, (method, rtol) = variational_equation(workload, k), METHODS[workload.kind]
    x, growth = np.array(workload.start, float), np.zeros(k)
    for i in range(count):
        span = (i * workload.every, (i + 1) * workload.every)
        y = np.concatenate([x, columns.ravel()])
        y = solve_ivp(variational, span, y, method=method, rtol=rtol, atol=ATOL).y[:, -1]
        x, (columns, r) = y[:n], np.linalg.qr(y[n:].reshape(n, k))
        growth += np.log(np.abs(np.diagonal(r)))
    return growth


def variational_equation(workload: Workload, k: int):
    """State and k columns as one vector, as a user of SciPy writes it."""
    n, p = workload.n, workload.p
    if workload.forms:
        array, tangent = workload.forms.array(np), workload.forms.tangent(np)
        return lambda t, y: np.concatenate([array(t, y[:n], p), tangent(t, y[:n], p, y[n:].reshape(n, k)).ravel()])
    field, jacobian = workload.formula(math), workload.jacobian(math)

    def variational(t, y):
        x = y[:n].tolist()
        return np.concatenate([field(t, x, p), (np.array(jacobian(t, x, p)) @ y[n:].reshape(n, k)).ravel()])

    return variational


def map_growth(workload: Workload, columns: np.ndarray) -> np.ndarray:
    """Σ ln R_ii of the derivative along the orbit."""
    rule, jacobian = workload.formula(math), workload.jacobian(math)
    x, growth = workload.start, np.zeros(columns.shape[1])
    for _ in range(round(workload.short)):
        columns, r = np.linalg.qr(np.array(jacobian(0.0, x, workload.parameters)) @ columns)
        growth += np.log(np.abs(np.diagonal(r)))
        x = rule(0.0, x, workload.parameters)
    return growth


GROWTH = {
    "flow": flow_growth,
    "stiff": flow_growth,
    "map": map_growth,
    "impact": impact_growth,
    "friction": friction_growth,
    "disks": converged_growth,
}
