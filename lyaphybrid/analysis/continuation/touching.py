"""Whether an orbit touches a guard: grazes it from one side, or reaches it with no speed."""

import jax
import jax.numpy as jnp
import numpy as np

from ...systems.hybrid import Hybrid, Transition
from ..orbits.shooting import Motion, MotionPiece
from .equations import BranchEquations, BranchPoint

__all__ = ["touches"]

GRAZED = 1e-5  # largest |extremum| of a grazed guard, relative to the guard's range
TANGENTIAL_RATE = 1e-3  # largest rate of a guard at a tangential event, relative to the largest rate on the orbit


def touches(equations: BranchEquations, point: BranchPoint) -> bool:
    """Whether some guard nearly vanishes together with its rate."""
    flow = equations.motion(point.parameter)
    system = flow.problem.system
    if not isinstance(system, Hybrid):
        return False
    guarded = [(j, transition) for j, transition in enumerate(system.transitions) if transition.guard is not None]
    return any(_touched(flow, piece, j, transition) for piece in point.orbit.pieces for j, transition in guarded)


def _touched(flow: Motion, piece: MotionPiece, j: int, transition: Transition) -> bool:
    names = flow.problem.system.mode_names
    sources = range(len(names)) if transition.source is None else map(names.index, transition.source)
    for mode in sources:
        inside = piece.modes == mode
        fired = (piece.events.transition == j) & (piece.events.mode_before == mode)
        if not np.any(inside) and not np.any(fired):
            continue
        times = np.concatenate([piece.times[inside], piece.events.t[fired]])
        states = np.concatenate([piece.points[inside], piece.events.x_before[fired]])
        values, rates = _guard_values(flow, transition, mode, piece.start.t + times, states)
        split = np.sum(inside)
        if _grazes(values[:split], np.flatnonzero(inside)) or _slow(rates[split:], rates):
            return True
    return False


def _guard_values(flow: Motion, transition: Transition, mode: int, times, states):
    """Values and rates (samples, m) of a guard along the motion in a mode."""
    field, guard, args = flow.problem.system.fields[mode], transition.guard, flow.problem.args
    assert guard is not None

    def one(t, x):
        velocity = field(t, x, args)
        return jax.jvp(lambda t, x: jnp.ravel(guard(t, x, args)), (t, x), (jnp.ones_like(t), velocity))

    return [np.asarray(found) for found in jax.vmap(one)(jnp.asarray(times), jnp.asarray(states))]


def _grazes(values: np.ndarray, at: np.ndarray) -> bool:
    """Whether an extremum, from the parabola through three consecutive samples, is nearly zero."""
    if len(values) < 3:
        return False
    a, b, c = values[:-2], values[1:-1], values[2:]
    together = ((at[2:] - at[:-2]) == 2)[:, None]
    curvature = a - 2 * b + c
    turning = together & ((b - a) * (c - b) <= 0) & (curvature != 0)
    extrema = b - (c - a) ** 2 / (8 * np.where(turning, curvature, 1.0))
    return bool(np.any(turning & (np.abs(extrema) < GRAZED * np.ptp(values, axis=0))))


def _slow(rates: np.ndarray, everywhere: np.ndarray) -> bool:
    return bool(len(rates)) and bool(np.any(np.abs(rates) < TANGENTIAL_RATE * np.max(np.abs(everywhere), axis=0)))
