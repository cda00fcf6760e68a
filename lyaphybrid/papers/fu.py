"""Fu, Wang & Wang, Lyapunov exponents of discontinuous systems with dry friction (2004): Figs. 1 to 4.

A forced pendulum with dry friction, θ'' + βθ' + 0.87 sin θ + α Sgn(θ') ∋ 0.586 sin 0.666 t: a cycle that slips to and
fro, one that sticks twice a period, chaos that sticks very rarely, and attractors against β. The paper shows curves and
tells signs. Beside them stand exact values, three computations of this package (exponents, multipliers of the cycle,
two trajectories), and the paper's own scheme (`transfer_matrices`), which is wrong wherever the motion sticks.
"""

import dataclasses
import functools
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from .. import zoo
from ..comparisons import TwoTrajectories, two_trajectories
from ..diagrams import BifurcationDiagram, bifurcation_diagram
from ..periodic_orbits import Floquet, floquet
from ..results import Spectrum
from ..sections import PoincareSection, poincare_section
from ..spectra import lyapunov_spectrum
from ..systems import Hybrid
from ..trajectories import Trajectory, trajectory
from . import fu_report, transfer_matrices
from .output import save

__all__ = ["BIFURCATIONS", "CASES", "FULL", "QUICK", "Case", "Found", "Lengths", "Reproduction", "reproduce", "write"]

PERIOD = 2 * np.pi / 0.666
STEPS = 1000  # of the paper's scheme, a period: Δt = 0.0094; the paper does not say
BOX = np.array([[-np.pi, -2.0], [np.pi, 2.0]])  # of starts
FINITE_PART, FINITE_PART_ERROR = -0.17727, 1e-4  # of λ₂ in Fig. 3: event-driven Taylor series, 3e6 periods
STICKS, STICKS_ERROR = 3.7e-4, 1.1e-5  # a period, there
SLIPPING = 9.43421217 - 2.01777389218  # of a period, in Fig. 2
WITHIN, FACTOR = 5.0, 1.5  # standard errors; of the rate of sticks
GATE = 5e-4  # standard error of λ₁ in Fig. 3, at full length


@dataclasses.dataclass(frozen=True)
class Case:
    """A figure of the paper.

    Attributes:
        figure: 1, 2 or 3.
        beta, alpha: its parameters.
        motion: what it shows.
        says: what the paper says of the three exponents.
        losses: how often a cycle loses a direction in a period; None: it is no cycle.
    """

    figure: int
    beta: float
    alpha: float
    motion: str
    says: tuple[str, str, str]
    losses: int | None

    @property
    def cycle(self) -> bool:
        """Whether the motion is periodic."""
        return self.losses is not None


CASES = (
    Case(1, 0.3, 0.01, "slips to and fro, period 1", ("zero", "negative", "negative"), 0),
    Case(2, 0.052, 0.5, "sticks twice a period, period 1", ("zero", "negative", "negative"), 2),
    Case(3, 0.052, 0.01, "chaos that rarely sticks", ("zero", "positive", "negative"), None),
)

# At α = 0.01, from cycles continued by Newton's method, independently of this package; the last one by its trace and
# determinant only.
BIFURCATIONS = (
    (0.0141710587, "fold of P1w3"),
    (0.0552057, "symmetry of P5"),
    (0.0583948553, "fold of P5"),
    (0.119144134, "doubling of P3w2"),
    (0.1211681137, "fold of P3w2"),
    (0.141556765, "doubling of P3"),
    (0.1459824746, "symmetry of P3"),
    (0.1467190146, "doubling of P1"),
    (0.1587880508, "fold of P3"),
    (0.1905219547, "symmetry of P1"),
    (0.2100355766, "doubling of P2w1"),
    (0.2140805105, "fold of P2w1"),
    (0.2400935056, "symmetry of P5b"),
    (0.2486769, "symmetry of P5b"),
    (0.2529744417, "fold of P5c"),
)
SWEEP = {0.12: ("P3w2", -0.0183346577), 0.2: ("P1w0", -0.0358938838), 0.3: ("P1w0", -0.1526045112)}


@dataclasses.dataclass(frozen=True)
class Lengths:
    """Lengths in periods, and the grid of Fig. 4.

    Attributes:
        cycle, chaos: of the spectra of Figs. 1 and 2, and of Fig. 3.
        shown: of the running exponents in the figures.
        two: of the two trajectories.
        scheme: of the paper's scheme in Fig. 3; for cycles 640.
        points: of the Poincaré map of Fig. 3.
        values: of β in Fig. 4; starts: random ones for each; transient, t1: of each run there.
    """

    cycle: int
    chaos: int
    shown: int
    two: int
    scheme: int
    points: int
    values: int
    starts: int
    transient: int
    t1: int


FULL = Lengths(4000, 200_000, 2000, 4000, 16_000, 20_000, 301, 4, 300, 700)
QUICK = Lengths(4000, 20_000, 2000, 1000, 2000, 2000, 61, 2, 200, 500)
SCHEME_CYCLE = 640


