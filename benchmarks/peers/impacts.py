"""The oscillator with impacts in closed form: x'' + 2ζx' + x = cos ωt, x ≤ 0, at the wall v → -r v."""

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from benchmarks.peers.workloads import Workload

LOOK = 1e-3  # between looks at the wall; no flight of these parameters is as short


class Flight:
    """The motion between two impacts, from (t, x)."""

    def __init__(self, t: float, x: np.ndarray, zeta: float, omega: float):
        self.t, self.zeta, self.omega = t, zeta, omega
        self.matrix = np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]])
        # the periodic solution Re(c exp(iωt)), its velocity Re(iωc exp(iωt))
        self.amplitude = 1.0 / (1.0 - omega**2 + 2j * zeta * omega)
        self.free = x - self.periodic(t)

    def periodic(self, t: float) -> np.ndarray:
        turning = self.amplitude * np.exp(1j * self.omega * t)
        return np.array([turning.real, (1j * self.omega * turning).real])

    def transition(self, t: float) -> np.ndarray:
        """The fundamental matrix from the start of the flight."""
        return expm(self.matrix * (t - self.t))

    def state(self, t: float) -> np.ndarray:
        return self.periodic(t) + self.transition(t) @ self.free

    def impact(self, end: float) -> float | None:
        """When the wall is reached before the end."""
        damped = np.sqrt(1.0 - self.zeta**2)
        times = np.append(np.arange(self.t + LOOK, end, LOOK), end)
        s, (x, v) = times - self.t, self.free
        swing = x * np.cos(damped * s) + (v + self.zeta * x) / damped * np.sin(damped * s)
        places = (self.amplitude * np.exp(1j * self.omega * times)).real + np.exp(-self.zeta * s) * swing
        beyond = np.flatnonzero(places > 0.0)
        if not beyond.size:
            return None
        after = times[beyond[0]]
        return brentq(lambda t: self.state(t)[0], after - LOOK, after, xtol=1e-15, rtol=1e-15)


def impact_growth(workload: Workload, columns: np.ndarray) -> np.ndarray:
    """Σ ln R_ii over the short length."""
    (zeta, omega), restitution = workload.p, -workload.event.reset[1]
    reset = np.diag([1.0, -restitution])
    t, x, growth = 0.0, np.array(workload.start), np.zeros(columns.shape[1])
    while t < workload.short:
        flight = Flight(t, x, zeta, omega)
        impact = flight.impact(workload.short)
        t = workload.short if impact is None else impact
        before = flight.state(t)
        columns, x = flight.transition(t) @ columns, before
        if impact is not None:
            x = np.array([0.0, -restitution * before[1]])
            acceleration = [np.cos(omega * t) - 2.0 * zeta * v for v in (before[1], x[1])]
            jump = np.array([x[1], acceleration[1]]) - reset @ np.array([before[1], acceleration[0]])
            columns = reset @ columns + np.outer(jump, columns[0]) / before[1]
        columns, r = np.linalg.qr(columns)
        growth += np.log(np.abs(np.diagonal(r)))
    return growth
