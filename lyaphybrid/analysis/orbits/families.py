"""Families of periodic orbits, which exist where a quantity is conserved.

In a family the equations of an orbit are singular: no direction in the range of M − I changes the conserved quantity.
At a fold they are singular too. To tell them apart, a neighbouring orbit is computed: only a family has one.
"""

import numpy as np

from ..._jax.precision import digits
from ...errors import RunFailedError
from ...systems.kinds import iterates
from .motion.invariants import Conserved, energies_of
from .motion.motions import Motion, Node
from .periods import uses_time
from .shooting import OrbitIterate, retimed, scaled, shares_of, shot

__all__ = ["apart_from_shifts", "energy_moved", "family_of", "shifts_in_time"]

FAMILY_SINGULAR_VALUE = 1e-6  # singular values below this fraction of the largest, or of 1, may mean a family
NEIGHBOUR_DISTANCE = 5e-3  # of the orbit's extent: distance to the neighbouring orbit
CLOSES = 1e-9  # residual of an orbit; next to a fold about NEIGHBOUR_DISTANCE² would remain, at a pitchfork its cube
NEWTON_ITERATIONS = 6
ALONG_FLOW = 1e-6  # 1 − cos of the angle between the velocity and a direction of the family, at most
ENERGY_CHANGED = 1e-6  # of the start's size: a larger change, as a distance of states, means another energy


def family_of(flow: Motion, orbit: OrbitIterate, autonomous: bool, known: int | None = None) -> np.ndarray:
    """The directions (n, f) from the first node to other orbits, except along the flow or a group.

    With their number `known` no neighbouring orbit is computed.
    """
    flow, n = flow._replace(conserved=None), len(orbit.nodes[0].x)
    none = np.zeros((n, 0))
    if not orbit.residual <= digits(CLOSES, orbit.nodes[0].x):
        return none
    equations = scaled(flow, orbit, shares_of(orbit.nodes, orbit.period), autonomous)
    if not np.all(np.isfinite(equations.system)):
        return none
    _, singular, right = np.linalg.svd(equations.system)
    units = orbit.units
    if known is not None:
        return np.column_stack([none, *(units * v[:n] for v in right[len(right) - known :])])
    small = digits(FAMILY_SINGULAR_VALUE, orbit.nodes[0].x) * max(1.0, singular[0])
    found = [v for v, size in zip(right, singular, strict=True) if size < small]
    return np.column_stack(
        [none, *(units * v[:n] for v in found if _goes_on(flow, orbit, autonomous, v, equations.scales))]
    )


def _goes_on(flow: Motion, orbit: OrbitIterate, autonomous: bool, along: np.ndarray, scales: np.ndarray) -> bool:
    """Whether there is another orbit in this direction of the unknowns."""
    n, m = len(orbit.nodes[0].x), len(orbit.nodes)
    off = np.abs(along[: m * n].reshape(m, n)) * orbit.units / orbit.extents
    change = NEIGHBOUR_DISTANCE / max(float(np.max(off)), np.finfo(float).tiny) * along
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
            system, gaps, own = scaled(flow, trial, shares, autonomous)
            change = np.linalg.lstsq(np.vstack([system * scales / own, along]), np.append(-gaps, 0.0))[0]
    except RunFailedError:
        return False
    return False


def shifts_in_time(flow: Motion, orbit: OrbitIterate) -> bool:
    """Whether the orbit, begun later, is one too: nothing depends on time, and it does not rest."""
    system, base, args = flow.problem.system, orbit.nodes[0], flow.problem.args
    if iterates(system) or uses_time(system, base.x, args):
        return False
    speed = np.linalg.norm(flow.velocity(base) / orbit.units) * orbit.period
    return bool(speed > digits(CLOSES, base.x))


def apart_from_shifts(flow: Motion, orbit: OrbitIterate, family: np.ndarray) -> np.ndarray:
    """The family (n, f) of an orbit whose period was given, without its own shift in time, if that is one of it."""
    if not family.shape[1] or not shifts_in_time(flow, orbit):
        return family
    along = flow.velocity(orbit.nodes[0]) / orbit.units
    along = along / np.linalg.norm(along)
    basis = np.linalg.qr(family / orbit.units[:, None])[0]
    if np.linalg.norm(basis.T @ along) < 1 - digits(ALONG_FLOW, orbit.nodes[0].x):
        return family
    left, _, _ = np.linalg.svd(basis - np.outer(along, along @ basis))
    return left[:, : family.shape[1] - 1] * orbit.units[:, None]


def energy_moved(flow: Motion, start: Node, end: Node, sizes: np.ndarray) -> bool:
    """Whether the energy, if the system knows one, differs from that of the start; components have sizes (n,)."""
    args, energies = flow.problem.args, energies_of(flow.problem.system)
    if not energies or None in energies:
        return False
    wanted = Conserved(energies, np.zeros(1)).value(flow.mode(start), start.x, args)
    strayed, slopes = Conserved(energies, wanted).strayed(flow.mode(end), end.x, args)
    steepness = np.linalg.norm(slopes * sizes, axis=1)
    return bool(np.any(np.abs(strayed) > digits(ENERGY_CHANGED, start.x) * steepness))
