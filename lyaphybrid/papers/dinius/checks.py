"""The checks of the reproduction of Dinius' hard disks."""

import itertools
from typing import TYPE_CHECKING

import numpy as np

from ..._text import with_error
from ..claims import Check
from .examples import FIRST_MATRIX, SECOND_MATRIX, STRIKES
from .table import CLOSED, COLLISION_RATE, COLLISION_RATE_ERROR, LAW_FROM, SCATTER, WITHIN, ZERO

if TYPE_CHECKING:
    from . import reproduction as dinius

__all__ = ["checks", "checks_of_convergence", "decay_of_zeros", "latest_off", "scatter_at", "signed", "settled"]

LARGEST_RATIO = 2.0  # largest factor between the scatter of a few runs and the expected one


def signed(text: str) -> str:
    """The text with typographic minus signs."""
    return text.replace("-", "−")


def checks(r: "dinius.Reproduction") -> list[Check]:
    """All checks of the reproduction."""
    return [
        *_of_the_spectrum(r),
        *_of_the_normalisation(r),
        *checks_of_convergence(r),
        *_of_other_starts(r),
        _of_orders(r),
        *_of_wrong_rules(r),
    ]


def _most(deviations) -> tuple[str, bool]:
    largest = float(np.nanmax(np.abs(deviations)))
    return f"{largest:.1f} at most", largest <= WITHIN


def _of_the_spectrum(r: "dinius.Reproduction") -> list[Check]:
    rate_error = np.hypot(r.collision_rate_error, COLLISION_RATE_ERROR)
    return [
        Check("λ1 … λ5, λ12 … λ16: standard errors off the reference", "at most 5", *_most(r.deviations)),
        Check(f"zeros, |λ| < {ZERO:g}", "2d + 2 = 6", f"{r.zeros}", r.zeros == 6),
        Check("pairing, max |λ_i + λ_17−i|", "below 1e-9", f"{r.pairing_defect:.0e}", r.pairing_defect < CLOSED),
        Check("sum of the exponents", "0, to 1e-9", f"{abs(r.sum):.0e}", abs(r.sum) < CLOSED),
        Check(
            "collisions per unit of time, to 5 standard errors",
            with_error(COLLISION_RATE, COLLISION_RATE_ERROR),
            with_error(r.collision_rate, r.collision_rate_error),
            bool(abs(r.collision_rate - COLLISION_RATE) <= WITHIN * rate_error),
        ),
    ]


def _of_the_normalisation(r: "dinius.Reproduction") -> list[Check]:
    mean, error = r.by_time
    moving = ~np.isnan(r.deviations)
    apart = ((mean - r.exponents) / np.hypot(error, r.stderr))[moving]
    return [
        Check("every 0.01: standard errors off the reference", "at most 5", *_most(r.deviations_by_time)),
        Check("every 0.01 less at collisions, in standard errors", "at most 5", *_most(apart)),
    ]


def checks_of_convergence(r: "dinius.Reproduction") -> list[Check]:
    """Whether running exponents converge, and as fast as expected."""
    time, _ = r.running
    late = time >= LAW_FROM
    scatter, decay = scatter_at(r), decay_of_zeros(r)
    holds = all(1 / LARGEST_RATIO < value < LARGEST_RATIO for value in scatter.values())
    names = ", ".join(f"{t:g}" for t in scatter)
    return [
        Check(
            f"running λ1 … λ5 of single runs from t = {LAW_FROM:g} on: scatters off",
            "at most 5",
            *_most(r.scattered[:, late]),
        ),
        Check(
            f"scatter of runs of t = {names} over that of the reference, which falls as 1/√t",
            f"1, to a factor {LARGEST_RATIO:g}",
            ", ".join(f"{value:.2f}" for value in scatter.values()),
            holds,
        ),
        Check("second halves: max − min of running λ1 … λ5 in scatters of t/2", "at most 5", *_most(settled(r))),
        Check(
            "zeros of single runs: |λ| t at the end over that of t/10",
            "1, to 0.05",
            f"{decay:.3f}",
            abs(decay - 1) < 0.05,
        ),
    ]


