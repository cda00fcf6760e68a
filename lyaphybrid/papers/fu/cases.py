"""The cases of the paper, and the lengths of the runs."""

import dataclasses

import numpy as np

from . import bifurcations as fu_bifurcations

__all__ = ["FigureCase", "Lengths"]

PERIOD = 2 * np.pi / 0.666
STEPS_PER_PERIOD = 1000  # steps per period of the paper's scheme, Δt = 0.0094; the paper gives no value
BOX = np.array([[-np.pi, -2.0], [np.pi, 2.0]])  # box of random starts
CYCLE_STEPS, CHAOS_STEPS = 11, 8  # steps of the bisection of the coupling, to 5e-4 and 4e-3
OFF = (0.4, 0.3)  # offset from the zoo's start, which is on the cycle, to show the convergence


@dataclasses.dataclass(frozen=True)
class FigureCase:
    """A figure of the paper.

    Attributes:
        figure: 1, 2 or 3.
        beta, alpha: its parameters.
        motion: what it shows.
        says: the paper's statement on the exponents λ1 ≥ λ2 ≥ λ3 of (θ, θ', z).
        losses: number of directions that the cycle loses in a period; None if it is no cycle.
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
    FigureCase(1, 0.3, 0.01, "slips to and fro, period 1", ("zero", "negative", "negative"), 0),
    FigureCase(2, 0.052, 0.5, "sticks twice a period, period 1", ("zero", "negative", "negative"), 2),
    FigureCase(3, 0.052, 0.01, "chaos that rarely sticks", ("positive", "zero", "negative"), None),
)
BIFURCATIONS = tuple((one.beta, one.name) for one in fu_bifurcations.LISTED)
SWEEP = {0.12: ("P3w2", -0.0183346577), 0.2: ("P1w0", -0.0358938838), 0.3: ("P1w0", -0.1526045112)}


@dataclasses.dataclass(frozen=True)
class Lengths:
    """Lengths in periods, and the grid of Fig. 4.

    Attributes:
        cycle, chaos: of the spectra of Figs. 1 and 2, and of Fig. 3.
        shown: of the running exponents in the figures.
        two: of the two trajectories.
        trials: for each coupling of two copies in Fig. 3.
        scheme: of the paper's scheme in Fig. 3; for cycles 640.
        points: of the Poincaré map of Fig. 3.
        values: of β in Fig. 4; starts: random ones for each; transient, t1: of each run there.
    """

    cycle: int
    chaos: int
    shown: int
    two: int
    trials: int
    scheme: int
    points: int
    values: int
    starts: int
    transient: int
    t1: int


FULL = Lengths(4000, 200_000, 2000, 4000, 101, 16_000, 20_000, 301, 4, 300, 700)
QUICK = Lengths(4000, 20_000, 2000, 1000, 31, 2000, 8000, 301, 2, 200, 300)
SCHEME_CYCLE = 640
