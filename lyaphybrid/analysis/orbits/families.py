"""Families of periodic orbits, which exist where a quantity is conserved.

In a family the equations of an orbit are singular: no direction in the range of M − I changes the conserved quantity.
At a fold they are singular too. To tell them apart, a neighbouring orbit is computed: only a family has one.
"""

import numpy as np

from ..._jax.precision import digits
from ...errors import RunFailedError
from .invariants import Conserved, energies_of
from .shooting import LEAST_SCALE, Motion, Node, OrbitIterate, linearised, retimed, shares_of, shot, states_of

__all__ = ["energy_moved", "family_of"]

FAMILY_SINGULAR_VALUE = 1e-6  # singular values below this fraction of the largest, or of 1, may mean a family
NEIGHBOUR_DISTANCE = 5e-3  # of the orbit's extent: distance to the neighbouring orbit
CLOSES = 1e-9  # residual of an orbit; next to a fold about NEIGHBOUR_DISTANCE² would remain, at a pitchfork its cube
NEWTON_ITERATIONS = 6
ENERGY_CHANGED = 1e-6  # of the start's size: a larger change, as a distance of states, means another energy


def family_of(flow: Motion, orbit: OrbitIterate, autonomous: bool, known: int | None = None) -> np.ndarray:
    """The directions (n, f) from the first node to other orbits, except along the flow or a group.

    With their number `known` no neighbouring orbit is computed.
    """
    flow, n = flow._replace(conserved=None), len(orbit.nodes[0].x)
    none = np.zeros((n, 0))
    if not orbit.residual <= digits(CLOSES, orbit.nodes[0].x):
        return none
    system, scales = _scaled(flow, orbit, autonomous)
    if not np.all(np.isfinite(system)):
        return none
    _, singular, right = np.linalg.svd(system)
    if known is not None:
        return np.column_stack([none, *(v[:n] for v in right[len(right) - known :])])
    small = digits(FAMILY_SINGULAR_VALUE, orbit.nodes[0].x) * max(1.0, singular[0])
    found = [v for v, size in zip(right, singular, strict=True) if size < small]
    return np.column_stack([none, *(v[:n] for v in found if _goes_on(flow, orbit, autonomous, v, scales))])


def _scaled(flow: Motion, orbit: OrbitIterate, autonomous: bool) -> tuple[np.ndarray, np.ndarray]:
    """The linearised equations, all unknowns scaled to lengths; and the scales."""
    system = linearised(flow, orbit, shares_of(orbit.nodes, orbit.period), autonomous)[0]
    states = len(orbit.nodes) * len(orbit.nodes[0].x)
    # The columns of the period and of the shift are velocities; their rows are the transposed ones.
    lengths = np.linalg.norm(system[:, states:], axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    scales = np.concatenate([np.ones(states), 1 / lengths])
    rows = np.linalg.norm(system[states:], axis=1)
    return system * scales / np.concatenate([np.ones(states), np.where(rows > 0, rows, 1.0)])[:, None], scales


def _goes_on(flow: Motion, orbit: OrbitIterate, autonomous: bool, along: np.ndarray, scales: np.ndarray) -> bool:
    """Whether there is another orbit in this direction of the unknowns."""
    n, m = len(orbit.nodes[0].x), len(orbit.nodes)
    change = NEIGHBOUR_DISTANCE * _extent(orbit) * np.sqrt(m) * along
    trial, shares = orbit, shares_of(orbit.nodes, orbit.period)
    try:
        for _ in range(NEWTON_ITERATIONS):
            values = change * scales
            steps, rest = values[: m * n].reshape(m, n), values[m * n :]
            moved = [flow.moved(node, step) for node, step in zip(trial.nodes, steps, strict=True)]
            period = trial.period + (float(rest[0]) if autonomous else 0.0)
            shift = trial.shift + rest[int(autonomous) :]
            trial = shot(flow, retimed(moved, shares, period), shares, period, 0, shift)
            if trial.residual <= digits(CLOSES, orbit.nodes[0].x):
                return True
            system, gaps = linearised(flow, trial, shares, autonomous)
            change = np.linalg.lstsq(np.vstack([system * scales, along]), np.append(-gaps, 0.0))[0]
    except RunFailedError:
        return False
    return False


def _extent(orbit: OrbitIterate) -> float:
    """The largest extent of an orbit in a component; for a single point its distance from 0."""
    states = np.concatenate([states_of(piece)[1] for piece in orbit.pieces])
    across, away = float(np.max(np.ptp(states, axis=0))), float(np.max(np.abs(states)))
    return across if across > LEAST_SCALE * away else away or 1.0


def energy_moved(flow: Motion, start: Node, end: Node) -> bool:
    """Whether the energy, if the system knows one, differs from that of the start."""
    args, energies = flow.problem.args, energies_of(flow.problem.system)
    if not energies or None in energies:
        return False
    wanted = Conserved(energies, np.zeros(1)).value(flow.mode(start), start.x, args)
    strayed = Conserved(energies, wanted).strayed(flow.mode(end), end.x, args)[0]
    return bool(np.max(np.abs(strayed)) > digits(ENERGY_CHANGED, start.x) * np.max(np.abs(start.x)))