@dataclasses.dataclass(frozen=True)
class Found:
    """All that was computed for one figure.

    Attributes:
        case: which.
        spectrum: the two exponents of (θ, θ').
        autonomous: the three of (θ, θ', z), shorter, with the history that is drawn.
        orbit: the cycle and its multipliers; None in chaos.
        two: the largest exponent from two trajectories.
        schemes: what the paper's scheme gives, "euler" and "rk4".
        motion: a few periods in time.
        section: states at t = 0 mod 2π/ω.
    """

    case: Case
    spectrum: Spectrum
    autonomous: Spectrum
    orbit: Floquet | None
    two: TwoTrajectories
    schemes: dict[str, transfer_matrices.Run]
    motion: Trajectory
    section: PoincareSection

    @property
    def losses(self) -> float:
        """Directions lost, a period."""
        return float(np.sum(np.asarray(self.spectrum.loss_rate))) * PERIOD

    @property
    def zero(self) -> float:
        """The exponent of the direction z = t, which is 0: that of the three which is nearest."""
        exponents = np.asarray(self.autonomous.exponents)
        return float(exponents[np.argmin(np.abs(exponents))])


@dataclasses.dataclass(frozen=True)
class Reproduction:
    """Figs. 1 to 4, computed and compared.

    Attributes:
        found: one `Found` for each of `CASES`.
        diagram: Fig. 4.
        lengths: in periods.
    """

    found: tuple[Found, Found, Found]
    diagram: BifurcationDiagram
    lengths: Lengths

    @property
    def checks(self) -> dict[str, bool]:
        """What must hold, by name."""
        checks = {}
        for found in self.found[:2]:
            checks |= _checks_of_cycle(found)
        checks |= _checks_of_chaos(self.found[2], self.lengths.chaos)
        checks |= _checks_of_scheme(self.found[1].schemes)
        zeros = max(abs(found.zero) for found in self.found)
        return checks | {
            "z = t adds an exponent 0": zeros < 2 / (self.lengths.shown * PERIOD),
            "Fig. 4: no run failed": bool(np.all(self.diagram.status == 0)),
            "Fig. 4: cycles at β = 0.12, 0.2 and 0.3 within 1e-3": _cycles_of_diagram(self.diagram),
        }

    @property
    def passed(self) -> bool:
        """Whether all checks hold."""
        return all(self.checks.values())

    def __str__(self) -> str:
        return fu_report.table(self)

    def data(self) -> dict:
        """All numbers, ready for JSON."""
        return fu_report.numbers(self)

    def figure(self, number: int = 4):
        """Fig. 1, 2, 3 or 4."""
        from . import fu_figures

        return fu_figures.bifurcations(self.diagram) if number == 4 else fu_figures.motion(self.found[number - 1])


def sum_of_the_scheme() -> float:
    """What RK4 makes of the sum of the two exponents of Fig. 2 as Δt → 0: a stick keeps P₄(−1), not nothing."""
    kept = 2 * np.log(transfer_matrices.fourth_order(-1.0))
    return float((kept - CASES[1].beta * SLIPPING) / PERIOD)


def _exact(case: Case) -> zoo.Reference:
    reference = zoo.friction_pendulum(beta=case.beta, alpha=case.alpha).reference
    assert reference is not None
    return reference


def _checks_of_cycle(found: Found) -> dict[str, bool]:
    case, orbit, exact = found.case, found.orbit, np.array(_exact(found.case).exponents)
    assert orbit is not None
    start = np.asarray(zoo.friction_pendulum(beta=case.beta, alpha=case.alpha).x0)
    ours, multipliers = np.asarray(found.spectrum.exponents), np.asarray(orbit.exponents)
    name = f"Fig. {case.figure}: "
    return {
        name + "multipliers to 1e-9": _near(multipliers, exact, 1e-9),
        name + "strobe point to 1e-9": bool(np.max(np.abs(np.asarray(orbit.x0) - start)) < 1e-9),
        name + "spectrum to 1e-4": _near(ours, exact, 1e-4),
        name + f"{case.losses} losses a period": abs(found.losses - (case.losses or 0)) < 1e-3,
        name + "two trajectories to 1e-2": abs(float(found.two.exponent) - exact[0]) < 1e-2,
    }


def _near(values, exact, tolerance: float) -> bool:
    """Whether both are −∞ in the same places, and elsewhere the same."""
    finite = np.isfinite(exact)
    same = bool(np.all(np.isneginf(values) == ~finite))
    return same and bool(np.max(np.abs(values[finite] - exact[finite])) < tolerance)


