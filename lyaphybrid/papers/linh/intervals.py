"""Further results of Algorithms 3.1 and 3.3: λ^l, λ^u, and Steklov differences."""

import dataclasses

import numpy as np

from ...analysis.spectra import lyapunov_spectrum
from .tables import OFFSETS, PublishedRow, exact, limits, problem_of

__all__ = ["WINDOWS", "Intervals", "intervals", "wanted"]

WINDOWS = 64  # number of windows for Steklov differences; τ = T/2


@dataclasses.dataclass(frozen=True)
class Intervals:
    """Intervals of one run.

    Attributes:
        lower, upper: (2,) λ_i^l and λ_i^u, least and greatest λ_i(t) over τ ≤ t ≤ T.
        steklov: the least difference of the growth rates λ₁ − λ₂ over a window.
    """

    lower: np.ndarray
    upper: np.ndarray
    steklov: float


def intervals(row: PublishedRow) -> Intervals:
    """The intervals of the run of a row."""
    system, x0, args = problem_of(row.table.example)
    spectrum = lyapunov_spectrum(
        system, x0, args, t1=float(row.length), method=row.table.method(row.tolerance), blocks=WINDOWS,
        count_start=row.table.algorithm == "discrete",
    )  # fmt: skip
    growth, time = np.asarray(spectrum.history.growth), np.asarray(spectrum.history.time)
    rates = growth / np.diff(time, prepend=0.0)[:, None]
    return Intervals(np.asarray(spectrum.lower), np.asarray(spectrum.upper), float(np.min(rates[:, 0] - rates[:, 1])))


def wanted(row: PublishedRow) -> Intervals:
    """The same from λ_i(t) = λ_i + C_i/t; the least difference is in the first window, because of C_i."""
    ends = exact(row.table.algorithm, np.array([row.length / 2, row.length]))
    first = limits() + np.array(OFFSETS["continuous"]) * WINDOWS / row.length
    return Intervals(ends.min(axis=0), ends.max(axis=0), float(first[0] - first[1]))
