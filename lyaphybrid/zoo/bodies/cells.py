"""The schedule of many bodies: contacts are predicted only with bodies in the same or a neighbouring cell.

Cells are at least as wide as the largest body, so that bodies meet only if their cells touch. Leaving a cell is an
event at which a body's predictions are made again; it changes only the schedule, which then goes on to the next event
(D. C. Rapaport, J. Comput. Phys. 34 (1980) 184, doi:10.1016/0021-9991(80)90104-7). So the cost of an event does not
depend on the number of bodies.

The prediction of a body is void if its partner's motion has changed since; then it is made again.
"""

import itertools
import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from .contacts import (
    BodyKind,
    bodies_of,
    contact,
    dot,
    each,
    motion,
    name_of,
    nearest,
    of_axes,
    smallest,
    time_to_wall,
    with_motion_of,
)

__all__ = ["CELLS_AN_AXIS", "CellPredictions", "along", "look_at_all", "predicted", "shifted", "update"]

CELLS_AN_AXIS = 4  # least number: then only the nearest image can be met
NOBODY = -1
LEAVES = -2  # the partner of a body that leaves its cell through border b is LEAVES - b


class LinkedCells(NamedTuple):
    """The bodies of each cell as linked lists: `head` is the first one, `after` links to the next."""

    counts: Array  # (d,) cells along each axis
    head: Array  # (cells,) first body of each cell
    after: Array  # (n,) next body of the same cell
    before: Array  # (n,) previous body of the same cell
    place: Array  # (d, n) cell of each body, along each axis


class CellPredictions(NamedTuple):
    """The cache of the schedule; positions and velocities by axis."""

    time: Array  # (n,) time of each body's next event, counted from the rebasing
    partner: Array  # (n,) its partner: another body, n + 2·axis + side for a wall, or `LEAVES`
    looked: Array  # (n,) number of events before each body's last prediction
    changed: Array  # (n,) number of the event that last changed each body's motion
    events: Array  # number of events so far
    first: Array  # body with the next event
    q: Array  # (d, n) comoving positions, q − t v
    v: Array  # (d, n)
    diameter: Array  # (n,)
    box: Array  # (d,)
    cells: LinkedCells


# Cells.


def _index(counts, place):
    """The cell at a place (d,)."""
    index = place[0]
    for axis in range(1, place.shape[0]):
        index = index * counts[axis] + place[axis]
    return index


def along(side, n: int, sides, widest):
    """Number of cells along a side of the box: at least as wide as the largest body, at most about 2n cells in all."""
    return jnp.minimum(side / widest, side * (2 * n / math.prod(sides)) ** (1 / len(sides)))


def _counts(kind: BodyKind, box, widest):
    return jnp.stack([jnp.floor(along(side, kind.n, list(box), widest)).astype(jnp.int32) for side in box])


def _filled(kind: BodyKind, q, box, widest) -> LinkedCells:
    counts = jnp.maximum(_counts(kind, box, widest), 1)
    share = q / box[:, None]
    place = jnp.floor((share - jnp.floor(share)) * counts[:, None].astype(q.dtype)).astype(jnp.int32)
    place = jnp.minimum(place, counts[:, None] - 1)
    nobody = jnp.full(kind.n, NOBODY, jnp.int32)
    empty = LinkedCells(counts, jnp.full(2 * kind.n, NOBODY, jnp.int32), nobody, nobody, place)
    return lax.fori_loop(0, kind.n, lambda body, cells: _entered(cells, body), empty)


def _entered(cells: LinkedCells, body) -> LinkedCells:
    """Insert a body at the head of the list of its cell."""
    body = jnp.asarray(body, jnp.int32)
    cell = _index(cells.counts, cells.place[:, body])
    follower = cells.head[cell]
    return cells._replace(
        head=cells.head.at[cell].set(body),
        after=cells.after.at[body].set(follower),
        before=_where_somebody(cells.before, follower, body).at[body].set(NOBODY),
    )


def _left(cells: LinkedCells, body) -> LinkedCells:
    """Remove a body from the list of its cell."""
    cell = _index(cells.counts, cells.place[:, body])
    ahead, follower = cells.before[body], cells.after[body]
    return cells._replace(
        head=cells.head.at[cell].set(jnp.where(ahead < 0, follower, cells.head[cell])),
        after=_where_somebody(cells.after, ahead, follower),
        before=_where_somebody(cells.before, follower, ahead),
    )


def _where_somebody(links, body, value):
    """Set the link of a body, unless `body` is NOBODY."""
    safe = jnp.maximum(body, 0)
    return links.at[safe].set(jnp.where(body < 0, links[safe], value))


