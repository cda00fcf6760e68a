"""Hard disks and spheres as a scheduled system: straight flights, elastic contacts, one prediction a body.

Every body knows when it next meets another one (or a wall), as of when it was last looked at: the earliest contact over
all partners and their periodic images. An event changes two bodies; these are looked at again. Others may have counted
on one of them: that is seen when their turn comes, because the partner's number of events is not what it was, and
only then are they looked at again (B. D. Lubachevsky, J. Comput. Phys. 94 (1991) 255). So an event costs some three
looks at n partners, whatever the number of pairs.

A pair can meet through any periodic image. While its displacement changes by less than 1.5 L - σ, L the shortest side,
only the images next to the nearest one can be met; and of these not those behind the motion, because the nearest one
is at least as close to the partner at all later times: two an axis are left. Where no contact comes within that
horizon, the body has to be looked at again then: an event with a negative name, at which nothing happens.

The state is x = (q₁, …, q_n, p₁, …, p_n), d components each. Between rebasings q stands for q - p t/m.
"""

import functools
import itertools
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from ..systems import EventDriven, Schedule

__all__ = ["SIDES", "hard_particles"]

SIDES = ("width", "height", "depth")  # names of the box's sides in args
NEVER = -1  # the partner of a body that is only to be looked at again


class Predictions(NamedTuple):
    """The cache of the schedule; positions and velocities by axis, so that n partners are one vector."""

    time: Array  # (n,) of each body's next event, counted from the rebasing
    partner: Array  # (n,) with whom: another body, n + 2·axis + (0 low, 1 high) for a wall, or `NEVER`
    seen: Array  # (n,) the partner's number of events when it was predicted
    events: Array  # (n,) of each body so far
    first: Array  # whose event is next
    q: Array  # (d, n) comoving
    v: Array  # (d, n)
    diameter: Array  # (n,)
    box: Array  # (d,)


class Kind(NamedTuple):
    """What is fixed when a system is made."""

    n: int
    d: int
    walls: bool

    @property
    def faces(self) -> int:
        """Names of walls that one body needs."""
        return 2 * self.d


@functools.cache
def hard_particles(n: int, d: int, walls: bool) -> EventDriven:
    """Bodies that meet elastically in d dimensions, in a periodic box or between hard walls.

    An event is called n·k + l, k < l, where k meets l; n² + 2d·k + 2·axis + side where k meets a wall; and -1 - k where
    k is only looked at again.

    args: "diameter" and "mass", a number or (n,); the sides of the box by the names in `SIDES`.
    """
    kind = Kind(n, d, walls)

    def bound(function):
        return functools.partial(function, kind)

    schedule = Schedule(
        init=bound(_look_at_all),
        next=bound(_next),
        update=bound(_update),
        shift=_shift,
        touch=bound(_touched),
        flat=True,
    )
    return EventDriven(bound(_fly), None, bound(_collide), bound(_gap), schedule=schedule, canonical=True)


def _each(kind: Kind, value) -> Array:
    """A property of the bodies, (n,)."""
    return jnp.broadcast_to(jnp.asarray(value), (kind.n,))


def _box(kind: Kind, args) -> Array:
    return jnp.stack([jnp.asarray(args[side]) for side in SIDES[: kind.d]])


def _fly(kind: Kind, dt, x, args):
    half = kind.n * kind.d
    mass = jnp.repeat(_each(kind, args["mass"]), kind.d)
    return jnp.concatenate([x[:half] + (dt / mass) * x[half:], x[half:]])


# Events.


