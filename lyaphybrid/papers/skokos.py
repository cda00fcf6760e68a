"""Skokos & Gerlach, Numerical integration of variational equations (2010): Figs. 1 to 11 and Table 1.

Orbits of three Hamiltonian systems, regular ones (R1, R2, R3) and chaotic ones (C1, C2), with their deviation vectors
by five methods: DOP853 for the variational equations, the tangent map of a symplectic scheme (TM), and three that
freeze the coefficients of the variational equations (TDHcc, TDHes, TDHeps). The first two keep the laws of regular
motion; with the others λ₁ levels off above 0, and the GALIs fall exponentially, as if the motion were chaotic.
"""

import dataclasses
import functools
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from .. import zoo
from ..hamiltonians import Hamiltonian
from ..indicators import Alignment, gali
from ..indicators.following import generic_frame
from ..methods import RungeKutta, Symplectic, TangentHamiltonian
from ..methods.base import Method
from ..sections import PoincareSection, poincare_section
from ..spectra import lyapunov_spectrum
from . import skokos_checks, skokos_report
from .output import save

__all__ = [
    "FULL", "METHODS", "ORBITS", "QUICK", "SURE", "TABLE", "Lengths", "Orbit", "Reproduction", "Row", "Run",
    "reproduce", "write",
]  # fmt: skip

STEP = 0.05
EVERY = 10  # steps between orthonormalisations; the paper's is each, and so it is where time is taken
FIRST, A_DECADE = 10.0, 100  # where curves begin, and how many points they have: GALIs of tori never rest
TIMED = 2e4  # length of the runs whose time is taken
METHODS = ("DOP853", "TDHcc", "TDHes", "TDHeps", "TM")
SURE = ("DOP853", "TM")  # the methods that keep the laws
BEST = ("DOP853", "TDHeps", "TM")  # those that the paper shows for more than two degrees of freedom


