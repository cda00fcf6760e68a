"""The equations of a branch of periodic orbits: those of multiple shooting, with a parameter p as one more unknown.

The unknowns u = (x_0, …, x_{m−1}, [T], p), each divided by its scale, are one more than the equations. So
the Jacobian J(u) has a null vector, the tangent of the branch. Newton's method is restricted to a hyperplane
c·u = s, which works at folds too.

Each conserved quantity E is one more equation. It gets one more unknown σ, a force σ ∇E that would do work along the
motion, so that σ = 0 on every periodic orbit. The parameter may be the conserved value itself.

F. J. Muñoz-Almaraz, E. Freire, J. Galán, E. Doedel & A. Vanderbauwhede, Continuation of periodic orbits in conservative
and Hamiltonian systems, Physica D 181 (2003) 1, doi:10.1016/S0167-2789(03)00097-6.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compiled
from ..._jax.tracing import as_jax, traced
from ...engine import problems
from ...errors import RunFailedError
from ...systems.smooth import Map
from ..orbits.motion.invariants import Conserved, steepness_of
from ..orbits.motion.motions import SAMPLES_PER_PIECE, Motion, Node, states_of
from ..orbits.periodic_orbits import CONVERGED
from ..orbits.shooting import NEWTON_RESIDUAL, OrbitIterate, linearised, placed, retimed, shares_of, shot
from ..orbits.symmetries import Symmetry
from ..sensitivity.implicit import PeriodRun

__all__ = ["BranchEquations", "ParameterOf", "BranchPoint", "ConstantArgs", "states_over", "tangent"]

GAIN = 0.25  # Newton's method goes on while a step reduces the residual to less than this fraction
NEWTON_ITERATIONS = 8
ZERO_SINGULAR_VALUE = 1e-11  # singular values below this fraction of the largest count as zero


class ParameterOf(eqx.Module):
    """The function p ↦ args as a pytree, so that another leaf value, or another parameter, compiles nothing new."""

    args_of: Callable  # (q,) ↦ args
    leaf: Any  # (q,) values of the leaf that has p as an entry
    entry: Any = eqx.field(converter=np.asarray)

    def __call__(self, p):
        """The args with this parameter."""
        if traced(p, self.leaf, self.entry):
            return self.args_of(jnp.where(np.arange(len(self.leaf)) == self.entry, p, self.leaf))
        leaf = np.array(self.leaf)  # of numbers without programs of XLA, which take long to compile
        leaf[self.entry] = p
        return self.args_of(as_jax(leaf))


class ConstantArgs(eqx.Module):
    """Args that do not depend on the parameter."""

    args: Any

    def __call__(self, p):
        """The args."""
        del p
        return self.args


class BranchPoint(NamedTuple):
    """A point of a branch."""

    orbit: OrbitIterate
    parameter: float
    u: np.ndarray  # (N + 1,)
    jacobian: np.ndarray  # (N, N + 1)
    tangent: np.ndarray  # (N + 1,) of length 1
    iterations: int  # of Newton's method
    limit: "BranchPoint | None" = None  # the equilibrium to which the orbits shrink from here, at the end of a branch


class BranchEquations(NamedTuple):
    """The problem, scales and conditions that all points of a branch share."""

    problem: problems.RunProblem
    args_of: ParameterOf | ConstantArgs
    method: Any
    period: Any  # None (unknown), a number, or args ↦ number
    turns: int  # number of given periods after which the orbit closes
    segments: int
    sizes: np.ndarray  # (n,) scales of the state
    time: float  # scale of the period
    span: float  # scale of the parameter
    symmetry: Symmetry | None = None
    conserved: Conserved | None = None
    shifts: tuple[float, ...] = ()  # (q,) scales of the shift of a group
    samples: int = SAMPLES_PER_PIECE  # recorded points of a piece of motion

    @property
    def level(self) -> bool:
        """Whether the parameter is the conserved value."""
        return isinstance(self.args_of, ConstantArgs)

    @property
    def fixed(self) -> int:
        """How many values are conserved."""
        return 0 if self.conserved is None else len(self.conserved.wanted)

    @property
    def discrete(self) -> bool:
        """Whether time counts iterations."""
        return isinstance(self.problem.system, Map)

    @property
    def autonomous(self) -> bool:
        """Whether the period is unknown."""
        return self.period is None

    def motion(self, p: float) -> Motion:
        """The motion at this parameter."""
        conserved = self.conserved
        if conserved is not None and self.level:
            conserved = conserved._replace(wanted=np.array([p]))
        return Motion(
            self.problem._replace(args=self.args_of(_number(p))), self.symmetry, conserved, self.samples, self.sizes
        )

    def length(self, p: float) -> float:
        """The time after which a forced orbit closes."""
        return self.turns * float(self.own_period(p))

    def own_period(self, p) -> Any:
        """The period that was given, at this parameter."""
        return self.period(self.args_of(_number(p))) if callable(self.period) else self.period

    def orbit_from(self, node: Node, p: float, period: float) -> OrbitIterate:
        """The motion from this node, over that time, cut into pieces away from events and surfaces that hold it."""
        flow = self.motion(p)
        nodes = placed(flow, node, period, self.segments, free=True)
        return shot(flow, nodes, shares_of(nodes, period), period, 0)

    def scales(self, orbit: OrbitIterate) -> np.ndarray:
        """The scale (N + 1,) of each unknown."""
        nodes = orbit.nodes
        states = np.tile(self.sizes * np.sqrt(len(nodes)), len(nodes))
        return np.concatenate([states, [self.time] * self.autonomous, self.shifts, np.ones(self.fixed), [self.span]])

    def vector(self, orbit: OrbitIterate, p: float) -> np.ndarray:
        """The unknowns u (N + 1,) of an orbit."""
        states = [np.asarray(node.x) for node in orbit.nodes]
        rest = [orbit.period] * self.autonomous, orbit.shift, np.zeros(self.fixed), [p]
        return np.concatenate([*states, *rest]) / self.scales(orbit)

    def shoot(self, u: np.ndarray, like: OrbitIterate) -> tuple[OrbitIterate, float]:
        """The orbit with the nodes given by u, at the same fractions of the period as in `like`; and the parameter."""
        m, n = len(like.nodes), len(like.nodes[0].x)
        values = u * self.scales(like)
        p = float(values[-1])
        period = float(values[m * n]) if self.autonomous else self.length(p)
        shift = values[m * n + self.autonomous :][: len(self.shifts)]
        flow, states = self.motion(p), values[: m * n].reshape(m, n)
        nodes = [flow.moved(node, x - np.asarray(node.x)) for node, x in zip(like.nodes, states, strict=True)]
        shares = shares_of(like.nodes, like.period)
        return shot(flow, retimed(nodes, shares, period), shares, period, 0, shift), p

    def linearised(self, orbit: OrbitIterate, p: float) -> tuple[np.ndarray, np.ndarray]:
        """The Jacobian (N, N + 1) of the equations, and their residuals (N,)."""
        flow, shares = self.motion(p), shares_of(orbit.nodes, orbit.period)
        system, gaps = linearised(flow, orbit, shares, self.autonomous, self.sizes)
        units = np.tile(self.sizes, len(orbit.nodes))
        states = len(units)
        lengths = np.linalg.norm(system[states:, :states] * units, axis=1)
        column, forces = np.zeros((len(gaps), 1)), np.zeros((len(gaps), self.fixed))
        column[:states, 0] = np.concatenate(self._by_parameter(orbit, shares, p))
        if flow.conserved is not None:
            first = orbit.nodes[0]
            column[len(gaps) - self.fixed :, 0] = self._kept_by_parameter(first, p)
            slopes = flow.strayed(first)[1] * self.sizes
            slopes = slopes / steepness_of(slopes)[:, None]
            forces[states - len(first.x) : states] = (slopes * self.sizes).T
        rows = np.concatenate([units, np.maximum(lengths, np.finfo(float).tiny)])
        return np.hstack([system, forces, column]) * self.scales(orbit) / rows[:, None], gaps / rows

    def _kept_by_parameter(self, node: Node, p: float) -> np.ndarray:
        """Derivative (c,) of the distances from the conserved values by the parameter."""
        flow = self.motion(p)
        assert flow.conserved is not None
        mode, x = flow.mode(node), np.asarray(node.x)
        slopes = flow.conserved.with_slopes(mode, x, flow.problem.args)[1]
        function = flow.conserved.functions[mode]
        assert function is not None
        x = as_jax(np.asarray(node.x))
        change = -np.ones(1) if self.level else np.atleast_1d(_slope(function, self.args_of, _number(p), x))
        return change / steepness_of(slopes)

    def _by_parameter(self, orbit: OrbitIterate, shares, p: float) -> list[np.ndarray]:
        """Derivatives (n,) of the pieces' ends by the parameter, through a period that depends on it too."""
        longer = 0.0
        if callable(self.period) and not self.discrete:
            longer = self.turns * float(_slope(self.period, self.args_of, _number(p)))
        later = longer * np.concatenate([[0.0], np.cumsum(shares)[:-1]])
        still = np.zeros(len(orbit.nodes[0].x))
        return [
            self.carried(piece.start, piece.length, p, (1.0, dt, still, longer * share))
            for piece, dt, share in zip(orbit.pieces, later, shares, strict=True)
        ]

    def carried(self, node: Node, length: float, p: float, along: tuple) -> np.ndarray:
        """The derivative (n,) of the motion's end along changes (dp, dt, dx, dlength) of p, start and length."""
        flow = self.motion(p)
        mode = 0 if self.discrete else flow.mode(node)
        turn = PeriodRun(flow.problem_from(node).system, self.args_of, None, None, self.method)
        given, changes = ([_number(value) for value in values] for values in ((p, *node[:2], length), along))
        return np.asarray(_carried(turn, as_jax(np.asarray(mode)), given, changes, self.discrete))

    def corrected(
        self, guess: np.ndarray, like: OrbitIterate, across: np.ndarray, level: float, reach: float = np.inf
    ) -> BranchPoint | None:
        """The point of the branch near a guess on the hyperplane across·u = level; None without convergence.

        Gives up farther than `reach` from the guess: there the motion may be of another kind and take very long.
        """
        u, before = guess, np.inf
        for iteration in range(NEWTON_ITERATIONS):
            try:
                orbit, p = self.shoot(u, like)
            except (RunFailedError, ValueError):
                return None
            jacobian, gaps = self.linearised(orbit, p)
            if not np.all(np.isfinite(jacobian)):
                return None
            u = self.vector(orbit, p)  # projected onto the constraints, if there are any
            if orbit.residual <= CONVERGED and not NEWTON_RESIDUAL < orbit.residual < GAIN * before:
                along = tangent(jacobian, across)
                return BranchPoint(orbit, p, u, jacobian, along, iteration) if np.all(np.isfinite(along)) else None
            if iteration > 1 and not orbit.residual < before:
                return None
            before = orbit.residual
            change = solved(jacobian, across, np.append(-gaps, level - across @ u))
            u = u + change
            if not np.linalg.norm(u - guess) <= reach:
                return None
        return None