def _checks_of_chaos(found: Found, periods: int) -> dict[str, bool]:
    exact, s = _exact(found.case), found.spectrum
    exponent, error = float(s.exponents[0]), float(s.stderr[0])
    expected, counted = STICKS * periods, found.losses * periods
    finite = np.hypot(_finite_error(s), FINITE_PART_ERROR)
    poisson = abs(counted - expected) <= WITHIN * expected**0.5
    two = np.hypot(float(found.two.stderr), exact.stderr[0])
    return {
        "Fig. 3: λ1 within 5 standard errors": abs(exponent - exact.exponents[0])
        <= WITHIN * np.hypot(error, exact.stderr[0]),
        "Fig. 3: its standard error small enough": error <= GATE * (FULL.chaos / periods) ** 0.5,
        "Fig. 3: λ2 = −∞": bool(np.isneginf(s.exponents[1])),
        # Where few losses are expected their scatter is wider than the factor.
        "Fig. 3: rate of losses": poisson and (expected < 50 or 1 / FACTOR < counted / expected < FACTOR),
        "Fig. 3: finite part of λ2 within 5 standard errors": bool(
            abs(float(s.finite_exponents[1]) - FINITE_PART) <= WITHIN * finite
        ),
        "Fig. 3: two trajectories within 5 standard errors": bool(
            abs(float(found.two.exponent) - exact.exponents[0]) <= WITHIN * two
        ),
    }


def _finite_error(s: Spectrum) -> float:
    """Standard error of the finite part of λ₂, from the blocks; its own error is that of −∞."""
    growth, ends = np.asarray(s.history.growth)[:, 1], np.asarray(s.history.time)
    rates = growth / np.diff(ends, prepend=0.0)
    return float(np.std(rates, ddof=1) / len(rates) ** 0.5)


def _checks_of_scheme(schemes) -> dict[str, bool]:
    euler, rk4 = schemes["euler"].exponents, schemes["rk4"].exponents
    return {
        "scheme: RK4 at a stick keeps P₄(−1) = 0.375": abs(rk4[1] + rk4[2] - sum_of_the_scheme()) < 1e-3,
        "scheme: a finite exponent for −∞": bool(np.isfinite(rk4[2])),
        "scheme: Euler off by its step": 1e-4 < abs(euler[1] - _exact(CASES[1]).exponents[0]) < 1e-2,
    }


def _cycles_of_diagram(diagram: BifurcationDiagram) -> bool:
    """Whether the cycles that are known were found, with their exponents."""
    for beta, (label, exponent) in SWEEP.items():
        row = int(np.argmin(np.abs(diagram.values - beta)))
        same = diagram.labels[row] == label
        if not np.any(same) or not np.all(np.abs(diagram.exponents[row, same, 0] - exponent) < 1e-3):
            return False
    return True


@functools.cache
def _problem(case: Case, form: str = "forced"):
    """System, start, and parameters as arrays: then all figures share what is compiled."""
    problem = zoo.friction_pendulum(beta=case.beta, alpha=case.alpha, form=form)
    system = problem.system
    assert isinstance(system, Hybrid)
    return system, problem.x0, {name: jnp.asarray(value, float) for name, value in problem.args.items()}


def _found(case: Case, lengths: Lengths, progress=None) -> Found:
    forced, autonomous = _problem(case), _problem(case, "autonomous")
    periods = lengths.cycle if case.cycle else lengths.chaos
    settle = (20 if case.cycle else 500) * PERIOD
    schemes = {
        method: transfer_matrices.run(
            autonomous[1],
            autonomous[2],
            method=method,
            steps=STEPS,
            periods=SCHEME_CYCLE if case.cycle else lengths.scheme,
            transient=40,
        )
        for method in transfer_matrices.METHODS
    }
    return Found(
        case,
        lyapunov_spectrum(*forced, t1=periods * PERIOD, blocks=200, transient=settle, progress=progress),
        lyapunov_spectrum(*autonomous, t1=lengths.shown * PERIOD, blocks=500),
        floquet(*forced, period=PERIOD) if case.cycle else None,
        two_trajectories(*forced, t1=lengths.two * PERIOD, transient=settle),
        schemes,
        trajectory(*forced, t1=SHOWN * PERIOD, n=200 * SHOWN),
        poincare_section(*forced, period=PERIOD, n=lengths.points, transient=500),
    )


SHOWN = 12  # periods of the velocity


def _diagram(lengths: Lengths) -> BifurcationDiagram:
    system, _, args = _problem(CASES[2])
    return bifurcation_diagram(
        system,
        {"beta": np.linspace(0.0, 0.3, lengths.values)},
        BOX,
        args,
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
    # Two threads: most of the time of the one is that in which the other's functions are compiled.
    with ThreadPoolExecutor(1) as aside:
        diagram = aside.submit(_diagram, lengths)
        one, two, three = (_found(case, lengths, None if case.cycle else progress) for case in CASES)
    return Reproduction((one, two, three), diagram.result(), lengths)


def write(result: Reproduction, folder: Path) -> list[Path]:
    """Figures (PNG, PDF) and numbers (JSON) into a folder; returns the files."""
    return save(folder, "fu", {f"fu-{number}": result.figure(number) for number in (1, 2, 3, 4)}, result.data())
