"""Fu, Wang & Wang, Lyapunov exponents of discontinuous systems with dry friction (2004): Figs. 1 to 4.

A forced pendulum with dry friction, θ'' + βθ' + 0.87 sin θ + α Sgn(θ') ∋ 0.586 sin 0.666 t: a cycle that slips to and
fro, one that sticks twice a period, chaos that sticks very rarely, and attractors against β. The paper gives curves and
signs. They are compared with exact values, with four computations of this package (exponents, multipliers of the cycle,
two trajectories, the coupling at which two copies synchronise), and with the paper's own scheme (`transfer_matrices`),
which is wrong wherever the motion sticks.
"""

import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np

from ... import zoo
from ...analysis.comparisons import TwoTrajectories, two_trajectories
from ...analysis.diagrams.diagrams import BifurcationDiagram, bifurcation_diagram
from ...analysis.diagrams.sections import PoincareSection, poincare_section
from ...analysis.orbits.periodic_orbits import Floquet, floquet
from ...analysis.spectra import lyapunov_spectrum
from ...analysis.trajectories import Trajectory, trajectory
from ...results.spectrum import Spectrum
from ...systems.hybrid import Hybrid
from ...zoo.mechanics import friction
from .. import reproductions
from ..claims import Check, Claim
from ..reproductions import write
from . import bifurcations as fu_bifurcations
from . import checks as fu_checks
from . import report as fu_report
from . import synchronisation, transfer_matrices
from .cases import (
    BOX,
    CASES,
    CHAOS_STEPS,
    CYCLE_STEPS,
    FULL,
    OFF,
    PERIOD,
    QUICK,
    SCHEME_CYCLE,
    STEPS_PER_PERIOD,
    FigureCase,
    Lengths,
)

__all__ = ["FigureResults", "Reproduction", "reproduce", "write"]


@dataclasses.dataclass(frozen=True)
class FigureResults:
    """All results for one figure.

    Attributes:
        case: parameters and motion.
        spectrum: the two exponents of (θ, θ').
        autonomous: the three of (θ, θ', z), shorter, with the history that is drawn.
        orbit: the cycle and its multipliers; None in chaos.
        two: the largest exponent from two trajectories.
        synchronised: the largest exponent from two coupled copies.
        schemes: results of the paper's scheme, "euler" and "rk4".
        motion: a few periods in time.
        section: states at t = 0 mod 2π/ω; for a cycle from the start on.
        loop: once round the cycle; None in chaos.
    """

    case: FigureCase
    spectrum: Spectrum
    autonomous: Spectrum
    orbit: Floquet | None
    two: TwoTrajectories
    synchronised: synchronisation.Synchronised
    schemes: dict[str, transfer_matrices.SchemeRun]
    motion: Trajectory
    section: PoincareSection
    loop: Trajectory | None

    @property
    def losses(self) -> float:
        """Number of lost directions per period."""
        return float(np.sum(np.asarray(self.spectrum.loss_rate))) * PERIOD

    @property
    def zero(self) -> float:
        """The exponent of z = t, which is 0: the one of the three that is nearest to 0."""
        exponents = np.asarray(self.autonomous.exponents)
        return float(exponents[np.argmin(np.abs(exponents))])

    @property
    def exact(self) -> zoo.Reference:
        """The reference for the two exponents of (θ, θ')."""
        reference = zoo.friction_pendulum(beta=self.case.beta, alpha=self.case.alpha).reference
        assert reference is not None
        return reference

    @property
    def order(self) -> list[int]:
        """Indices of (zero, first, second of (θ, θ')) that are λ1 ≥ λ2 ≥ λ3 of (θ, θ', z)."""
        exponents = (0.0, *self.exact.exponents)
        return sorted(range(3), key=lambda i: -exponents[i])

    @property
    def exponents(self) -> np.ndarray:
        """(3,) λ1 ≥ λ2 ≥ λ3 of (θ, θ', z)."""
        return np.array([self.zero, *np.asarray(self.spectrum.exponents)])[self.order]


@dataclasses.dataclass(frozen=True)
class Reproduction(reproductions.Reproduction):
    """Figs. 1 to 4, computed and compared.

    Attributes:
        found: one `FigureResults` for each of `CASES`.
        diagram: Fig. 4.
        vanishings: λ₁ at the bifurcations.
        lengths: in periods.
    """

    name = "fu"

    found: tuple[FigureResults, FigureResults, FigureResults]
    diagram: BifurcationDiagram
    vanishings: tuple[fu_bifurcations.Vanishing, ...]
    lengths: Lengths

    def compared(self) -> list[Check]:
        """All checks."""
        return fu_checks.checks(self)

    def judged(self) -> list[Claim]:
        """The claims of the paper, item by item, with the findings."""
        return fu_checks.claims(self)

    def report(self) -> str:
        """Tables, checks and claims."""
        return fu_report.table(self)

    def data(self) -> dict:
        """All numbers, ready for JSON."""
        return fu_report.numbers(self)

    def figures(self) -> dict:
        """All figures by the names of their files."""
        return {f"fu-{number}": self.figure(number) for number in (1, 2, 3, 4)}

    def figure(self, number: int = 4):
        """Fig. 1, 2, 3 or 4."""
        from . import figures as fu_figures

        return fu_figures.bifurcations(self.diagram) if number == 4 else fu_figures.motion(self.found[number - 1])


