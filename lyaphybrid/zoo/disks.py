"""Hard disks in a periodic box, and one disk among fixed ones: the closed-form flow is a straight line.

The next contact of a pair may be with any periodic image. While a pair's displacement changes by less than
1.5 L − σ, L the shorter side, only the 3×3 images round the nearest one can be met; and of these not those
behind the motion, because the nearest one is at least as close to the partner at all later times: 2×2 are
left. Where no contact comes within that horizon, `next_event` returns the time at which it has to look again,
with which = -1: nobody meets, the jump is the identity.
"""

import math

import jax.numpy as jnp
from jax import lax

from ..systems import EventDriven
from .problem import (
    Problem,
    Real,
    Reference,
    computed,
    near,
    problem,
    require,
    state,
)

TRIANGULAR = math.sqrt(3) / 2  # the aspect of a box that a triangular lattice of 4 m² sites fits


def _nearest(displacement, side):
    """The displacement to the nearest image; the choice of the image has no derivative."""
    return displacement - lax.stop_gradient(side * jnp.round(displacement / side))


def _contact_times(dx, dy, vx, vy, width, height, diameter):
    """Time (pairs,) until |d + v t| falls to the diameter, over the images that may be met; inf: never."""
    dx, dy = _nearest(dx, width), _nearest(dy, height)
    speed2 = vx * vx + vy * vy
    shifts_x = (0.0, jnp.where(vx > 0, -width, width))
    shifts_y = (0.0, jnp.where(vy > 0, -height, height))
    soonest = jnp.full_like(dx, jnp.inf)
    for shift_x in shifts_x:
        for shift_y in shifts_y:
            x, y = dx + shift_x, dy + shift_y
            approach, excess = x * vx + y * vy, x * x + y * y - diameter * diameter
            discriminant = approach * approach - speed2 * excess
            meets = (approach < 0) & (discriminant > 0)
            root = jnp.sqrt(jnp.where(meets, discriminant, 1.0))
            soonest = jnp.minimum(soonest, jnp.where(meets, excess / (root - approach), jnp.inf))
    return soonest, speed2


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1]


def _horizon(speed2, width, height, diameter):
    """The time for which the images next to the nearest one are all that can be met."""
    fastest = jnp.sqrt(jnp.maximum(jnp.max(speed2), jnp.finfo(speed2.dtype).tiny))
    return (1.5 * jnp.minimum(width, height) - diameter) / fastest


def _look_again(t):
    """A guard that falls through zero here and now, whatever the state."""
    return lax.stop_gradient(t) - t


def _ray(dt, t, x, args):
    return jnp.concatenate([x[:2] + dt * x[2:], x[2:]])


def _next_scatterer(t, x, args):
    dx, dy, vx, vy = (x[i : i + 1] for i in range(4))
    times, speed2 = _contact_times(dx, dy, vx, vy, 1.0, 1.0, args["radius"])
    horizon = _horizon(speed2, 1.0, 1.0, args["radius"])
    again = times[0] > horizon
    return jnp.where(again, horizon, times[0]), jnp.where(again, -1, 0)


def _reflect(t, x, args, which):
    d, v = _nearest(x[:2], 1.0), x[2:]
    turned = v - (2 * jnp.sum(d * v) / args["radius"] ** 2) * d
    return jnp.concatenate([x[:2], jnp.where(jnp.asarray(which) < 0, v, turned)])


def _outside(t, x, args, which):
    d = _nearest(x[:2], 1.0)
    outside = (jnp.sum(d * d) - args["radius"] ** 2) / 2
    return jnp.where(jnp.asarray(which) < 0, _look_again(t), outside)


SINAI = EventDriven(flow=_ray, next_event=_next_scatterer, jump=_reflect, guard=_outside, canonical=True)

# by radius: the exponent per unit time and its standard error
_SINAI_VALUES = {
    0.4: (2.738746203850052, 1.1002418984596302e-4),
    0.2: (1.4700714947236198, 5.032388602553726e-05),
}


def _paired(values, stderr, dimension, how) -> Reference:
    """The positive exponents, their negatives, and zeros between them."""
    zeros = [0.0] * (dimension - 2 * len(values))
    down = [-v for v in reversed(values)]
    return computed([*values, *zeros, *down], [*stderr, *zeros, *reversed(stderr)], source=how)


@problem
def sinai_billiard(*, radius: Real = 0.4) -> Problem:
    """A point of speed 1 among fixed disks: one of this radius at each corner of a periodic unit square.

    State x = (q, v), shape (4,). Exponents λ, 0, 0, −λ. Two hard disks of diameter σ in a square of side L
    are this billiard for their relative coordinate, with radius σ/L.

    Args:
        radius: of the scatterers, in units of the side, in (0, 1/2).

    Returns:
        A `Problem`, with a reference at radius 0.4 (2.73875(11)) and 0.2 (1.470071(50)).

    Source:
        Ya. G. Sinai, Dynamical systems with elastic reflections, Russ. Math. Surv. 25 (1970) 137,
        doi:10.1070/RM1970v025n02ABEH003794.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.sinai_billiard().reference)
        2.73875(11), 0, 0, -2.73875(11) per unit time (ray tracing in C)
    """
    require("radius", radius, lambda r: 0 < r < 0.5, "between 0 and 1/2 of the side")
    reference = None
    for known, (value, stderr) in _SINAI_VALUES.items():
        if near(radius, known):
            reference = _paired([value], [stderr], 4, "ray tracing in C")
    return Problem(
        system=SINAI,
        x0=state(0.5, 0.45, math.cos(0.7), math.sin(0.7)),
        args={"radius": radius},
        t1=10_000.0,
        transient=20.0,
        reference=reference,
        source="Ya. G. Sinai, Russ. Math. Surv. 25 (1970) 137, doi:10.1070/RM1970v025n02ABEH003794",
    )
