"""A point between walls: closed-form paths, and the exact time at which one meets the first wall.

A wall is a height, q ↦ h(q): positive where the point may be, zero on the wall, a polynomial of second degree
(lines, circles, ellipses). The event's guard is h, its normal is ∇h, and along a path h is a quadratic in one
parameter u,

    h(q(t)) (1 + k²u²) = h + ḣ u + (ḧ/2 + k²h) u²        with the derivatives along the path at t = 0:

for straight lines and parabolas u = t and k = 0; for lines and circles along the arc of a charge in a magnetic
field B, k = B/2 and u = tan(kt)/k, which is t again as B → 0. During a whole turn 1/u falls from ∞ to −∞,
and h falls through zero at most once, at the larger root in 1/u. The contact that the point has just left is the
other root, so the last wall need not be remembered, however soon it is met again.

M. Robnik & M. V. Berry, Classical billiards in magnetic fields, J. Phys. A 18 (1985) 1361,
doi:10.1088/0305-4470/18/9/019.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from ...systems.event_driven import EventDriven

__all__ = ["ARC", "FALL", "STRAIGHT_PATH", "Path", "billiard", "falls", "first", "lowest"]


class Path(NamedTuple):
    """The motion of a point between walls; u = n/d with n ≥ 0."""

    flow: Callable  # (dt, t, x, args) -> x
    acceleration: Callable  # (v, args) -> (2,)
    turning: Callable  # args -> k, half the angular velocity of v
    duration: Callable  # (n, d, args) -> time at which the parameter is u = n/d, inf: never


def _over_x(function, series, x):
    """function(x)/x from its series in x² near 0, where rounding spoils the derivative of the quotient."""
    near = jnp.abs(x) < 0.1
    away = jnp.where(near, 1.0, x)
    return jnp.where(near, functools.reduce(lambda s, c: s * x * x + c, series), function(away) / away)


SIN_SERIES = (1 / 362880, -1 / 5040, 1 / 120, -1 / 6, 1.0)
ATAN_SERIES = (-1 / 15, 1 / 13, -1 / 11, 1 / 9, -1 / 7, 1 / 5, -1 / 3, 1.0)


def _perpendicular(v):
    return jnp.stack([-v[1], v[0]])


def _turned(v, angle):
    return jnp.cos(angle) * v + jnp.sin(angle) * _perpendicular(v)


def _straight(dt, t, x, args):
    return jnp.concatenate([x[:2] + dt * x[2:], x[2:]])


def _parabola(dt, t, x, args):
    q, v = x[:2], x[2:]
    return jnp.concatenate([q + dt * v + dt * dt / 2 * _down(v, args), v + dt * _down(v, args)])


def _arc(dt, t, x, args):
    """The flow along an arc; its chord is parallel to the velocity at its middle."""
    half = args["field"] * dt / 2
    chord = dt * _over_x(jnp.sin, SIN_SERIES, half)
    return jnp.concatenate([x[:2] + chord * _turned(x[2:], half), _turned(x[2:], 2 * half)])


def _down(v, args):
    return jnp.stack([0 * v[0], 0 * v[1] - 1])


def _ahead(n, d, args):
    """The time, equal to the parameter n/d."""
    ahead = d > 0
    return jnp.where(ahead, n / jnp.where(ahead, d, 1.0), jnp.inf)


def _along_the_arc(n, d, args):
    """The time t with tan(kt)/k = n/d, kt in [0, π)."""
    k = jnp.abs(args["field"] / 2)
    early, turns = k * n < 0.1 * d, k > 0
    u = n / jnp.where(early, d, 1.0)
    some = jnp.where(turns, k, 1.0)
    angle = jnp.arctan2(some * jnp.where(early, 1.0, n), jnp.where(early, 1.0, d))
    late = jnp.where(turns, angle / some, jnp.inf)
    return jnp.where(early, u * _over_x(jnp.arctan, ATAN_SERIES, k * jnp.where(early, u, 0.0)), late)


def _none(args):
    return 0.0


STRAIGHT_PATH = Path(_straight, lambda v, args: 0 * v, _none, _ahead)
FALL = Path(_parabola, _down, _none, _ahead)  # in gravity 1
ARC = Path(_arc, lambda v, args: args["field"] * _perpendicular(v), lambda args: args["field"] / 2, _along_the_arc)


def _course(path: Path, heights: Callable, x, args):
    """h, ḣ and ḧ of each wall along the path."""
    q, v = x[:2], x[2:]

    def along(direction, function):
        return lambda q: jax.jvp(function, (q,), (direction,))[1]

    def height(q):
        return heights(q, args)

    rate = along(v, height)
    return height(q), rate(q), along(v, rate)(q) + along(path.acceleration(v, args), height)(q)


def falls(path: Path, heights: Callable, x, args, inside: Any = True):
    """The time at which each height falls through zero.

    Args:
        path: of the point.
        heights: ``(q, args) -> (walls,)``.
        x: (q, v), shape (4,).
        args: of the system.
        inside: (walls,), whether the point can be behind that wall by rounding only.

    Returns:
        (walls,), inf where a height does not fall through zero.
    """
    value, rate, second = _course(path, heights, x, args)
    value = value - lax.stop_gradient(jnp.where(inside, jnp.minimum(value, 0.0), 0.0))
    half, bend = rate / 2, second / 2 + path.turning(args) ** 2 * value
    discriminant = half * half - bend * value
    meets = discriminant > 0
    root = jnp.sqrt(jnp.where(meets, discriminant, 1.0))
    # Of the two forms of the root, the one without cancellation; its numerator is made positive.
    sign = jnp.where(value < 0, -1.0, 1.0)
    n = jnp.where(half < 0, sign * value, root + half)
    d = jnp.where(half < 0, sign * (root - half), -bend)
    return jnp.where(meets, path.duration(n, d, args), jnp.inf)


def first(times):
    """The first of the walls that are met: (dt, which)."""
    return jnp.min(times), jnp.argmin(times)


def lowest(heights):
    """The least of some heights, with the derivative of that one.

    Within a loop compiled by jax 0.12 the derivative of `jnp.min` was seen to be nan. Likely
    cause: it searches for the numbers equal to the least one, and finds none if the compiler computes them twice with
    different rounding.
    """
    return heights[jnp.argmin(heights)]


def billiard(path: Path, next_event: Callable, height: Callable) -> EventDriven:
    """A point that follows the path and is reflected by walls, v⁺ = v − 2 (n·v) n/n², n = ∇h.

    Args:
        path: between the walls.
        next_event: ``(t, x, args) -> (dt, which)``; which = -1: no wall, predict again then.
        height: ``(q, args, which) -> scalar``, above the wall that is met.

    Returns:
        An `lh.EventDriven` of the state (q, v); (q, v) is canonical without a magnetic field.
    """

    def jump(t, x, args, which):
        q, v = x[:2], x[2:]
        n = jax.grad(height)(q, args, which)
        turned = v - (2 * jnp.sum(n * v) / jnp.sum(n * n)) * n
        return jnp.concatenate([q, jnp.where(jnp.asarray(which) < 0, v, turned)])

    def guard(t, x, args, which):
        again = lax.stop_gradient(t) - t  # a guard that falls through zero at this time for every state
        return jnp.where(jnp.asarray(which) < 0, again, height(x[:2], args, which))

    return EventDriven(flow=path.flow, next_event=next_event, jump=jump, guard=guard, canonical=path is not ARC)