@dataclasses.dataclass(frozen=True)
class Orbit:
    """An orbit of the paper.

    Attributes:
        name: R1, C1, C2, R2 or R3.
        problem: which of the zoo; parameters: its parameters.
        motion: what it does.
        freedoms: N; torus: dimension of that on which it moves, None in chaos.
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
        Orbit("R1", "henon_heiles", (("y", 0.55),), "regular, Hénon–Heiles", 2, 2),
        Orbit("C1", "henon_heiles", (("y", -0.016),), "chaotic, Hénon–Heiles", 2, None),
        # In place of y = −0.01344, which leaves for the big sea at t of 1e4 to 1e5 by every method.
        Orbit("C2", "henon_heiles", (("y", -0.01333),), "weakly chaotic, Hénon–Heiles", 2, None),
        Orbit("R2", "hamiltonian_3d", (), "regular, three oscillators", 3, 3),
        Orbit("R3", "fpu_beta", (), "regular on a 4-torus, eight masses", 8, 4),
    )
}


@dataclasses.dataclass(frozen=True)
class Row:
    """A row of Table 1: how the exponents of R1 are computed.

    Attributes:
        method: one of `METHODS`.
        step: τ, of the deviation vectors.
        threshold: δ, the tolerance of DOP853, whose steps are no longer than τ.
        minutes: of CPU time in the paper, for t = 10⁸.
    """

    method: str
    step: float
    threshold: float | None
    minutes: int


# The thresholds are lost from the text. With these two the times are as it says: alike up to τ = 0.2, twice at 0.5.
LOOSE, TIGHT = 1e-5, 1e-7
TABLE = (
    Row("DOP853", 0.05, LOOSE, 498),
    Row("TDHcc", 0.05, None, 348),
    Row("TDHes", 0.05, None, 336),
    Row("TDHeps", 0.05, None, 363),
    Row("TM", 0.05, None, 280),
    Row("DOP853", 0.1, LOOSE, 251),
    Row("DOP853", 0.1, TIGHT, 252),
    Row("DOP853", 0.2, LOOSE, 126),
    Row("DOP853", 0.2, TIGHT, 123),
    Row("DOP853", 0.5, LOOSE, 50),
    Row("DOP853", 0.5, TIGHT, 100),
    Row("TDHeps", 0.1, None, 181),
    Row("TDHeps", 0.2, None, 93),
    Row("TDHeps", 0.5, None, 37),
    Row("TM", 0.1, None, 136),
    Row("TM", 0.2, None, 68),
    Row("TM", 0.5, None, 27),
)


@dataclasses.dataclass(frozen=True)
class Lengths:
    """How long orbits are followed, and the numbers of points of sections.

    Attributes:
        table: of Table 1, and so of Figs. 2 and 3.
        exponents: of the others; indices: of the GALIs, of C1 `chaos`, of R3 `many`.
        points: of the sections of R1 and C1; around: of that of C2.
    """

    table: float
    exponents: float
    indices: float
    chaos: float
    many: float
    points: int
    around: int


FULL = Lengths(1e7, 1e6, 1e6, 2e5, 1e6, 3000, 10_000)
QUICK = Lengths(1e5, 1e5, 1e5, 1e4, 5e5, 1000, 2000)


@dataclasses.dataclass(frozen=True)
class Run:
    """The exponents of an orbit by a method.

    Attributes:
        time: (times,); exponents: (times, 2N) averages up to there.
        error: one standard error of the first.
        energy: relative error of the energy at the end.
    """

    time: np.ndarray
    exponents: np.ndarray
    error: float
    energy: float

    @property
    def sums(self) -> np.ndarray:
        """(times, N) λ_i + λ_{2N+1−i}, which are 0 in the limit."""
        half = self.exponents.shape[1] // 2
        return (self.exponents + self.exponents[:, ::-1])[:, :half]


@dataclasses.dataclass(frozen=True)
class Reproduction:
    """Figs. 1 to 11 and Table 1, computed and compared.

    Attributes:
        table: a `Run` of R1 for each of `TABLE`.
        seconds: for each of `TABLE`, of computing for t = 10⁶, orthonormalised after each step.
        exponents: for C1, C2 and R2 a `Run` for each method.
        indices: for each orbit an `lh.Alignment` for each method.
        sections: of R1, C1 and C2 with x = 0, p_x ≥ 0.
        lengths: of the runs.
    """

    table: tuple[Run, ...]
    seconds: tuple[float, ...]
    exponents: dict[str, dict[str, Run]]
    indices: dict[str, dict[str, Alignment]]
    sections: dict[str, PoincareSection]
    lengths: Lengths

    def of_r1(self, method: str, step: float = STEP) -> Run:
        """The first row of Table 1 with this method and step."""
        return next(run for row, run in zip(TABLE, self.table, strict=True) if (row.method, row.step) == (method, step))

    def of(self, orbit: str) -> dict[str, Run]:
        """The runs of an orbit by method, with the step 0.05."""
        return {method: self.of_r1(method) for method in METHODS} if orbit == "R1" else self.exponents[orbit]

    @functools.cached_property
    def checks(self) -> dict[str, bool]:
        """What must hold, by name."""
        return skokos_checks.checks(self)

    @property
    def passed(self) -> bool:
        """Whether all checks hold."""
        return all(self.checks.values())

    def __str__(self) -> str:
        return skokos_report.table(self)

    def data(self) -> dict:
        """All numbers, ready for JSON."""
        return skokos_report.numbers(self)

    def figure(self, number: int = 2):
        """Fig. 1 to 11."""
        from . import skokos_figures

        return skokos_figures.figure(self, number)


def method_of(name: str, step: float, threshold: float | None = None) -> Method:
    """A method of the paper."""
    if name == "TM":
        return Symplectic("SBAB2C", dt=step)
    if name == "DOP853" and threshold is None:
        return RungeKutta("dop853", dt=step)
    if name == "DOP853":
        return RungeKutta("dop853", rtol=threshold, atol=threshold, max_step=step)
    return TangentHamiltonian(name.removeprefix("TDH"), dt=step)


@functools.cache
def _problem(name: str):
    """System, start, and parameters as arrays."""
    orbit = ORBITS[name]
    problem = zoo.get(orbit.problem)(**dict(orbit.parameters))
    assert isinstance(problem.system, Hamiltonian)
    args = None if problem.args is None else {key: jnp.asarray(value, float) for key, value in problem.args.items()}
    return problem.system, problem.x0, args


def _times(t1: float) -> np.ndarray:
    """Whole numbers, as evenly as that goes on a logarithmic scale: all steps divide them."""
    count = round(A_DECADE * np.log10(t1 / FIRST)) + 1
    return np.unique(np.round(np.geomspace(FIRST, t1, count)))


def _run(orbit: str, method: str, t1: float, step: float = STEP, threshold: float | None = None) -> Run:
    system, x0, args = _problem(orbit)
    n = x0.shape[0]
    spectrum = lyapunov_spectrum(
        system, x0, args, t1=t1, times=_times(t1), frame=generic_frame(n, n, x0.dtype),
        method=method_of(method, step, threshold), every=EVERY if threshold is None else EVERY * step,
    )  # fmt: skip
    start, end = (float(system.energy(x, args)) for x in (x0, spectrum.x))
    history = spectrum.history
    return Run(
        np.asarray(history.time), np.asarray(history.exponents), _error_of(spectrum), abs(end - start) / abs(start)
    )


def _error_of(spectrum) -> float:
    """One standard error of λ₁, from the later blocks, each as heavy as it is long."""
    time, growth = np.asarray(spectrum.history.time), np.asarray(spectrum.history.growth)[:, 0]
    length = np.diff(time, prepend=0.0)
    late = time > 0.01 * time[-1]
    mean = np.sum(growth[late]) / np.sum(length[late])
    return float(np.sqrt(np.sum((growth - mean * length)[late] ** 2)) / np.sum(length[late]))


def _indices(orbit: str, method: str, t1: float) -> Alignment:
    system, x0, args = _problem(orbit)
    return gali(
        system, x0, args, t1=t1, times=_times(t1), orders=ORBITS[orbit].orders, method=method_of(method, STEP)
    )  # fmt: skip


def _section(orbit: str, points: int) -> PoincareSection:
    system, x0, args = _problem(orbit)
    return poincare_section(
        system, x0, args, section=lambda t, x, args: x[0], direction=1, n=points, method=method_of("TM", STEP)
    )


def _seconds(row: Row, t1: float = TIMED) -> float:
    """Seconds for t = 10⁶: the shortest of three runs, orthonormalised after each step, that find all compiled."""
    system, x0, args = _problem("R1")
    method = method_of(row.method, row.step, row.threshold)
    taken = []
    for _ in range(4):
        start = time.perf_counter()
        lyapunov_spectrum(system, x0, args, t1=t1, method=method, every=1 if row.threshold is None else row.step)
        taken.append(time.perf_counter() - start)
    return min(taken[1:]) * 1e6 / t1


def _length_of_indices(orbit: str, lengths: Lengths) -> float:
    return {"C1": lengths.chaos, "R3": lengths.many}.get(orbit, lengths.indices)


def reproduce(*, quick: bool = False, progress=None) -> Reproduction:
    """Compute Figs. 1 to 11 and Table 1.

    Args:
        quick: shorter runs and fewer points, nothing else.
        progress: a function of the fraction done.

    Returns:
        A `Reproduction`.
    """
    lengths = QUICK if quick else FULL
    methods = {"R1": METHODS, "C1": METHODS, "C2": METHODS, "R2": BEST, "R3": BEST}
    tasks = {}
    for orbit in ("R3", "R2", "R1", "C2", "C1"):  # the longest first
        for method in methods[orbit]:
            tasks["indices", orbit, method] = (_indices, orbit, method, _length_of_indices(orbit, lengths))
    for row in TABLE:
        tasks["table", row] = (_run, "R1", row.method, lengths.table, row.step, row.threshold)
    for orbit in ("R2", "C2", "C1"):
        for method in methods[orbit]:
            tasks["exponents", orbit, method] = (_run, orbit, method, lengths.exponents)
    for orbit, points in (("R1", lengths.points), ("C1", lengths.points), ("C2", lengths.around)):
        tasks["sections", orbit] = (_section, orbit, points)
    done = _all(tasks, progress)
    return Reproduction(
        tuple(done["table", row] for row in TABLE),
        tuple(_seconds(row) for row in TABLE),  # with nothing beside it
        {o: {m: done["exponents", o, m] for m in methods[o]} for o in ("C1", "C2", "R2")},
        {o: {m: done["indices", o, m] for m in methods[o]} for o in methods},
        {o: done["sections", o] for o in ("R1", "C1", "C2")},
        lengths,
    )


def _all(tasks: dict, progress) -> dict:
    """The results by name; two threads, for two cores."""
    done = {}
    with ThreadPoolExecutor(2) as threads:
        waiting = {name: threads.submit(*task) for name, task in tasks.items()}
        for name, result in waiting.items():
            done[name] = result.result()
            if progress is not None:
                progress(len(done) / len(tasks))
    return done


def write(result: Reproduction, folder: Path) -> list[Path]:
    """Figures (PNG, PDF) and numbers (JSON) into a folder; returns the files."""
    figures = {f"skokos-{number}": result.figure(number) for number in range(1, 12)}
    return save(folder, "skokos", figures, result.data())
