"""The adaptive exponential neuron as a map from spike to spike: its exponents without saltation matrices or frames.

Reset to V_r, only w is free: w⁺ = Φ(w) after the time T(w). With Φ' from the variational equation the exponents of the
flow are 0 and ⟨ln|Φ'|⟩ / ⟨T⟩. Integrated by RK4, first in an arc length of V, then, where V runs away, over V itself:
the spike has no last step there.
"""

import numpy as np
from scipy.interpolate import CubicSpline

RUNS_AWAY = -38.0  # mV: from here on V only grows
STEP = 0.05  # of the arc length
STEPS = 100  # of V, from peak to peak
GRID = np.linspace(30.0, 160.0, 261)  # pA


def _rk4(rate, y, h):
    a = rate(y)
    b = rate(y + h / 2 * a)
    c = rate(y + h / 2 * b)
    return y + h / 6 * (a + 2 * b + 2 * c + rate(y + h * c))


def _rates(p, v, w):
    upstroke = np.exp((v - p["threshold"]) / p["slope"])
    leak = p["conductance"] * (v - p["rest"])
    dv = (p["conductance"] * p["slope"] * upstroke - leak - w + p["current"]) / p["capacitance"]
    dw = (p["a"] * (v - p["rest"]) - w) / p["adaptation_time"]
    return dv, dw, p["conductance"] * (upstroke - 1) / p["capacitance"]


def _in_arc_length(p, y):
    """(V, w, t, δV, δw)."""
    v, w, _, v_moved, w_moved = y
    dv, dw, slope = _rates(p, v, w)
    rates = [
        dv,
        dw,
        np.ones_like(v),
        slope * v_moved - w_moved / p["capacitance"],
        (p["a"] * v_moved - w_moved) / p["adaptation_time"],
    ]
    return np.stack(rates) / (1 + np.abs(dv) / 4)


def _over_v(p, y):
    """(V, w, t, δw at the same V)."""
    v, w, _, w_moved = y
    dv, dw, _ = _rates(p, v, w)
    bend = -1 / (p["adaptation_time"] * dv) + dw / (dv**2 * p["capacitance"])
    return np.stack([np.ones_like(v), dw / dv, 1 / dv, bend * w_moved])


def spike_maps(p: dict, peaks, w) -> list[np.ndarray]:
    """For each peak (ascending) the rows Φ(w), Φ'(w) and T(w); p as in `zoo.adex`, its current may be an array."""
    v = np.full_like(w, p["reset"])
    y = np.stack([v, w, 0 * w, 0 * w, 1 + 0 * w])
    while np.any(y[0] < RUNS_AWAY):
        y = np.where(y[0] < RUNS_AWAY, _rk4(lambda y: _in_arc_length(p, y), y, STEP), y)
    dv, dw, _ = _rates(p, y[0], y[1])
    y, found = np.stack([*y[:3], y[4] - dw / dv * y[3]]), []
    for peak in peaks:
        h = (peak - y[0]) / STEPS
        for _ in range(STEPS):
            y = _rk4(lambda y: _over_v(p, y), y, h)
        found.append(np.stack([y[1] + p["b"], y[3], y[2]]))
    return found


def exponents(p: dict, currents, peaks, *, start: float, lanes: int = 64, transient: int = 1000, spikes: int = 4000):
    """The exponent ⟨ln|Φ'|⟩ / ⟨T⟩ and its standard error, each (currents, peaks).

    Args:
        p: parameters of `zoo.adex`.
        currents: of which.
        peaks: ascending.
        start: w of the first reset; the lanes start next to it.
        lanes: orbits.
        transient: spikes that are not counted.
        spikes: that are.
    """
    p = p | {"current": np.asarray(currents)[:, None]}
    maps = np.stack(spike_maps(p, peaks, np.broadcast_to(GRID, (len(currents), GRID.size))))
    table = CubicSpline(GRID, maps, axis=-1).c  # (4, cells, peaks, 3, currents)
    table = np.transpose(table, (4, 2, 1, 0, 3)).reshape(-1, 4, 3)  # of all cells, one map after the other
    first = (GRID.size - 1) * np.arange(len(currents) * len(peaks))[:, None]
    w = np.broadcast_to(start + np.linspace(0, 1e-3, lanes), (len(first), lanes))
    growth, time = np.zeros((2, *w.shape))
    for n in range(transient + spikes):
        cell = np.clip(((w - GRID[0]) / (GRID[1] - GRID[0])).astype(int), 0, GRID.size - 2)
        along, (a, b, c, d) = (w - GRID[cell])[..., None], np.moveaxis(table[first + cell], 2, 0)
        w, slope, interval = np.moveaxis(((a * along + b) * along + c) * along + d, 2, 0)
        if n >= transient:
            growth, time = growth + np.log(np.abs(slope)), time + interval
    each = (growth / time).reshape(len(currents), len(peaks), lanes)
    return np.mean(each, axis=-1), np.std(each, axis=-1, ddof=1) / lanes**0.5
