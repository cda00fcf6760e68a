"""The orbits, methods and rows of Table 1 that Skokos & Gerlach compare, and the lengths of the runs here."""

import dataclasses

__all__ = [
    "BEST", "EVERY", "FULL", "LOOSE", "METHODS", "ORBITS", "QUICK", "STEP", "TRUSTED_METHODS", "TABLE", "TIGHT",
    "Lengths", "PaperOrbit", "MethodRow",
]  # fmt: skip

STEP = 0.05
EVERY = 10  # steps between orthonormalisations; 1 in the paper and in the timed runs
METHODS = ("DOP853", "TDHcc", "TDHes", "TDHeps", "TM")
TRUSTED_METHODS = ("DOP853", "TM")  # methods that satisfy the laws of motion
BEST = ("DOP853", "TDHeps", "TM")  # methods that the paper shows for more than two degrees of freedom


@dataclasses.dataclass(frozen=True)
class PaperOrbit:
    """An orbit of the paper.

    Attributes:
        name: R1, C1, C2, R2 or R3.
        problem: name in the zoo; parameters: its parameters.
        motion: the kind of motion.
        freedoms: N; torus: dimension of its torus, None in chaos.
    """

    name: str
    problem: str
    parameters: tuple[tuple[str, float], ...]
    motion: str
    freedoms: int
    torus: int | None

    @property
    def orders(self) -> tuple[int, ...]:
        """2 … 2N."""
        return tuple(range(2, 2 * self.freedoms + 1))


ORBITS = {
    orbit.name: orbit
    for orbit in (
        PaperOrbit("R1", "henon_heiles", (("y", 0.55),), "regular, Hénon–Heiles", 2, 2),
        PaperOrbit("C1", "henon_heiles", (("y", -0.016),), "chaotic, Hénon–Heiles", 2, None),
        # Instead of y = −0.01344, which enters the big chaotic sea at t = 1e4 to 1e5 by every method.
        PaperOrbit("C2", "henon_heiles", (("y", -0.01333),), "weakly chaotic, Hénon–Heiles", 2, None),
        PaperOrbit("R2", "hamiltonian_3d", (), "regular, three oscillators", 3, 3),
        PaperOrbit("R3", "fpu_beta", (), "regular on a 4-torus, eight masses", 8, 4),
    )
}


@dataclasses.dataclass(frozen=True)
class MethodRow:
    """A row of Table 1: how the exponents of R1 are computed.

    Attributes:
        method: one of `METHODS`.
        step: τ, step size for the deviation vectors.
        threshold: δ, the tolerance of DOP853, whose steps are no longer than τ.
        minutes: of CPU time in the paper, for t = 10⁸.
    """

    method: str
    step: float
    threshold: float | None
    minutes: int


# The thresholds are missing in our text of the paper. These two give its relations of times between the rows.
LOOSE, TIGHT = 1e-5, 1e-7
TABLE = (
    MethodRow("DOP853", 0.05, LOOSE, 498),
    MethodRow("TDHcc", 0.05, None, 348),
    MethodRow("TDHes", 0.05, None, 336),
    MethodRow("TDHeps", 0.05, None, 363),
    MethodRow("TM", 0.05, None, 280),
    MethodRow("DOP853", 0.1, LOOSE, 251),
    MethodRow("DOP853", 0.1, TIGHT, 252),
    MethodRow("DOP853", 0.2, LOOSE, 126),
    MethodRow("DOP853", 0.2, TIGHT, 123),
    MethodRow("DOP853", 0.5, LOOSE, 50),
    MethodRow("DOP853", 0.5, TIGHT, 100),
    MethodRow("TDHeps", 0.1, None, 181),
    MethodRow("TDHeps", 0.2, None, 93),
    MethodRow("TDHeps", 0.5, None, 37),
    MethodRow("TM", 0.1, None, 136),
    MethodRow("TM", 0.2, None, 68),
    MethodRow("TM", 0.5, None, 27),
)


@dataclasses.dataclass(frozen=True)
class Lengths:
    """Lengths of runs, and the numbers of points of sections.

    Attributes:
        table: of Table 1, and so of Figs. 2 and 3.
        exponents: of the others; indices: of the GALIs, of C1 `chaos`, of R3 `many`.
        longer: of those of R3 by TDHeps, which start to fall late.
        points: of the sections of R1 and C1; around: of that of C2.
    """

    table: float
    exponents: float
    indices: float
    chaos: float
    many: float
    longer: float
    points: int
    around: int


FULL = Lengths(1e7, 1e6, 1e6, 2e5, 1e6, 1e7, 3000, 10_000)
QUICK = Lengths(1e5, 1e5, 1e5, 1e4, 5e5, 5e5, 1000, 2000)
