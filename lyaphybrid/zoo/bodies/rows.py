"""The schedule of up to some hundred bodies: contacts of a body with all others are predicted in one vector.

For every body the cache holds its next contact (or wall), the earliest over all partners and their periodic images, as
predicted last. An event changes two bodies, whose predictions are made again. The predictions of others with one of
them are void; that is noticed when such a prediction becomes the next event, by the partner's number of events, and
only then the body chooses again among its known contacts (B. D. Lubachevsky, J. Comput. Phys. 94 (1991) 255). So an
event costs two predictions against n partners, not one for each pair.

A pair can meet through any periodic image. While its displacement changes by less than 1.5 L - σ, L the shortest side,
only the images next to the nearest one can be met; and of these not those behind the motion, because the nearest one
is at least as close to the partner at all later times: two an axis are left. Without a contact within that
horizon the body's prediction is made again at its end: an event with a negative name that changes no state.
"""

import functools
import itertools
from typing import NamedTuple

import jax
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

__all__ = ["RowPredictions", "look_at_all", "predicted", "shifted", "update"]

NEW_PREDICTION = -1  # the partner of a body whose next event is only a new prediction


class RowPredictions(NamedTuple):
    """The cache of the schedule; positions and velocities by axis, so that n partners are one vector."""

    time: Array  # (n,) time of each body's next event, counted from the rebasing
    partner: Array  # (n,) its partner: another body, n + 2·axis + (0 low, 1 high) for a wall, or `NEW_PREDICTION`
    looked: Array  # (n,) number of events before each body's last prediction
    since: Array  # (n,) time of that prediction
    known: Array  # (n, n) times from `since` to the contacts of each body
    aside: Array  # (n,) time of a wall or of a new prediction
    face: Array  # (n,) which of these
    events: Array  # number of events so far
    first: Array  # body with the next event
    q: Array  # (d, n) comoving positions, q − t v
    v: Array  # (d, n)
    diameter: Array  # (n,)
    box: Array  # (d,)
    roomy: Array  # whether the images of a body cannot overlap each other
    horizon: Array  # time in which no displacement changes by more than 1.5 L - σ


def look_at_all(kind: BodyKind, t, x, args) -> RowPredictions:
    """Predict the next events of all bodies from the time t on."""
    n = kind.n
    diameter, none = each(kind, args["diameter"]).astype(x.dtype), jnp.zeros(n, jnp.int32)
    mass, (q, v) = each(kind, args["mass"]), motion(kind, x, args)
    widest, box = jnp.max(diameter), of_axes(kind, args).astype(x.dtype)
    # Largest relative speed: that of two of the lightest bodies with all of the energy.
    fastest = jnp.sqrt(2 * jnp.sum(mass[None, :] * v * v) / jnp.min(mass))
    start = RowPredictions(
        time=jnp.zeros_like(diameter),
        partner=none,
        looked=none,
        since=jnp.zeros_like(diameter),
        known=jnp.zeros((n, n), x.dtype),
        aside=jnp.zeros_like(diameter),
        face=none,
        events=none[0],
        first=none[0],
        q=q,
        v=v,
        diameter=diameter,
        box=box,
        roomy=jnp.min(box) >= 2 * widest,
        horizon=(1.5 * jnp.min(box) - widest) / jnp.maximum(fastest, jnp.finfo(x.dtype).tiny),
    )
    every = lax.fori_loop(0, n, lambda body, cache: _look_at(kind, cache, (body,), t), start)
    return every._replace(first=smallest(every.time)[1])


def predicted(kind: BodyKind, cache: RowPredictions):
    """The time of the next event, and its name."""
    body, partner = cache.first, cache.partner[cache.first]
    return cache.time[body], jnp.where(partner == NEW_PREDICTION, -1 - body, name_of(kind, body, partner))


def shifted(cache: RowPredictions, dt) -> RowPredictions:
    """Subtract dt from all times (rebasing)."""
    return cache._replace(
        time=cache.time - dt, since=cache.since - dt, aside=cache.aside - dt, q=cache.q + dt * cache.v
    )


