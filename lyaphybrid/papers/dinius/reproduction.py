"""J. Dinius, Computing Lyapunov Exponents of Hybrid Dynamical Systems (2011): Table I and Fig. 2.

Four hard disks in a periodic box: number density ρσ² = 0.7, L_x/L_y = √3/2, K = 4, total momentum 0,
t = 1000; here 16 runs, each from its own momenta, in two ways: all at once, orthonormalised at collisions, after a
transient; and one by one as in the paper, from unit vectors, without transient, orthonormalised every 0.01. The 16
exponents are compared with an independent reference (event-driven C, total time 2.8e7) and with the results of four
wrong rules for perturbations at a collision (`collisions`).
"""

import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np

from ... import zoo
from ..._jax.engines import compiled
from ...analysis.spectra import lyapunov_spectrum
from ...engine.evolvers.scheduled import predicting_anew
from ...results.solution_sets import Solutions
from ...results.spectrum import Spectrum
from ...systems.event_driven import EventDriven
from .. import reproductions
from ..claims import Check, Claim
from ..reproductions import write
from . import checks as dinius_checks
from . import claims as dinius_claims
from . import report as dinius_report
from .collisions import MISTAKES, Mistake, collide, crossing_by
from .examples import orders_of_two_clocks
from .table import (
    NORMALISATION,
    RATE_SCATTER,
    REPLICATES,
    SCATTER,
    T1,
    T1_MISTAKES,
    T1_MISTAKES_QUICK,
    T1_QUICK,
    ZERO,
    N,
)

__all__ = [
    "MISTAKES",
    "Mistake",
    "Reproduction",
    "as_in_the_paper",
    "one_perturbation",
    "reproduce",
    "spectrum",
    "spectrum_by",
    "without_collisions",
    "write",
]


@functools.cache
def _problem() -> zoo.Problem:
    return zoo.hard_disks(n=N)


@functools.cache
def _by_rule() -> EventDriven:
    system = _problem().system
    assert isinstance(system, EventDriven)
    return crossing_by(collide, predicting_anew(system, (4 * N,)))


def generic_frame(n: int) -> np.ndarray:
    """Orthonormal columns in dimension n that lie in no invariant subspace.

    Unit vectors do: total momentum is conserved, so only rounding would turn them to the right directions.
    """
    return np.linalg.qr(np.random.default_rng(0).normal(size=(n, n)))[0]


@compiled(hands_on=True)
def _starts(key, replicates):
    return jax.vmap(lambda key: zoo.hard_disks(n=N, key=key).x0)(jax.random.split(key, replicates))


def _starts_for(key, replicates):
    return _starts(jax.random.key(0) if key is None else key, replicates)


def spectrum(*, t1: float, key=None, replicates: int = REPLICATES, progress=None) -> Spectrum:
    """The exponents of Table I from several runs, each from its own momenta.

    Args:
        t1: length of each run after a transient of 20.
        key: a `jax.random.key`; None: key 0.
        replicates: number of runs.
        progress: as in `lh.lyapunov_spectrum`.
    """
    return _run(_problem().system, {}, replicates, key, t1=t1, transient=20.0, progress=progress)


def spectrum_by(mistake: Mistake, *, t1: float, key=None, replicates: int = REPLICATES) -> Spectrum:
    """The exponents by another rule for perturbations at collisions.

    Args:
        mistake: one of `MISTAKES`, or another `Mistake`: the factors 1 and 1 are right.
        t1: length of each run, and of the transient before.
        key: a `jax.random.key`; None: key 0.
        replicates: number of runs.
    """
    system, factors = _by_rule(), {"jump": mistake.jump, "shift": mistake.shift}
    return _run(system, factors, replicates, key, t1=t1, transient=t1, frame=generic_frame(4 * N))


def _run(system, factors, replicates, key, **keywords) -> Spectrum:
    # As arrays the factors are traced: the four wrong rules compile once.
    args = {name: jnp.asarray(value, float) for name, value in (_problem().args | factors).items()}
    return _by_numpy(lyapunov_spectrum(system, _starts_for(key, replicates), args, times="log", **keywords))


