"""The claims of Linh, Truong & Tuyen, item by item, with their outcomes."""

from typing import TYPE_CHECKING

import numpy as np

from ..claims import AGREED, CORRECTED, NOT_REPRODUCIBLE, Claim
from .checks import (
    CONTINUOUS,
    LEAST_ERROR_UNCONTROLLED,
    PAIR_5,
    at_equal_steps,
    growth_left,
    listed,
    moved,
    off,
    off_by_order,
    order,
    ranged,
    rows_at,
    slope_of_linearisation,
    unexplained,
)
from .orders import EXPONENT_ORDERS
from .tables import SHORTEST_LENGTH, TABLES, TOLERANCES, exact

if TYPE_CHECKING:
    from . import reproduction as linh

__all__ = ["claims"]


def claims(r: "linh.Reproduction") -> list[Claim]:
    """The claims of the paper, item by item, with outcome and evidence."""
    return [*_about_exponents(r), *_about_quadrature(r), *_about_pairs(r), *_about_errors(r), *_about_times(r)]


def _pairs(r: "linh.Reproduction", *numbers: int):
    return [pair for number in numbers for pair in r.of(TABLES[number - 1])]


def _offs(r: "linh.Reproduction", *numbers: int) -> tuple[str, str]:
    """The largest errors over the tolerance, in the paper and here."""
    pairs = _pairs(r, *numbers)
    return (
        f"{max(off(row, row.exponents) for row, _ in pairs):.0f}",
        f"{max(off(row, found.exponents) for row, found in pairs):.0f}",
    )


def _power_of_steps(r: "linh.Reproduction", number: int) -> float:
    """The power of the step with which the published errors at T = 1000 fall."""
    rows = rows_at(r, number)
    errors = [np.linalg.norm(np.array(row.exponents) - row.exact) for row in rows]
    return -float(np.polyfit(np.log([row.steps for row in rows]), np.log(errors), 1)[0])


def _about_exponents(r: "linh.Reproduction") -> list[Claim]:
    paper, ours = _offs(r, 1, 3, 5, 6, 9)
    first, turned = (dict(zip(r.rows, r.found, strict=True))[rows_at(r, n)[-1]].exponents for n in (1, 5))
    steps = [found.steps / row.steps for row, found in _pairs(r, 1, 3, 4, 5, 6, 9, 10)]
    vector = r.characteristic.vectors[-1][:, 0]
    least = min(found.intervals.steklov for found in r.found)
    return [
        Claim(
            "Tables 1, 3, 5, 6, 9",
            f"exponents by discrete QR, which are within {paper} tolerances of the exact ones",
            f"within {ours} tolerances, by {ranged(steps)} times the steps",
            AGREED,
        ),
        Claim(
            "Example 5.2",
            "it has the exponents of Example 5.1",
            f"at TOL = 1e-6 and T = 1000 they differ by {listed(np.abs(first - turned), '.0e')}",
            AGREED,
        ),
        Claim(
            "§2.1, Algorithm 3.1",
            "exponents are stable where directions are integrally separated, as Steklov differences show",
            f"the least difference over a window is {least:.3f} in all runs, above 0; λ^l and λ^u are those of λ + C/t",
            AGREED,
        ),
        Claim(
            "Definition 2.3",
            "stable exponents move little where E and A do",
            f"by {np.max(moved(r)):.2f} times |ΔE|, |ΔA| at most, constant or periodic, from 0.1 to 1e-4; with "
            "constant ones they are the eigenvalues of the pencil",
            AGREED,
        ),
        Claim(
            "(7) and (8)",
            "ln μ_i of Λ = lim (YᵀY)^(1/2T) are the exponents, along its eigenvectors",
            f"T (ln μ_i − λ_i) goes to {listed(growth_left(r)[-1], '.6f')}; p1 = ({listed(vector, '.8f')}) from "
            "T = 20 on",
            AGREED,
        ),
        Claim(
            "(19) and (28)",
            "both algorithms start with s_i = φ_i = 0",
            f"discrete tables count ln R(t0) = {listed(r.initial, '.6f')}, continuous ones do not",
            CORRECTED,
            f"with it the tables differ from the exact values by {paper} tolerances at most, without it by "
            f"{np.max(np.abs(r.initial)) / SHORTEST_LENGTH / 1e-6:.0f} (T = 1000, TOL = 1e-6)",
        ),
        Claim(
            "Algorithms 3.1 and 3.3",
            "the error of x decides on the step",
            f"so λ2 of Example 5.1 is {listed([r.state_alone[1]], '.3f')} in place of "
            f"{listed([exact('discrete', SHORTEST_LENGTH)[1]], '.3f')}",
            CORRECTED,
            f"x comes to rest, and nothing then bounds the step: λ2 is off by more than {LEAST_ERROR_UNCONTROLLED:g} "
            "at TOL = 1e-6; the steps of Tables 1, 3, 5, 6 and 9 are those of an error of x and Y",
        ),
    ]


def _about_quadrature(r: "linh.Reproduction") -> list[Claim]:
    left = {number: ranged(unexplained(r, number)) for number in CONTINUOUS}
    slope, own = (order(r.exponent_orders[name]) for name in ("continuous, right rectangle", "continuous"))
    paper, ours = _offs(r, 8)
    return [
        Claim(
            "Table 8",
            "exponents by continuous QR, computed by (28) from w(t_{j+1})",
            f"φ += h w(t + h), the right rectangle rule, has the errors of the table, but for {left[8]} of them",
            CORRECTED,
            f"that rule is of first order ({slope:.2f}), the quadrature by the method's own weights of order "
            f"{own:.2f}; with it the errors are within {ours} tolerances in place of {paper}",
        ),
        Claim(
            "Tables 2 and 7",
            "exponents by continuous QR",
            f"their errors are neither ours nor those of the right rectangle rule, which leaves {left[2]} of them in "
            f"Table 2, {left[7]} in Table 7",
            NOT_REPRODUCIBLE,
            "the paper does not say by which quadrature φ is computed, nor what is controlled beside x; the exact "
            "exponents are known, and ours are nearer to them",
        ),
    ]


