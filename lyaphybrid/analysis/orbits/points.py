"""The point of an orbit that a result shows."""

import jax.numpy as jnp
import numpy as np

from ..._jax.precision import digits
from ...systems.smooth import Map
from .motion.motions import Motion, Node
from .shooting import OrbitIterate

__all__ = ["at_start", "nearest"]

EVENT_AT_START = 1e-6  # of the period: an event this near to x0 counts as at x0


def nearest(flow: Motion, base: Node, period: float, x, units: np.ndarray) -> Node:
    """The point of an orbit that is nearest to a state, in units (n,); at a jump the nearer one of both sides."""
    turn = flow.piece(base, period * (1 + digits(EVENT_AT_START, base.x)))  # longer, to record a jump at the end
    times, points, modes = [turn.times], [turn.points], [turn.modes]
    if turn.events is not None:
        times += [turn.events.t, turn.events.t]
        points += [turn.events.x_before, turn.events.x_after]
        modes += [turn.events.mode_before, turn.events.mode_after]
    times, points, modes = np.concatenate(times), np.concatenate(points), np.concatenate(modes)
    if flow.symmetry is not None and flow.symmetry.freedom:
        order = np.argsort(times, kind="stable")
        times, points, modes = times[order], points[order], modes[order]
        distance, shifts = flow.symmetry.followed(x, points, units)
        i = int(np.argmin(distance))
        points[i] = flow.symmetry.back(points[i], shifts[i])
    else:
        i = int(np.argmin(np.linalg.norm((points - np.asarray(x)) / units, axis=1)))
    return Node(base.t + float(times[i]), jnp.asarray(points[i]), int(modes[i]))


def at_start(flow: Motion, orbit: OrbitIterate, start: Node, period: float) -> Node:
    """The point of a forced orbit at t0; if it jumps there, the side of the jump that is nearer to x0."""
    base, shift, units = orbit.nodes[0], orbit.shift, orbit.extents
    offset = (base.t - start.t) % period
    if offset == 0 or isinstance(flow.problem.system, Map):
        return base
    length, near = period - offset, digits(EVENT_AT_START, base.x) * period
    ends = [flow.piece(base, length).end]
    events = flow.piece(base, length + near).events
    for i in np.flatnonzero(np.abs(events.t - length) < near):
        ends.append(Node(start.t, jnp.asarray(events.x_before[i]), int(events.mode_before[i])))
        ends.append(Node(start.t, jnp.asarray(events.x_after[i]), int(events.mode_after[i])))
    if flow.symmetry is not None:  # the ends lie one period later
        ends = [node._replace(x=jnp.asarray(flow.symmetry.back(node.x, shift))) for node in ends]
    return min(ends, key=lambda node: float(np.linalg.norm((np.asarray(node.x) - np.asarray(start.x)) / units)))
