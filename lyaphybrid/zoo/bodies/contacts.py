"""What both schedules of many bodies share: the bodies of an event, times of contacts and of wall collisions."""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array

__all__ = [
    "SIDES",
    "BodyKind",
    "bodies_of",
    "contact",
    "dot",
    "each",
    "motion",
    "name_of",
    "nearest",
    "of_axes",
    "smallest",
    "square",
    "time_to_wall",
    "with_motion_of",
]

SIDES = ("width", "height", "depth")  # names of the box's sides in args
LANES = 128  # numbers that are compared at once; more are compared in a loop, to keep the code short


class BodyKind(NamedTuple):
    """The static properties of a system."""

    n: int
    d: int
    walls: bool

    @property
    def faces(self) -> int:
        """Number of walls, two for each axis."""
        return 2 * self.d


def each(kind: BodyKind, value) -> Array:
    """A property of the bodies, (n,)."""
    return jnp.broadcast_to(jnp.asarray(value), (kind.n,))


def of_axes(kind: BodyKind, args) -> Array:
    """The sides of the box, (d,)."""
    return jnp.stack([jnp.asarray(args[side]) for side in SIDES[: kind.d]])


@functools.partial(jax.jit, static_argnums=0)  # traced once
def bodies_of(kind: BodyKind, which) -> tuple[Any, Any]:
    """The two bodies of an event; at a wall, or at a mere new prediction, the second one is arbitrary."""
    n = kind.n
    pair, at_wall, idle = which, (which - n * n) // kind.faces, -1 - which
    alone = jnp.where(which < 0, idle, at_wall)
    single = (which < 0) | (which >= n * n)
    return jnp.where(single, alone, pair // n), jnp.where(single, (alone + 1) % n, pair % n)


def name_of(kind: BodyKind, body, partner):
    """The name of an event of a body with a partner: another body, or n + 2·axis + side for a wall."""
    pair = kind.n * jnp.minimum(body, partner) + jnp.maximum(body, partner)
    return jnp.where(partner < kind.n, pair, kind.n**2 + kind.faces * body + (partner - kind.n))


def motion(kind: BodyKind, x, args) -> tuple[Array, Array]:
    """Comoving positions (d, n) and velocities (d, n) of all bodies."""
    q, p = x.reshape(2, kind.n, kind.d)
    return q.T, (p / each(kind, args["mass"])[:, None]).T


def with_motion_of(kind: BodyKind, bodies, cache: Any, x, args) -> Any:
    """The cache with updated positions and velocities of these bodies."""
    q, v, half = cache.q, cache.v, kind.n * kind.d
    for body in bodies:
        place, column = (kind.d * body,), (jnp.zeros_like(body), body)
        position, momentum = (lax.dynamic_slice(part, place, (kind.d,)) for part in (x, x[half:]))
        q = lax.dynamic_update_slice(q, position[:, None], column)
        v = lax.dynamic_update_slice(v, (momentum * (1 / each(kind, args["mass"])[body]))[:, None], column)
    return cache._replace(q=q, v=v)


def nearest(displacement, box):
    """The displacement to the nearest image; the choice of the image is constant for derivatives."""
    return displacement - lax.stop_gradient(box * jnp.round(displacement * (1 / box)))


def dot(a, b):
    """The scalar product of lists of components."""
    return functools.reduce(jnp.add, [one * other for one, other in zip(a, b, strict=True)])


def square(a):
    """The scalar product of a list of components with itself; its derivative has half the products of `dot`."""
    return functools.reduce(jnp.add, map(jnp.square, a))


def contact(approach, excess, speed2):
    """The first t ≥ 0 with |q + w t| = σ, from q² - σ² = excess, q·w = approach, w² = speed2; inf: never."""
    discriminant = approach * approach - speed2 * excess
    meets = (approach < 0) & (discriminant > 0)
    root = jnp.sqrt(jnp.where(meets, discriminant, 1.0))
    return jnp.where(meets, excess / (root - approach), jnp.inf)


def smallest(values) -> tuple[Array, Array]:
    """The smallest value and its index, by pairwise halving, which avoids a chain of dependent comparisons."""
    n = values.shape[0]
    whole = -n % LANES if n > LANES else 2 ** math.ceil(math.log2(n)) - n
    values = jnp.pad(values, (0, whole), constant_values=jnp.inf) if whole else values
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


def time_to_wall(kind: BodyKind, cache: Any, body, t):
    """Time to the first wall, and the wall."""
    v, radius = cache.v[:, body], cache.diameter[body] / 2
    q = cache.q[:, body] + t * v
    room = jnp.where(v > 0, cache.box - radius - q, q - radius)
    moving = v != 0
    times = jnp.where(moving, room / jnp.where(moving, jnp.abs(v), 1.0), jnp.inf)
    faces = kind.n + 2 * jnp.arange(kind.d, dtype=jnp.int32) + (v > 0).astype(jnp.int32)
    soonest = jnp.min(times)
    return soonest, jnp.max(jnp.where(times == soonest, faces, 0))
