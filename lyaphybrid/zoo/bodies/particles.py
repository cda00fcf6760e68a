"""Hard disks and spheres as a scheduled system: straight flights, elastic contacts, predictions in `rows` or `cells`.

The state is x = (q₁, …, q_n, p₁, …, p_n), d components each. Between rebasings q stands for q - p t/m.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from ...systems.event_driven import EventDriven, Schedule
from . import cells, rows
from .contacts import SIDES, Kind, bodies_of, dot, each, nearest

__all__ = ["better_in_cells", "hard_particles"]

IN_CELLS_FROM = 256  # bodies: with 128 a look at all of them costs no more


@functools.cache
def hard_particles(n: int, d: int, walls: bool, in_cells: bool = False) -> EventDriven:
    """Bodies that meet elastically in d dimensions, in a periodic box or between hard walls.

    An event is called n·k + l, k < l, where k meets l; n² + 2d·k + 2·axis + side where k meets a wall; and -1 - k where
    k is only looked at again.

    in_cells: bodies look for others next to them only; the sides of the box must be four diameters at least, else no
        event has a time.

    args: "diameter" and "mass", a number or (n,); the sides of the box by the names in `SIDES`.
    """
    kind, way = Kind(n, d, walls), cells if in_cells else rows

    def bound(function):
        return functools.partial(function, kind)

    schedule = Schedule(
        init=bound(way.look_at_all),
        next=bound(way.predicted),
        update=bound(way.update),
        shift=way.shifted,
        touch=bound(_touched),
        flat=True,
    )
    return EventDriven(bound(_fly), None, bound(_collide), bound(_gap), schedule=schedule, canonical=True)


def better_in_cells(n: int, sides: Sequence[float], widest: float) -> bool:
    """Whether there are many bodies, and a box of so many cells that it may yet become narrower, or they wider."""
    wide = (cells.along(side, n, sides, widest) >= 2 * cells.CELLS_AN_AXIS for side in sides)
    return n >= IN_CELLS_FROM and all(map(bool, wide))


def _fly(kind: Kind, dt, x, args):
    half = kind.n * kind.d
    mass = jnp.repeat(each(kind, args["mass"]), kind.d)
    return jnp.concatenate([x[:half] + (dt / mass) * x[half:], x[half:]])


# Events.


def _touched(kind: Kind, which):
    """Components of the positions and momenta of the two."""
    one, other = bodies_of(kind, which)
    axes = jnp.arange(kind.d, dtype=which.dtype)
    places = jnp.concatenate([kind.d * one + axes, kind.d * other + axes])
    return jnp.concatenate([places, kind.n * kind.d + places])


class Pair(NamedTuple):
    """Two bodies at the time t, component by component: numbers that XLA need not put together."""

    q: Any  # of each, positions at present
    p: Any  # of each, momenta
    mass: Any  # of each
    apart: list  # from the first to the second, or to the image of it that is met


def _pair(kind: Kind, t, rows, args, which) -> Pair:
    d, bodies = kind.d, bodies_of(kind, which)
    mass = tuple(each(kind, args["mass"])[body] for body in bodies)
    p = tuple([rows[(2 + i) * d + axis] for axis in range(d)] for i in range(2))
    q = tuple([rows[i * d + axis] + t / mass[i] * p[i][axis] for axis in range(d)] for i in range(2))
    apart = [there - here for here, there in zip(*q, strict=True)]
    if not kind.walls:
        apart = [nearest(apart[axis], args[SIDES[axis]]) for axis in range(d)]
    return Pair(q, p, mass, apart)


def _collide(kind: Kind, t, rows, args, which):
    """The momentum 2μ (w·q) q/q² goes from the second to the first, w the relative velocity; at a wall p_a turns round.

    μ is the reduced mass. What a kick changes in a momentum it changes in the comoving position, times -t/m.
    """
    pair = _pair(kind, t, rows, args, which)
    (one, other), d = pair.mass, kind.d
    # 2μ w = 2 (m₁ p₂ - m₂ p₁)/(m₁ + m₂)
    relative = [2 * (one * there - other * here) / (one + other) for here, there in zip(*pair.p, strict=True)]
    share = dot(relative, pair.apart) / dot(pair.apart, pair.apart)
    kicks = [[sign * share * q for q in pair.apart] for sign in (1, -1)]
    if kind.walls:
        at_wall = which >= kind.n**2
        turned = _turned(kind, pair, which)
        kicks = [[jnp.where(at_wall, turned[i][a], kicks[i][a]) for a in range(d)] for i in range(2)]
    kicks = [[jnp.where(which < 0, 0.0, kick) for kick in of] for of in kicks]
    q = [rows[i * d + axis] - t / pair.mass[i] * kicks[i][axis] for i in range(2) for axis in range(d)]
    p = [pair.p[i][axis] + kicks[i][axis] for i in range(2) for axis in range(d)]
    return jnp.stack(q + p)


def _turned(kind: Kind, pair: Pair, which):
    """The kicks at a wall: the first body's momentum along the axis turns round."""
    axis = ((which - kind.n**2) % kind.faces) // 2
    return [[jnp.where(axis == a, -2 * pair.p[0][a], 0.0) for a in range(kind.d)], [0 * p for p in pair.p[1]]]


def _gap(kind: Kind, t, rows, args, which):
    """(q² - σ²)/2 of the two; or the distance of the first from the wall."""
    pair = _pair(kind, t, rows, args, which)
    diameter = [each(kind, args["diameter"])[body] for body in bodies_of(kind, which)]
    gap = (dot(pair.apart, pair.apart) - (diameter[0] + diameter[1]) ** 2 / 4) / 2
    if not kind.walls:
        return gap
    face = (which - kind.n**2) % kind.faces
    distances = [_to_wall(pair.q[0][a], args[SIDES[a]], high) for a in range(kind.d) for high in (False, True)]
    distance = functools.reduce(jnp.add, [jnp.where(face == i, one, 0.0) for i, one in enumerate(distances)])
    return jnp.where(which >= kind.n**2, distance - diameter[0] / 2, gap)


def _to_wall(position, side, high: bool):
    return side - position if high else position
