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

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compiled
from ..._jax.precision import digits
from ..._jax.tracing import array, as_jax
from ...engine import problems
from ...engine.host import driver
from ...engine.host.places import account, place_of
from ...errors import NoPeriodicOrbitError, RunFailedError
from ...statuses import STATUS
from ...systems.consistency import put_on_constraints
from ...systems.daes.semi_linear import Constrained, fields_of
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid, disarmed
from ...systems.smooth import Map
from .invariants import Conserved
from .symmetries import Symmetry

__all__ = [
    "Motion",
    "Node",
    "SAMPLES_PER_PIECE",
    "OrbitIterate",
    "MotionPiece",
    "close_return",
    "linearised",
    "newton",
    "placed",
    "retimed",
    "shares_of",
    "shot",
    "states_of",
    "times_apart",
    "velocity",
]

NEWTON_RESIDUAL = 1e-13  # residual, relative to the orbit, at which Newton's method stops
LEAST_SCALE = 1e-6  # least scale of an orbit, which may be the origin itself
HALVINGS = 8  # trial lengths of a Newton step, each half of the one before
NODE_CLEARANCE = 0.02  # of the period: distance that nodes keep from events where possible
CLOSE_RETURN = 0.1  # of the orbit's size: largest distance of a close return
DOUBLINGS = 14  # doublings of the time in which a return is searched
LONG = 100.0  # the first time is no longer than this times that in which the velocity changes
SAMPLES_PER_PIECE = 1000  # recorded points of a piece
EVENT_LOG_ROWS = 1024  # events that one compiled call can record; a full log is emptied and the run goes on


class Node(NamedTuple):
    """A point of an orbit."""

    t: float
    x: Any  # (n,)
    mode: Any  # index; None: the state determines it
    without: tuple[int, int] | None = None  # transition, entry of its guard: what the piece from here does not feel


class MotionPiece(NamedTuple):
    """The motion over a length of time from a node."""

    start: Node
    length: float
    x: Any  # (n,) state at the end
    mode: int  # at the end
    matrix: np.ndarray  # (n, n) dx(end)/dx(start), jumps included
    jumps: int
    times: np.ndarray  # (samples,) since the start
    points: np.ndarray  # (samples, n)
    modes: np.ndarray  # (samples,)
    events: Any  # columns as in `states.EventLog`, times since the start

    @property
    def end(self) -> Node:
        """The point at the end."""
        return Node(self.start.t + self.length, self.x, self.mode)


class OrbitIterate(NamedTuple):
    """An iterate of Newton's method."""

    nodes: list[Node]
    pieces: list[MotionPiece]
    period: float
    gap: float  # largest mismatch of states or of conserved values, relative to the orbit
    iterations: int
    shift: np.ndarray  # (q,) element of the group modulo which it closes
    goal: Node  # where the last piece is to end: the first node, or its image

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


@compiled(hands_on=True)
def velocity(system, t, x, args, mode: int):
    """Dx/dt (n,) in a mode."""
    return fields_of(system)[mode](t, x, args)


