"""The motion of a point and its tangents, in pieces from node to node."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...._jax.engines import compiled
from ...._jax.tracing import array, as_jax
from ....engine import problems
from ....engine.host import driver
from ....engine.host.places import account, place_of
from ....errors import RunFailedError
from ....statuses import STATUS
from ....systems.consistency import put_on_constraints
from ....systems.daes.semi_linear import Constrained, fields_of
from ....systems.event_driven import EventDriven
from ....systems.hybrid import Hybrid, disarmed
from ....systems.smooth import Map
from ..symmetries import Symmetry
from .invariants import Conserved
from .sizes import LEAST_SCALE, finer, mixing_of, sizes_of

__all__ = ["Motion", "MotionPiece", "Node", "SAMPLES_PER_PIECE", "sized", "states_of", "velocity"]

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


@compiled(hands_on=True)
def velocity(system, t, x, args, mode: int):
    """Dx/dt (n,) in a mode."""
    return fields_of(system)[mode](t, x, args)


@compiled(hands_on=True)
def acceleration(system, t, x, args, mode: int):
    """d²x/dt² (n,) along the motion in a mode."""
    field = fields_of(system)[mode]
    return jax.jvp(lambda t, x: field(t, x, args), (t, x), (jnp.ones_like(t), field(t, x, args)))[1]


@compiled(hands_on=True)
def slope_of(system, t, x, args, mode: int):
    """The derivative (n, n) by the state of the field of a mode, or of a map's rule."""
    function = system.rule if isinstance(system, Map) else fields_of(system)[mode]
    return jax.jacfwd(lambda x: function(t, x, args))(x)


class Motion(NamedTuple):
    """Motion of a point and its tangents, with the symmetry and the conserved values of its orbits."""

    problem: problems.RunProblem
    symmetry: Symmetry | None = None
    conserved: Conserved | None = None
    samples: int = SAMPLES_PER_PIECE
    sizes: np.ndarray | None = None  # (n,) of the components along the motion from the start; None: not known

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

    def acceleration(self, node: Node) -> np.ndarray:
        """d²x/dt² at a point, along the motion in its mode."""
        problem, t = self.problem, array(node.t, node.x.dtype)
        return np.asarray(acceleration(problem.system, t, node.x, problem.args, self.mode(node)))

    def slope(self, node: Node) -> np.ndarray:
        """The derivative (n, n) of the field, or of a map's rule, by the state at a point."""
        x = as_jax(np.asarray(node.x))
        args = self.problem.args
        return np.asarray(slope_of(self.problem.system, array(node.t, x.dtype), x, args, self.mode(node)))

    def mixing(self, node: Node, matrix: np.ndarray, length: float) -> np.ndarray:
        """What components make of each other (n, n) on a way of a length, with the derivative `matrix` (n, n)."""
        return mixing_of(matrix, self.slope(node), 1.0 if isinstance(self.problem.system, Map) else length)

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

    def apart(self, x, points: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances of points (samples, n) from x or its nearest image, in units (n,); shifts (samples, q)."""
        if self.symmetry is None:
            return np.linalg.norm((points - np.asarray(x)) / units, axis=1), np.zeros((len(points), 0))
        return self.symmetry.followed(x, points, units)

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


def states_of(piece: MotionPiece) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, states and modes of a piece, including those after its jumps."""
    if piece.events is None:
        return piece.times, piece.points, piece.modes
    times = np.concatenate([piece.times, piece.events.t])
    points = np.concatenate([piece.points, piece.events.x_after])
    modes = np.concatenate([piece.modes, piece.events.mode_after])
    order = np.argsort(times, kind="stable")
    return times[order], points[order], modes[order]


def sized(flow: Motion, trial: MotionPiece, is_default: bool, near: Any) -> Motion:
    """The motion with the sizes of its components along a trial; a default method has tolerances for them.

    No size is a much smaller one than that at the start `near` (n,): what decays is none.
    """
    points = np.concatenate([np.asarray(trial.start.x)[None], states_of(trial)[1]])
    problem, mixing = flow.problem, flow.mixing(trial.start, trial.matrix, trial.length)
    if is_default:
        problem = problem._replace(method=finer(problem.method, points, np.maximum(np.abs(trial.matrix), mixing)))
    return flow._replace(problem=problem, sizes=sizes_of(points, mixing, LEAST_SCALE * np.abs(near)))