def _by_numpy(found: Spectrum) -> Spectrum:
    """With arrays of NumPy, or XLA would compile each sum and index of the checks and the report."""
    return jax.tree.map(np.asarray, found)


def as_in_the_paper(x0, *, t1: float) -> Spectrum:
    """One run as the paper has it: from the unit vectors, without transient, orthonormalised every 0.01.

    Args:
        x0: (16,) positions and momenta.
        t1: length of the run; 1000 in the paper.
    """
    problem = _problem()
    every, frame = ("time", NORMALISATION), np.eye(4 * N)
    found = lyapunov_spectrum(problem.system, x0, problem.args, t1=t1, every=every, frame=frame, times="log")
    return _by_numpy(found)


def without_collisions() -> np.ndarray:
    """A start (16,) with the energy and momentum of Table I whose disks never meet: two columns pass each other."""
    x = np.array(_problem().x0).reshape(2, N, 2)
    x[1] = [[0.0, 2**0.5 if column == 0 else -(2**0.5)] for column in np.unique(x[0, :, 0], return_inverse=True)[1]]
    return x.ravel()


def one_perturbation(*, t1: float, key=None, replicates: int = REPLICATES) -> Spectrum:
    """The growth of a single perturbation that starts orthogonal to another one.

    It is the first column of a frame: no orthonormalisation turns that, and the program is that of `spectrum`.

    Args:
        t1: length of each run, after a transient of 20.
        key: a `jax.random.key`; None: key 0.
        replicates: number of runs.

    Returns:
        A `Spectrum`; its first exponent is that of the perturbation.
    """
    second_first = np.roll(generic_frame(4 * N), -1, axis=1)
    return _run(_problem().system, {}, replicates, key, t1=t1, transient=20.0, frame=second_first)


