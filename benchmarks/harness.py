"""Timing: two sides in turn, A B A B …, so that both see the same noise of the machine.

One side is "ours", the other one of `AGAINST`. A side is a callable ``make() -> (run, work)``: `make` builds
everything and makes the first call, `run` is a warm call that returns only when its result is there, `work` is
how many units (steps, collisions, units of time) one run does. `run` returns a dictionary of what it found, to
be shown next to the times.
"""

import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

AGAINST = ("c", "diffrax")
Run = Callable[[], dict[str, Any]]
Make = Callable[[], tuple[Run, float]]


class Timing(NamedTuple):
    """Seconds of the warm runs of one side."""

    seconds: list[float]
    first_call: float
    work: float
    found: dict[str, Any]

    @property
    def minimum(self) -> float:
        """The fastest run, in ns per unit of work."""
        return 1e9 * min(self.seconds) / self.work

    @property
    def median(self) -> float:
        """The median run, in ns per unit of work."""
        return 1e9 * statistics.median(self.seconds) / self.work

    def summary(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "ns_min": self.minimum,
            "ns_median": self.median,
            "seconds": self.seconds,
            "first_call_s": self.first_call,
            "work": self.work,
            **self.found,
        }


def time_interleaved(makes: dict[str, Make], rounds: int) -> dict[str, Timing]:
    """Make every side, then time `rounds` warm runs of each, in turn."""
    runs, works, first_calls, found = {}, {}, {}, {}
    for name, make in makes.items():
        start = time.perf_counter()
        runs[name], works[name] = make()
        first_calls[name] = time.perf_counter() - start
    if "ours" in runs:
        from .ours import with_best_code  # imports JAX, which the process that collects the rows does not need

        with_best_code(runs["ours"])
    seconds: dict[str, list[float]] = {name: [] for name in makes}
    for _ in range(rounds):
        for name, run in runs.items():
            start = time.perf_counter()
            found[name] = run()
            seconds[name].append(time.perf_counter() - start)
    return {name: Timing(seconds[name], first_calls[name], works[name], found[name]) for name in makes}


def peak_memory() -> float:
    """Peak resident memory of this process so far, in MB."""
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return kilobytes / (1e6 if sys.platform == "darwin" else 1e3)


def compare(name: str, unit: str, makes: dict[str, Make], rounds: int) -> dict[str, Any]:
    """Time both sides, ours and the other one, or the one that is given; returns a row of the table."""
    timings = time_interleaved(makes, rounds)
    row: dict[str, Any] = {"case": name, "unit": unit, "rounds": rounds}
    row |= {side: timing.summary() for side, timing in timings.items()}
    others = [timing for side, timing in timings.items() if side != "ours"]
    if "ours" in timings and others:
        row["ratio_min"] = timings["ours"].minimum / others[0].minimum
        row["ratio_median"] = timings["ours"].median / others[0].median
    row["peak_memory_mb"] = peak_memory()
    row["python"], row["machine"] = platform.python_version(), platform.machine()
    return row


_COLUMNS = "case,unit,against,ours min,ours med,its min,its med,ratio min,ratio med,1st call s,MB".split(",")

_WIDTHS = (9, 7, *(max(9, len(column)) for column in _COLUMNS[3:]))  # of all columns but the first


def _cells(row: dict[str, Any]) -> list[str]:
    other = next((side for side in AGAINST if side in row), "-")

    def number(side: str, key: str, form: str) -> str:
        return format(row[side][key], form) if side in row else "-"

    times = [number(side, key, ".1f") for side in ("ours", other) for key in ("ns_min", "ns_median")]
    ratios = [format(row[key], ".2f") if key in row else "-" for key in ("ratio_min", "ratio_median")]
    first_call, memory = number("ours", "first_call_s", ".2f"), format(row["peak_memory_mb"], ".0f")
    return [row["case"], row["unit"], other, *times, *ratios, first_call, memory]


def head(cases: list[str]) -> str:
    """The names of the columns, above the lines of these cases."""
    return _aligned(_COLUMNS, cases)


def line(row: dict[str, Any], cases: list[str]) -> str:
    """A row as text, as wide as those of the other cases; times in ns per unit of work."""
    return _aligned(_cells(row), cases)


def _aligned(cells: list[str], cases: list[str]) -> str:
    widths = [max(map(len, [*cases, _COLUMNS[0]])), *_WIDTHS]
    left = [cell.ljust(width) for cell, width in zip(cells[:3], widths[:3], strict=True)]
    right = [cell.rjust(width) for cell, width in zip(cells[3:], widths[3:], strict=True)]
    return "  ".join(left + right)
