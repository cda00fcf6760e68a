"""The claims of Dinius, item by item, with their outcomes."""

from typing import TYPE_CHECKING

import numpy as np

from ..._text import with_error
from ..claims import AGREED, CORRECTED, NOT_REPRODUCIBLE, Claim
from .checks import checks_of_convergence, decay_of_zeros, latest_off, scatter_at, signed
from .examples import STRIKES
from .table import CLOSED, LAW_FROM, WITHIN, N

if TYPE_CHECKING:
    from . import reproduction as dinius

__all__ = ["claims", "eigenvalues_of_a_flight", "jump_back", "printed_rule"]

A_FEW_PERCENT = 0.03  # "a few percent"
CONTACT = np.array([0.6, 0.8]), np.array([-1.0, 0.5])  # q and p at a collision, σ = m = 1


def claims(r: "dinius.Reproduction") -> list[Claim]:
    """The claims of the paper, item by item, with outcome and evidence."""
    return [*_about_exponents(r), *_about_hybrid_systems(r), *_about_disks(r), *_about_results(r)]


def eigenvalues_of_a_flight(t: float) -> np.ndarray:
    """(4N,) of ∫ Df over a flight of this length: f = (p/m, 0)."""
    return np.linalg.eigvals(t * np.eye(4 * N, k=2 * N))


def jump_back() -> float:
    """Distance of a pair from its start after two collisions by D as printed in the paper."""
    q, p = CONTACT

    def collided(p):
        return p - 2 * (p @ q) * q  # difference of p_k + (p·q) q and p_l − (p·q) q

    return float(np.max(np.abs(collided(collided(p)) - p)))


def printed_rule(dq: np.ndarray) -> np.ndarray:
    """(2,) δq_l − δq_k after a collision, as printed in the paper."""
    q, _ = CONTACT
    return dq - 2 * (q @ dq) * dq


def _by(holds: bool) -> tuple[str, str]:
    """The outcome of a claim that depends on a numerical check."""
    return (AGREED, "") if holds else (CORRECTED, "the check of it fails")


def _value(value, error) -> str:
    return signed(with_error(float(value), float(error)))


def _about_exponents(r: "dinius.Reproduction") -> list[Claim]:
    one, error = float(r.alone.exponents[0]), float(r.alone.stderr[0])
    still = float(np.max(np.abs(r.straight.exponents)))
    eigenvalue = float(np.max(np.abs(eigenvalues_of_a_flight(1.0))))
    first, second = r.reference[0][:2]
    return [
        Claim(
            "(2) and (3)",
            "λ̄_m is an eigenvalue of ∫ Df dτ",
            f"in flight all eigenvalues of ∫ Df are {eigenvalue:g}, and yet δq = δp t/m grows",
            CORRECTED,
            "x' = Df(t) x is solved by exp ∫ Df only where Df(t) at different times commute, and δq grows as singular "
            "values do, not as eigenvalues; at collisions there is no Df at all",
        ),
        Claim(
            "§II.A, direction",
            "a perturbation that begins orthogonal to m − 1 others gives λ_m",
            f"one that begins orthogonal to another, followed by itself, grows with {_value(one, error)} = λ1",
            CORRECTED,
            f"λ1 = {first:.4f} and λ2 = {second:.4f}: each turns to the first direction, unless it is made orthogonal "
            "again and again, as Algorithm 2 does",
        ),
        Claim(
            "§II.A, start",
            "the limit is the same for every start",
            f"so it is for {len(r.singles)} starts with random momenta; but from one whose disks never meet the "
            f"largest |λ| is {still:.2g}",
            CORRECTED,
            "the theorems say it of almost every start: two columns of disks that pass each other have the energy and "
            "the momentum of Table I, and exponents 0",
        ),
    ]


