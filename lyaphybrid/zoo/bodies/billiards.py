"""Billiards: a point of speed 1 among fixed disks, in a stadium, in an ellipse; and one that falls in a wedge.

In a magnetic field the arcs between the walls are as exact as straight lines (`walls`). Among disks, within
a path of 1.5 rows minus the radius, only the disks of the 3×3 cells around the nearest one can be met. Without a
contact on that path `next_event` returns its end, with which = -1: the prediction is made again there.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from ..problem import (
    Problem,
    Real,
    Reference,
    computed,
    exact,
    near,
    one_of,
    positive,
    problem,
    require,
    state,
    traced,
)
from .walls import ARC, FALL, STRAIGHT_PATH, billiard, falls, first, lowest

SQUARE = ((1.0, 0.0), (0.0, 1.0))
TRIANGULAR_LATTICE = ((1.0, 0.5), (0.0, math.sqrt(3) / 2))
CELLS = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(9, 2)


def _lattice_gas(path, lattice, sizes):
    """A point among disks: the columns of the lattice are unit vectors; sizes: args -> (spacing, radius)."""
    basis = np.array(lattice)
    row = float(np.linalg.det(basis))

    def heights(q, args):
        """Heights (9,) above the nine disks around q."""
        spacing, radius = sizes(args)
        vectors = spacing * jnp.asarray(basis, q.dtype)
        cell = jnp.round(jnp.asarray(np.linalg.inv(basis), q.dtype) @ q / spacing)
        d = q[None, :] - (cell[None, :] + jnp.asarray(CELLS, q.dtype)) @ vectors.T
        return (jnp.sum(d * d, axis=1) - radius * radius) / 2

    def nearest(q, args, which):
        return lowest(heights(q, args))

    def next_event(t, x, args):
        spacing, radius = sizes(args)
        reach, speed = 1.5 * row * spacing - radius, jnp.sqrt(jnp.sum(x[2:] ** 2))
        # A circular path that stays within the reach without a contact never has one.
        turns = jnp.abs(path.turning(args)) * reach > speed
        horizon = jnp.where(turns, jnp.inf, reach / speed)
        soonest = jnp.min(falls(path, heights, x, args))
        again = soonest > horizon
        return jnp.where(again, horizon, soonest), jnp.where(again, -1, 0)

    return billiard(path, next_event, nearest)


def _convex(path, heights):
    """A point inside convex walls: the event is the first height that falls through zero."""

    def next_event(t, x, args):
        return first(falls(path, heights, x, args))

    return billiard(path, next_event, lambda q, args, which: heights(q, args)[which])


def _in_stadium(path):
    """Two lines and two half circles, which = 0 … 3: above, below, right, left; q = 0 in the middle."""

    def heights(q, args):
        r, right, left = args["radius"], q[0] - args["side"] / 2, q[0] + args["side"] / 2
        arcs = [(r * r - x * x - q[1] * q[1]) / 2 for x in (right, left)]
        return jnp.stack([r - q[1], r + q[1], *arcs])

    def beyond(x, args):
        """Signed distances beyond the points where lines and circles meet: (…) -> (…, 2)."""
        return jnp.stack([x, -x], axis=-1) - args["side"] / 2

    def next_event(t, x, args):
        inside = jnp.concatenate([jnp.ones(2, bool), beyond(x[0], args) > 0])
        times = falls(path, heights, x, args, inside)
        met = jax.vmap(lambda dt: path.flow(dt, t, x, args)[0])(jnp.where(times < jnp.inf, times, 0.0))
        past = beyond(met, args)
        # Near their common point line and circle differ only by the distance squared: both count there.
        slack = args["radius"] * jnp.finfo(x.dtype).eps ** 0.5
        there = jnp.concatenate([jnp.max(past[:2], axis=1) < slack, jnp.diagonal(past[2:]) > -slack])
        return first(jnp.where(there, times, jnp.inf))

    return billiard(path, next_event, lambda q, args, which: heights(q, args)[which])


def _in_ellipse(q, args):
    return (1 - (q[:1] / args["a"]) ** 2 - (q[1:] / args["b"]) ** 2) / 2


def _in_wedge(q, args):
    across, up = q[0] * jnp.cos(args["angle"]), q[1] * jnp.sin(args["angle"])
    return jnp.stack([up - across, up + across])


def _unit_square(args):
    return 1.0, args["radius"]


def _unit_disks(args):
    return 2 + args["gap"], 1.0


# Keys: whether there is a magnetic field.
SINAI = {False: _lattice_gas(STRAIGHT_PATH, SQUARE, _unit_square), True: _lattice_gas(ARC, SQUARE, _unit_square)}
LORENTZ = {
    False: _lattice_gas(STRAIGHT_PATH, TRIANGULAR_LATTICE, _unit_disks),
    True: _lattice_gas(ARC, TRIANGULAR_LATTICE, _unit_disks),
}
STADIUM = {False: _in_stadium(STRAIGHT_PATH), True: _in_stadium(ARC)}
ELLIPSE = _convex(STRAIGHT_PATH, _in_ellipse)
WEDGE = _convex(FALL, _in_wedge)

# Exponent per unit time and its standard error, by problem and parameter.
_VALUES = {
    ("sinai_billiard", 0.4): (2.738746203850052, 1.1002418984596302e-4),
    ("sinai_billiard", 0.2): (1.4700714947236198, 5.032388602553726e-05),
    ("lorentz_gas", 0.3): (1.7593596049348743, 6.959871598209079e-05),
    ("stadium", 1.0): (0.4603368696744877, 0.00014255899798038045),
}


def _in_field(systems, field, **args):
    """The system and its args; without a field the lines are straight, and (q, v) is canonical."""
    magnetic = traced(field) or field != 0
    return {"system": systems[magnetic], "args": {**args, "field": field} if magnetic else args}


def known_reference(name: str, parameter, field) -> Reference | None:
    """The reference λ, 0, 0, −λ, if there is no field and λ is known."""
    for (known, value), (exponent, stderr) in _VALUES.items():
        if known == name and near((parameter, field), value, 0.0):
            return computed((exponent, 0, 0, -exponent), (stderr, 0, 0, stderr), source="ray tracing in C")
    return None


def _start(x, y):
    return state(x, y, math.cos(0.7), math.sin(0.7))


@problem
def sinai_billiard(*, radius: Real = 0.4, field: Real = 0.0) -> Problem:
    """A point of speed 1 among fixed disks: one of this radius at each corner of a periodic unit square.

    State x = (q, v), shape (4,); positions are not wrapped into the square. Exponents λ, 0, 0, −λ. Two hard
    disks of diameter σ in a square of side L are this billiard for their relative coordinate, with radius σ/L.

    Args:
        radius: of the scatterers, in units of the side, in (0, 1/2).
        field: B, the velocity's angular velocity: v' = B (−v_y, v_x); |B| is the curvature of the arcs.

    Returns:
        A `Problem`, with a reference at radius 0.4 (2.73875(11)) and 0.2 (1.470071(50)) without field. The
        event's `which` is 0; -1 is no reflection but a prediction to be made again.

    Source:
        Ya. G. Sinai, Dynamical systems with elastic reflections, Russ. Math. Surv. 25 (1970) 137,
        doi:10.1070/RM1970v025n02ABEH003794.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.sinai_billiard().reference)
        2.73875(11), 0, 0, -2.73875(11) per unit time (ray tracing in C)
    """
    require("radius", radius, lambda r: 0 < r < 0.5, "between 0 and 1/2 of the side")
    return Problem(
        **_in_field(SINAI, field, radius=radius),
        x0=_start(0.5, 0.45),
        t1=10_000.0,
        transient=20.0,
        reference=known_reference("sinai_billiard", radius, field),
        source="Ya. G. Sinai, Russ. Math. Surv. 25 (1970) 137, doi:10.1070/RM1970v025n02ABEH003794",
    )


@problem
def lorentz_gas(*, gap: Real = 0.3, field: Real = 0.0) -> Problem:
    """A point of speed 1 among fixed disks of radius 1, whose centres are a triangular lattice.

    State x = (q, v), shape (4,), a centre at 0; positions are not wrapped, so that they diffuse. Exponents λ,
    0, 0, −λ. Free paths are bounded where gap < 4/√3 − 2 = 0.3094; above, corridors are open.

    Args:
        gap: between the disks: centres are 2 + gap apart, in units of the radius.
        field: B, the velocity's angular velocity: v' = B (−v_y, v_x); |B| is the curvature of the arcs.

    Returns:
        A `Problem`, with a reference at gap 0.3 (1.759360(70)) without field. The event's `which` is 0; -1 is
        no reflection but a prediction to be made again.

    Source:
        L. A. Bunimovich & Ya. G. Sinai, Statistical properties of Lorentz gas with periodic configuration of
        scatterers, Commun. Math. Phys. 78 (1981) 479, doi:10.1007/BF02046760.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.lorentz_gas().reference)
        1.759360(70), 0, 0, -1.759360(70) per unit time (ray tracing in C)
    """
    positive(gap=gap)
    return Problem(
        **_in_field(LORENTZ, field, gap=gap),
        x0=_start((2 + gap) / 2, (2 + gap) / 3),  # between three disks
        t1=10_000.0,
        transient=20.0,
        reference=known_reference("lorentz_gas", gap, field),
        source="L. A. Bunimovich & Ya. G. Sinai, Commun. Math. Phys. 78 (1981) 479, doi:10.1007/BF02046760",
    )


@problem
def stadium(*, side: Real = 1.0, radius: Real = 1.0, field: Real = 0.0) -> Problem:
    """A point of speed 1 between two parallel lines, closed by two half circles.

    State x = (q, v), shape (4,), q = 0 in the middle. Exponents λ, 0, 0, −λ. The event's `which` is 0, 1, 2, 3:
    the line above, that below, the half circle to the right, that to the left.

    Args:
        side: length of the lines.
        radius: of the half circles, half the distance of the lines.
        field: B, the velocity's angular velocity: v' = B (−v_y, v_x); |B| is the curvature of the arcs.

    Returns:
        A `Problem`, with a reference at side 1 and radius 1 without field (0.46034(14)).

    Source:
        L. A. Bunimovich, On the ergodic properties of nowhere dispersing billiards, Commun. Math. Phys. 65
        (1979) 295, doi:10.1007/BF01197884.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.stadium().reference)
        0.46034(14), 0, 0, -0.46034(14) per unit time (ray tracing in C)
    """
    positive(side=side, radius=radius)
    return Problem(
        **_in_field(STADIUM, field, side=side, radius=radius),
        x0=_start(0.1 * side, 0.2 * radius),
        t1=20_000.0,
        transient=50.0,
        reference=known_reference("stadium", side, field) if near(radius, 1.0) else None,
        source="L. A. Bunimovich, Commun. Math. Phys. 65 (1979) 295, doi:10.1007/BF01197884",
    )


@problem
def ellipse(*, a: Real = 2.0, b: Real = 1.0) -> Problem:
    """A point of speed 1 inside the ellipse x²/a² + y²/b² = 1.

    State x = (q, v), shape (4,). Integrable: the product of the angular momenta about the two foci is conserved,
    and all exponents are 0.

    Args:
        a: half axis along x.
        b: half axis along y.

    Returns:
        A `Problem`, with its exact reference.

    Source:
        M. V. Berry, Regularity and chaos in classical mechanics, illustrated by three deformations of a circular
        'billiard', Eur. J. Phys. 2 (1981) 91, doi:10.1088/0143-0807/2/2/006.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.ellipse().reference)
        0, 0, 0, 0 per unit time (integrable)
    """
    positive(a=a, b=b)
    return Problem(
        system=ELLIPSE,
        x0=_start(0.1 * a, 0.2 * b),
        args={"a": a, "b": b},
        t1=10_000.0,
        transient=50.0,
        reference=exact(0, 0, 0, 0, source="integrable"),
        source="M. V. Berry, Eur. J. Phys. 2 (1981) 91, doi:10.1088/0143-0807/2/2/006",
    )


@problem
def wedge(*, angle: Real = math.pi / 4) -> Problem:
    """A point that falls, y'' = −1, between two walls that rise from the origin at equal angles.

    State x = (q, v), shape (4,). The speed varies; the energy v²/2 + y is conserved. With walls at 45° from the
    vertical it is integrable: all exponents are 0. Wider wedges are chaotic: λ, 0, 0, −λ; in narrower ones islands
    and chaos are mixed. λ scales as 1/√E.

    Args:
        angle: between each wall and the vertical, radians, in (0, π/2).

    Returns:
        A `Problem`, with its exact reference at π/4. The event's `which` is 0, the wall to the right, or 1.

    Source:
        H. E. Lehtihet & B. N. Miller, Numerical study of a billiard in a gravitational field, Physica D 21 (1986)
        93; M. P. Wojtkowski, A system of one dimensional balls with gravity, Commun. Math. Phys. 126 (1990) 507,
        doi:10.1007/BF02125698.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.wedge().reference)
        0, 0, 0, 0 per unit time (integrable)
    """
    require("angle", angle, lambda w: 0 < w < math.pi / 2, "between 0 and π/2")
    return Problem(
        system=WEDGE,
        x0=state(0.0, 1.0, 0.4, 0.3),
        args={"angle": angle},
        t1=20_000.0,
        transient=50.0,
        reference=exact(0, 0, 0, 0, source="integrable") if near(angle, math.pi / 4) else None,
        source="H. E. Lehtihet & B. N. Miller, Physica D 21 (1986) 93; M. P. Wojtkowski, Commun. Math. Phys. 126 "
        "(1990) 507, doi:10.1007/BF02125698",
    )


# For each problem: parameters -> (accessible area, perimeter within it) of one cell.
_EXTENT = {
    "sinai_billiard": lambda radius: (1 - math.pi * radius**2, 2 * math.pi * radius),
    "lorentz_gas": lambda gap: (math.sqrt(3) / 2 * (2 + gap) ** 2 - math.pi, 2 * math.pi),
    "stadium": lambda side, radius: (2 * side * radius + math.pi * radius**2, 2 * side + 2 * math.pi * radius),
}


def mean_free_path(billiard: Problem) -> Real:
    """The mean length of the paths between reflections, π · area/perimeter, exactly.

    The mean over all points and directions: that of almost every run where the billiard is ergodic. A magnetic
    field does not change it where every orbit meets a wall.

    Args:
        billiard: a `sinai_billiard`, `lorentz_gas` or `stadium`.

    Returns:
        π times the accessible area over the perimeter within it; open corridors make no difference.

    Raises:
        ValueError: for any other problem.

    Source:
        N. Chernov, Entropy, Lyapunov exponents, and mean free path for billiards, J. Stat. Phys. 88 (1997) 1,
        doi:10.1007/BF02508462.

    Example:
        >>> from lyaphybrid import zoo
        >>> round(zoo.mean_free_path(zoo.lorentz_gas()), 6)
        0.719841
    """
    one_of("the problem", billiard.name, tuple(_EXTENT))
    shape = {name: value for name, value in billiard.parameters.items() if name != "field"}
    area, perimeter = _EXTENT[billiard.name](**shape)
    return math.pi * area / perimeter
