"""Whether an event-driven system keeps its promises: no event destroys a direction, dq∧dp is conserved."""

from typing import Any

import numpy as np

from ..._jax.precision import is_short
from ...systems.event_driven import EventDriven
from ..trajectories import Trajectory, tangent_map
from .report import Finding, right, wrong

__all__ = ["check_promises"]

EVENTS = 8  # looked at, the first ones of the trial run
LARGEST_STATE = 64  # components; larger ones would take too long
DESTROYED = 1e-13  # a direction that grows by less than this, relative to the one that grows most, is destroyed
LARGEST_DEFECT = 1e-7  # of MᵀJM − J, relative to the terms that add up to it: far above what rounding leaves


def check_promises(system: Any, args: Any, run: Trajectory, start: tuple) -> list[Finding]:
    """What the first events of a run from `start`, (t, x), do to directions and to dq∧dp; not of a schedule."""
    t, x = start
    promises = isinstance(system, EventDriven) and (system.canonical or system.invertible)
    times = np.append(np.asarray(run.events.t), float(run.t[-1])) - float(t)
    if not promises or system.schedule is not None or np.size(x) > LARGEST_STATE or is_short(x):
        return []
    between = np.mean([times[:-1], times[1:]], axis=0)  # after each event, before the next
    lengths = between[between > 0][:EVENTS].tolist()
    before = np.eye(len(x))
    for length in lengths:
        matrix = np.asarray(tangent_map(system, x, args, t0=float(t), t1=length, throw=False).matrix)
        if not np.all(np.isfinite(matrix)):  # the run ended before; what is said of that is said elsewhere
            break
        until = float(t) + length
        growth = np.linalg.svd(np.linalg.solve(before.T, matrix.T), compute_uv=False)
        if growth[-1] < DESTROYED * growth[0]:
            return [wrong("promises", _DESTROYED.format("canonical" if system.canonical else "invertible", until))]
        defect = _defect(matrix) if system.canonical else 0.0
        if defect > LARGEST_DEFECT:
            return [wrong("promises", _NO_PAIRS.format(until, defect))]
        before = matrix
    pairs = ", and conserve dq∧dp" if system.canonical else ""
    return [right("promises", f"the first {len(lengths)} events destroy no direction{pairs}")] if lengths else []


def _defect(matrix: np.ndarray) -> float:
    """By how much dq∧dp changes, relative to the terms of MᵀJM."""
    half = len(matrix) // 2
    form = np.block([[np.zeros((half, half)), np.eye(half)], [-np.eye(half), np.zeros((half, half))]])
    terms = np.abs(matrix.T) @ np.abs(form) @ np.abs(matrix)
    return float(np.max(np.abs(matrix.T @ form @ matrix - form) / (terms + np.max(np.abs(matrix)))))


_DESTROYED = (
    "{0}=True promises that no event destroys a direction, and one is destroyed before t = {1:.6g}: an exponent of −∞ "
    "would be finite. Leave {0}=True out."
)
_NO_PAIRS = (
    "canonical=True promises x = (q, p) with dq∧dp conserved; until t = {:.6g} it changes by {:.1e} of its terms. Of "
    "several masses p are momenta, not velocities."
)
