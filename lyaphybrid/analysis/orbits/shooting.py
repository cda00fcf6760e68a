"""Multiple shooting: Newton's method for the points of a periodic orbit, through all jumps on the way.

An orbit of period T is a root of φ_T(x) − x. Multiple shooting cuts it at nodes x_0, …, x_{m−1} and asks that each
piece ends where the next begins, in the same mode. For an autonomous system the period is one more unknown, and
f(x_0)·δx_0 = 0 one more equation, which fixes the phase along the orbit.

Modulo a symmetry the last piece ends at g(x_0, s) instead of x_0. The shift s of a group is one more unknown, and one
more equation fixes the point along the group. A conserved quantity with a wanted value is one equation more than there
are unknowns: it replaces a redundant one, as no direction in the range of M − I changes that quantity.

The same state in the same mode always has the same future, so the cycle of events repeats too. A root of the equations
of states alone may be no orbit: fields continue beyond the guards at which their modes end, and there the motion may
return to a state in another mode.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..._jax.precision import digits
from ...errors import RunFailedError
from ...systems.smooth import Map
from .motion.invariants import steepness_of
from .motion.motions import Motion, MotionPiece, Node, states_of
from .motion.returns import CLOSE_RETURN, close_return
from .motion.sizes import LEAST_SCALE, extents_of, sizes_of, units_of

__all__ = [
    "OrbitIterate",
    "ScaledEquations",
    "linearised",
    "newton",
    "placed",
    "retimed",
    "scaled",
    "shares_of",
    "shot",
    "times_apart",
]

NEWTON_RESIDUAL = 1e-13  # residual, relative to the orbit, at which Newton's method stops
HALVINGS = 8  # trial lengths of a Newton step, each half of the one before
NODE_CLEARANCE = 0.02  # of the period: distance that nodes keep from events where possible


class OrbitIterate(NamedTuple):
    """An iterate of Newton's method."""

    nodes: list[Node]
    pieces: list[MotionPiece]
    period: float
    gap: float  # largest mismatch of states or of conserved values, relative to the sizes of the components
    iterations: int
    shift: np.ndarray  # (q,) element of the group modulo which it closes
    goal: Node  # where the last piece is to end: the first node, or its image
    sizes: np.ndarray  # (n,) largest |x| of each component
    extents: np.ndarray  # (n,) how far each component moves
    units: np.ndarray  # (n,) in which the equations are even

    @property
    def seams(self) -> list[tuple[MotionPiece, Node]]:
        """Each piece with the node at which it is to end."""
        return list(zip(self.pieces, [*self.nodes[1:], self.goal], strict=True))

    @property
    def torn(self) -> list[tuple[int, int]]:
        """Modes (wanted, found) of the pieces that end in another mode than the next one begins in."""
        # A node without a mode gets it from its state: equal states then have equal modes.
        return [(int(node.mode), piece.mode) for piece, node in self.seams if node.mode not in (None, piece.mode)]

    @property
    def residual(self) -> float:
        """The gap; inf where the modes of the pieces do not match."""
        return np.inf if self.torn else self.gap


def placed(flow: Motion, start: Node, period: float, segments: int, *, free: bool = False) -> list[Node]:
    """Nodes along the motion from `start`, away from events.

    `free`: not in modes that hold the motion on a surface, if it leaves them: along a branch the surface may move.
    """
    if isinstance(flow.problem.system, Map):
        return [start]
    whole = flow.piece(start, period * (1 + NODE_CLEARANCE))  # longer, to record an event at the end of the period
    events = np.zeros(0) if whole.events is None else np.unique(whole.events.t % period)
    is_free = functools.partial(_is_free, flow, whole) if free else lambda at: True
    clear = np.sort([_away_from_events(at, events, period, is_free) for at in period * np.arange(segments) / segments])
    clear = clear[
        np.diff(clear, prepend=-period) > NODE_CLEARANCE * period
    ]  # two may have been moved into the same gap
    return [start if at == 0 else flow.piece(start, float(at)).end for at in clear]


def times_apart(times: Any, other: float, period: float) -> Any:
    """How far times of a periodic motion are from one of them."""
    return np.abs((times - other + period / 2) % period - period / 2)


def _is_free(flow: Motion, piece: MotionPiece, at: float) -> bool:
    """Whether nothing holds the motion on a surface at this time."""
    tangent = getattr(flow.problem.system, "tangent", ())
    return not any(tangent) or tangent[piece.modes[np.argmin(np.abs(piece.times - at))]] is None


