"""Conditions on events: an orbit touches a guard, an event falls on another guard's zero, a point lies on a border.

A touch at the time τ after the first node is h = 0 and dh/dt = 0; an event on the edge of another guard e is h = 0 and
e = 0; an event at a tick is h = 0 and t = phase + n·period of the clock; τ is one more unknown. The motion up to there
does not feel the guard h, so that it is smooth on both sides.

M. di Bernardo, C. Budd, A. Champneys & P. Kowalczyk, Piecewise-smooth Dynamical Systems (Springer 2008), chapters 3, 6
and 8, doi:10.1007/978-1-84628-708-4.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compiled
from ..._jax.tracing import as_jax
from ...systems.daes.semi_linear import fields_of
from ..continuation.equations import BranchEquations
from ..continuation.touching import FoundTouch, Touch, tick_time
from ..orbits.motion.motions import Motion, Node
from ..orbits.shooting import OrbitIterate, shares_of, shot, times_apart
from .equations import EXACTLY, ConditionValue, CurveIterate, first_that_runs

__all__ = ["BorderCondition", "TouchCondition", "placed_around"]

BESIDE_EDGE = (0.0, 1e-11, -1e-11, 1e-10, -1e-10)  # of the range
SAME_EVENT = 1e-6  # of the period: an event so near to the touch is it, or follows from it
BEFORE_TICK = 1e-8  # of the time from the first node: the motion runs so near to a tick
LONGEST_SHARE = 0.4  # of the period: the first node lies no longer before the touch


class TouchCondition(NamedTuple):
    """There is a touch."""

    touch: Touch
    unknowns: int = 1

    @property
    def beside(self) -> tuple[float, ...]:
        """Exactly on an edge rounding decides which field holds, and may do so again and again."""
        return EXACTLY if self.touch.tangential else BESIDE_EDGE

    def at(self, there: CurveIterate) -> ConditionValue:
        """Residuals and derivatives."""
        branch, motion, node = there.branch, there.motion, there.orbit.nodes[0]
        length = float(there.own[0]) * branch.time
        if not 0 < length < there.orbit.period:
            raise ValueError("the touch has left the piece of motion that was to hold it")
        free = node._replace(without=self.touch.guard)
        felt = self._until_tick(motion, node, length)
        run = motion.piece(free, felt)
        velocity = motion.velocity(run.end)
        values, by_args, by_time, by_state = _touched(
            motion.problem.system,
            self.touch,
            there.equations.args_of.args_of,
            there.equations.leaf(there.pair),
            (node.t + length, np.asarray(run.x) + velocity * (length - felt)),
        )
        sizes = np.linalg.norm(by_state * branch.sizes, axis=1) + np.abs(by_time) * branch.time
        sizes = np.where(sizes > 0, sizes, 1.0)
        states = by_state @ run.matrix * branch.scales(there.orbit)[: len(node.x)]
        rows = np.zeros((2, len(there.u) + 1))
        rows[:, : states.shape[1]] = states
        still = (1.0, 0.0, np.zeros(len(node.x)), 0.0)
        for i, (entry, span) in enumerate(zip(there.equations.entries, there.equations.spans, strict=True)):
            moved = there.equations.along(i, there.pair).carried(free, felt, there.pair[i], still)
            rows[:, len(there.u) - 2 + i] = (by_args[:, entry] + by_state @ moved) * span
        rows[:, -1] = (by_time + by_state @ velocity) * branch.time
        none = np.zeros((len(there.gaps), 1))
        return ConditionValue(values / sizes, rows / sizes[:, None], none)

    def _until_tick(self, motion: Motion, node: Node, length: float) -> float:
        """How long the motion runs: to just before the tick, which is not to be felt, and straight on from there."""
        if self.touch.tick is None:
            return length
        clock, tick = self.touch.tick
        transition, args = motion.problem.system.transitions[clock], motion.problem.args
        to_tick = float(tick_time(transition, tick, args)) - node.t
        before = min(length, to_tick) - BEFORE_TICK * abs(length)
        if not before > 0:
            raise ValueError("the tick has left the piece of motion that was to hold it")
        return before


@compiled()
def _derivatives_of_touch(system, touch: Touch, args_of, leaf, at):
    field = fields_of(system)[touch.mode]

    def entry_of(which, t, x, args):
        transition, entry = which
        return jnp.ravel(jnp.asarray(system.transitions[transition].guard(t, x, args)))[entry]

    def values(leaf, t, x):
        args = args_of(leaf)
        if touch.tick is not None:
            clock, tick = touch.tick
            return jnp.stack([entry_of(touch.guard, t, x, args), t - tick_time(system.transitions[clock], tick, args)])
        if touch.edge is not None:
            return jnp.stack([entry_of(touch.guard, t, x, args), entry_of(touch.edge, t, x, args)])
        along = jnp.ones_like(t), field(t, x, args)
        return jnp.stack(jax.jvp(lambda t, x: entry_of(touch.guard, t, x, args), (t, x), along))

    return values(leaf, *at), jax.jacfwd(values, argnums=(0, 1, 2))(leaf, *at)


def _touched(system, touch: Touch, args_of, leaf: np.ndarray, at: tuple) -> tuple[np.ndarray, ...]:
    """Both values (2,) of a touch, and their derivatives by the leaf of args, the time and the state."""
    t, x = (as_jax(np.asarray(one, float)) for one in at)
    values, slopes = _derivatives_of_touch(system, touch, args_of, as_jax(leaf), (t, x))
    return tuple(np.asarray(found) for found in (values, *slopes))


class BorderCondition(NamedTuple):
    """The point of a map's orbit at the start lies on a border."""

    border: Callable  # (n, x, args) -> number
    unknowns: int = 0
    beside: tuple[float, ...] = EXACTLY

    def at(self, there: CurveIterate) -> ConditionValue:
        """Residual and derivatives."""
        branch, node = there.branch, there.orbit.nodes[0]
        leaf, at = as_jax(there.equations.leaf(there.pair)), (as_jax(np.asarray(node.t, float)), as_jax(node.x))
        value, (by_args, by_state) = _derivatives_of_border(self.border, there.equations.args_of.args_of, leaf, at)
        by_args, by_state = np.asarray(by_args), np.asarray(by_state)
        size = float(np.linalg.norm(by_state * branch.sizes)) or 1.0
        row = np.zeros((1, len(there.u)))
        row[0, : len(by_state)] = by_state * branch.scales(there.orbit)[: len(by_state)]
        row[0, -2:] = by_args[list(there.equations.entries)] * there.equations.spans
        return ConditionValue(np.atleast_1d(value) / size, row / size, np.zeros((len(there.gaps), 0)))


