"""The tables and the numbers of the reproduction of Linh, Truong & Tuyen."""

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from ..claims import check_lines, claim_lines
from ..output import plain
from . import checks as linh_checks
from .beyond import extensions_report
from .intervals import WINDOWS
from .orders import COUNTS, EXPONENT_ORDERS
from .tables import EXAMPLES, SHORTEST_LENGTH, TABLES, TOLERANCES, PublishedRow, exact
from .theory import LENGTHS, SIZES

if TYPE_CHECKING:
    from . import intervals as linh_intervals
    from . import reproduction as linh

__all__ = ["numbers", "table"]

HEADS = ("T", "TOL", "λ1 paper", "exact", "ours", "λ2 paper", "exact", "ours", "off", "ours", "steps", "ours", "ratio",
         "CPU s", "ours")  # fmt: skip
WIDTHS = (5, 5, 11, 11, 11, 11, 11, 11, 6, 5, 6, 7, 5, 8, 7)
INTRODUCTION = """Linh, Truong & Tuyen: Lyapunov exponents of semi-linear DAEs by QR methods with error control

Exact: λ_i + C_i/T, with C_i as the algorithm counts. off: the larger |λ − exact| over TOL, in the paper and ours.
ratio: our steps over the paper's. CPU s: in the paper (Core i5, 2.7 GHz, Matlab R2022a), and ours on this machine,
compiled before.
Continuous: here the errors of φ are controlled too, hence up to three times the steps, and smaller errors.
Below each table: [λ_i^l, λ_i^u], the bounds of λ_i(t) over T/2 ≤ t ≤ T, and the least Steklov difference, the mean
of the growth rates λ1 − λ2 over one of {windows} windows; above 0 the directions are integrally separated."""
CORRECTIONS = """Corrections:
  1. Discrete tables count ln R(t0), continuous ones do not: they differ by ln R(t0)_ii/T, ln R(t0) = {initial}.
  2. ESDIRK34 goes on by its weights of order 4, for these have the errors of Table 9; it is then not L-stable.
  3. The errors of Table 8 are those of φ += h w(t + h), the right rectangle rule, which is of first order. Those of
     Tables 2 and 7 are not explained by it (see below).
  4. The errors at TOL = 1e-4 of Tables 1, 3, 5, 6 and 9 are those of the tolerance: with equations solved far
     below it they are as large, and fall with it.
  5. ESDIRK54b: order conditions leave a family, of which the member with γ = 0.27 has the errors of Tables 4 and 10,
     going on by the weights of order 5. In Table 4 they are up to 102 tolerances: near λ2 h = −1 both members of the
     pair have nearly the same error, and the estimate does not see it."""


def table(r: "linh.Reproduction") -> str:
    """Tables 1 to 10, and a summary of the other results."""
    lines = [INTRODUCTION.format(windows=WINDOWS)]
    for one in TABLES:
        lines += ["", f"Table {one.number}: {EXAMPLES[one.example]}, {one.algorithm} QR, {one.pair}", ""]
        lines += [_line(HEADS), *(_line(_row(row, found)) for row, found in r.of(one))]
        lines += ["", *(_bounds(row, found.intervals) for row, found in r.of(one))]
    initial = ", ".join(f"{v:.6f}" for v in r.initial)
    lines += ["", CORRECTIONS.format(initial=initial), ""]
    for part in (_rectangle, _accuracy, _ordinary, _theorem, _characteristic, _perturbed, _orders):
        lines += [*part(r), ""]
    lines += [*extensions_report.lines(r.extensions), ""]
    lines += [*check_lines(r.checks), "", *claim_lines(r.claims), ""]
    failed = [one.name for one in r.checks if not one.holds]
    lines.append(f"FAILED: {'; '.join(failed)}" if failed else f"passed: all {len(r.checks)} checks hold")
    return "\n".join(line.rstrip() for line in lines)


def _line(cells) -> str:
    return " ".join(f"{cell:>{width}s}" for cell, width in zip(cells, WIDTHS, strict=True))


def _signed(value: float, digits: int = 8) -> str:
    return f"{value:.{digits}f}".replace("-", "−")


def _power(tolerance: float) -> str:
    return f"{tolerance:.0e}".replace("e-0", "e-")


def _row(row: PublishedRow, found: "linh.RowResults") -> tuple[str, ...]:
    values = (_signed(v) for i in (0, 1) for v in (row.exponents[i], row.exact[i], found.exponents[i]))
    return (
        str(row.length),
        _power(row.tolerance),
        *values,
        f"{linh_checks.off(row, row.exponents):.1f}",
        f"{linh_checks.off(row, found.exponents):.1f}",
        str(row.steps),
        str(found.steps),
        f"{found.steps / row.steps:.2f}",
        f"{row.seconds:.3f}",
        f"{found.seconds:.4f}",
    )


