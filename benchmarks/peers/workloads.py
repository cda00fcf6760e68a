"""What is computed: one table. Lengths are units of time, or iterations of a map, or points of a sweep."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks import problems
from benchmarks.peers.formulas import large, small
from benchmarks.peers.formulas.large import Large


class Event(NamedTuple):
    """A component passes zero: the state is multiplied by `reset`, and the last parameter may change its sign."""

    guard: int
    reset: tuple[float, ...]
    flips: bool

    def beyond(self, last: float) -> float:
        """The last parameter after the event."""
        return -last if self.flips else last


class Sweep(NamedTuple):
    """Many values of the last parameter, each for so long."""

    first: float
    final: float
    t1: float
    kind: str  # of a single one

    def values(self, count: float) -> np.ndarray:
        return np.linspace(self.first, self.final, round(count))


class Workload(NamedTuple):
    """One system, one start and one set of parameters for all programs."""

    title: str
    kind: str  # "flow", "map", "stiff", "impact", "friction", "disks", "flow_sweep", …
    formula: Callable | None  # m -> field(t, x, p), components
    jacobian: Callable | None  # m -> jacobian(t, x, p), rows; of few components
    start: tuple[float, ...]
    parameters: tuple[float, ...]
    short: float  # length over which exponents are compared
    long: float  # length that is timed
    every: float = 1.0  # between orthonormalisations, where the program leaves that to the user
    steps: tuple[int, ...] = ()  # fixed steps within `every`, from coarse to fine
    k: int = 0  # exponents; 0: all
    forms: Large | None = None  # the other forms of a formula of many components
    potential: Callable | None = None  # of H = p²/2 + V(q)
    before: Callable | None = None  # of a map: the point whose image is the start
    last: float | None = None  # one parameter more, which events or sweeps change
    event: Event | None = None
    sweep: Sweep | None = None
    unit: str = "unit of time"

    @property
    def n(self) -> int:
        """The dimension."""
        return len(self.start)

    @property
    def p(self) -> tuple[float, ...]:
        """What the field is given."""
        return self.parameters if self.last is None else (*self.parameters, self.last)

    def at(self, value: float) -> "Workload":
        """One point of a sweep."""
        return self._replace(kind=self.sweep.kind, last=value, short=self.sweep.t1, sweep=None)

    @property
    def frame(self) -> np.ndarray:
        """The columns (n, k) to begin with."""
        return np.eye(self.n)[:, : self.k or self.n]

    def field(self, xp) -> Callable:
        """``field(t, x, p)`` that returns an array of `xp`."""
        if self.forms:
            return self.forms.array(xp)
        components = self.formula(xp)
        return lambda t, x, p: xp.stack(components(t, x, p))


def _large(title: str, formula: Large, start, parameters, short, long, k, every, steps) -> Workload:
    form = {"forms": formula, "potential": formula.potential}
    return Workload(title, "flow", formula.components, None, start, parameters, short, long, every, steps, k, **form)


def _impact_oscillator() -> Workload:
    zeta, omega, restitution = (problems.IMPACT_PARAMETERS[name] for name in ("zeta", "omega", "restitution"))
    formulas = small.oscillator, small.oscillator_jacobian
    title = "Oscillator with impacts, both exponents"
    steps = (3, 5, 10, 25, 50, 100)
    event = Event(0, (1.0, -restitution), False)
    start, more = problems.IMPACT_START, {"event": event, "last": omega}
    return Workload(title, "impact", *formulas, start, (zeta,), 10.0, 1000.0, 0.5, steps, **more)


def _friction_pendulum() -> Workload:
    names = ("beta", "alpha", "stiffness", "amplitude", "omega")
    parameters = tuple(problems.FRICTION_PARAMETERS[name] for name in names)
    formulas = small.friction_pendulum, small.friction_pendulum_jacobian
    title, steps, more = "Pendulum with dry friction, both exponents", (10, 25, 50, 100), {"last": 1.0}
    more["event"] = Event(1, (1.0, 1.0), True)
    return Workload(title, "friction", *formulas, problems.FRICTION_START, parameters, 30.0, 500.0, 1.0, steps, **more)


def _sweep(title: str, one: Workload, first: float, final: float) -> Workload:
    """10⁴ points for ten units of time; exponents of eight are compared."""
    parameters = one.parameters if one.last is not None else one.parameters[:-1]
    sweep = Sweep(first, final, 10.0, one.kind)
    changed = {"parameters": parameters, "last": first, "short": 8, "long": 10_000, "unit": "point"}
    return one._replace(title=title, kind=f"{one.kind}_sweep", sweep=sweep, **changed)


def _map(title: str, rule, jacobian, before, start, parameters, short) -> Workload:
    return Workload(title, "map", rule, jacobian, start, parameters, short, 100_000, before=before, unit="iteration")


def _flow(title: str, formula, jacobian, start, parameters, every, steps, **more) -> Workload:
    return Workload(title, "flow", formula, jacobian, start, parameters, 10.0, 1000.0, every, steps, **more)


_SIGMA, _RHO, _BETA = problems.LORENZ_PARAMETERS
_LORENZ = (_SIGMA, _BETA, _RHO)

WORKLOADS = {
    "lorenz": _flow(
        "Lorenz, all exponents", small.lorenz, small.lorenz_jacobian, problems.LORENZ_START,
        _LORENZ, 0.5, (25, 50, 100, 300, 800),
    ),
    "rossler": _flow(
        "Rössler, all exponents", small.rossler, small.rossler_jacobian, (1.0, 1.0, 0.0), (0.2, 0.2, 5.7),
        1.0, (10, 20, 50, 100, 400),
    ),
    "henon_heiles": _flow(
        "Hénon–Heiles, all exponents", small.henon_heiles, small.henon_heiles_jacobian,
        problems.HENON_HEILES_START, (), 1.0, (2, 3, 5, 10, 25, 50, 200), potential=small.henon_heiles_potential,
    ),
    "henon_map": _map(
        "Hénon's map, both exponents", small.henon_map, small.henon_map_jacobian, small.henon_map_before,
        (0.1, 0.1), (1.4, 0.3), 20,
    ),
    "standard_map": _map(
        "Standard map, K = 6.9115, both exponents", small.standard_map, small.standard_map_jacobian,
        small.standard_map_before, (0.1, 0.2), (6.9115,), 10,
    ),
    "fpu_beta": _large(
        "FPU-β, 8 masses, 16 exponents", large.FPU, (0.1,) * 8 + (0.0,) * 8, (1.5,), 10.0, 1000.0, 16,
        1.0, (2, 3, 5, 10, 25, 50, 200),
    ),
    "lorenz96_40": _large(
        "Lorenz-96, N = 40, 40 exponents", large.LORENZ96, large.lorenz96_start(40), (8.0,), 5.0, 20.0, 40,
        0.2, (10, 25, 50, 100, 200),
    ),
    "lorenz96_1000": _large(
        "Lorenz-96, N = 1000, 10 exponents", large.LORENZ96, large.lorenz96_start(1000), (8.0,), 1.0, 4.0, 10,
        0.2, (10, 25, 50, 100, 200),
    ),
    "kuramoto_200": _large(
        "Kuramoto, N = 200, 5 exponents", large.KURAMOTO, large.kuramoto_start(200), (1.0,), 10.0, 50.0, 5,
        1.0, (4, 10, 25, 50),
    ),
    "kuramoto_2000": _large(
        "Kuramoto, N = 2000, 5 exponents", large.KURAMOTO, large.kuramoto_start(2000), (1.0,), 10.0, 10.0, 5,
        1.0, (4, 10, 25, 50),
    ),
    "oregonator": Workload(
        "Oregonator (stiff), the largest exponent", "stiff", small.oregonator, small.oregonator_jacobian,
        (1.0, 2.0, 3.0), (77.27, 8.375e-6, 0.161), 30.0, 320.0, every=10.0, k=1,
    ),
    "impact_oscillator": _impact_oscillator(),
    "friction_pendulum": _friction_pendulum(),
    "hard_disks": Workload(
        "Four hard disks, 16 exponents", "disks", None, None, problems.DISKS_START, (), 2.0, 1000.0
    ),
}  # fmt: skip
WORKLOADS |= {
    "lorenz_sweep": _sweep("Lorenz at 10⁴ values of ρ", WORKLOADS["lorenz"], 26.0, 30.0),
    "impact_sweep": _sweep("Oscillators with impacts at 10⁴ frequencies", WORKLOADS["impact_oscillator"], 2.7, 2.9),
}
