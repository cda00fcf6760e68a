"""Statistics of the collisions of hard disks and spheres: rates, free paths, the pressure.

All are by-products of a trajectory. Most are also known from an equation of state, from kinetic theory or, for two
disks, in closed form, so that missed or false collisions of a schedule would show.

With a kick of modulus J at every contact of two bodies, σ the distance of their centres, the virial theorem is

    d P V = 2K + (Σ σ J + Σ (σ_i/2) J) / t,

d the dimension, K the kinetic energy; the second sum over the contacts of bodies i with hard walls. In a periodic box
of vanishing total momentum all positions are equally probable, and all momenta of energy K. So the relation between the
rate of collisions and the pressure, `kick_by_energy`, is exact for any number of bodies.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..._arguments import positive, whole
from ..._text import Table, with_error
from ...analysis.trajectories import trajectory
from ...results.events import Events
from ...results.result import Data, Result
from ..problem import Problem
from .contacts import SIDES

__all__ = ["CollisionStatistics", "Measured", "collision_statistics", "kick_by_energy"]

ENTRIES = 2**20  # numbers in a log of states: 8 MiB for those before the events, 8 MiB for those after
FEWEST_EVENTS = 16  # least number of events in a piece of the run


class Measured(NamedTuple):
    """A value and its standard error."""

    value: float
    stderr: float

    def __str__(self) -> str:
        return with_error(*self)


@dataclasses.dataclass(frozen=True, repr=False)
class CollisionStatistics(Result):
    """Measured quantities, each a `Measured`: a value with its standard error from blocks of the run.

    Attributes:
        rate: total collisions of two bodies per unit time.
        mean_free_time: of a body between two collisions with others, n/(2 rate).
        mean_free_path: mean length of these flights, Σ|v_i|/(2 rate).
        kick: the mean of J/√μ, J the modulus of the exchanged momentum, μ the reduced mass; `kick_by_energy` is exact.
        pressure: by the virial, per length in the plane, per area in space.
        compressibility: Z = d P V/(2K), which is 1 for an ideal gas: P V/(n k T) with d n k T = 2K.
        time: length of the run.
        collisions: of two bodies.
        wall_rate: contacts with hard walls per unit time; None in a periodic box.
        wall_pressure: the momentum given to hard walls per time and area, the mean over the axes; None in a periodic
        box.

    Example:
        >>> import lyaphybrid as lh
        >>> found = lh.zoo.collision_statistics(lh.zoo.hard_disks(n=2, aspect=1), t1=50.0, blocks=4)
        >>> bool(found.rate.value > 0)
        True
    """

    rate: Measured
    mean_free_time: Measured
    mean_free_path: Measured
    kick: Measured
    pressure: Measured
    compressibility: Measured
    time: float
    collisions: int
    wall_rate: Measured | None = None
    wall_pressure: Measured | None = None

    def _measured(self) -> dict[str, Measured]:
        """The quantities that were measured, by name."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, Measured)}

    def _table(self) -> Table:
        title = f"Collisions of hard bodies (t = {self.time:g}, {self.collisions} collisions)"
        return Table(title, [(name.replace("_", " "), str(value)) for name, value in self._measured().items()])

    def _data(self) -> Data:
        variables = {}
        for name, measured in self._measured().items():
            variables |= {name: ((), measured.value), f"{name}_stderr": ((), measured.stderr)}
        return Data(variables, {}, {"time": self.time, "collisions": self.collisions})


class Totals(NamedTuple):
    """Sums over a length of time."""

    time: float = 0.0
    collisions: int = 0
    path: float = 0.0  # Σ over bodies of their path lengths
    kicks: float = 0.0  # Σ J/√μ
    virial: float = 0.0  # Σ J times the distance of the centres, or half a diameter at a wall
    wall_contacts: int = 0
    wall_momentum: float = 0.0  # Σ over the walls' momenta J, each times the length of the box along the axis


class Bodies(NamedTuple):
    """A problem of hard bodies, as numbers."""

    n: int
    d: int
    diameter: np.ndarray  # (n,)
    mass: np.ndarray  # (n,)
    sides: np.ndarray  # (d,)
    energy: float
    walls: bool


