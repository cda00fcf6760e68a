"""What is computed: one table. Lengths are units of time, or iterations of a map, or points of a sweep."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks import problems
from benchmarks.peers import formulas


class Workload(NamedTuple):
    """One system, one start and one set of parameters for all programs."""

    title: str
    kind: str  # "flow", "map", "impact"
    formula: Callable  # m -> field(t, x, p)
    jacobian: Callable  # m -> jacobian(t, x, p)
    start: tuple[float, ...]
    parameters: tuple[float, ...]
    short: float  # length over which exponents are compared
    long: float  # length that is timed
    every: float = 1.0  # between orthonormalisations, where the program leaves that to the user
    steps: tuple[int, ...] = ()  # fixed steps within `every`, from coarse to fine
    k: int = 0  # exponents; 0: all
    before: Callable | None = None  # of a map: the point whose image is the start
    unit: str = "unit of time"

    @property
    def n(self) -> int:
        """The dimension."""
        return len(self.start)

    @property
    def frame(self) -> np.ndarray:
        """The columns (n, k) to begin with."""
        return np.eye(self.n)[:, : self.k or self.n]


_IMPACT = tuple(problems.IMPACT_PARAMETERS[name] for name in ("zeta", "omega", "restitution"))

WORKLOADS = {
    "lorenz": Workload(
        "Lorenz, all exponents",
        "flow",
        formulas.lorenz,
        formulas.lorenz_jacobian,
        problems.LORENZ_START,
        problems.LORENZ_PARAMETERS,
        10.0,
        1000.0,
        every=0.5,
        steps=(25, 50, 100, 300, 800),
    ),
    "henon_map": Workload(
        "Hénon map, both exponents",
        "map",
        formulas.henon_map,
        formulas.henon_map_jacobian,
        (0.1, 0.1),
        (1.4, 0.3),
        20,
        100_000,
        before=formulas.henon_map_before,
        unit="iteration",
    ),
    "impact_oscillator": Workload(
        "Oscillator with impacts, both exponents",
        "impact",
        formulas.oscillator,
        formulas.oscillator_jacobian,
        problems.IMPACT_START,
        _IMPACT,
        10.0,
        1000.0,
        every=0.5,
        steps=(5, 10, 25, 50, 100),
    ),
}