def _about_hybrid_systems(r: "dinius.Reproduction") -> list[Claim]:
    per_jump, rate = r.exponents[0] / r.collision_rate, r.collision_rate
    return [
        Claim(
            "(7) to (10), Fig. 1",
            "S(δx_m) = Dg δx_m + [Dg f − f∘g] δτ_m, with δx_m = δx + f δτ_m",
            "the formula is that of the saltation matrix with δx in place of δx_m",
            CORRECTED,
            "a perturbation along the flow, δx = f, has δτ = −1 and must become f∘g: so it does with δx; δx_m is 0 "
            "then, and with it f∘g − Dg f comes out",
        ),
        Claim(
            "§II.C, properties 1 to 5",
            "one of them is necessary for a complete solution",
            "lh.TimeDomain tells the five, and the sixth that is missing: zeno",
            CORRECTED,
            "a ball that keeps r of its speed bounces infinitely often until t = 2v/(g(1 − r)), with intervals all of "
            "which are positive: it is complete, and has none of the five",
        ),
        Claim(
            "§II.C, s = max(sup t, sup j)",
            "exponents per unit of s",
            f"with {rate:.1f} collisions per unit of time s is the number of collisions, and λ1 is {per_jump:.4f}",
            CORRECTED,
            "the text then takes the limit in time (§III.A, Fig. 2), where λ1 is "
            f'{_value(r.exponents[0], r.stderr[0])}; clock="time", "jumps" and "hybrid" give either',
        ),
        Claim(
            "§III.A",
            "the limit is meaningful in time and in the number of jumps",
            f"both exist, and differ by the factor {rate:.2f}, the mean number of collisions per unit of time",
            AGREED,
        ),
        Claim(
            "Algorithms 1 and 2",
            "modified Gram–Schmidt after each step; Algorithm 2 returns vectors",
            f"every ten steps, as Table I has it, with the norms: within {np.nanmax(np.abs(r.deviations_by_time)):.1f} "
            "standard errors of the reference",
            CORRECTED,
            "the exponents are the sums of the logarithms of the norms, which Algorithm 2 does not return",
        ),
    ]


def _about_disks(r: "dinius.Reproduction") -> list[Claim]:
    ends = np.array([one.x for one in r.singles]).reshape(len(r.singles), 2, N, 2)
    energy = float(np.max(np.abs(np.sum(ends[:, 1] ** 2, axis=(1, 2)) / 2 - N)))
    momentum = float(np.max(np.abs(np.sum(ends[:, 1], axis=1))))
    dq = np.array([0.3, 0.1])
    grown = float(np.linalg.norm(printed_rule(2 * dq) - 2 * printed_rule(dq)) / np.linalg.norm(printed_rule(dq)))
    return [
        Claim(
            "§III.A, g",
            "a collision conserves kinetic energy and momentum",
            f"at t = {r.t1:g} the energy of {len(r.singles)} runs is off by {energy:.0e} at most, the momentum by "
            f"{momentum:.0e}",
            *_by(max(energy, momentum) < CLOSED),
        ),
        Claim(
            "§III.A, C and D",
            "D: the smallest distance is at most σ; a box for 2N positions",
            "D needs the nearest image of each pair and p·q < 0, and there are N positions",
            CORRECTED,
            "after a collision the distance is still σ, so that x⁺ lies in D as printed, and jumps back at once: "
            f"|g(g(x)) − x| = {jump_back():.0e}",
        ),
        Claim(
            "§III.A, δq⁺ and δp⁺",
            "δq_k⁺ = δq_k + (q·δq) δq/σ², δp_k⁺ = p_k + …",
            "δq_k⁺ = δq_k + (q·δq) q/σ², δp_k⁺ = δp_k + …: with these all is as by the saltation matrix",
            CORRECTED,
            f"the printed rule is not linear: S(2 δq) − 2 S(δq) is {grown:.1f} times as long as S(δq), and δp = 0 "
            "becomes p_k",
        ),
        Claim(
            "§III.A, δτ_c and δq_c",
            "perturbations meet at their own instants",
            "rules that forget this, or have its sign wrong, are off the exponents by "
            f"{np.min(r.mistaken_deviations):.0f} standard errors at least",
            *_by(bool(np.min(r.mistaken_deviations) > WITHIN)),
        ),
    ]