def _away_from_events(at: float, events: np.ndarray, period: float, is_free: Callable[[float], bool]) -> float:
    """The wanted time, or, if it is near an event or not free, the middle of the next free gap between events."""
    if not len(events):
        return at
    if np.min(times_apart(events, at, period)) > NODE_CLEARANCE * period and is_free(at):
        return at
    after = np.sort((events - at - 1e-9 * period) % period)
    after = after[after > NODE_CLEARANCE * period]
    gaps = np.diff(np.concatenate([[0.0], after, [period]]))
    ends = np.concatenate([after, [period]])
    middles = (at + ends - gaps / 2) % period
    wide = np.flatnonzero(gaps > 2 * NODE_CLEARANCE * period)
    wanted = [i for i in wide if is_free(middles[i])] or wide
    return float(middles[wanted[0] if len(wanted) else int(np.argmax(gaps))])


def newton(flow: Motion, nodes: list[Node], period: float, autonomous: bool, most: int) -> OrbitIterate:
    """Newton's method with step halving; where modes do not match it restarts from the state a period later."""
    orbit = shot(flow, nodes, shares_of(nodes, period), period, 0)
    for iteration in range(1, most + 1):
        if orbit.residual <= digits(NEWTON_RESIDUAL, nodes[0].x):
            break
        trial = _stepped(flow, orbit, period, autonomous, iteration)
        if not _is_less(flow, trial, orbit):
            if not (orbit.torn or trial.torn):
                break
            # A mode ends on the way to the root: it is no orbit, or cannot be reached from here.
            nodes, period = _carried_on(flow, orbit, autonomous)
            trial = shot(flow, nodes, shares_of(nodes, period), period, iteration)
        orbit = trial
    return orbit


def _stepped(flow: Motion, orbit: OrbitIterate, period: float, autonomous: bool, iteration: int) -> OrbitIterate:
    """A Newton step that reduces the residual, with matching modes; if none does, the shortest one tried."""
    shares, trial = shares_of(orbit.nodes, orbit.period), orbit
    steps, change, turn = _newton_step(flow, orbit, shares, autonomous)
    for factor in [0.5**halving for halving in range(HALVINGS)]:
        moved = [flow.moved(node, factor * step) for node, step in zip(orbit.nodes, steps, strict=True)]
        at = orbit.period + factor * change
        if at <= 0.1 * period or at >= 10 * period:
            continue
        try:
            trial = shot(flow, retimed(moved, shares, at), shares, at, iteration, orbit.shift + factor * turn)
        except RunFailedError:
            continue
        if _is_less(flow, trial, orbit):
            break
    return trial


def _is_less(flow: Motion, trial: OrbitIterate, orbit: OrbitIterate) -> bool:
    """Whether modes match and the gap is smaller, both in the sizes before: a smaller orbit alone is no success."""
    return not trial.torn and _gap_in(flow, trial, orbit.sizes) < orbit.gap


def _carried_on(flow: Motion, orbit: OrbitIterate, autonomous: bool) -> tuple[list[Node], float]:
    """New nodes that start at the state and mode after one period; and the period."""
    end = orbit.pieces[-1].end
    again = end._replace(t=orbit.nodes[0].t), orbit.period
    start, period = close_return(flow, end) if autonomous else again
    return placed(flow, start, period, len(orbit.nodes)), period


def shares_of(nodes: list[Node], period: float) -> np.ndarray:
    """The lengths of the pieces, as fractions of the period."""
    times = np.array([node.t for node in nodes])
    return np.diff(np.append(times, times[0] + period)) / period


def retimed(nodes: list[Node], shares, period: float) -> list[Node]:
    """The nodes with their times scaled to another period."""
    times = nodes[0].t + period * np.concatenate([[0.0], np.cumsum(shares)[:-1]])
    return [node._replace(t=float(t)) for node, t in zip(nodes, times, strict=True)]


def shot(flow: Motion, nodes: list[Node], shares, period: float, iteration: int, shift=None) -> OrbitIterate:
    """Run all pieces from the given nodes; a missing shift of the group is found from the motion."""
    nodes = [flow.consistent(node) for node in nodes]
    pieces = [flow.piece(node, float(share * period)) for node, share in zip(nodes, shares, strict=True)]
    points = np.concatenate([*(states_of(piece)[1] for piece in pieces), np.asarray(pieces[-1].x)[None]])
    matrix = functools.reduce(lambda product, piece: piece.matrix @ product, pieces, np.eye(len(nodes[0].x)))
    mixing = flow.mixing(nodes[0], matrix, period)
    sizes = sizes_of(points, mixing, 0.0 if flow.sizes is None else LEAST_SCALE * flow.sizes)
    extents = extents_of(points, sizes)
    if shift is None:
        # The shift is followed along the motion: after a turn by 2π the state is equal, but not the shift.
        shift = flow.apart(nodes[0].x, points, extents)[1][-1]
    scales = sizes, extents, units_of(extents, matrix)
    orbit = OrbitIterate(nodes, pieces, period, np.inf, iteration, shift, flow.goal(nodes[0], shift), *scales)
    return orbit._replace(gap=_gap_in(flow, orbit, sizes))


