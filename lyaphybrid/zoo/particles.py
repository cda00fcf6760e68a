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
import math
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

from ..systems import EventDriven, Schedule

__all__ = ["SIDES", "hard_particles"]

SIDES = ("width", "height", "depth")  # names of the box's sides in args
LANES = 128  # so many numbers are compared at once; more in a loop, to keep the code short
NEVER = -1  # the partner of a body that is only to be looked at again


class Predictions(NamedTuple):
    """The cache of the schedule; positions and velocities by axis, so that n partners are one vector."""

    time: Array  # (n,) of each body's next event, counted from the rebasing
    partner: Array  # (n,) with whom: another body, n + 2·axis + (0 low, 1 high) for a wall, or `NEVER`
    looked: Array  # (n,) the number of the event after which each body was looked at
    known: Array  # (n, n) times of the contacts of each body as of that look
    aside: Array  # (n,) and of what is not a contact: a wall, or to look again
    face: Array  # (n,) which of these
    events: Array  # so far
    first: Array  # whose event is next
    q: Array  # (d, n) comoving
    v: Array  # (d, n)
    diameter: Array  # (n,)
    box: Array  # (d,)
    roomy: Array  # whether the images of a body keep clear of each other
    horizon: Array  # for so long no displacement changes by more than 1.5 L - σ


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
    """Two bodies at the time t, component by component: numbers that XLA need not put together."""

    q: Any  # of each, positions at present
    p: Any  # of each, momenta
    mass: Any  # of each
    apart: list  # from the first to the second, or to the image of it that is met


def _pair(kind: Kind, t, rows, args, which) -> Pair:
    d, bodies = kind.d, _bodies(kind, which)
    mass = tuple(_each(kind, args["mass"])[body] for body in bodies)
    p = tuple([rows[(2 + i) * d + axis] for axis in range(d)] for i in range(2))
    q = tuple([rows[i * d + axis] + t / mass[i] * p[i][axis] for axis in range(d)] for i in range(2))
    apart = [there - here for here, there in zip(*q, strict=True)]
    if not kind.walls:
        apart = [_nearest(apart[axis], args[SIDES[axis]]) for axis in range(d)]
    return Pair(q, p, mass, apart)


def _dot(a, b):
    return functools.reduce(jnp.add, [one * other for one, other in zip(a, b, strict=True)])


def _collide(kind: Kind, t, rows, args, which):
    """The momentum 2μ (w·q) q/q² goes from the second to the first, w the relative velocity; at a wall p_a turns round.

    μ is the reduced mass. What a kick changes in a momentum it changes in the comoving position, times -t/m.
    """
    pair = _pair(kind, t, rows, args, which)
    (one, other), d = pair.mass, kind.d
    # 2μ w = 2 (m₁ p₂ - m₂ p₁)/(m₁ + m₂)
    relative = [2 * (one * there - other * here) / (one + other) for here, there in zip(*pair.p, strict=True)]
    share = _dot(relative, pair.apart) / _dot(pair.apart, pair.apart)
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
    diameter = [_each(kind, args["diameter"])[body] for body in _bodies(kind, which)]
    gap = (_dot(pair.apart, pair.apart) - (diameter[0] + diameter[1]) ** 2 / 4) / 2
    if not kind.walls:
        return gap
    face = (which - kind.n**2) % kind.faces
    distances = [_to_wall(pair.q[0][a], args[SIDES[a]], high) for a in range(kind.d) for high in (False, True)]
    distance = functools.reduce(jnp.add, [jnp.where(face == i, one, 0.0) for i, one in enumerate(distances)])
    return jnp.where(which >= kind.n**2, distance - diameter[0] / 2, gap)


def _to_wall(position, side, high: bool):
    return side - position if high else position


# Predictions.