def collision_statistics(
    problem: Problem, *, t1: float, transient: float | None = None, blocks: int = 32
) -> CollisionStatistics:
    """Rate of collisions, free path and pressure of hard disks or spheres, from one trajectory.

    P V = (2K + Σ σ J/t)/d, J the momenta exchanged in the time t, σ the distances of the centres, d the dimension; at
    hard walls half a diameter in place of σ.

    Args:
        problem: of `zoo.hard_disks` or `zoo.hard_spheres`: any number, masses, diameters, walls.
        t1: length of the run, time.
        transient: length before; None: that of the problem.
        blocks: equal parts of the run, whose scatter gives the errors (jackknife); too small if a part lasts
            less than a few mean free times.

    Returns:
        A `CollisionStatistics`.

    Raises:
        ValueError: on a problem of another kind, a length that is not positive, fewer than two blocks.

    Source:
        J. J. Erpenbeck & W. W. Wood, in B. J. Berne (ed.), Statistical Mechanics B (Plenum, 1977), ch. 1: the virial
        of impulsive forces.

    Example:
        >>> from lyaphybrid import zoo
        >>> two = zoo.collision_statistics(zoo.hard_disks(n=2, density=0.32, aspect=1), t1=2000.0)
        >>> abs(two.rate.value - 1.8199) < 5 * two.rate.stderr
        True
    """
    bodies = _bodies(problem)
    positive("t1, a length of time,", t1)
    whole("blocks", blocks, least=2, each=1)
    transient = float(problem.transient if transient is None else transient)
    run = _PiecewiseRun(problem, bodies)
    if transient:
        run.totals(transient)
    parts = np.array([run.totals(t1 / blocks) for _ in range(blocks)])
    sums = Totals(*np.sum(parts, axis=0))
    quantities = _quantities(bodies, sums)
    left_out = [_quantities(bodies, Totals(*(np.array(sums) - part))) for part in parts]
    measured = {
        name: Measured(float(value), _jackknife([part[name] for part in left_out]))
        for name, value in quantities.items()
    }
    return CollisionStatistics(time=float(t1), collisions=int(sums.collisions), **measured)


def kick_by_energy(kinetic_energy: float, freedom: int) -> float:
    """The mean of J/√μ over collisions, J the exchanged momentum, μ the reduced mass: 2 √(2K) / (f a_f).

    a_f = Γ(f/2)/(√π Γ((f + 1)/2)) is the mean modulus of a component of a unit vector in f dimensions. The momenta,
    each divided by the square root of its mass, are uniform on a sphere of radius √(2K), independently of positions;
    and the rate of collisions is proportional to the speed of approach.

    Args:
        kinetic_energy: K of all bodies together.
        freedom: f, the dimension of the momenta's space: d (n - 1) in a periodic box, d n between hard walls.

    Returns:
        The mean, √energy: with it the virial is rate · σ √μ · kick for equal bodies, at any density and number.

    Example:
        >>> from lyaphybrid.zoo.bodies.statistics import kick_by_energy
        >>> round(kick_by_energy(2.0, 2), 6)  # two disks: 2 · 2/(2 · 2/π)
        3.141593
    """
    mean_component = math.exp(math.lgamma(freedom / 2) - math.lgamma((freedom + 1) / 2)) / math.sqrt(math.pi)
    return 2 * math.sqrt(2 * kinetic_energy) / (freedom * mean_component)


def _bodies(problem: Problem) -> Bodies:
    if problem.name not in ("hard_disks", "hard_spheres"):
        raise ValueError(f"problem must be one of hard_disks, hard_spheres; got {problem.name!r}.")
    n, args = problem.parameters["n"], problem.args
    sides = np.array([float(args[side]) for side in SIDES if side in args])
    mass = np.broadcast_to(np.asarray(args["mass"], float), n)
    momenta = np.asarray(problem.x0).reshape(2, n, len(sides))[1]
    return Bodies(
        n=n,
        d=len(sides),
        diameter=np.broadcast_to(np.asarray(args["diameter"], float), n),
        mass=mass,
        sides=sides,
        energy=float(np.sum(momenta**2 / mass[:, None]) / 2),
        walls=problem.parameters["walls"] == "hard",
    )


