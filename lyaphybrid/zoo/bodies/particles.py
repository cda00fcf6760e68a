"""Hard disks and spheres as a scheduled system: straight flights, elastic contacts, predictions in `rows` or `cells`.

The state is x = (q₁, …, q_n, p₁, …, p_n), d components each. Between rebasings q stands for q - p t/m.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from ...systems.event_driven import EventDriven, Schedule
from . import cells, rows
from .contacts import SIDES, BodyKind, bodies_of, dot, each, nearest, square

__all__ = ["better_in_cells", "hard_particles"]

IN_CELLS_FROM = 256  # number of bodies from which cells are faster (benchmarks/scaling.py)


@functools.cache
def hard_particles(n: int, d: int, walls: bool, in_cells: bool = False) -> EventDriven:
    """Bodies that meet elastically in d dimensions, in a periodic box or between hard walls.

    An event is called n·k + l, k < l, where k meets l; n² + 2d·k + 2·axis + side where k meets a wall; and -1 - k where
    only the prediction of k is made again.

    in_cells: contacts are predicted only between neighbours; the sides of the box must be at least four diameters,
        otherwise all times are nan.

    args: "diameter" and "mass", a number or (n,); the sides of the box by the names in `SIDES`.
    """
    kind, way = BodyKind(n, d, walls), cells if in_cells else rows

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
    return EventDriven(bound(_free_flight), None, bound(_collide), bound(_gap), schedule=schedule, canonical=True)


def better_in_cells(n: int, sides: Sequence[float], widest: float) -> bool:
    """Whether there are many bodies, and enough cells that the box may shrink or the bodies grow a little."""
    wide = (cells.along(side, n, sides, widest) >= 2 * cells.CELLS_AN_AXIS for side in sides)
    return n >= IN_CELLS_FROM and all(map(bool, wide))


def _free_flight(kind: BodyKind, dt, x, args):
    half = kind.n * kind.d
    mass = jnp.repeat(each(kind, args["mass"]), kind.d)
    return jnp.concatenate([x[:half] + (dt / mass) * x[half:], x[half:]])


# Events.


def _touched(kind: BodyKind, which):
    """Indices of the state's components that belong to the two bodies."""
    one, other = bodies_of(kind, which)
    axes = jnp.arange(kind.d, dtype=which.dtype)
    places = jnp.concatenate([kind.d * one + axes, kind.d * other + axes])
    return jnp.concatenate([places, kind.n * kind.d + places])


class BodyPair(NamedTuple):
    """Two bodies at the time t, as scalars by component, so that no arrays must be assembled."""

    lightness: Any  # 1/m of each
    v: Any  # velocities of each
    relative: list  # velocity of the second relative to the first
    apart: list  # displacement from the first to the second, or to its nearest image


def _pair(kind: BodyKind, t, rows, args, which) -> BodyPair:
    d = kind.d
    lightness = tuple(1 / each(kind, args["mass"])[body] for body in bodies_of(kind, which))
    v = tuple([lightness[i] * rows[(2 + i) * d + axis] for axis in range(d)] for i in range(2))
    relative = [there - here for here, there in zip(*v, strict=True)]
    apart = [(rows[d + axis] - rows[axis]) + t * relative[axis] for axis in range(d)]
    if not kind.walls:
        apart = [nearest(apart[axis], args[SIDES[axis]]) for axis in range(d)]
    return BodyPair(lightness, v, relative, apart)


def _collide(kind: BodyKind, t, rows, args, which):
    """The momentum 2μ (w·q) q/q² goes from the second to the first, w the relative velocity; at a wall p_a is reversed.

    μ is the reduced mass. A kick Δp also changes the comoving position, by -t Δp/m.
    """
    pair, d = _pair(kind, t, rows, args, which), kind.d
    inverse = lax.integer_pow(sum(pair.lightness) / 2 * square(pair.apart), -1)  # 2μ/q²; its derivative is a product
    share = dot(pair.relative, pair.apart) * inverse
    kick, takes = [share * q for q in pair.apart], (1.0, -1.0)  # takes: the share of the kick that each gets
    if kind.walls:
        at_wall, axis = which >= kind.n**2, ((which - kind.n**2) % kind.faces) // 2
        turned = [jnp.where(axis == a, -2 * rows[2 * d + a], 0.0) for a in range(d)]
        kick = [jnp.where(at_wall, *one) for one in zip(turned, kick, strict=True)]
        takes = 1.0, jnp.where(at_wall, 0.0, -1.0)
    kick = [jnp.where(which < 0, 0.0, one) for one in kick]
    moved = [t * one for one in kick]
    q = [rows[i * d + a] - takes[i] * pair.lightness[i] * moved[a] for i in range(2) for a in range(d)]
    p = [rows[(2 + i) * d + a] + takes[i] * kick[a] for i in range(2) for a in range(d)]
    return jnp.stack(q + p)


def _gap(kind: BodyKind, t, rows, args, which):
    """The guard: q² - σ² of the two bodies, or the distance of the first from the wall."""
    pair = _pair(kind, t, rows, args, which)
    diameter = [each(kind, args["diameter"])[body] for body in bodies_of(kind, which)]
    gap = square(pair.apart) - (diameter[0] + diameter[1]) ** 2 / 4
    if not kind.walls:
        return gap
    face = (which - kind.n**2) % kind.faces
    position = [rows[a] + t * pair.v[0][a] for a in range(kind.d)]
    distances = [_to_wall(position[a], args[SIDES[a]], high) for a in range(kind.d) for high in (False, True)]
    distance = functools.reduce(jnp.add, [jnp.where(face == i, one, 0.0) for i, one in enumerate(distances)])
    return jnp.where(which >= kind.n**2, distance - diameter[0] / 2, gap)


def _to_wall(position, side, high: bool):
    return side - position if high else position