def _look_at_all(kind: Kind, t, x, args) -> Predictions:
    n, half = kind.n, kind.n * kind.d
    diameter, none = _each(kind, args["diameter"]).astype(x.dtype), jnp.zeros(n, jnp.int32)
    q, v = x[:half].reshape(n, kind.d).T, (x[half:].reshape(n, kind.d) / _each(kind, args["mass"])[:, None]).T
    widest, box = jnp.max(diameter), _box(kind, args).astype(x.dtype)
    # No two bodies part faster than two of the lightest that have all the energy.
    fastest = jnp.sqrt(2 * jnp.sum(x[half:].reshape(n, kind.d).T * v) / jnp.min(_each(kind, args["mass"])))
    start = Predictions(
        time=jnp.zeros_like(diameter),
        partner=none,
        looked=none,
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
    return every._replace(first=_first(every.time)[1])


def _next(kind: Kind, cache: Predictions):
    body, n = cache.first, kind.n
    partner = cache.partner[body]
    pair = n * jnp.minimum(body, partner) + jnp.maximum(body, partner)
    wall = n * n + kind.faces * body + (partner - n)
    return cache.time[body], jnp.where(partner == NEVER, -1 - body, jnp.where(partner < n, pair, wall))


def _shift(cache: Predictions, dt) -> Predictions:
    return cache._replace(
        time=cache.time - dt, known=cache.known - dt, aside=cache.aside - dt, q=cache.q + dt * cache.v
    )


def _update(kind: Kind, cache: Predictions, t, x, args, which) -> Predictions:
    """Look again at the two bodies of the event, and then at what is known of whoever is next but counted on one."""
    q, v, half = cache.q, cache.v, kind.n * kind.d
    bodies = _bodies(kind, which)
    for body in bodies:
        place, column = (kind.d * body,), (jnp.zeros_like(body), body)
        position = lax.dynamic_slice(x, place, (kind.d,))
        momentum = lax.dynamic_slice(x[half:], place, (kind.d,))
        q = lax.dynamic_update_slice(q, position[:, None], column)
        v = lax.dynamic_update_slice(v, (momentum / _each(kind, args["mass"])[body])[:, None], column)
    cache = _look_at(kind, cache._replace(q=q, v=v, events=cache.events + 1), bodies, t)

    def is_void(state):
        """Whether the next event's partner has been looked at since it was predicted."""
        _, partner, body = state
        known = (partner[body] >= 0) & (partner[body] < kind.n)
        return known & (cache.looked[jnp.clip(partner[body], 0, kind.n - 1)] > cache.looked[body])

    def choose_again(state):
        """From what is known of the body, less what has changed since."""
        time, partner, body = state
        changed = cache.looked > cache.looked[body]
        soonest, whom = _earliest(cache, body, jnp.where(changed, jnp.inf, cache.known[body]))
        time, partner = time.at[body].set(soonest), partner.at[body].set(whom)
        return time, partner, _first(time)[1]

    state = (cache.time, cache.partner, _first(cache.time)[1])
    time, partner, first = lax.while_loop(is_void, choose_again, state)
    return cache._replace(time=time, partner=partner, first=first)


def _first(values) -> tuple[Array, Array]:
    """The smallest value and its index: by halves, for a loop would wait for each comparison."""
    n = values.shape[0]
    whole = -n % LANES if n > LANES else 2 ** math.ceil(math.log2(n)) - n
    values = jnp.pad(values, (0, whole), constant_values=jnp.inf)
    places = jnp.arange(values.shape[0], dtype=jnp.int32)

    def smaller(one, other):
        less = other[0] < one[0]
        return jnp.where(less, other[0], one[0]), jnp.where(less, other[1], one[1])

    pairs = values, places
    if n > LANES:
        rows = values.reshape(-1, LANES), places.reshape(-1, LANES)
        start = rows[0][0], rows[1][0]
        pairs = lax.fori_loop(1, rows[0].shape[0], lambda i, best: smaller(best, (rows[0][i], rows[1][i])), start)
    while pairs[0].shape[0] > 1:
        half = pairs[0].shape[0] // 2
        pairs = smaller(*(tuple(part[side] for part in pairs) for side in (slice(None, half), slice(half, None))))
    return pairs[0][0], pairs[1][0]


def _earliest(cache: Predictions, body, contacts) -> tuple[Array, Array]:
    """The first of these contacts of a body, or what else comes before."""
    soonest, whom = _first(contacts)
    aside = cache.aside[body]
    return jnp.minimum(soonest, aside), jnp.where(aside < soonest, cache.face[body], whom)


def _look_at(kind: Kind, cache: Predictions, bodies, t) -> Predictions:
    """Predict the next events of bodies from the time t on."""
    for body in bodies:
        dt, face = _wall(kind, cache, body, t) if kind.walls else (cache.horizon, NEVER)
        contacts = t + _contacts(kind, cache, body, t)
        cache = cache._replace(
            looked=cache.looked.at[body].set(cache.events),
            known=lax.dynamic_update_index_in_dim(cache.known, contacts, body, 0),
            aside=cache.aside.at[body].set(t + dt),
            face=cache.face.at[body].set(face),
        )
        soonest, whom = _earliest(cache, body, contacts)
        time, partner = cache.time.at[body].set(soonest), cache.partner.at[body].set(whom)
        cache = cache._replace(time=time, partner=partner)
    return cache


def _contacts(kind: Kind, cache: Predictions, body, t):
    """Times (n,) to the contacts of a body with all others."""
    if kind.walls:
        return _contact(*_approach(cache, body, t))

    def soonest():
        images, speed2 = _images(cache, body, t)
        return functools.reduce(jnp.minimum, [_contact(*image, speed2) for image in images])

    def nearest_first():
        """Obstacles that do not overlap are met in the order of their centres: one root is enough."""
        images, speed2 = _images(cache, body, t)
        approach, excess = -jnp.inf, jnp.zeros_like(speed2)
        for one, other in images:
            meets = (one < 0) & (one * one > speed2 * other) & (one > approach)
            approach, excess = jnp.where(meets, one, approach), jnp.where(meets, other, excess)
        met = approach > -jnp.inf
        return jnp.where(met, _contact(jnp.where(met, approach, -1.0), excess, speed2), jnp.inf)

    return lax.cond(cache.roomy, nearest_first, soonest)


def _relative(cache: Predictions, body, t):
    """By axis: displacements (n,) of all from a body at the time t, and their velocities; and the squared reaches."""
    velocity = [v - v[body] for v in cache.v]
    apart = [(q - q[body]) + t * w for q, w in zip(cache.q, velocity, strict=True)]
    return apart, velocity, ((cache.diameter + cache.diameter[body]) / 2) ** 2


def _approach(cache: Predictions, body, t):
    """q·w, q² - σ² and w² of all with a body; q is from it to them, w the relative velocity."""
    apart, velocity, reach2 = _relative(cache, body, t)
    return _dot(apart, velocity), _dot(apart, apart) - reach2, _dot(velocity, velocity)


def _images(cache: Predictions, body, t):
    """The same for the images that can be met: (q·w, q² - σ²) of each, and w² of all.

    Along each axis: the nearest image, and the next one ahead.
    """
    apart, velocity, reach2 = _relative(cache, body, t)
    shares = []  # of the scalar products
    for displacement, w, side in zip(apart, velocity, cache.box, strict=True):
        nearest = _nearest(displacement, side)
        ahead = nearest + jnp.where(w > 0, -side, side)
        shares.append([(q * w, q * q) for q in (nearest, ahead)])
    images = [
        tuple(functools.reduce(jnp.add, part) for part in zip(*image, strict=True))
        for image in itertools.product(*shares)
    ]
    return [(approach, square - reach2) for approach, square in images], _dot(velocity, velocity)


def _contact(approach, excess, speed2):
    """When q + w t is as long as the reach: q² - σ² = excess, q·w = approach, w² = speed2; inf: never."""
    discriminant = approach * approach - speed2 * excess
    meets = (approach < 0) & (discriminant > 0)
    root = jnp.sqrt(jnp.where(meets, discriminant, 1.0))
    return jnp.where(meets, excess / (root - approach), jnp.inf)


def _wall(kind: Kind, cache: Predictions, body, t):
    """Time to the first wall, and which."""
    v, radius = cache.v[:, body], cache.diameter[body] / 2
    q = cache.q[:, body] + t * v
    room = jnp.where(v > 0, cache.box - radius - q, q - radius)
    moving = v != 0
    times = jnp.where(moving, room / jnp.where(moving, jnp.abs(v), 1.0), jnp.inf)
    faces = kind.n + 2 * jnp.arange(kind.d, dtype=jnp.int32) + (v > 0).astype(jnp.int32)
    soonest = jnp.min(times)
    return soonest, jnp.max(jnp.where(times == soonest, faces, 0))
