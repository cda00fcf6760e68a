"""The table and the numbers of the reproduction of Dinius' hard disks."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from ..._text import with_error
from ..claims import check_lines, claim_lines
from ..output import plain
from .checks import latest_off, scatter_at, signed
from .collisions import MISTAKES, Mistake
from .table import CLOSED, COLLISION_RATE, NORMALISATION, ZERO, N

if TYPE_CHECKING:
    from . import reproduction as dinius

__all__ = ["numbers", "table"]


def table(r: "dinius.Reproduction") -> str:
    """The result as a table."""
    lines = [*_exponents(r), "", *_wrong_rules(r), "", *check_lines(r.checks), "", *claim_lines(r.claims)]
    failed = [one.name for one in r.checks if not one.holds]
    largest = np.nanmax(np.abs(r.deviations))
    verdict = f"FAILED: {'; '.join(failed)}" if failed else f"passed: all {len(r.checks)} checks hold"
    lines += ["", f"{verdict}; the largest deviation is {largest:.1f} standard errors"]
    return "\n".join(lines)


def _number(value: float, error: float) -> str:
    """Formatted as 4.8853(92); plain 0 for zero up to rounding."""
    return "0" if abs(value) < CLOSED else signed(with_error(value, error))


def _exponents(r: "dinius.Reproduction") -> list[str]:
    values, errors = r.reference
    per_jump, (by_time, its_errors) = r.exponents / r.collision_rate, r.by_time
    lines = [
        f"Table I of Dinius: {N} hard disks, number density 0.7, L_x/L_y = √3/2, K = 4",
        f"t = {r.t1:g}, {len(r.singles)} runs; in brackets one standard error of the last digits; orthonormalised",
        "at collisions, after a transient, from paired vectors; and as Table I has it, every "
        f"{NORMALISATION:g}, from unit vectors",
        "",
        "       at collisions       reference   deviation    every 0.01   λ/(j/t): the paper's s = max(t, j)",
    ]
    for i, deviation in enumerate(r.deviations):
        apart = "" if np.isnan(deviation) else signed(f"{deviation:+.1f} se")
        jump = "0" if abs(per_jump[i]) < CLOSED else signed(f"{per_jump[i]:.4f}")
        lines.append(
            f"λ{i + 1:<3d} {_number(r.exponents[i], r.stderr[i]):>15s} {_number(values[i], errors[i]):>15s}"
            f" {apart:>11s} {_number(by_time[i], its_errors[i]):>13s} {jump:>11s}"
        )
    return lines


def _wrong_rules(r: "dinius.Reproduction") -> list[str]:
    lines = [
        f"What wrong rules at the collisions give (t = {r.t1_mistakes:g}, {len(r.singles)} runs) [reference]",
        "",
        "     " + " ".join(f"{mistake.name:>22s}" for mistake in MISTAKES),
    ]
    for i in range(4 * N):
        cells = (_cell(s, m, i) for s, m in zip(r.mistakes, MISTAKES, strict=True))
        lines.append(f"λ{i + 1:<3d} " + " ".join(f"{cell:>22s}" for cell in cells))
    lines.append("off  " + " ".join(f"{f'{d:.0f} se':>22s}" for d in r.mistaken_deviations))
    lines.append("sum  " + " ".join(f"{abs(float(np.sum(s.exponents))):>22.0e}" for s in r.mistakes))
    return lines


def _cell(found, mistake: Mistake, i: int) -> str:
    value, error = float(found.exponents[i]), float(found.stderr[i])
    decays = abs(value) < 2 / float(np.mean(found.time))  # a zero exponent, from a generic frame
    ours = "0" if decays else with_error(value, error)
    theirs = "0" if abs(mistake.exponents[i]) < ZERO else f"{mistake.exponents[i]:.3f}"
    return signed(f"{ours} [{theirs}]")


def numbers(r: "dinius.Reproduction") -> dict:
    """All numbers, ready for JSON."""
    values, errors = r.reference
    by_time, its_errors = r.by_time
    time, running = r.running
    return {
        "paper": "J. Dinius, Computing Lyapunov Exponents of Hybrid Dynamical Systems, Table I",
        "parameters": r.parameters,
        "t1": r.t1,
        "replicates": len(np.asarray(r.spectrum.replicates)),
        "status": str(r.spectrum.status),
        "exponents": plain(r.exponents),
        "stderr": plain(r.stderr),
        "error_kind": r.spectrum.error_kind,
        "reference": {"exponents": plain(values), "stderr": plain(errors)},
        "deviations": plain(r.deviations),
        "zeros": r.zeros,
        "pairing_defect": r.pairing_defect,
        "sum": r.sum,
        "collision_rate": r.collision_rate,
        "collision_rate_reference": COLLISION_RATE,
        "exponents_per_jump": plain(r.exponents / r.collision_rate),
        "as_in_the_paper": {
            "normalisation": NORMALISATION,
            "exponents": plain(by_time),
            "stderr": plain(its_errors),
            "deviations": plain(r.deviations_by_time),
            "runs": plain(running[:, -1]),
            "time": plain(time),
            "running": plain(running[0]),
            "scatter_over_law": {f"{t:g}": value for t, value in scatter_at(r).items()},
            "within_3_percent_from": plain(latest_off(r, 0.03)),
        },
        "one_perturbation": {"exponent": float(r.alone.exponents[0]), "stderr": float(r.alone.stderr[0])},
        "without_collisions": plain(r.straight.exponents),
        "orders_of_two_clocks": plain(r.orders.exponents),
        "mistakes": [
            {
                "name": mistake.name,
                "t1": r.t1_mistakes,
                "exponents": plain(found.exponents),
                "stderr": plain(found.stderr),
                "reference": list(mistake.exponents),
                "largest_deviation": float(off),
            }
            for mistake, found, off in zip(MISTAKES, r.mistakes, r.mistaken_deviations, strict=True)
        ],
        "checks": [dataclasses.asdict(one) for one in r.checks],
        "claims": [dataclasses.asdict(one) for one in r.claims],
        "passed": r.passed,
    }