def _bounds(row: PublishedRow, found: "linh_intervals.Intervals") -> str:
    ends = (f"λ{i + 1} [{_signed(found.lower[i])}, {_signed(found.upper[i])}]" for i in (0, 1))
    return f"{row.length:5d} {_power(row.tolerance):>5s}  {', '.join(ends)}, Steklov {found.steklov:.4f}"


def _rectangle(r: "linh.Reproduction"):
    yield "λ1, λ2 less the exact ones at T = 1000, continuous: in the paper; ours by the right rectangle rule; ours"
    truth = exact("continuous", SHORTEST_LENGTH)
    for number, example in ((2, "5.1"), (7, "5.2"), (8, "5.2 fast")):
        pairs = [pair for pair in zip(r.rows, r.found, strict=True) if pair[0] in linh_checks.rows_at(r, number)]
        for (row, found), rule in zip(pairs, r.rectangle[example], strict=True):
            parts = (_pair(np.asarray(one) - truth) for one in (row.exponents, rule, found.exponents))
            yield f"  Table {number}, {_power(row.tolerance)}: {'; '.join(parts)}"


def _pair(values) -> str:
    return ", ".join(f"{v:+.1e}".replace("-", "−") for v in values)


def _accuracy(r: "linh.Reproduction"):
    yield f"The larger error over TOL, TOL = {', '.join(_power(tol) for tol in TOLERANCES)}:"
    for (example, algorithm), errors in r.accuracy.items():
        yield f"  {EXAMPLES[example]}, {algorithm}: {_few(np.max(errors, axis=1) / TOLERANCES, 2)}"


def _ordinary(r: "linh.Reproduction"):
    yield f"Remark 5.3: Example 5.1 as an ordinary equation (dopri5, discrete QR), T = {r.lengths[-1]}, beside the"
    yield "DAEs of Tables 1 and 5 (in brackets over the ordinary equation's time). The constraints of Example 5.1 are"
    yield "linear in x3 and x4, which are eliminated here too. The equations of Example 5.2 are solved by iteration."
    for run in r.ordinary:
        values = ", ".join(_signed(v) for v in run.exponents)
        times = (
            f"{name} {s:.4f} s ({s / run.seconds:.1f})" for name, s in (("5.1", run.of_dae), ("5.2", run.of_turning))
        )
        yield f"  {_power(run.tolerance)}: {values}; {run.seconds:.4f} s; {', '.join(times)}"


def _theorem(r: "linh.Reproduction"):
    found, slope = r.linearisation, linh_checks.slope_of_linearisation(r)
    yield f"Theorem 4.1, Example 5.1: max |f_x(ψ) − f_x(φ)| ~ TOL^{slope:.2f}, and N ε with N = {found.bound[-1]:.3f}:"
    for tolerance, distance, difference, bound in zip(
        TOLERANCES, found.distance, found.difference, found.bound, strict=True
    ):
        yield f"  {_power(tolerance):>5s}: {difference:.2e} ≤ {bound * distance:.2e}"
    yield "On Example 5.2 with ω(t) = t + TOL t/20, the largest |f_x(ω, ψ) − f_x(t, φ)| over M δ + N ε, and over N ε:"
    for tolerance, share, alone in zip(TOLERANCES, r.turning.share, r.turning.without_time, strict=True):
        yield f"  {_power(tolerance):>5s}: {share:.2f}, {alone:.2f}"


def _characteristic(r: "linh.Reproduction"):
    yield "Λ(T) = (YᵀY)^(1/2T) of Example 5.1, Y(0) the columns of Ē⁻¹: ln μ_i, T (ln μ_i − λ_i), and p1"
    found, left = r.characteristic, linh_checks.growth_left(r)
    for length, exponents, rest, vectors in zip(LENGTHS, found.exponents, left, found.vectors, strict=True):
        parts = (linh_checks.listed(v, ".8f") for v in (exponents, rest, vectors[:, 0]))
        yield f"  T = {length:3d}: {'; '.join(parts)}"


def _perturbed(r: "linh.Reproduction"):
    yield "[E + ΔE] x' = [A + ΔA] x, |ΔE| = |ΔA| = δ, Example 5.1 at rest: constant; eigenvalues; cos t and sin √2t"
    found = r.perturbed
    for size, *three in zip(SIZES, found.constant, found.eigenvalues, found.periodic, strict=True):
        yield f"  {size:.0e}: {'; '.join(linh_checks.listed(v, '.9f') for v in three)}"