def _moved_to_neighbour(cells: LinkedCells, body, border) -> LinkedCells:
    """Move a body through the border 2·axis + (0 low, 1 high)."""
    cells = _left(cells, body)
    step = jnp.where(jnp.arange(cells.counts.shape[0], dtype=jnp.int32) == border // 2, 2 * (border % 2) - 1, 0)
    place = (cells.place[:, body] + step) % cells.counts
    place = lax.dynamic_update_slice(cells.place, place[:, None], (jnp.zeros_like(body), body))
    return _entered(cells._replace(place=place), body)


# Predictions.


def look_at_all(kind: BodyKind, t, x, args) -> CellPredictions:
    """Predict the next events of all bodies from the time t on."""
    n = kind.n
    diameter, none = each(kind, args["diameter"]).astype(x.dtype), jnp.zeros(n, jnp.int32)
    q, v = motion(kind, x, args)
    box = of_axes(kind, args).astype(x.dtype)
    start = CellPredictions(
        time=jnp.zeros_like(diameter),
        partner=none,
        looked=none,
        changed=none,
        events=none[0],
        first=none[0],
        q=q,
        v=v,
        diameter=diameter,
        box=box,
        cells=_filled(kind, q, box, jnp.max(diameter)),
    )
    every = lax.fori_loop(0, n, lambda body, cache: _look_at(kind, cache, jnp.asarray(body, jnp.int32), t), start)
    # With too few cells neighbours would be missed: then all times are nan.
    enough = jnp.all(_counts(kind, box, jnp.max(diameter)) >= CELLS_AN_AXIS)
    every = every._replace(time=jnp.where(enough, every.time, jnp.nan))
    return _go_on(kind, every._replace(first=smallest(every.time)[1]), t)


def predicted(kind: BodyKind, cache: CellPredictions):
    """The time of the next event, and its name."""
    return cache.time[cache.first], name_of(kind, cache.first, cache.partner[cache.first])


def shifted(cache: CellPredictions, dt) -> CellPredictions:
    """Subtract dt from all times (rebasing)."""
    return cache._replace(time=cache.time - dt, q=cache.q + dt * cache.v)


def update(kind: BodyKind, cache: CellPredictions, t, x, args, which) -> CellPredictions:
    """Predict again for both bodies of the event, then for bodies that leave a cell or had one of them as partner."""
    bodies, events, changed = bodies_of(kind, which), cache.events + 1, cache.changed
    for body in bodies:
        changed = changed.at[body].set(events)
    cache = with_motion_of(kind, bodies, cache._replace(events=events, changed=changed), x, args)
    for body in bodies:
        cache = _look_at(kind, cache, body, t)
    return _go_on(kind, cache._replace(first=smallest(cache.time)[1]), t)


def _go_on(kind: BodyKind, cache: CellPredictions, t) -> CellPredictions:
    """Handle events of the schedule alone, from the time t to the next contact or wall."""

    def only_of_the_schedule(state):
        cache, _ = state
        partner = cache.partner[cache.first]
        changed = cache.changed[jnp.clip(partner, 0, kind.n - 1)] > cache.looked[cache.first]
        return (partner <= LEAVES) | ((partner >= 0) & (partner < kind.n) & changed)

    def look_again(state):
        cache, now = state
        body = cache.first
        partner = cache.partner[body]
        leaves = partner <= LEAVES
        now = jnp.where(leaves, cache.time[body], now)
        cells = lax.cond(leaves, lambda: _moved_to_neighbour(cache.cells, body, LEAVES - partner), lambda: cache.cells)
        cache = _look_at(kind, cache._replace(cells=cells), body, now)
        return cache._replace(first=smallest(cache.time)[1]), now

    return lax.while_loop(only_of_the_schedule, look_again, (cache, t))[0]


def _look_at(kind: BodyKind, cache: CellPredictions, body, t) -> CellPredictions:
    """Predict the next event of a body from time t on: the first of a contact, a wall and the border of its cell."""
    dt, partner = _neighbours(kind, cache, body, t)
    if kind.walls:
        wall, face = time_to_wall(kind, cache, body, t)
        dt, partner = jnp.minimum(dt, wall), jnp.where(wall < dt, face, partner)
    leave, border = _leaves(cache, body, t)
    partner = jnp.where(leave < dt, LEAVES - border, partner)
    return cache._replace(
        time=cache.time.at[body].set(t + jnp.minimum(dt, leave)),
        partner=cache.partner.at[body].set(partner),
        looked=cache.looked.at[body].set(cache.events),
    )


def _neighbours(kind: BodyKind, cache: CellPredictions, body, t):
    """Time to the first contact with a body of this or a neighbouring cell, and that body."""
    d, cells = kind.d, cache.cells
    around = jnp.asarray(list(itertools.product((-1, 0, 1), repeat=d)), jnp.int32)
    here, own_v, own_diameter = [cache.q[a, body] for a in range(d)], cache.v[:, body], cache.diameter[body]

    def meet(state):
        other, soonest, whom = state
        w = [cache.v[a, other] - own_v[a] for a in range(d)]
        apart = [(cache.q[a, other] - here[a]) + t * w[a] for a in range(d)]
        if not kind.walls:
            apart = [nearest(apart[a], cache.box[a]) for a in range(d)]
        reach = (cache.diameter[other] + own_diameter) / 2
        dt = contact(dot(apart, w), dot(apart, apart) - reach**2, dot(w, w))
        return cells.after[other], jnp.minimum(dt, soonest), jnp.where(dt < soonest, other, whom)

    def in_cell(i, state):
        cell = _index(cells.counts, (cells.place[:, body] + around[i]) % cells.counts)
        _, *best = lax.while_loop(lambda state: state[0] >= 0, meet, (cells.head[cell], *state))
        return tuple(best)

    never = jnp.full_like(t, jnp.inf), jnp.asarray(NOBODY, jnp.int32)
    return lax.fori_loop(0, around.shape[0], in_cell, never)


def _leaves(cache: CellPredictions, body, t):
    """Time until a body leaves its cell, and the border 2·axis + (0 low, 1 high)."""
    v, side = cache.v[:, body], cache.box / cache.cells.counts.astype(cache.box.dtype)
    inside = cache.q[:, body] + t * v - cache.cells.place[:, body].astype(side.dtype) * side
    inside = inside - cache.box * jnp.round((inside - side / 2) / cache.box)
    moving = v != 0
    room = jnp.maximum(jnp.where(v > 0, side - inside, inside), 0.0)
    times = jnp.where(moving, room / jnp.where(moving, jnp.abs(v), 1.0), jnp.inf)
    axis = jnp.argmin(times).astype(jnp.int32)
    return times[axis], 2 * axis + (v[axis] > 0).astype(jnp.int32)