def _about_pairs(r: "linh.Reproduction") -> list[Claim]:
    ninth = max(off_by_order(*pair) for pair in r.of(TABLES[8]))
    pairs = [pair for table in TABLES if table.pair == PAIR_5 for pair in r.of(table)]
    alike = ranged([at_equal_steps(*pair) for pair in pairs])
    steps = ranged([found.steps / row.steps for row, found in pairs])
    paper, _ = _offs(r, 4)
    return [
        Claim(
            "Tables 3 and 9",
            "ESDIRK34, which in its source goes on by the weights of order 3",
            f"by those of order 4 errors are the paper's, to {100 * ninth:.1f} % of them",
            CORRECTED,
            f"the published errors of Table 9 fall with the {_power_of_steps(r, 9):.2f}th power of the steps; by the "
            "weights of order 4 the method is not L-stable",
        ),
        Claim(
            "Tables 4 and 10",
            "ESDIRK54b, whose suffix stands for going on by the weights of order 4; no coefficients",
            f"order conditions leave a family; its member with γ = 0.27 has, by the weights of order 5, {alike} times "
            f"the errors of λ2 at equal steps, and {steps} times the steps",
            CORRECTED,
            "the two errors of Table 4 where the motion is at rest, ln R(λh)/h − λ, are met to 0.03 %; by the weights "
            "of order 4 no member has them",
        ),
        Claim(
            "§4.1",
            "errors have the order of magnitude of the tolerance",
            f"for Dormand and Prince and ESDIRK34; of ESDIRK54b on Example 5.1 they are up to {paper} tolerances",
            CORRECTED,
            "near λ2 h = −1 both members of ESDIRK54b have nearly the same error, and their difference, the estimate, "
            "misses it",
        ),
    ]


def _about_errors(r: "linh.Reproduction") -> list[Claim]:
    powers = {name: f"{order(r.exponent_orders[name]):.2f}" for name in EXPONENT_ORDERS}
    kept, embedded, lost = (order(r.orders[name]) for name in ("propagated", "embedded", "without (9)"))
    most = max(float(np.max(errors / np.array(TOLERANCES)[:, None])) for errors in r.accuracy.values())
    return [
        Claim(
            "§4.1",
            "errors of exponents are controlled by the local errors, and of the size of the tolerance",
            f"within {most:.0f} tolerances from 1e-4 to 1e-10, both algorithms, all three systems (Dormand and Prince)",
            AGREED,
        ),
        Claim(
            "§4.1",
            "errors of exponents are O(h^p)",
            "; ".join(f"{name}: {power}" for name, power in powers.items() if "rectangle" not in name),
            AGREED,
        ),
        Claim(
            "§2.2",
            "with (9) the half-explicit method has the order p of the underlying one, without it order is lost",
            f"orders {kept:.2f} and, embedded, {embedded:.2f}; without (9) {lost:.2f}",
            AGREED,
        ),
        Claim(
            "Theorem 4.1",
            "the linearisation along a computed motion is off by at most M δ + N ε",
            f"by at most {np.max(r.turning.share):.2f} of that (Example 5.2, δ = TOL), and by up to "
            f"{np.max(r.turning.without_time):.2f} N ε; on Example 5.1, δ = 0, "
            f"it is proportional to TOL^{slope_of_linearisation(r):.2f}",
            AGREED,
        ),
    ]


def _about_times(r: "linh.Reproduction") -> list[Claim]:
    """Claims about times: reported only, because they depend on the machine and the implementation."""
    longest = {n: r.of(TABLES[n - 1])[-1][1].seconds for n in range(1, 11)}
    ordinary = r.ordinary[-1]
    machine = "times of Matlab on another machine; constraints are eliminated and all is compiled here"
    return [
        Claim(
            "§5",
            "continuous QR is faster where coefficients vary slowly, discrete QR slightly where they vary fast",
            f"discrete over continuous time at TOL = 1e-6: {longest[5] / longest[7]:.2f} slowly, "
            f"{longest[6] / longest[8]:.2f} fast",
            *_by(
                longest[5] > longest[7] and longest[6] < longest[8], f"{machine}, and the error of φ is controlled too"
            ),
        ),
        Claim(
            "§5",
            "ESDIRK methods take more time than the half-explicit one",
            f"ESDIRK34 {longest[3] / longest[1]:.1f}, ESDIRK54b {longest[4] / longest[1]:.1f} times as long (5.1), "
            f"{longest[9] / longest[5]:.1f} and {longest[10] / longest[5]:.1f} (5.2)",
            *_by(longest[3] > longest[1] and longest[9] > longest[5], machine),
        ),
        Claim(
            "Remark 5.3",
            "methods for ordinary equations are expected to be faster where a system can be made one",
            f"the DAEs take {listed([ordinary.of_dae / ordinary.seconds], '.1f')} (5.1) and "
            f"{listed([ordinary.of_turning / ordinary.seconds], '.1f')} (5.2) times as long",
            *_by(ordinary.of_turning > ordinary.seconds, machine),
        ),
        Claim(
            "Tables 1 to 10",
            "CPU times",
            "they stand beside ours in the tables",
            NOT_REPRODUCIBLE,
            "Matlab R2022a on a Core i5 of 2.7 GHz",
        ),
    ]


def _by(agrees: bool, reason: str) -> tuple[str, str]:
    return (AGREED, "") if agrees else (NOT_REPRODUCIBLE, reason)