def _orders(r: "linh.Reproduction"):
    yield "Orders of the half-explicit method of Dormand and Prince with equal steps, by the error at t = 1:"
    names = {
        "propagated": "reformulated as in (9), Example 5.2",
        "embedded": "the same, embedded weights",
        "without (9)": "without the reformulation, Example 5.2",
        "without (9), constant E": "without the reformulation, Example 5.1 (E is constant)",
    }
    for name, text in names.items():
        yield f"  {text}: {linh_checks.order(r.orders[name]):.2f}"
    yield "Orders of the exponents with equal steps, by the error of λ_i(1):"
    for name, (example, *_) in EXPONENT_ORDERS.items():
        yield f"  {name}, Example {example}: {linh_checks.order(r.exponent_orders[name]):.2f}"


def _few(values, digits: int) -> str:
    return " ".join(f"{v:.{digits}f}" for v in values)


def numbers(r: "linh.Reproduction") -> dict[str, Any]:
    """All numbers, ready for JSON."""
    # Long: a list of all numbers of the report.
    return {
        "paper": "V. H. Linh, N. D. Truong & P. Q. Tuyen, On computation of Lyapunov exponents by QR methods with "
        "error control for semi-linear DAEs, DAE Panel 3 (2025), doi:10.52825/dae-p.v3i.2632",
        "tables": [
            {
                "table": row.table.number,
                "example": row.table.example,
                "algorithm": row.table.algorithm,
                "pair_in_the_paper": row.table.pair,
                "pair": row.table.tableau,
                "T": row.length,
                "tolerance": row.tolerance,
                "exact": plain(row.exact),
                "in_the_paper": {"exponents": list(row.exponents), "steps": row.steps, "cpu_seconds": row.seconds},
                "ours": {"exponents": plain(found.exponents), "steps": found.steps, "seconds": found.seconds},
                "bounds": {
                    "lower": plain(found.intervals.lower),
                    "upper": plain(found.intervals.upper),
                    "steklov": plain(found.intervals.steklov),
                },
            }
            for row, found in zip(r.rows, r.found, strict=True)
        ],
        "initial_log_r": plain(r.initial),
        "right_rectangle": {example: plain(values) for example, values in r.rectangle.items()},
        "tolerances": list(TOLERANCES),
        "errors": {f"{example}, {name}": plain(errors) for (example, name), errors in r.accuracy.items()},
        "running": {
            name: {"time": plain(time), "exponents": plain(exponents)} for name, (time, exponents) in r.running.items()
        },
        "ordinary": [
            {
                "tolerance": run.tolerance,
                "T": run.length,
                "exponents": plain(run.exponents),
                "seconds": run.seconds,
                "seconds_of_example_5_1": run.of_dae,
                "seconds_of_example_5_2": run.of_turning,
            }
            for run in r.ordinary
        ],
        "theorem_4_1": {
            "distance": plain(r.linearisation.distance),
            "difference": plain(r.linearisation.difference),
            "bound": plain(r.linearisation.bound),
            "slope": linh_checks.slope_of_linearisation(r),
        },
        "orders": {
            "steps": list(COUNTS),
            "errors": {name: plain(errors) for name, errors in r.orders.items()},
            "slopes": {name: linh_checks.order(errors) for name, errors in r.orders.items()},
        },
        "exponent_orders": {
            "errors": {name: plain(errors) for name, errors in r.exponent_orders.items()},
            "slopes": {name: linh_checks.order(errors) for name, errors in r.exponent_orders.items()},
        },
        "lambda_matrix": {
            "T": list(LENGTHS),
            "exponents": plain(r.characteristic.exponents),
            "vectors": plain(r.characteristic.vectors),
        },
        "theorem_4_1_with_time": {"over_bound": plain(r.turning.share), "over_n_eps": plain(r.turning.without_time)},
        "perturbed": {
            "size": list(SIZES),
            "constant": plain(r.perturbed.constant),
            "eigenvalues": plain(r.perturbed.eigenvalues),
            "periodic": plain(r.perturbed.periodic),
        },
        "state_alone": plain(r.state_alone),
        "extensions": extensions_report.numbers(r.extensions),
        "checks": {one.name: one.holds for one in r.checks},
        "claims": [dataclasses.asdict(one) for one in r.claims],
        "passed": r.passed,
    }