class _PiecewiseRun:
    """A trajectory in pieces whose logs have a bounded size."""

    def __init__(self, problem: Problem, bodies: Bodies):
        self.problem, self.bodies, self.x = problem, bodies, problem.x0
        self.most = max(FEWEST_EVENTS, ENTRIES // problem.x0.shape[0])
        self.rate = _dilute_rate(bodies)  # rate of events; replaced by the measured one

    def totals(self, length: float) -> Totals:
        """Continue the run by this length of time, and return its sums."""
        sums = np.array(Totals(), float)
        for dt, events in self._pieces(length):
            sums = sums + np.array(_totals(self.bodies, dt, events, np.asarray(self.x)), float)
        return Totals(*sums)

    def _pieces(self, length: float) -> Iterator[tuple[float, Events]]:
        left = length
        while left > 0:
            dt = min(left, self.most / self.rate)
            piece = trajectory(self.problem.system, self.x, self.problem.args, t1=dt, n=1)
            self.x, left = piece.x[-1], left - dt
            self.rate = max(self.rate, len(piece.events) / dt)
            yield dt, piece.events


def _dilute_rate(bodies: Bodies) -> float:
    """Estimated rate of collisions and wall contacts, as if positions were independent."""
    speed = math.sqrt(2 * bodies.energy / np.sum(bodies.mass))
    sphere = 2 * math.pi ** (bodies.d / 2) / math.gamma(bodies.d / 2)
    section = sphere * np.max(bodies.diameter) ** (bodies.d - 1)
    return float(speed * bodies.n * (bodies.n * section / np.prod(bodies.sides) + np.sum(1 / bodies.sides)))


def _totals(bodies: Bodies, dt: float, events: Events, end: np.ndarray) -> Totals:
    """The sums over one piece that ends at the state `end`."""
    n, d = bodies.n, bodies.d
    which, half = np.asarray(events.which), n * d
    before, after = (np.asarray(x)[:, half:].reshape(-1, n, d) for x in (events.x_before, events.x_after))
    speeds = np.linalg.norm(np.concatenate([before, end[None, half:].reshape(1, n, d)]), axis=2) / bodies.mass
    flights = np.diff(np.asarray(events.t), prepend=0.0, append=dt)
    at_wall = which >= n * n
    row = np.arange(len(which))
    first = np.where(at_wall, (which - n * n) // (2 * d), which // n)
    second = np.where(at_wall, first, which % n)
    change = after[row, first] - before[row, first]
    kick = np.linalg.norm(change, axis=1)
    mass, diameter = bodies.mass, bodies.diameter
    reduced = 1 / (1 / mass[first] + 1 / mass[second])
    reach = np.where(at_wall, diameter[first], diameter[first] + diameter[second]) / 2
    return Totals(
        time=dt,
        collisions=int(np.sum(~at_wall)),
        path=float(flights @ np.sum(speeds, axis=1)),
        kicks=float(np.sum((kick / np.sqrt(reduced))[~at_wall])),
        virial=float(np.sum(kick * reach)),
        wall_contacts=int(np.sum(at_wall)),
        wall_momentum=float(np.sum(np.abs(change[at_wall]) @ bodies.sides)),
    )


def _quantities(bodies: Bodies, sums: Totals) -> dict[str, float]:
    """The measured quantities from sums over a long time."""
    volume = float(np.prod(bodies.sides))
    meetings = 2 * sums.collisions or math.nan
    virial = 2 * bodies.energy + sums.virial / sums.time
    found = {
        "rate": sums.collisions / sums.time,
        "mean_free_time": bodies.n * sums.time / meetings,
        "mean_free_path": sums.path / meetings,
        "kick": 2 * sums.kicks / meetings,
        "pressure": virial / (bodies.d * volume),
        "compressibility": virial / (2 * bodies.energy),
    }
    if not bodies.walls:
        return found
    # Two walls for each axis, each of area volume/side.
    pressure = sums.wall_momentum / (2 * sums.time * bodies.d * volume)
    return found | {"wall_rate": sums.wall_contacts / sums.time, "wall_pressure": pressure}


def _jackknife(left_out: list[float]) -> float:
    """The standard error of a quantity from its values without one block each."""
    return float(np.std(left_out) * math.sqrt(len(left_out) - 1))