def _bodies(kind: Kind, which) -> tuple[Any, Any]:
    """The two bodies of an event; at a wall, or where nothing happens, the second is any other one."""
    n = kind.n
    pair, at_wall, idle = which, (which - n * n) // kind.faces, -1 - which
    alone = jnp.where(which < 0, idle, at_wall)
    single = (which < 0) | (which >= n * n)
    return jnp.where(single, alone, pair // n), jnp.where(single, (alone + 1) % n, pair % n)


def _touched(kind: Kind, which):
    """Components of the positions and momenta of the two."""
    one, other = _bodies(kind, which)
    axes = jnp.arange(kind.d, dtype=which.dtype)
    places = jnp.concatenate([kind.d * one + axes, kind.d * other + axes])
    return jnp.concatenate([places, kind.n * kind.d + places])


def _nearest(displacement, box):
    """The displacement to the nearest image; the choice of the image has no derivative."""
    return displacement - lax.stop_gradient(box * jnp.round(displacement / box))


class Pair(NamedTuple):
    """Two bodies at the time t."""

    q: Array  # (2, d) positions at present
    p: Array  # (2, d)
    mass: Array  # (2,)
    apart: Array  # (d,) from the first to the second, or to the image of it that is met

    @property
    def velocity(self) -> Array:
        """(d,) of the second relative to the first."""
        return self.p[1] / self.mass[1] - self.p[0] / self.mass[0]


def _pair(kind: Kind, t, rows, args, which) -> Pair:
    mass = jnp.stack([_each(kind, args["mass"])[body] for body in _bodies(kind, which)])
    q, p = rows.reshape(2, 2, kind.d)
    q = q + (t / mass)[:, None] * p
    apart = q[1] - q[0]
    return Pair(q, p, mass, apart if kind.walls else _nearest(apart, _box(kind, args)))


def _collide(kind: Kind, t, rows, args, which):
    """The momentum 2μ (w·q) q/q² goes from the second to the first, w the relative velocity; at a wall p_a turns round.

    μ is the reduced mass. What a kick changes in a momentum it changes in the comoving position, times -t/m.
    """
    pair = _pair(kind, t, rows, args, which)
    reduced = pair.mass[0] * pair.mass[1] / (pair.mass[0] + pair.mass[1])
    square = jnp.sum(pair.apart**2)
    kick = 2 * reduced * jnp.sum(pair.velocity * pair.apart) / square * pair.apart
    kicks = jnp.stack([kick, -kick])
    if kind.walls:
        kicks = jnp.where(which >= kind.n**2, _turned(kind, pair, which), kicks)
    kicks = jnp.where(which < 0, 0.0, kicks)
    q, p = rows.reshape(2, 2, kind.d)
    return jnp.stack([q - (t / pair.mass)[:, None] * kicks, p + kicks]).ravel()


def _turned(kind: Kind, pair: Pair, which):
    """The kicks at a wall: the first body's momentum along the axis turns round."""
    axis = ((which - kind.n**2) % kind.faces) // 2
    here = jnp.arange(kind.d, dtype=axis.dtype) == axis
    return jnp.stack([jnp.where(here, -2 * pair.p[0], 0.0), jnp.zeros_like(pair.p[1])])


def _gap(kind: Kind, t, rows, args, which):
    """(q² - σ²)/2 of the two; or the distance of the first from the wall; falls where nothing happens, too."""
    pair = _pair(kind, t, rows, args, which)
    diameter = jnp.stack([_each(kind, args["diameter"])[body] for body in _bodies(kind, which)])
    gap = (jnp.sum(pair.apart**2) - (diameter[0] + diameter[1]) ** 2 / 4) / 2
    if not kind.walls:
        return gap
    face = (which - kind.n**2) % kind.faces
    axis, high = face // 2, face % 2 == 1
    here = jnp.arange(kind.d, dtype=axis.dtype) == axis
    position = jnp.sum(jnp.where(here, pair.q[0], 0.0))
    side = jnp.sum(jnp.where(here, _box(kind, args), 0.0))
    distance = jnp.where(high, side - position, position) - diameter[0] / 2
    return jnp.where(which >= kind.n**2, distance, gap)


# Predictions.


def _look_at_all(kind: Kind, t, x, args) -> Predictions:
    half = kind.n * kind.d
    mass = _each(kind, args["mass"])
    none = jnp.zeros(kind.n, jnp.int32)
    diameter = _each(kind, args["diameter"]).astype(x.dtype)
    q, v = x[:half].reshape(kind.n, kind.d).T, (x[half:].reshape(kind.n, kind.d) / mass[:, None]).T
    box = _box(kind, args).astype(x.dtype)
    start = Predictions(jnp.zeros_like(diameter), none, none, none, none[0], q, v, diameter, box)
    every = lax.fori_loop(0, kind.n, lambda body, known: _look_at(kind, known, body, t), start)
    return every._replace(first=_argmin(every.time))


def _next(kind: Kind, known: Predictions):
    body = known.first
    partner, n = known.partner[body], kind.n
    pair = n * jnp.minimum(body, partner) + jnp.maximum(body, partner)
    wall = n * n + kind.faces * body + (partner - n)
    return known.time[body], jnp.where(partner == NEVER, -1 - body, jnp.where(partner < n, pair, wall))


def _shift(known: Predictions, dt) -> Predictions:
    return known._replace(time=known.time - dt, q=known.q + dt * known.v)


def _update(kind: Kind, known: Predictions, t, x, args, which) -> Predictions:
    """Look again at the two bodies of the event, and then at whoever is next but counted on one who has changed."""
    time, events, q, v = known.time, known.events, known.q, known.v
    mass, half = _each(kind, args["mass"]), kind.n * kind.d
    for body in _bodies(kind, which):
        time = time.at[body].set(-jnp.inf)
        events = events.at[body].add(1)
        q = lax.dynamic_update_slice(
            q, lax.dynamic_slice(x, (kind.d * body,), (kind.d,))[:, None], (jnp.zeros_like(body), body)
        )
        p = lax.dynamic_slice(x, (half + kind.d * body,), (kind.d,))
        v = lax.dynamic_update_slice(v, (p / mass[body])[:, None], (jnp.zeros_like(body), body))
    known = known._replace(time=time, events=events, q=q, v=v, first=_bodies(kind, which)[0])

    def is_void(known):
        body = known.first
        partner = known.partner[body]
        counted = (partner >= 0) & (partner < kind.n)
        changed = known.events[jnp.clip(partner, 0, kind.n - 1)] != known.seen[body]
        return (counted & changed) | (known.time[body] == -jnp.inf)

    def look(known):
        known = _look_at(kind, known, known.first, t)
        return known._replace(first=_argmin(known.time))

    return lax.while_loop(is_void, look, known)


def _argmin(values) -> Array:
    """The index of the smallest."""
    places = jnp.arange(values.shape[0], dtype=jnp.int32)
    return jnp.min(jnp.where(values == jnp.min(values), places, values.shape[0] - 1))


def _look_at(kind: Kind, known: Predictions, body, t) -> Predictions:
    """Predict the next event of a body from the time t on."""
    apart = (known.q - known.q[:, body][:, None]) + t * (known.v - known.v[:, body][:, None])
    velocity = known.v - known.v[:, body][:, None]
    reach = (known.diameter + known.diameter[body]) / 2
    dt, partner = _soonest(kind, apart, velocity, reach, known.box)
    if kind.walls:
        q = known.q[:, body] + t * known.v[:, body]
        at_wall, face = _soonest_wall(kind, q, known.v[:, body], known.diameter[body] / 2, known.box)
        partner = jnp.where(at_wall < dt, face, partner)
        dt = jnp.minimum(at_wall, dt)
    seen = known.events[jnp.clip(partner, 0, kind.n - 1)]
    return known._replace(
        time=known.time.at[body].set(t + dt),
        partner=known.partner.at[body].set(partner),
        seen=known.seen.at[body].set(seen),
    )


def _soonest(kind: Kind, apart, velocity, reach, box):
    """Time to the first contact and with whom, or to when all partners have to be looked at again.

    apart, velocity: (d, n) of the partners relative to the body.
    """
    # Along each axis: the nearest image, and the next one ahead; its share of the scalar products q·w and q².
    shares = []
    for axis in range(kind.d):
        images = [apart[axis]]
        if not kind.walls:
            nearest = _nearest(apart[axis], box[axis])
            images = [nearest, nearest + jnp.where(velocity[axis] > 0, -box[axis], box[axis])]
        shares.append([(q * velocity[axis], q * q) for q in images])
    speed2, contact = jnp.sum(velocity**2, axis=0), jnp.full_like(reach, jnp.inf)
    for image in itertools.product(*shares):
        approach, square = (sum(parts) for parts in zip(*image, strict=True))
        contact = jnp.minimum(contact, _contact(approach, square - reach**2, speed2))
    partners, time = jnp.arange(kind.n, dtype=jnp.int32), contact
    if not kind.walls:
        # Until then the displacement changes by less than 1.5 L - σ.
        tiny = jnp.finfo(speed2.dtype).tiny
        horizon = (1.5 * jnp.min(box) - reach) / jnp.sqrt(jnp.maximum(speed2, tiny))
        time, partners = jnp.minimum(contact, horizon), jnp.where(contact > horizon, NEVER, partners)
    soonest = jnp.min(time)
    return soonest, jnp.max(jnp.where(time == soonest, partners, NEVER))


def _contact(approach, excess, speed2):
    """When q + w t is as long as the reach: q² - σ² = excess, q·w = approach, w² = speed2; inf: never."""
    discriminant = approach * approach - speed2 * excess
    meets = (approach < 0) & (discriminant > 0)
    root = jnp.sqrt(jnp.where(meets, discriminant, 1.0))
    return jnp.where(meets, excess / (root - approach), jnp.inf)


def _soonest_wall(kind: Kind, q, v, radius, box):
    """Time to the first wall, and which."""
    room = jnp.where(v > 0, box - radius - q, q - radius)
    moving = v != 0
    times = jnp.where(moving, room / jnp.where(moving, jnp.abs(v), 1.0), jnp.inf)
    faces = kind.n + 2 * jnp.arange(kind.d, dtype=jnp.int32) + (v > 0).astype(jnp.int32)
    soonest = jnp.min(times)
    return soonest, jnp.max(jnp.where(times == soonest, faces, 0))