@functools.cache
def _problem(case: FigureCase, form: str = "forced"):
    """System, start, and parameters as arrays, so that all figures share compiled code."""
    problem = zoo.friction_pendulum(beta=case.beta, alpha=case.alpha, form=form)
    system = problem.system
    assert isinstance(system, Hybrid)
    return system, problem.x0, {name: jnp.asarray(value, float) for name, value in problem.args.items()}


def _off(case: FigureCase, form: str = "forced"):
    """The problem with a start beside the cycle."""
    system, start, args = _problem(case, form)
    return system, start + jnp.zeros_like(start).at[:2].set(jnp.asarray(OFF)), args


def _found(case: FigureCase, lengths: Lengths, progress=None) -> FigureResults:
    forced, autonomous = _off(case), _off(case, "autonomous")
    periods = lengths.cycle if case.cycle else lengths.chaos
    transient = 0 if case.cycle else 500
    settle = (50 if case.cycle else 500) * PERIOD
    schemes = {
        method: transfer_matrices.run(
            autonomous[1],
            autonomous[2],
            method=method,
            steps=STEPS_PER_PERIOD,
            periods=SCHEME_CYCLE if case.cycle else lengths.scheme,
            transient=40,
        )
        for method in transfer_matrices.TRANSFER_SCHEMES
    }
    orbit = floquet(*forced, period=PERIOD, transient=settle) if case.cycle else None
    return FigureResults(
        case,
        lyapunov_spectrum(*forced, t1=periods * PERIOD, blocks=200, transient=settle, progress=progress),
        lyapunov_spectrum(*autonomous, t1=lengths.shown * PERIOD, times=_times(lengths.shown)),
        orbit,
        two_trajectories(*forced, t1=lengths.two * PERIOD, transient=settle),
        _synchronised(case, 1 if case.cycle else lengths.trials),
        schemes,
        trajectory(*forced, t1=PERIODS_SHOWN * PERIOD, n=200 * PERIODS_SHOWN),
        poincare_section(
            *forced, period=PERIOD, n=POINTS_BEFORE_CYCLE if case.cycle else lengths.points, transient=transient
        ),
        None if orbit is None else trajectory(forced[0], orbit.x0, forced[2], t1=PERIOD, n=400),
    )


def _synchronised(case: FigureCase, trials: int) -> synchronisation.Synchronised:
    """Starts on the attractor at t = 0; on a cycle one trial is enough, and gives more digits."""
    system, start, args = _off(case)
    settled = trajectory(system, start, args, t1=50 * PERIOD, n=1).x[-1]
    steps = CYCLE_STEPS if case.cycle else CHAOS_STEPS
    return synchronisation.synchronised(_pair(), settled, args, period=PERIOD, angles=(0,), trials=trials, steps=steps)


@functools.cache
def _pair() -> Hybrid:
    return synchronisation.coupled(*friction.PENDULUM_PARTS)


def _times(periods: int) -> np.ndarray:
    """Times of the running exponents: after each of the first periods, later at growing distances."""
    return np.unique(np.round(np.geomspace(1, periods, 300))) * PERIOD


PERIODS_SHOWN, POINTS_BEFORE_CYCLE = 12, 60  # periods of the velocity, and points on the way to a cycle


def _diagram(lengths: Lengths) -> BifurcationDiagram:
    system, _, args = _problem(CASES[2])
    return bifurcation_diagram(
        system,
        BOX,
        args,
        over={"beta": np.linspace(0.0, 0.3, lengths.values)},
        period=PERIOD,
        angles=(0,),
        starts=lengths.starts,
        transient=lengths.transient,
        t1=lengths.t1,
        escape=True,
    )


def reproduce(*, quick: bool = False, progress=None) -> Reproduction:
    """Compute Figs. 1 to 4.

    Args:
        quick: shorter runs and fewer values of β, nothing else.
        progress: as in `lh.lyapunov_spectrum`, of Fig. 3.

    Returns:
        A `Reproduction`.
    """
    lengths = QUICK if quick else FULL
    # Two threads, so that one computes while the other compiles.
    with ThreadPoolExecutor(1) as aside:
        diagram = aside.submit(_diagram, lengths)
        one, two, three = (_found(case, lengths, None if case.cycle else progress) for case in CASES)
        system, _, args = _problem(CASES[2])
        vanishings = fu_bifurcations.vanishings(system, args)
    return Reproduction((one, two, three), diagram.result(), vanishings, lengths)
