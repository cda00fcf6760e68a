"""Many hard disks and hard spheres: named problems with starts and references."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._jax.engines import compiled
from ..problem import (
    Problem,
    Real,
    Reference,
    computed,
    near,
    number,
    one_of,
    positive,
    problem,
    require,
    several,
    traced,
)
from .billiards import known_reference
from .contacts import SIDES
from .particles import better_in_cells, hard_particles

TRIANGULAR_ASPECT = math.sqrt(3) / 2  # aspect of a box that fits a triangular lattice of 4 m² sites
WALLS = ("periodic", "hard")
SOURCE = (
    "C. Dellago, H. A. Posch & W. G. Hoover, Phys. Rev. E 53 (1996) 1485, doi:10.1103/PhysRevE.53.1485; J. Dinius, "
    "Computing Lyapunov Exponents of Hybrid Dynamical Systems"
)

# By (n, density σ², aspect): positive exponents in units of √(K/(m n))/σ, standard errors, source.
_DISK_VALUES = {
    (4, 0.7, TRIANGULAR_ASPECT): (
        (4.882388346721429, 4.131369664339284, 3.546932156196429, 3.054711729975, 2.6269126780428564),
        (0.0001998147082338836, 0.00015994570337895237, 0.00014755608759481882, 0.00015464533531656092)
        + (0.00014168204475602757,),
        "event-driven C, t = 2.8e7",
    ),
    (4, 0.2, TRIANGULAR_ASPECT): (
        (1.5808275537888894, 1.1704466810555554, 0.8674522158233333, 0.6382693979933334, 0.48097748955999986),
        (0.0002606812180448773, 0.0002480443740446444, 0.0002144278897259846, 0.00017893523565866453)
        + (0.00015821774569596645,),
        "event-driven C, t = 9e6",
    ),
}


def _disk_reference(n, density, aspect, diameter, mass, energy) -> Reference | None:
    if traced(density, aspect, diameter, mass, energy) or np.ndim(diameter) or np.ndim(mass):
        return None
    rate = math.sqrt(energy / (mass * n)) / diameter
    for (count, number_density, shape), (values, stderr, how) in _DISK_VALUES.items():
        if count == n and near((density * diameter**2, aspect), number_density, shape):
            return _paired([v * rate for v in values], [e * rate for e in stderr], 4 * n, how)
    side = math.sqrt(n / density)
    billiard = known_reference("sinai_billiard", diameter / side, 0.0)
    if n == 2 and near(aspect, 1.0) and billiard:  # that of their relative coordinate
        speed = 2 * math.sqrt(energy / mass) / side  # relative to the box
        value, error = billiard.exponents[0] * speed, billiard.stderr[0] * speed
        return _paired([value], [error], 8, "equals the Sinai billiard, ray tracing in C")
    return None


def _paired(values, stderr, dimension, how) -> Reference:
    """The positive exponents, their negatives, and zeros between them."""
    zeros = [0.0] * (dimension - 2 * len(values))
    down = [-v for v in reversed(values)]
    return computed([*values, *zeros, *down], [*stderr, *zeros, *reversed(stderr)], source=how)


def _lattice(n: int, sides: Sequence[float], walls: bool) -> tuple[np.ndarray, float]:
    """Return n sites (n, d) of the lattice with the largest spacing in this box, and the spacing.

    Tried are lattices of equal cells; in a periodic box also with every second layer shifted by half a cell along the
    other axes, which makes triangular lattices in the plane, body-centred and face-centred ones in space.
    """
    best = np.zeros((n, len(sides))), 0.0
    for counts in _cells(n, sides):
        cells = np.stack([a.ravel() for a in np.indices(counts)], axis=1)
        for stagger in (0.0, 0.5) if counts[0] % 2 == 0 and not walls else (0.0,):
            shift = stagger * (cells[:, :1] % 2) * np.array([0.0] + [1.0] * (len(sides) - 1))
            sites = (cells + (0.5 if walls else 0.25) + shift) / np.array(counts)
            apart = sites[1:] - sites[0]
            apart = (apart - np.round(apart)) * np.array(sides)
            spacing = min(np.min(np.linalg.norm(apart, axis=1), initial=np.inf), *sides)
            if spacing > best[1] * (1 + 1e-9):
                best = (sites * np.array(sides))[:n], float(spacing)
    return best


def _cells(n: int, sides: Sequence[float]):
    """Numbers of cells along the axes, at least n together and within a factor of three of cubes."""
    cube = (math.prod(sides) / n) ** (1 / len(sides))
    free = [range(max(1, int(side / cube / 3)), min(n, math.ceil(3 * side / cube)) + 1) for side in sides[:-1]]
    for counts in itertools.product(*free):
        yield (*counts, -(-n // math.prod(counts)))


@compiled()
def _start(key, sites, mass, energy):
    """The state (2nd,): sites, and normal random momenta of sum zero with this kinetic energy."""
    share = jnp.broadcast_to(mass, sites.shape[:1])[:, None]
    momenta = jnp.sqrt(share) * jax.random.normal(key, sites.shape, sites.dtype)
    momenta = momenta - share / jnp.sum(share) * jnp.sum(momenta, axis=0, keepdims=True)
    momenta = momenta * jnp.sqrt(2 * energy / jnp.sum(momenta**2 / share))
    return jnp.concatenate([sites.ravel(), momenta.ravel()])


def _particles(n, density, sides, diameter, mass, energy, walls, key, **more) -> Problem:
    """A problem of hard bodies in a box with these sides."""
    what = {2: "disks", 3: "spheres"}[len(sides)]
    widest, shape = float(np.max(diameter)), " × ".join(f"{side:.4g}" for side in sides)
    sites, spacing = _lattice(n, sides, walls == "hard")
    if spacing <= widest:
        raise ValueError(
            f"{n} {what} of diameter {widest:g} at the number density {density:g} do not fit on a lattice in a box "
            f"{shape}: neighbours would be {spacing:.4g} apart. The density must be below "
            f"{density * (spacing / widest) ** len(sides):.4g} for this n and shape."
        )
    start = _start(
        jax.random.key(0) if key is None else key, jnp.asarray(sites, float), jnp.asarray(mass, float), energy
    )
    return Problem(
        system=hard_particles(n, len(sides), walls == "hard", better_in_cells(n, sides, widest)),
        x0=start,
        args=dict(zip(SIDES, sides, strict=False)) | {"diameter": diameter, "mass": mass},
        t1=1000.0,
        transient=20.0,
        **more,
    )


def _check(n, walls, diameter, mass, kinetic_energy, **known) -> tuple[Any, Any, Any]:
    """Diameters, masses and the energy; values that the start depends on must not be traced."""
    require("n", n, lambda v: v >= 2, "at least 2")
    one_of("walls", walls, WALLS)
    diameter, mass = several("diameter", diameter, n), several("mass", mass, n)
    names = [*known, "diameter"]
    if traced(*known.values(), diameter):
        raise ValueError(
            f"{', '.join(names[:-1])} and {names[-1]} decide where the bodies start and must be known numbers; trace "
            "the sides of the box and args['diameter'] of a problem instead."
        )
    positive(diameter=diameter, mass=mass, **known)
    energy = float(n) if kinetic_energy is None else number("kinetic_energy", kinetic_energy)
    positive(kinetic_energy=energy)
    return diameter, mass, energy


@problem
def hard_disks(
    *,
    n: int = 4,
    density: Real = 0.7,
    aspect: Real = TRIANGULAR_ASPECT,
    diameter: Real | Float[Array, " n"] = 1.0,
    mass: Real | Float[Array, " n"] = 1.0,
    kinetic_energy: Real | None = None,
    walls: str = "periodic",
    key: jax.Array | None = None,
) -> Problem:
    """Hard disks, n of them, in a box L_x × L_y, L_x L_y = n/density, L_x/L_y = aspect.

    q' = p/m. Disks k and l meet where (|q|² − σ²)/2 falls through 0, q the displacement l minus k to the
    nearest image, and exchange the momentum 2μ (w·q) q/q², w the relative velocity and μ the reduced mass: (p·q) q/σ²,
    p = p_l − p_k, for equal masses. State x = (q₁x, q₁y, …, p₁x, p₁y, …), shape (4n,); positions are not wrapped into
    the box. Exponents come in pairs ±λ; in a periodic box six of them are 0 (energy, two momenta, and their
    partners: the flow and two translations), between hard walls two. λ scales as √(K/(m n))/σ at fixed
    density · σ² and aspect.

    The event's `which` is n·k + l with k < l; n² + 4k + 2·axis + side where k meets a wall, side 0 the low one;
    negative where only a prediction is made again. From 256 disks on contacts are searched only among neighbours,
    in cells of the box: a changed diameter or box must then leave it four diameters in each direction. The start
    is a lattice with normally distributed momenta, their sum taken away, scaled to the kinetic energy. Other keys give
    other starts of the same ensemble.

    Args:
        n: number of disks, at least 2.
        density: number density n/(L_x L_y), per length².
        aspect: L_x/L_y.
        diameter: σ, length; or (n,), one a disk: two meet at the mean of theirs.
        mass: m; or (n,), one a disk.
        kinetic_energy: K of all disks together; None: n.
        walls: "periodic", or "hard": a box whose walls reflect.
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
        >>> zoo.hard_disks(n=64).x0.shape
        (256,)
    """
    diameter, mass, energy = _check(n, walls, diameter, mass, kinetic_energy, density=density, aspect=aspect)
    sides = math.sqrt(n / density * aspect), math.sqrt(n / density / aspect)
    reference = None if walls == "hard" else _disk_reference(n, density, aspect, diameter, mass, energy)
    parameters = {"density": density, "aspect": aspect, "diameter": diameter, "mass": mass, "kinetic_energy": energy}
    return _particles(
        n,
        density,
        sides,
        diameter,
        mass,
        energy,
        walls,
        key,
        reference=reference,
        source=SOURCE,
        parameters={"n": n, **parameters, "walls": walls},
    )


@problem
def hard_spheres(
    *,
    n: int = 8,
    density: Real = 0.5,
    aspect: tuple[float, float] = (1.0, 1.0),
    diameter: Real | Float[Array, " n"] = 1.0,
    mass: Real | Float[Array, " n"] = 1.0,
    kinetic_energy: Real | None = None,
    walls: str = "periodic",
    key: jax.Array | None = None,
) -> Problem:
    """Hard spheres, n of them, in a box of volume n/density: `hard_disks` in three dimensions.

    State x = (q₁x, q₁y, q₁z, q₂x, …, p₁x, …), shape (6n,). In a periodic box eight exponents are 0 (energy, three
    momenta, and their partners: the flow and three translations), between hard walls two.

    Args:
        n: number of spheres, at least 2.
        density: number density n/(L_x L_y L_z), per length³.
        aspect: L_x/L_z and L_y/L_z.
        diameter: σ, length; or (n,), one a sphere: two meet at the mean of theirs.
        mass: m; or (n,), one a sphere.
        kinetic_energy: K of all spheres together; None: n.
        walls: "periodic", or "hard": a box whose walls reflect.
        key: a `jax.random.key`; None: key 0.

    Returns:
        A `Problem`, without a reference. The event's `which` is as in `hard_disks`, with n² + 6k + 2·axis + side
        at a wall.

    Source:
        C. Dellago & H. A. Posch, Kolmogorov–Sinai entropy and Lyapunov spectra of a hard-sphere gas, Physica A 240
        (1997) 68, doi:10.1016/S0378-4371(97)00131-3.

    Example:
        >>> from lyaphybrid import zoo
        >>> spheres = zoo.hard_spheres()
        >>> spheres.x0.shape, round(spheres.args["depth"], 4)
        ((48,), 2.5198)
    """
    shape = np.asarray(aspect, float)
    if shape.shape != (2,):
        raise ValueError(f"aspect must be two numbers, L_x/L_z and L_y/L_z; got {aspect!r}.")
    first, second = map(float, shape)
    diameter, mass, energy = _check(
        n, walls, diameter, mass, kinetic_energy, density=density, aspect=float(np.min(shape))
    )
    depth = (n / density / (first * second)) ** (1 / 3)
    parameters = {"density": density, "aspect": aspect, "diameter": diameter, "mass": mass, "kinetic_energy": energy}
    return _particles(
        n,
        density,
        (first * depth, second * depth, depth),
        diameter,
        mass,
        energy,
        walls,
        key,
        source="C. Dellago & H. A. Posch, Physica A 240 (1997) 68, doi:10.1016/S0378-4371(97)00131-3",
        parameters={"n": n, **parameters, "walls": walls},
    )