class Motion(NamedTuple):
    """Motion of a point and its tangents, with the symmetry and the conserved values of its orbits."""

    problem: problems.RunProblem
    symmetry: Symmetry | None = None
    conserved: Conserved | None = None
    samples: int = SAMPLES_PER_PIECE

    def problem_from(self, node: Node) -> problems.RunProblem:
        """The problem of the piece from a node."""
        if node.without is None:
            return self.problem
        return self.problem._replace(system=disarmed(self.problem.system, *node.without))

    def piece(self, node: Node, length: float) -> MotionPiece:
        """Run the system from a node over a length of time."""
        x0, discrete = as_jax(np.asarray(node.x)), isinstance(self.problem.system, Map)
        hybrid, problem = isinstance(self.problem.system, Hybrid | EventDriven), self.problem_from(node)
        plan = problems.RunPlan(log=EVENT_LOG_ROWS * hybrid, collect=problems.point)
        t0, ends = array(node.t, x0.dtype), length * np.arange(1, self.samples + 1) / self.samples
        ends = array(np.arange(1, length + 1) if discrete else ends, x0.dtype)
        frame = np.eye(len(x0), dtype=x0.dtype)
        loop_state = driver.start(problem, plan, t0, x0, frame, node.mode, 1.0)
        outcome = driver.drive(problem, plan, loop_state, ends, ends)
        status, matrix = STATUS(int(outcome.status)), np.asarray(outcome.loop_state.carry.frame)
        where, why = f"On a piece of length {length:.6g} from t = {node.t:.6g}: ", outcome.why
        if status == STATUS.interrupted:  # of an orbit in parts nothing can be told
            raise KeyboardInterrupt
        if status == STATUS.ok and not np.all(np.isfinite(matrix)):
            status, where = STATUS.nonfinite, where + "its derivative by its start is not finite. "
        if status != STATUS.ok:
            stood = account(status, place_of(outcome.loop_state, self.problem.system), why=why)
            raise RunFailedError(status, where + stood, None)
        carry, (t, x, modes, _) = outcome.loop_state.carry, outcome.records.collected
        logs = jax.tree.map(lambda *parts: np.concatenate(parts), *outcome.logs) if hybrid else None
        logs = None if logs is None else logs._replace(t=logs.t - node.t)
        shown = np.asarray(t) - node.t, np.asarray(x), np.asarray(modes)
        return MotionPiece(node, length, carry.x, int(problems.mode_of(carry)), matrix, int(carry.jumps), *shown, logs)

    def velocity(self, node: Node) -> np.ndarray:
        """Dx/dt at a point."""
        problem = self.problem
        return np.asarray(velocity(problem.system, array(node.t, node.x.dtype), node.x, problem.args, self.mode(node)))

    def _field(self, node: Node):
        return fields_of(self.problem.system)[self.mode(node)]

    def degrees_of_freedom(self, node: Node) -> int:
        """The number of degrees of freedom at a point."""
        if isinstance(self.problem.system, Map):
            return len(node.x)
        return getattr(self._field(node), "n_differential", len(node.x))

    def consistent(self, node: Node) -> Node:
        """The point with the same E₁ x that satisfies the constraints of its mode."""
        if isinstance(self.problem.system, Map) or not isinstance(self._field(node), Constrained):
            return node
        t = jnp.asarray(node.t, node.x.dtype)
        return node._replace(x=put_on_constraints(self._field(node), t, node.x, self.problem.args))

    def moved(self, node: Node, dx) -> Node:
        """The point moved by dx, projected onto the tangent space of its mode; without a fixed mode not projected."""
        system, dx = self.problem.system, as_jax(np.asarray(dx, node.x.dtype))
        onto = system.tangent[node.mode] if isinstance(system, Hybrid) and node.mode is not None else None
        if onto is not None:
            dx = onto(jnp.asarray(node.t, node.x.dtype), node.x, self.problem.args, dx)
        return node._replace(x=as_jax(np.add(node.x, dx)))

    def apart(self, x, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances of points (samples, n) from x or its nearest image; the shifts (samples, q) of the group."""
        if self.symmetry is None:
            return np.linalg.norm(points - np.asarray(x), axis=1), np.zeros((len(points), 0))
        return self.symmetry.followed(x, points)

    def goal(self, node: Node, shift: np.ndarray) -> Node:
        """The point that an orbit through this node reaches after its period."""
        return node if self.symmetry is None else node._replace(x=jnp.asarray(self.symmetry.image(node.x, shift).x))

    def strayed(self, node: Node) -> tuple[np.ndarray, np.ndarray]:
        """Distances (c,) from the wanted conserved values, in state space; and their derivatives (c, n)."""
        if self.conserved is None:
            return np.zeros(0), np.zeros((0, len(node.x)))
        return self.conserved.strayed(self.mode(node), node.x, self.problem.args)

    def mode(self, node: Node) -> int:
        """The mode at a point."""
        if node.mode is not None or isinstance(self.problem.system, Map):
            return int(node.mode or 0)
        t = jnp.asarray(node.t, node.x.dtype)
        return max(int(self.problem.system.initial_mode(t, node.x, self.problem.args)), 0)


def close_return(flow: Motion, start: Node) -> tuple[Node, float]:
    """A point and the time after which the motion returns close to it.

    Each piece is twice as long as the one before and starts at its end, so that a motion towards an orbit gets closer.
    """
    horizon = _first_horizon(flow, start)
    for _ in range(DOUBLINGS):
        stretch = flow.piece(start, float(horizon))
        times, points, modes = states_of(stretch)
        distance = flow.apart(start.x, points)[0]
        size = np.maximum.accumulate(distance)
        distance = np.where(modes == flow.mode(start), distance, np.inf)
        inner = np.flatnonzero((distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])) + 1
        close = inner[distance[inner] < CLOSE_RETURN * size[inner]]
        if len(close):
            return start, float(times[close[0]])
        start, horizon = Node(start.t, stretch.x, stretch.mode), 2 * horizon
    raise NoPeriodicOrbitError(
        f"The motion from x0 did not come back to itself, looked for over a time of {horizon / 2:.6g}: (a) it is far "
        "from a periodic orbit, give a transient; (b) it moves towards a fixed point; (c) give the period.",
        None,
    )


def _first_horizon(flow: Motion, start: Node) -> float:
    """A time to begin with, from the size of the state, its velocity and its acceleration.

    Near an equilibrium the velocity is small, and its own rate of change is what tells a time.
    """
    velocity = flow.velocity(start)
    size, speed = float(np.linalg.norm(start.x)) + 1e-3, float(np.linalg.norm(velocity))
    if speed == 0:
        raise NoPeriodicOrbitError(
            "x0 is at rest: its velocity is 0, and so it has no period. Start beside this equilibrium, and give a "
            "transient; what perturbations of an equilibrium do is in the eigenvalues of the field's derivative there.",
            None,
        )
    ahead = 1e-6 * size / speed
    moved = start._replace(t=start.t + ahead, x=as_jax(np.add(start.x, ahead * velocity)))
    change = float(np.linalg.norm(flow.velocity(moved) - velocity)) / ahead
    return min(size / speed, LONG * speed / change) if change > 0 else size / speed


def states_of(piece: MotionPiece) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, states and modes of a piece, including those after its jumps."""
    if piece.events is None:
        return piece.times, piece.points, piece.modes
    times = np.concatenate([piece.times, piece.events.t])
    points = np.concatenate([piece.points, piece.events.x_after])
    modes = np.concatenate([piece.modes, piece.events.mode_after])
    order = np.argsort(times, kind="stable")
    return times[order], points[order], modes[order]


def placed(flow: Motion, start: Node, period: float, segments: int) -> list[Node]:
    """Nodes along the motion from `start`, away from events."""
    if isinstance(flow.problem.system, Map):
        return [start]
    whole = flow.piece(start, period * (1 + NODE_CLEARANCE))  # longer, to record an event at the end of the period
    events = np.zeros(0) if whole.events is None else np.unique(whole.events.t % period)
    clear = np.sort([_away_from_events(at, events, period) for at in period * np.arange(segments) / segments])
    clear = clear[
        np.diff(clear, prepend=-period) > NODE_CLEARANCE * period
    ]  # two may have been moved into the same gap
    return [start if at == 0 else flow.piece(start, float(at)).end for at in clear]


def times_apart(times: Any, other: float, period: float) -> Any:
    """How far times of a periodic motion are from one of them."""
    return np.abs((times - other + period / 2) % period - period / 2)


def _away_from_events(at: float, events: np.ndarray, period: float) -> float:
    """The wanted time, or, if it is near an event, the middle of the next gap between events."""
    if not len(events):
        return at
    if np.min(times_apart(events, at, period)) > NODE_CLEARANCE * period:
        return at
    after = np.sort((events - at - 1e-9 * period) % period)
    after = after[after > NODE_CLEARANCE * period]
    gaps = np.diff(np.concatenate([[0.0], after, [period]]))
    ends = np.concatenate([after, [period]])
    wide = np.flatnonzero(gaps > 2 * NODE_CLEARANCE * period)
    i = wide[0] if len(wide) else int(np.argmax(gaps))
    return float((at + ends[i] - gaps[i] / 2) % period)


def newton(flow: Motion, nodes: list[Node], period: float, autonomous: bool, most: int) -> OrbitIterate:
    """Newton's method with step halving; where modes do not match it restarts from the state a period later."""
    orbit = shot(flow, nodes, shares_of(nodes, period), period, 0)
    for iteration in range(1, most + 1):
        if orbit.residual <= digits(NEWTON_RESIDUAL, nodes[0].x):
            break
        trial = _stepped(flow, orbit, period, autonomous, iteration)
        if not trial.residual < orbit.gap:
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
        if trial.residual < orbit.gap:
            break
    return trial


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
    if shift is None:
        # The shift is followed along the motion: after a turn by 2π the state is equal, but not the shift.
        points = np.concatenate([*(states_of(piece)[1] for piece in pieces), np.asarray(pieces[-1].x)[None]])
        shift = flow.apart(nodes[0].x, points)[1][-1]
    size = max(LEAST_SCALE, *(np.max(np.abs(piece.x)) for piece in pieces))
    orbit = OrbitIterate(nodes, pieces, period, np.inf, iteration, shift, flow.goal(nodes[0], shift))
    strayed = flow.strayed(nodes[0])[0]
    return orbit._replace(gap=float(max(np.max(np.abs(_gaps(orbit))), np.max(np.abs(strayed), initial=0.0)) / size))


def _gaps(orbit: OrbitIterate) -> np.ndarray:
    """(m, n) differences between the end of each piece and its goal."""
    return np.array([np.asarray(piece.x) - np.asarray(node.x) for piece, node in orbit.seams])


def linearised(flow: Motion, orbit: OrbitIterate, shares, autonomous: bool) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian of all equations, and their residuals.

    Unknowns: the nodes, the period of an autonomous system, the shift (q,) of the group. Equations: the pieces match,
    the first node moves neither along the orbit nor along the group, and quantities are conserved.
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
        system[rows_of_states, :n] = flow.velocity(first)
    if flow.symmetry is not None and image is not None:
        system[rows_of_states - n : rows_of_states, still - q : still] = -image.by_shift
        system[still - q : still, :n] = flow.symmetry.image(first.x).by_shift.T
    gaps[still:], system[still:, :n] = strayed
    return system, gaps


def _newton_step(
    flow: Motion, orbit: OrbitIterate, shares, autonomous: bool
) -> tuple[list[np.ndarray], float, np.ndarray]:
    """The changes of the nodes, of the period and of the shift."""
    m, n = len(orbit.nodes), len(orbit.nodes[0].x)
    # The least-norm solution: in a family of orbits (a block at rest anywhere) the matrix is singular.
    system, gaps = linearised(flow, orbit, shares, autonomous)
    change = np.linalg.lstsq(system, -gaps, rcond=digits(1e-11, orbit.nodes[0].x))[0]
    states, shift = change[: m * n].reshape(m, n), change[m * n + autonomous :]
    return list(states), float(change[m * n]) if autonomous else 0.0, shift