def _about_results(r: "dinius.Reproduction") -> list[Claim]:
    # Long: a list of claims, one after the other.
    _, running = r.running
    percent = float(np.max(np.abs(running[:, -1, :5] / r.reference[0][:5] - 1)))
    when, factors = latest_off(r, A_FEW_PERCENT), list(scatter_at(r).values())
    kept, moving = int(np.sum(when < r.t1)), ~np.isnan(r.deviations)
    since = f", and stay there from t = {np.median(when[when < r.t1]):.0f} on (median)" if kept else ""
    apart = np.abs(r.by_time[0] - r.exponents)[moving] / np.hypot(r.by_time[1], r.stderr)[moving]
    sums = max(abs(float(np.sum(s.exponents))) for s in r.mistakes)
    return [
        Claim(
            "Table I, parameters",
            "they set up the simulation",
            "taken here: ρ the number density, total momentum 0, random momenta, a lattice at the start",
            NOT_REPRODUCIBLE,
            "the paper does not define ρ, and tells neither the start nor the total momentum",
        ),
        Claim(
            "Table I, n_gs and dt",
            "normalisation every ten steps of 0.001; dt plays no other part",
            f"every 0.01 and at collisions the exponents are the same, to {np.max(apart):.1f} standard errors",
            *_by(bool(np.max(apart) <= WITHIN)),
        ),
        Claim(
            "§III.B, 1",
            "2d + 2 = 6 exponents are 0",
            f"{r.zeros} are; in runs from unit vectors without transient they fall as 1/t: from t/10 to t |λ| t "
            f"changes by the factor {decay_of_zeros(r):.3f}",
            *_by(r.zeros == 6),
        ),
        Claim(
            "§III.B, 2; Fig. 2, bottom",
            "the full spectrum converges over time",
            "single runs are off by what a law 1/√t wants, times "
            f"{min(factors):.2f} to {max(factors):.2f}, from t = {LAW_FROM:g} on",
            *_by(all(one.holds for one in checks_of_convergence(r))),
        ),
        Claim(
            "§III.B, 3; Fig. 2, top",
            "the sum is 0, because energy is conserved",
            f"it is 0 to {abs(r.sum):.0e}, as are λ_i + λ_17−i; the reason is that volume (and dq∧dp) is conserved",
            CORRECTED,
            "x' = −x, y' = 0 conserves y, and the sum is −1; the sum is a weak test besides: with four wrong rules at "
            f"collisions it is 0 to {sums:.0e}",
        ),
        Claim(
            "§IV",
            "exponents are meaningful only where the solution is unique",
            f"two clocks that strike together have {len(r.orders)} solutions, by the order of {STRIKES} strikes, with "
            f"λ1 from {r.orders.lower[0]:.4f} to {r.orders.upper[0]:.4f}; lh.solutions gives those of each",
            AGREED,
        ),
        Claim(
            "Fig. 2",
            "sixteen exponents, and their course in time",
            "in the table and the figure, with errors",
            NOT_REPRODUCIBLE,
            "it is a picture without numbers; the values here are held to an independent reference instead",
        ),
        Claim(
            "§III.B, references [2] and [4]",
            "the exponents match those of Forster and of Dellago, Posch & Hoover within a few percent, after a similar "
            "time",
            f"single runs are off the reference by {percent:.1%} at most at t = {r.t1:g}; {kept} of {len(when)} are "
            f"within {A_FEW_PERCENT:.0%} of it{since}",
            NOT_REPRODUCIBLE,
            "the paper quotes no value of theirs, and says neither for which number of disks, density and box, nor "
            "which exponents were compared",
        ),
    ]