def update(kind: BodyKind, cache: RowPredictions, t, x, args, which) -> RowPredictions:
    """Predict again for the two bodies of the event; while the next event is void, choose again from known contacts."""
    bodies = bodies_of(kind, which)
    cache = with_motion_of(kind, bodies, cache._replace(events=cache.events + 1), x, args)
    cache = _look_at(kind, cache, bodies, t)

    def is_void(state):
        """Whether the next event's partner has changed since the event was predicted."""
        _, partner, body = state
        known = (partner[body] >= 0) & (partner[body] < kind.n)
        return known & (cache.looked[jnp.clip(partner[body], 0, kind.n - 1)] > cache.looked[body])

    def choose_again(state):
        """The first of the body's known contacts with partners that have not changed since."""
        time, partner, body = state
        changed = cache.looked > cache.looked[body]
        soonest, whom = _earliest(cache, body, jnp.where(changed, jnp.inf, cache.known[body]))
        time, partner = time.at[body].set(soonest), partner.at[body].set(whom)
        return time, partner, smallest(time)[1]

    state = (cache.time, cache.partner, smallest(cache.time)[1])
    time, partner, first = lax.while_loop(is_void, choose_again, state)
    return cache._replace(time=time, partner=partner, first=first)


def _earliest(cache: RowPredictions, body, contacts) -> tuple[Array, Array]:
    """The first of these contacts of a body, or an earlier wall or new prediction."""
    soonest, whom = smallest(contacts)
    contact, aside = cache.since[body] + soonest, cache.aside[body]
    return jnp.minimum(contact, aside), jnp.where(aside < contact, cache.face[body], whom)


def _look_at(kind: BodyKind, cache: RowPredictions, bodies, t) -> RowPredictions:
    """Predict the next events of bodies from the time t on."""
    for body in bodies:
        cache = _looked_at(kind, cache, body, t)
    return cache


@functools.partial(jax.jit, static_argnums=0)  # traced once
def _looked_at(kind: BodyKind, cache: RowPredictions, body, t) -> RowPredictions:
    dt, face = time_to_wall(kind, cache, body, t) if kind.walls else (cache.horizon, NEW_PREDICTION)
    contacts = _contacts(kind, cache, body, t)
    cache = cache._replace(
        looked=cache.looked.at[body].set(cache.events),
        since=cache.since.at[body].set(t),
        known=lax.dynamic_update_index_in_dim(cache.known, contacts, body, 0),
        aside=cache.aside.at[body].set(t + dt),
        face=cache.face.at[body].set(face),
    )
    soonest, whom = _earliest(cache, body, contacts)
    time, partner = cache.time.at[body].set(soonest), cache.partner.at[body].set(whom)
    return cache._replace(time=time, partner=partner)


def _contacts(kind: BodyKind, cache: RowPredictions, body, t):
    """Times (n,) to the contacts of a body with all others."""
    if kind.walls:
        return contact(*_approach(cache, body, t))

    def soonest():
        images, speed2 = _images(cache, body, t)
        return functools.reduce(jnp.minimum, [contact(*image, speed2) for image in images])

    def nearest_first():
        """Images that do not overlap are met in the order of their centres, so one square root is enough."""
        images, speed2 = _images(cache, body, t)
        approach, excess = -jnp.inf, jnp.zeros_like(speed2)
        for one, other in images:
            meets = (one < 0) & (one * one > speed2 * other) & (one > approach)
            approach, excess = jnp.where(meets, one, approach), jnp.where(meets, other, excess)
        met = approach > -jnp.inf
        return jnp.where(met, contact(jnp.where(met, approach, -1.0), excess, speed2), jnp.inf)

    return lax.cond(cache.roomy, nearest_first, soonest)


def _relative(cache: RowPredictions, body, t):
    """For each axis displacements (n,) and relative velocities of all from a body at time t; and squared reaches."""
    velocity = [v - v[body] for v in cache.v]
    apart = [(q - q[body]) + t * w for q, w in zip(cache.q, velocity, strict=True)]
    return apart, velocity, ((cache.diameter + cache.diameter[body]) / 2) ** 2


def _approach(cache: RowPredictions, body, t):
    """q·w, q² - σ² and w² of all with a body; q is from it to them, w the relative velocity."""
    apart, velocity, reach2 = _relative(cache, body, t)
    return dot(apart, velocity), dot(apart, apart) - reach2, dot(velocity, velocity)


def _images(cache: RowPredictions, body, t):
    """As `_approach`, for the images that can be met: (q·w, q² - σ²) of each, and w².

    These are, along each axis, the nearest image and the next one ahead.
    """
    apart, velocity, reach2 = _relative(cache, body, t)
    shares = []  # terms of the scalar products
    for displacement, w, side in zip(apart, velocity, cache.box, strict=True):
        near = nearest(displacement, side)
        ahead = near + jnp.where(w > 0, -side, side)
        shares.append([(q * w, q * q) for q in (near, ahead)])
    images = [
        tuple(functools.reduce(jnp.add, part) for part in zip(*image, strict=True))
        for image in itertools.product(*shares)
    ]
    return [(approach, square - reach2) for approach, square in images], dot(velocity, velocity)