def _gap_in(flow: Motion, orbit: OrbitIterate, sizes: np.ndarray) -> float:
    """The largest mismatch of states or of conserved values, relative to components of these sizes (n,)."""
    strayed, slopes = flow.strayed(orbit.nodes[0])
    off = np.abs(strayed) / steepness_of(slopes * sizes)
    return float(max(np.max(np.abs(_gaps(orbit)) / sizes), np.max(off, initial=0.0)))


def _gaps(orbit: OrbitIterate) -> np.ndarray:
    """(m, n) differences between the end of each piece and its goal."""
    return np.array([np.asarray(piece.x) - np.asarray(node.x) for piece, node in orbit.seams])


def linearised(
    flow: Motion, orbit: OrbitIterate, shares, autonomous: bool, units: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian of all equations, and their residuals.

    Unknowns: the nodes, the period of an autonomous system, the shift (q,) of the group. Equations: the pieces match,
    the first node moves neither along the orbit nor along the group, as vectors in units (n,), and quantities are
    conserved.
    """
    m, n, q = len(orbit.nodes), len(orbit.nodes[0].x), len(orbit.shift)
    first, strayed = orbit.nodes[0], flow.strayed(orbit.nodes[0])
    rows_of_states, still = m * n, m * n + autonomous + q
    system, gaps = np.zeros((still + len(strayed[0]), still)), np.zeros(still + len(strayed[0]))
    gaps[:rows_of_states] = _gaps(orbit).ravel()
    image = None if flow.symmetry is None else flow.symmetry.image(first.x, orbit.shift)
    for i, piece in enumerate(orbit.pieces):
        rows, after = slice(i * n, (i + 1) * n), (i + 1) % m
        system[rows, rows] += piece.matrix
        system[rows, after * n : (after + 1) * n] -= image.by_state if image is not None and after == 0 else np.eye(n)
        if autonomous:
            system[rows, rows_of_states] = shares[i] * flow.velocity(piece.end)
    if autonomous:
        system[rows_of_states, :n] = flow.velocity(first) / units**2
    if flow.symmetry is not None and image is not None:
        system[rows_of_states - n : rows_of_states, still - q : still] = -image.by_shift
        system[still - q : still, :n] = (flow.symmetry.image(first.x).by_shift / units[:, None] ** 2).T
    gaps[still:], system[still:, :n] = strayed
    return system, gaps


class ScaledEquations(NamedTuple):
    """The linearised equations, their unknowns and they themselves scaled to the size of the orbit."""

    system: np.ndarray
    gaps: np.ndarray
    scales: np.ndarray  # of the unknowns


def scaled(flow: Motion, orbit: OrbitIterate, shares, autonomous: bool) -> ScaledEquations:
    """The equations of `linearised`, in which nothing depends on the units of state and time."""
    # What does not come back, but decays, is no measure of where the first node is along the orbit.
    open_ends = np.max(np.abs(_gaps(orbit)), axis=0)
    system, gaps = linearised(flow, orbit, shares, autonomous, np.maximum(orbit.units, open_ends / CLOSE_RETURN))
    units = np.tile(orbit.units, len(orbit.nodes))
    states = len(units)
    # The columns of the period and of the shift are velocities; their rows are transposed ones.
    lengths = np.linalg.norm(system[:states, states:] / units[:, None], axis=0)
    scales = np.concatenate([units, 1 / np.where(lengths > 0, lengths, 1.0)])
    heights = np.linalg.norm(system[states:, :states] * units, axis=1)
    rows = np.concatenate([units, np.where(heights > 0, heights, 1.0)])
    return ScaledEquations(system * scales / rows[:, None], gaps / rows, scales)


def _newton_step(
    flow: Motion, orbit: OrbitIterate, shares, autonomous: bool
) -> tuple[list[np.ndarray], float, np.ndarray]:
    """The changes of the nodes, of the period and of the shift."""
    m, n = len(orbit.nodes), len(orbit.nodes[0].x)
    # The least-norm solution: in a family of orbits (a block at rest anywhere) the matrix is singular.
    equations = scaled(flow, orbit, shares, autonomous)
    change = np.linalg.lstsq(equations.system, -equations.gaps, rcond=digits(1e-11, orbit.nodes[0].x))[0]
    change = change * equations.scales
    states, shift = change[: m * n].reshape(m, n), change[m * n + autonomous :]
    return list(states), float(change[m * n]) if autonomous else 0.0, shift