@dataclasses.dataclass(frozen=True)
class Reproduction(reproductions.Reproduction):
    """Table I and Fig. 2, computed and compared.

    Attributes:
        spectrum: the 16 exponents with their errors and history.
        mistakes: (4,) spectra by the wrong rules of `MISTAKES`.
        t1, t1_mistakes: length of each run.
        singles: runs by `as_in_the_paper`, of the length t1, each with its own history.
        alone: by `one_perturbation`.
        straight: by `as_in_the_paper` from `without_collisions`.
        orders: of events at one instant, by `dinius_examples.orders_of_two_clocks`.
    """

    name = "dinius"

    spectrum: Spectrum
    mistakes: tuple[Spectrum, ...]
    t1: float
    t1_mistakes: float
    singles: tuple[Spectrum, ...]
    alone: Spectrum
    straight: Spectrum
    orders: Solutions

    @property
    def exponents(self) -> np.ndarray:
        """(16,) per unit time."""
        return np.asarray(self.spectrum.exponents)

    @property
    def stderr(self) -> np.ndarray:
        """(16,) standard errors of the mean of the runs."""
        return np.asarray(self.spectrum.stderr)

    @property
    def reference(self) -> tuple[np.ndarray, np.ndarray]:
        """(16,) the exponents of the independent reference, and their standard errors."""
        reference = _problem().reference
        assert reference is not None
        return np.array(reference.exponents), np.array(reference.stderr)

    @property
    def parameters(self) -> dict:
        """The parameters of Table I."""
        return dict(_problem().parameters)

    @property
    def deviations(self) -> np.ndarray:
        """(16,) our exponents minus the reference, in combined standard errors; nan for the zeros."""
        return self._deviations(self.exponents, self.stderr)

    def _deviations(self, found, errors) -> np.ndarray:
        values, theirs = self.reference
        combined = np.hypot(np.asarray(errors), theirs)
        difference = np.asarray(found) - values
        return np.where(np.abs(values) > ZERO, difference / np.where(combined > 0, combined, 1.0), np.nan)

    @property
    def by_time(self) -> tuple[np.ndarray, np.ndarray]:
        """(16,) the mean over the runs as in the paper, and its standard errors."""
        found = np.array([one.exponents for one in self.singles])
        return np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / len(found) ** 0.5

    @property
    def deviations_by_time(self) -> np.ndarray:
        """(16,) differences of `by_time` from the reference, in combined standard errors; nan for the zeros."""
        return self._deviations(*self.by_time)

    @property
    def running(self) -> tuple[np.ndarray, np.ndarray]:
        """(blocks,) times, and (runs, blocks, 16) the running exponents of the runs as in the paper."""
        histories = [one.history for one in self.singles]
        return np.asarray(histories[0].time), np.array([one.exponents for one in histories])

    @property
    def scattered(self) -> np.ndarray:
        """(runs, blocks, 5) the running λ1 … λ5 minus the reference, over the expected scatter of such a run."""
        time, running = self.running
        return (running[..., :5] - self.reference[0][:5]) / (SCATTER / np.sqrt(time)[:, None])

    @property
    def zeros(self) -> int:
        """The number of exponents below 0.01 in modulus."""
        return int(np.sum(np.abs(self.exponents) < ZERO))

    @property
    def pairing_defect(self) -> float:
        """The largest |λ_i + λ_17−i|."""
        return float(np.max(np.abs(self.exponents + self.exponents[::-1])))

    @property
    def sum(self) -> float:
        """The sum of all exponents."""
        return float(np.sum(self.exponents))

    @property
    def collision_rate(self) -> float:
        """Collisions per unit time."""
        return float(np.mean(self.spectrum.jumps) / np.mean(self.spectrum.time))

    @property
    def collision_rate_error(self) -> float:
        """Its standard error, from the known scatter of runs of this length."""
        runs = len(np.asarray(self.spectrum.replicates))
        return RATE_SCATTER / (runs * self.t1) ** 0.5

    @property
    def mistaken_deviations(self) -> np.ndarray:
        """(4,) the largest deviation from the right reference by each wrong rule, in standard errors."""
        return np.array([np.nanmax(np.abs(self._deviations(s.exponents, s.stderr))) for s in self.mistakes])

    def compared(self) -> list[Check]:
        """All checks."""
        return dinius_checks.checks(self)

    def judged(self) -> list[Claim]:
        """The claims of the paper, item by item, with the findings."""
        return dinius_claims.claims(self)

    def report(self) -> str:
        """Tables, checks and claims."""
        return dinius_report.table(self)

    def data(self) -> dict:
        """All numbers, ready for JSON."""
        return dinius_report.numbers(self)

    def figures(self) -> dict:
        """All figures by the names of their files."""
        return {"dinius": self.figure()}

    def figure(self):
        """Fig. 2: the spectrum, its convergence in time in one run, and how far runs of a length are off."""
        from . import figures as dinius_figures

        return dinius_figures.figure(self)


def reproduce(*, quick: bool = False, key=None, progress=None) -> Reproduction:
    """Compute Table I and what the wrong rules give.

    Args:
        quick: a tenth of the length; nothing else differs.
        key: a `jax.random.key`; None: key 0.
        progress: as in `lh.lyapunov_spectrum`.

    Returns:
        A `Reproduction`.
    """
    t1, t1_mistakes = (T1_QUICK, T1_MISTAKES_QUICK) if quick else (T1, T1_MISTAKES)
    starts = _starts_for(key, REPLICATES)

    def aside():
        singles = [as_in_the_paper(x0, t1=t1) for x0 in [*starts, without_collisions()]]
        return tuple(singles[:-1]), singles[-1], orders_of_two_clocks()

    # One program runs while others are traced.
    with ThreadPoolExecutor(1) as executor:
        others = executor.submit(aside)
        right = spectrum(t1=t1, key=key, progress=progress)
        alone = one_perturbation(t1=t1_mistakes, key=key)
        wrong = tuple(spectrum_by(mistake, t1=t1_mistakes, key=key) for mistake in MISTAKES)
    singles, straight, orders = others.result()
    return Reproduction(right, wrong, t1, t1_mistakes, singles, alone, straight, orders)
