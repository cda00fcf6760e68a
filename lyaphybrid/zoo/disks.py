"""Hard disks in a periodic box: the closed-form flow is a straight line.

The next contact of a pair may be with any periodic image. While a pair's displacement changes by less than
1.5 L − σ, L the shorter side, only the 3×3 images round the nearest one can be met; and of these not those
behind the motion, because the nearest one is at least as close to the partner at all later times: 2×2 are
left. Where no contact comes within that horizon, `next_event` returns the time at which it has to look again,
with which = -1: nobody meets, the jump is the identity.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..systems import EventDriven
from .problem import (
    Problem,
    Real,
    Reference,
    computed,
    near,
    number,
    positive,
    problem,
    require,
    traced,
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


@functools.cache
def _disks(n: int) -> EventDriven:
    """Return n disks, x = (q₁, …, q_n, p₁, …, p_n); which = n·first + second of the pair, or -1."""
    offsets = range(1, n // 2 + 1)  # pairs (i, i + offset mod n): slices of a doubled vector, no gather
    one = np.tile(np.arange(n), len(offsets))
    other = np.concatenate([(np.arange(n) + offset) % n for offset in offsets])
    names = np.minimum(one, other) * n + np.maximum(one, other)

    def differences(u):
        twice = jnp.concatenate([u, u])
        return jnp.concatenate([twice[offset : offset + n] - u for offset in offsets])

    def components(x):
        return x[0 : 2 * n : 2], x[1 : 2 * n : 2], x[2 * n :: 2], x[2 * n + 1 :: 2]

    def flow(dt, t, x, args):
        return jnp.concatenate([x[: 2 * n] + (dt / args["mass"]) * x[2 * n :], x[2 * n :]])

    def next_event(t, x, args):
        dx, dy, px, py = (differences(u) for u in components(x))
        box = args["width"], args["height"], args["diameter"]
        times, speed2 = _contact_times(dx, dy, px / args["mass"], py / args["mass"], *box)
        soonest, horizon = jnp.min(times), _horizon(speed2, *box)
        pair = jnp.max(jnp.where(times == soonest, jnp.asarray(names), -1))
        again = soonest > horizon
        return jnp.where(again, horizon, soonest), jnp.where(again, -1, pair)

    def partners(which):
        """The two particles; twice the same one where nobody meets."""
        pair = jnp.maximum(jnp.asarray(which), 0)
        size = jnp.asarray(n, pair.dtype)
        return lax.div(pair, size), lax.rem(pair, size)

    def relative(x, args, first, second):
        """Displacement (2,) to the nearest image, and momentum (2,), second minus first."""

        def difference(start):
            there = lax.dynamic_slice_in_dim(x, start + 2 * second, 2)
            return there - lax.dynamic_slice_in_dim(x, start + 2 * first, 2)

        return _nearest(difference(0), jnp.stack([args["width"], args["height"]])), difference(2 * n)

    def jump(t, x, args, which):
        first, second = partners(which)

        def transfer(x):
            q, p = relative(x, args, first, second)
            return (_dot(p, q) / args["diameter"] ** 2) * q

        # Also so that XLA computes the transfer once, and not for every component anew.
        kick = lax.cond(jnp.asarray(which) >= 0, transfer, lambda x: jnp.zeros_like(x[:2]), x)
        here = jnp.arange(n, dtype=first.dtype)
        sign = (here == first).astype(x.dtype) - (here == second).astype(x.dtype)
        return x + jnp.concatenate([jnp.zeros(2 * n, x.dtype), jnp.outer(sign, kick).ravel()])

    def guard(t, x, args, which):
        q, _ = relative(x, args, *partners(which))
        return jnp.where(jnp.asarray(which) < 0, _look_again(t), (_dot(q, q) - args["diameter"] ** 2) / 2)

    return EventDriven(flow=flow, next_event=next_event, jump=jump, guard=guard, canonical=True)


# by radius: the exponent per unit time and its standard error
_SINAI_VALUES = {
    0.4: (2.738746203850052, 1.1002418984596302e-4),
    0.2: (1.4700714947236198, 5.032388602553726e-05),
}
# by (n, density σ², aspect): positive exponents in units of √(K/(m n))/σ, standard errors, how
_DISK_VALUES = {
    (4, 0.7, TRIANGULAR): (
        (4.882388346721429, 4.131369664339284, 3.546932156196429, 3.054711729975, 2.6269126780428564),
        (0.0001998147082338836, 0.00015994570337895237, 0.00014755608759481882, 0.00015464533531656092)
        + (0.00014168204475602757,),
        "event-driven C, t = 2.8e7",
    ),
    (4, 0.2, TRIANGULAR): (
        (1.5808275537888894, 1.1704466810555554, 0.8674522158233333, 0.6382693979933334, 0.48097748955999986),
        (0.0002606812180448773, 0.0002480443740446444, 0.0002144278897259846, 0.00017893523565866453)
        + (0.00015821774569596645,),
        "event-driven C, t = 9e6",
    ),
}


def _disk_reference(n, density, aspect, diameter, mass, energy) -> Reference | None:
    if traced(density, aspect, diameter, mass, energy):
        return None
    rate = math.sqrt(energy / (mass * n)) / diameter
    for (count, number_density, shape), (values, stderr, how) in _DISK_VALUES.items():
        if count == n and near((density * diameter**2, aspect), number_density, shape):
            return _paired([v * rate for v in values], [e * rate for e in stderr], 4 * n, how)
    side = math.sqrt(n / density)
    for ratio, (value, error) in _SINAI_VALUES.items():
        if n == 2 and near((aspect, diameter / side), 1.0, ratio):
            speed = 2 * math.sqrt(energy / mass) / side  # relative to the box
            return _paired([value * speed], [error * speed], 8, "equals the Sinai billiard, ray tracing in C")
    return None


def _paired(values, stderr, dimension, how) -> Reference:
    """The positive exponents, their negatives, and zeros between them."""
    zeros = [0.0] * (dimension - 2 * len(values))
    down = [-v for v in reversed(values)]
    return computed([*values, *zeros, *down], [*stderr, *zeros, *reversed(stderr)], source=how)


def _lattice(n: int, width: float, height: float) -> tuple[np.ndarray, float]:
    """Return n sites (n, 2) of the rectangular or staggered lattice that is widest, and that spacing."""
    best = np.zeros((n, 2)), 0.0
    for columns in range(1, n + 1):
        rows = -(-n // columns)
        i, j = (a.ravel() for a in np.divmod(np.arange(columns * rows), rows))
        for stagger in (0.0, 0.5) if columns % 2 == 0 else (0.0,):
            x = (i + 0.25) / columns
            y = (j + 0.25 + stagger * (i % 2)) / rows
            apart = np.stack([x[1:] - x[0], y[1:] - y[0]])
            apart = (apart - np.round(apart)) * np.array([[width], [height]])
            spacing = min(np.min(np.hypot(*apart), initial=np.inf), width, height)
            if spacing > best[1] * (1 + 1e-9):
                best = np.stack([x * width, y * height], axis=1)[:n], float(spacing)
    return best


@jax.jit
def _start(key, sites, square):
    """Sites and normal momenta of sum zero whose squares have this sum: (4n,)."""
    momenta = jax.random.normal(key, sites.shape, sites.dtype)
    momenta = momenta - jnp.mean(momenta, axis=0, keepdims=True)
    momenta = momenta * jnp.sqrt(square / jnp.sum(momenta**2))
    return jnp.concatenate([sites.ravel(), momenta.ravel()])


@problem
def hard_disks(
    *,
    n: int = 4,
    density: Real = 0.7,
    aspect: Real = TRIANGULAR,
    diameter: Real = 1.0,
    mass: Real = 1.0,
    kinetic_energy: Real | None = None,
    key: jax.Array | None = None,
) -> Problem:
    """Hard disks, n of them, in a periodic box L_x × L_y, L_x L_y = n/density, L_x/L_y = aspect.

    q' = p/m. Disks k and l meet where (|q|² − σ²)/2 falls through 0, q the displacement l minus k to the
    nearest image, and exchange the momentum (p·q) q/σ², p = p_l − p_k. State x = (q₁x, q₁y, …, p₁x, p₁y, …),
    shape (4n,); positions are not wrapped into the box. Exponents come in pairs ±λ; six of them are 0
    (energy, two momenta, and their partners: the flow and two translations). λ scales as √(K/(m n))/σ at
    fixed density · σ² and aspect.

    The event's `which` is n·k + l with k < l; -1 is no collision but a prediction to be made again. The start
    is a lattice with normally distributed momenta, their sum taken away, scaled to the kinetic energy. Other
    keys give other starts of the same ensemble.

    Args:
        n: number of disks, at least 2.
        density: number density n/(L_x L_y), per length².
        aspect: L_x/L_y.
        diameter: σ, length.
        mass: m.
        kinetic_energy: K of all disks together; None: n.
        key: a `jax.random.key`; None: key 0.

    Returns:
        A `Problem`; with a reference for n = 4 at density · σ² = 0.7 (Table I of Dinius; 4.88239(20), …) and
        0.2, and for n = 2 in the squares in which the pair is a Sinai billiard with a known exponent.

    Source:
        J. Dinius, Computing Lyapunov Exponents of Hybrid Dynamical Systems; C. Dellago, H. A. Posch & W. G.
        Hoover, Lyapunov instability in a system of hard disks, Phys. Rev. E 53 (1996) 1485,
        doi:10.1103/PhysRevE.53.1485.

    Example:
        >>> from lyaphybrid import zoo
        >>> disks = zoo.hard_disks()
        >>> disks.x0.shape, round(disks.args["width"], 4), round(disks.args["height"], 4)
        ((16,), 2.2246, 2.5687)
        >>> [round(v, 3) for v in disks.reference.exponents[:5]]
        [4.882, 4.131, 3.547, 3.055, 2.627]
    """
    require("n", n, lambda v: v >= 2, "at least 2")
    positive(density=density, aspect=aspect, diameter=diameter, mass=mass)
    if traced(density, aspect, diameter):
        raise ValueError(
            "density, aspect and diameter decide where the disks start and must be known numbers; "
            "trace args['width'], args['height'] and args['diameter'] of a problem instead."
        )
    energy = float(n) if kinetic_energy is None else number("kinetic_energy", kinetic_energy)
    positive(kinetic_energy=energy)
    width, height = math.sqrt(n / density * aspect), math.sqrt(n / density / aspect)
    sites, spacing = _lattice(n, width, height)
    if spacing <= diameter:
        raise ValueError(
            f"{n} disks of diameter {diameter:g} at the number density {density:g} do not fit on a lattice "
            f"in a box {width:.4g} × {height:.4g}: neighbours would be {spacing:.4g} apart. The density must "
            f"be below {density * (spacing / diameter) ** 2:.4g} for this n and aspect."
        )
    start = _start(jax.random.key(0) if key is None else key, jnp.asarray(sites, float), 2 * mass * energy)
    return Problem(
        system=_disks(n),
        x0=start,
        args={"width": width, "height": height, "diameter": diameter, "mass": mass},
        t1=1000.0,
        transient=20.0,
        reference=_disk_reference(n, density, aspect, diameter, mass, energy),
        source="C. Dellago, H. A. Posch & W. G. Hoover, Phys. Rev. E 53 (1996) 1485, "
        "doi:10.1103/PhysRevE.53.1485; J. Dinius, Computing Lyapunov Exponents of Hybrid Dynamical Systems",
        parameters={
            "n": n,
            "density": density,
            "aspect": aspect,
            "diameter": diameter,
            "mass": mass,
            "kinetic_energy": energy,
        },
    )
