"""Skokos & Gerlach, Numerical integration of variational equations (2010): Figs. 1 to 11 and Table 1, and its claims.

Orbits of three Hamiltonian systems, regular ones (R1, R2, R3) and chaotic ones (C1, C2), with their deviation vectors
by five methods: DOP853 for the variational equations, the tangent map of a symplectic scheme (TM), and three that
freeze the coefficients of the variational equations (TDHcc, TDHes, TDHeps). The first two satisfy the laws of
regular motion; with the others λ₁ levels off above 0, and the GALIs fall exponentially, as if the motion were chaotic.
"""

import dataclasses
import functools
import time

import jax
import jax.numpy as jnp
import numpy as np

from ... import zoo
from ..._linalg.frames import generic_frame
from ...analysis.diagrams.sections import PoincareSection, poincare_section
from ...analysis.indicators.alignment import GALIResult, gali
from ...analysis.spectra import lyapunov_spectrum
from ...analysis.trajectories import trajectory
from ...integrators import RungeKutta, Symplectic, TangentHamiltonian
from ...integrators.base import Method
from ...systems.hamiltonians import Hamiltonian
from .. import reproductions
from ..claims import Check, Claim
from ..reproductions import computed, write
from . import checks as skokos_checks
from . import claims as skokos_claims
from . import report as skokos_report
from .cases import BEST, EVERY, FULL, LOOSE, METHODS, ORBITS, QUICK, STEP, TABLE, Lengths, MethodRow

__all__ = ["NUMBER_OF_FIGURES", "Reproduction", "MethodRun", "reproduce", "write"]

FIRST_TIME, POINTS_PER_DECADE = 10.0, 100  # start of curves, and points per decade: GALIs of tori fluctuate
TIMED = 2e4  # length of the timed runs
NUMBER_OF_FIGURES = 12  # those of the paper, and one of the energy errors given in Table 1 and the text


@dataclasses.dataclass(frozen=True)
class MethodRun:
    """The exponents of an orbit by a method.

    Attributes:
        time: (times,); exponents: (times, 2N) averages up to there.
        error: one standard error of the first.
        drift: (times,) relative error of the energy.
    """

    time: np.ndarray
    exponents: np.ndarray
    error: float
    drift: np.ndarray

    @property
    def energy(self) -> float:
        """Size of the energy error at the end."""
        return abs(float(self.drift[-1]))

    @property
    def sums(self) -> np.ndarray:
        """(times, N) λ_i + λ_{2N+1−i}, which are 0 in the limit."""
        half = self.exponents.shape[1] // 2
        return (self.exponents + self.exponents[:, ::-1])[:, :half]


@dataclasses.dataclass(frozen=True)
class Reproduction(reproductions.Reproduction):
    """Figs. 1 to 11, Table 1 and the energy errors, computed and compared.

    Attributes:
        table: a `MethodRun` of R1 for each of `TABLE`.
        seconds: for each of `TABLE`, of computing for t = 10⁶, orthonormalised after each step.
        exponents: for C1, C2 and R2 a `MethodRun` for each method.
        indices: for each orbit an `lh.GALIResult` for each method.
        sections: of R1, C1 and C2 with x = 0, p_x ≥ 0.
        lengths: of the runs.
    """

    name = "skokos"

    table: tuple[MethodRun, ...]
    seconds: tuple[float, ...]
    exponents: dict[str, dict[str, MethodRun]]
    indices: dict[str, dict[str, GALIResult]]
    sections: dict[str, PoincareSection]
    lengths: Lengths

    def of_r1(self, method: str, step: float = STEP) -> MethodRun:
        """The first row of Table 1 with this method and step."""
        return next(run for row, run in zip(TABLE, self.table, strict=True) if (row.method, row.step) == (method, step))

    def of(self, orbit: str) -> dict[str, MethodRun]:
        """The runs of an orbit by method, with the step 0.05."""
        return {method: self.of_r1(method) for method in METHODS} if orbit == "R1" else self.exponents[orbit]

    def compared(self) -> list[Check]:
        """All checks."""
        return skokos_checks.checks(self)

    def judged(self) -> list[Claim]:
        """The claims of the paper, item by item, with the findings."""
        return skokos_claims.claims(self)

    def report(self) -> str:
        """Tables, checks and claims."""
        return skokos_report.table(self)

    def data(self) -> dict:
        """All numbers, ready for JSON."""
        return skokos_report.numbers(self)

    def figures(self) -> dict:
        """All figures by the names of their files."""
        return {f"skokos-{number}": self.figure(number) for number in range(1, NUMBER_OF_FIGURES + 1)}

    def figure(self, number: int = 2):
        """Fig. 1 to 11 of the paper; 12: errors of the energy."""
        from . import figures as skokos_figures

        return skokos_figures.figure(self, number)


def method_of(name: str, step: float, threshold: float | None = None) -> Method:
    """A method of the paper; DOP853 takes steps of at most τ, shorter where δ requires it."""
    if name == "TM":
        return Symplectic("SBAB2C", dt=step)
    if name == "DOP853":
        threshold = LOOSE if threshold is None else threshold
        return RungeKutta("dop853", rtol=threshold, atol=threshold, max_step=step)
    return TangentHamiltonian(name.removeprefix("TDH"), dt=step)