@compiled()
def _derivatives_of_border(border: Callable, args_of: Any, leaf, at):
    n, x = at

    def value(leaf, x):
        return jnp.reshape(border(n, x, args_of(leaf)), ())

    return value(leaf, x), jax.grad(value, argnums=(0, 1))(leaf, x)


def placed_around(
    equations: BranchEquations, orbit: OrbitIterate, p: float, found: FoundTouch
) -> tuple[OrbitIterate, float]:
    """The orbit with its first node before a touch, and the time from there to the touch.

    A guard that is touched is not felt on the piece that holds the touch; this piece ends before the next event. An
    event on an edge is felt: only the place of the event is looked for without it.
    """
    period, times = orbit.period, _event_times(orbit)
    others = times[(times_apart(times, found.t, period) > SAME_EVENT * period) | (not found.fired)]
    ahead, behind = (np.min(side * (others - found.t) % period, initial=period) for side in (1.0, -1.0))
    before = float(min(behind / 2, LONGEST_SHARE * period))
    after = float(min(ahead / 2, LONGEST_SHARE * period)) if found.touch.tangential and len(others) else None

    def placed_beside(shift: float) -> OrbitIterate:
        return _with_nodes(equations, orbit, p + shift * equations.span, found, before, after)

    return first_that_runs(placed_beside, TouchCondition(found.touch).beside), before


def _with_nodes(equations: BranchEquations, orbit: OrbitIterate, p: float, found: FoundTouch, before, after):
    """The orbit from a node so long before a touch, and another one after it if given."""
    flow, period = equations.motion(p), orbit.period
    start = _at(flow, orbit, found.t - before)._replace(t=found.t - before)  # not a period later: ticks are numbered
    nodes = [start._replace(without=found.touch.guard if found.touch.tangential else None)]
    if after is not None:
        nodes.append(flow.piece(nodes[0], before + after).end)
    return shot(flow, nodes, shares_of(nodes, period), period, 0, orbit.shift)


def _at(flow: Motion, orbit: OrbitIterate, t: float) -> Node:
    """The point of an orbit at a time, modulo the period; each piece feels what it felt."""
    starts = np.array([node.t for node in orbit.nodes])
    within = starts[0] + float((t - starts[0]) % orbit.period)
    node = orbit.nodes[int(np.searchsorted(starts, within, side="right")) - 1]
    return flow.piece(node, within - node.t).end if within > node.t else node


def _event_times(orbit: OrbitIterate) -> np.ndarray:
    return np.concatenate([piece.start.t + piece.events.t for piece in orbit.pieces if piece.events is not None])
