"""The table and the numbers of the reproduction of Skokos & Gerlach."""

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from ..claims import check_lines, claim_lines
from ..output import plain
from . import checks as skokos_checks
from .cases import ORBITS, STEP, TABLE, MethodRow

if TYPE_CHECKING:
    from . import reproduction as skokos

__all__ = ["numbers", "table"]

PAPER_TM = 280  # minutes
HEADS = ("method", "δ", "τ", "energy error", "λ1(t)", "level", "s for t=1e6", "of TM's", "in the paper")
WIDTHS = (8, 7, 6, 13, 10, 10, 12, 9, 13)


def table(r: "skokos.Reproduction") -> str:
    """Table 1, and a summary of the figures."""
    lines = [
        "Skokos & Gerlach: variational equations of Hamiltonian systems by five methods",
        "",
        f"Table 1: the four exponents of R1 (Hénon–Heiles, H = 1/8, y = 0.55) up to t = {r.lengths.table:.0e}, in the",
        "paper 1e8. level: d(t λ1)/dt over the last decade, where λ1 levels off. Seconds: alone on this machine,",
        "orthonormalised after each step; beside them the ratio to TM at τ = 0.05, here and in the paper.",
        "",
        _line(HEADS),
        *(_line(row) for row in _rows(r)),
        "",
        *_exponents(r),
        "",
        *_indices(r),
        "",
        *check_lines(r.checks),
        "",
        *claim_lines(r.claims),
    ]
    failed = [one.name for one in r.checks if not one.holds]
    verdict = f"FAILED: {'; '.join(failed)}" if failed else f"passed: all {len(r.checks)} checks hold"
    return "\n".join([*(line.rstrip() for line in lines), "", verdict])


def _line(cells) -> str:
    return " ".join(f"{cell:>{width}s}" for cell, width in zip(cells, WIDTHS, strict=True))


def _rows(r: "skokos.Reproduction"):
    tm = r.seconds[TABLE.index(MethodRow("TM", STEP, None, PAPER_TM))]
    for row, run, seconds in zip(TABLE, r.table, r.seconds, strict=True):
        yield (
            row.method,
            "" if row.threshold is None else f"{row.threshold:.0e}",
            f"{row.step:g}",
            f"{run.energy:.1e}",
            f"{run.exponents[-1, 0]:.2e}",
            f"{skokos_checks.level(run):.1e}",
            f"{seconds:.2f}",
            f"{seconds / tm:.2f}",
            f"{row.minutes / PAPER_TM:.2f}",
        )


def _exponents(r: "skokos.Reproduction"):
    yield f"λ1 at t = {r.lengths.exponents:.0e}, τ = 0.05:"
    for orbit in ("C1", "C2", "R2"):
        values = ", ".join(f"{method} {run.exponents[-1, 0]:.3g}" for method, run in r.of(orbit).items())
        yield f"  {orbit} {values}"
    yield "  C1 in the mean of many runs: 0.04434(22). C2 is y = −0.01333; −0.01344 leaves for the big sea."


def _indices(r: "skokos.Reproduction"):
    yield "d ln GALI_k / d ln t on tori:"
    for name, decades in skokos_checks.DECADES.items():
        orbit, last = ORBITS[name], "the last decade" if decades == 1 else f"the last {decades} decades"
        until, law = float(r.indices[name]["TM"].time[-1]), _list(skokos_checks.law(orbit), 0)
        yield f"  {name}, k = 2 … {orbit.orders[-1]}, {last} up to t = {until:.0e}; law {law}"
        for method, found in r.indices[name].items():
            yield f"    {method:<7s}{_list(skokos_checks.slopes(found, decades), 2 if len(orbit.orders) < 9 else 1)}"


def _list(values, digits: int) -> str:
    return " ".join(f"{round(float(v), digits) + 0.0:.{digits}f}".replace("-", "−") for v in values)


def numbers(r: "skokos.Reproduction") -> dict[str, Any]:
    """All numbers, ready for JSON: −∞ is "-inf", nan is null."""
    return {
        "paper": "Ch. Skokos & E. Gerlach, Numerical integration of variational equations, Phys. Rev. E 82 (2010) "
        "036704, doi:10.1103/PhysRevE.82.036704",
        "table_1": [
            {
                "method": row.method,
                "step": row.step,
                "threshold": row.threshold,
                "seconds_for_1e6": seconds,
                "minutes_in_the_paper": row.minutes,
                **_run(run),
            }
            for row, run, seconds in zip(TABLE, r.table, r.seconds, strict=True)
        ],
        "exponents": {o: {m: _run(run) for m, run in runs.items()} for o, runs in r.exponents.items()},
        "log_gali": {
            orbit: {
                method: {"time": plain(g.time), "orders": list(g.orders), "values": plain(g.log_values)}
                for method, g in found.items()
            }
            for orbit, found in r.indices.items()
        },
        "sections": {orbit: plain(np.round(np.asarray(s.x)[:, [1, 3]], 6)) for orbit, s in r.sections.items()},
        "checks": {one.name: bool(one.holds) for one in r.checks},
        "claims": [dataclasses.asdict(one) for one in r.claims],
        "passed": bool(r.passed),
    }


def _run(run: "skokos.MethodRun") -> dict[str, Any]:
    return {
        "energy_error": run.energy,
        "level": skokos_checks.level(run),
        "stderr_of_first": run.error,
        "time": plain(run.time),
        "exponents": plain(run.exponents),
        "energy_errors": plain(run.drift),
    }