def scatter_at(r: "dinius.Reproduction") -> dict[float, float]:
    """By time: root-mean-square error of single runs, over the expected scatter of such runs."""
    time, _ = r.running
    decades = LAW_FROM * 10.0 ** np.arange(np.log10(r.t1 / LAW_FROM) + 1e-9)
    places = [int(np.argmin(np.abs(time - t))) for t in decades]
    return {float(t): float(np.sqrt(np.mean(r.scattered[:, i] ** 2))) for t, i in zip(decades, places, strict=True)}


def settled(r: "dinius.Reproduction") -> np.ndarray:
    """(runs, 5) changes of λ1 … λ5 of single runs in their second half, in units of the scatter of half a run."""
    time, running = r.running
    late = running[:, time >= 0.5 * time[-1], :5]
    return (np.max(late, axis=1) - np.min(late, axis=1)) / (SCATTER / np.sqrt(0.5 * time[-1]))


def decay_of_zeros(r: "dinius.Reproduction") -> float:
    """Root mean square |λ| t of the zero exponents at the end of runs over that at a tenth of them; 1 for a 1/t law."""
    time, running = r.running
    early, size = int(np.argmin(np.abs(time - 0.1 * time[-1]))), np.sqrt(np.mean(running[..., 5:11] ** 2, axis=(0, 2)))
    return float(size[-1] * time[-1] / (size[early] * time[early]))


def latest_off(r: "dinius.Reproduction", part: float) -> np.ndarray:
    """(runs,) time from which all running λ1 … λ5 of a run stay within this fraction of their values."""
    time, running = r.running
    off = np.any(np.abs(running[..., :5] / r.reference[0][:5] - 1) > part, axis=2)
    return np.array([time[np.flatnonzero(one)[-1]] if np.any(one) else 0.0 for one in off])


def _of_other_starts(r: "dinius.Reproduction") -> list[Check]:
    found, error = float(r.alone.exponents[0]), float(r.alone.stderr[0])
    wanted, theirs = r.reference[0][0], r.reference[1][0]
    still, jumps = float(np.max(np.abs(r.straight.exponents))), int(r.straight.jumps)
    return [
        Check(
            "a perturbation followed by itself grows with λ1, to 5 standard errors",
            with_error(wanted, theirs),
            with_error(found, error),
            bool(abs(found - wanted) <= WITHIN * np.hypot(error, theirs)),
        ),
        Check(
            "a start without collisions: max |λ|",
            "0, to 1e-9",
            f"{still:.0e}, {jumps} collisions",
            still < CLOSED and jumps == 0,
        ),
    ]


def _of_orders(r: "dinius.Reproduction") -> Check:
    """Check of the largest exponents of solutions with different orders of events, against matrix products."""
    exact = []
    for orders in itertools.product(((FIRST_MATRIX, SECOND_MATRIX), (SECOND_MATRIX, FIRST_MATRIX)), repeat=STRIKES):
        product = np.eye(2)
        for first, second in orders:
            product = second @ first @ product
        exact.append(np.log(np.linalg.norm(product[:, 0])) / (STRIKES + 0.5))
    found = r.orders.exponents[:, 0]
    same = len(found) == len(exact) and bool(np.max(np.abs(np.sort(found) - np.sort(exact))) < CLOSED)

    def between(values) -> str:
        return f"{len(values)} in [{min(values):.6f}, {max(values):.6f}]"

    return Check("two clocks that strike together: λ1 of each order, to 1e-9", between(exact), between(found), same)


def _of_wrong_rules(r: "dinius.Reproduction") -> list[Check]:
    least, sums = float(np.min(r.mistaken_deviations)), max(abs(float(np.sum(s.exponents))) for s in r.mistakes)
    return [
        Check(
            "four wrong rules: standard errors off the reference", "above 5", f"{least:.0f} at least", least > WITHIN
        ),
        Check("their sums, which betray none", "0, to 1e-9", f"{sums:.0e}", sums < CLOSED),
    ]