def states_over(point: BranchPoint) -> np.ndarray:
    """States (samples, n) of the whole orbit, those before and after its jumps included."""
    pieces = point.orbit.pieces
    before = [piece.events.x_before for piece in pieces if piece.events is not None]
    return np.concatenate([*(states_of(piece)[1] for piece in pieces), *before])


def _number(value) -> Any:
    """A float or an array of floats as a JAX array; a tracer stays as it is."""
    return value if traced(value) else as_jax(np.asarray(value, float))


@compiled()
def _slope(function: Callable, args_of: ParameterOf, p, *state):
    """The derivative by the parameter of a function of a state, if it has one, and of args."""

    def value(p):
        return jnp.asarray(function(*state, args_of(p)), p.dtype)

    return jax.jvp(value, (p,), (jnp.ones_like(p),))[1]


@compiled()
def _carried(turn: PeriodRun, mode, given, along, discrete: bool):
    n = given[2].shape[0]

    def end(p, t, x, length):
        return turn._replace(t=t, mode=mode).end(p, x, length, np.zeros((n, 0), x.dtype))[0]

    if discrete:  # time is an integer: no derivative by it exists
        p, t, x, length = given
        return jax.jvp(lambda p, x: end(p, t, x, length), (p, x), (along[0], along[2]))[1]
    return jax.jvp(end, tuple(given), tuple(along))[1]


def solved(jacobian: np.ndarray, across: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The Newton correction (N + 1,); of least norm where it is not unique, as at a branch point."""
    return np.linalg.lstsq(np.vstack([jacobian, across]), right, rcond=ZERO_SINGULAR_VALUE)[0]


def tangent(jacobian: np.ndarray, along: np.ndarray) -> np.ndarray:
    """The unit null vector (N + 1,) of the Jacobian, oriented like `along`; nan where it has nothing of that."""
    last = np.zeros(len(along))
    last[-1] = 1.0
    found = solved(jacobian, along, last)
    return found / (np.linalg.norm(found) or np.nan)