def _each(method: Method, step: float, steps: int = 1) -> float:
    """The length of so many steps, in the unit of the method's `every`."""
    return steps * step if method.adaptive else steps


@functools.cache
def _problem(name: str):
    """System, start, and parameters as arrays."""
    orbit = ORBITS[name]
    problem = zoo.get(orbit.problem)(**dict(orbit.parameters))
    assert isinstance(problem.system, Hamiltonian)
    args = None if problem.args is None else {key: jnp.asarray(value, float) for key, value in problem.args.items()}
    return problem.system, problem.x0, args


def _times(t1: float) -> np.ndarray:
    """Whole numbers, nearly even on a logarithmic scale, so that all step sizes divide them."""
    count = round(POINTS_PER_DECADE * np.log10(t1 / FIRST_TIME)) + 1
    return np.unique(np.round(np.geomspace(FIRST_TIME, t1, count)))


def _run(orbit: str, method: str, t1: float, step: float = STEP, threshold: float | None = None) -> MethodRun:
    system, x0, args = _problem(orbit)
    n, chosen = x0.shape[0], method_of(method, step, threshold)
    spectrum = lyapunov_spectrum(
        system, x0, args, t1=t1, times=_times(t1), frame=generic_frame(n, n, x0.dtype), method=chosen,
        every=_each(chosen, step, EVERY),
    )  # fmt: skip
    way = trajectory(system, x0, args, t1=t1, times=_times(t1), method=chosen)
    start, on_the_way = system.energy(x0, args), jax.vmap(lambda x: system.energy(x, args))(way.x)
    history = spectrum.history
    return MethodRun(
        np.asarray(history.time),
        np.asarray(history.exponents),
        _error_of(spectrum),
        np.asarray((on_the_way - start) / jnp.abs(start)),
    )


def _error_of(spectrum) -> float:
    """One standard error of λ₁, from the later blocks, weighted by their lengths."""
    time, growth = np.asarray(spectrum.history.time), np.asarray(spectrum.history.growth)[:, 0]
    length = np.diff(time, prepend=0.0)
    late = time > 0.01 * time[-1]
    mean = np.sum(growth[late]) / np.sum(length[late])
    return float(np.sqrt(np.sum((growth - mean * length)[late] ** 2)) / np.sum(length[late]))


def _indices(orbit: str, method: str, t1: float) -> GALIResult:
    system, x0, args = _problem(orbit)
    return gali(
        system, x0, args, t1=t1, times=_times(t1), orders=ORBITS[orbit].orders, method=method_of(method, STEP)
    )  # fmt: skip


def _section(orbit: str, points: int) -> PoincareSection:
    system, x0, args = _problem(orbit)
    return poincare_section(
        system, x0, args, section=lambda t, x, args: x[0], direction=1, n=points, method=method_of("TM", STEP)
    )


def _seconds(row: MethodRow) -> float:
    """Seconds for t = 10⁶: the shortest of three runs, orthonormalised after each step, with everything compiled."""
    system, x0, args = _problem("R1")
    method = method_of(row.method, row.step, row.threshold)
    taken = []
    for _ in range(4):
        start = time.perf_counter()
        lyapunov_spectrum(system, x0, args, t1=TIMED, method=method, every=_each(method, row.step))
        taken.append(time.perf_counter() - start)
    return min(taken[1:]) * 1e6 / TIMED


def _length_of_indices(orbit: str, method: str, lengths: Lengths) -> float:
    many = lengths.longer if method == "TDHeps" else lengths.many
    return {"C1": lengths.chaos, "R3": many}.get(orbit, lengths.indices)


def reproduce(*, quick: bool = False, progress=None) -> Reproduction:
    """Compute Figs. 1 to 11, Table 1 and the energy errors.

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
            tasks["indices", orbit, method] = (_indices, orbit, method, _length_of_indices(orbit, method, lengths))
    for row in TABLE:
        tasks["table", row] = (_run, "R1", row.method, lengths.table, row.step, row.threshold)
    for orbit in ("R2", "C2", "C1"):
        for method in methods[orbit]:
            tasks["exponents", orbit, method] = (_run, orbit, method, lengths.exponents)
    for orbit, points in (("R1", lengths.points), ("C1", lengths.points), ("C2", lengths.around)):
        tasks["sections", orbit] = (_section, orbit, points)
    done = computed({name: (name, *task) for name, task in tasks.items()}, progress)
    return Reproduction(
        tuple(done["table", row] for row in TABLE),
        tuple(_seconds(row) for row in TABLE),  # not in parallel with anything
        {o: {m: done["exponents", o, m] for m in methods[o]} for o in ("C1", "C2", "R2")},
        {o: {m: done["indices", o, m] for m in methods[o]} for o in methods},
        {o: done["sections", o] for o in ("R1", "C1", "C2")},
        lengths,
    )
