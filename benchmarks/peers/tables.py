"""From what was measured (`results.json`) to tables, and what has got worse since."""

import statistics
from collections.abc import Iterator
from typing import Any

from benchmarks.peers.adapters import OURS, PEERS
from benchmarks.peers.precision import ENOUGH, TARGETS, Point, cost_at, method_of

WORSE = 1.25
HEAD = """# Ours and theirs, the same work at the same error

Written by `python -m benchmarks.peers --record` on {date}, commit {commit}: {machine}. Load at the beginning: {load}.
{versions}.

Each program computes the same exponents over a short length from the same start; their error is that against a
converged value (SciPy's DOP853 at 1e-13, Radau for stiff flows, closed form for impacts) for the columns that it
begins with. Each has a ladder of tolerances or steps, and each is timed over the same long run, or over one that is
ten or a hundred times as long if it needs less than {enough} s for that. What a unit costs at an error is
interpolated between two settings in logarithms, of its cheapest method; a dash: no setting reaches that error, or it
was not timed. What compiles for each length has run once before; `lyaphybrid`, which optimises what is repeated, for
{repeated:g} s. Minimum of the warm runs, in brackets the median where it is more by a tenth. The ratio is their minimum
over ours: above 1 ours is faster. The first call goes from nothing to the result of the long run, at one setting of
middle accuracy, the import apart; memory is the peak of a process after it. Which instructions are used each program
decides by itself: none is kept from AVX-512 where the machine has it.

nolds estimates exponents from a measured series and has none of a given equation: it is not compared.
"""
USES = "\n## How each program is used\n\n| program | use |\n|---|---|\n"


def points(row: dict[str, Any], length: float, summary=min) -> list[Point]:
    """Of one program, with the cost of a unit in seconds."""
    return [
        Point(method_of(label), one["error"], summary(one["seconds"]) / one.get("length", length))
        for label, one in row.get("points", {}).items()
        if one["seconds"] and one["error"] is not None
    ]


def costs(workload: dict[str, Any], summary=min) -> dict[str, dict[float, float | None]]:
    """By program and error."""
    return {
        peer: {target: cost_at(points(row, workload["length"], summary), target) for target in TARGETS}
        for peer, row in workload["peers"].items()
    }


def ratios(workload: dict[str, Any]) -> dict[tuple[str, float], float]:
    """Their cost over ours, by program and error, where both reach it."""
    found = costs(workload)
    ours = found.pop(OURS, {})
    return {
        (peer, target): cost / own
        for peer, by_target in found.items()
        for target, cost in by_target.items()
        if cost is not None and (own := ours.get(target)) is not None
    }


def worse(now: dict[str, Any], recorded: dict[str, Any]) -> Iterator[str]:
    """What has lost more than a quarter of a recorded ratio, a line each."""
    for name in [name for name in now["workloads"] if name in recorded["workloads"]]:
        before, after = ratios(recorded["workloads"][name]), ratios(now["workloads"][name])
        for key in [key for key in before if key in after]:
            if after[key] * WORSE < before[key]:
                peer, target = key
                yield f"{name}, {peer}, error {target:.0e}: {after[key]:.3g} times, recorded {before[key]:.3g}"


def duration(seconds: float) -> str:
    """With three digits and a unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def cell(least: float | None, middle: float | None) -> str:
    if least is None:
        return "–"
    return duration(least) + (f" ({duration(middle)})" if middle is not None and middle > 1.1 * least else "")


def table(workload: dict[str, Any]) -> str:
    """One workload, a line a program."""
    least, middle, times = costs(workload), costs(workload, statistics.median), ratios(workload)
    marks = " | ".join(f"at {target:.0e}" for target in TARGETS)
    lines = [f"| program | {marks} | ratios | first call | import | memory |", "|---|" + "---|" * (len(TARGETS) + 4)]
    for peer, row in workload["peers"].items():
        cells = [cell(least[peer][target], middle[peer][target]) for target in TARGETS]
        beside = [f"{times[peer, target]:.3g}" if (peer, target) in times else "–" for target in TARGETS]
        ends = ["–"] * 3
        if "first" in row:
            ends = [f"{row['first']:.2f} s", f"{row['import']:.2f} s", f"{row['memory']:.0f} MB"]
        said = [peer, *cells, "" if peer == OURS else ", ".join(beside), *ends]
        lines.append(f"| {' | '.join(said)} |")
    failed = [f"{peer}: {row['failed']}." for peer, row in workload["peers"].items() if "failed" in row]
    return "\n".join([f"## {workload['title']}", "", f"Times for one {workload['unit']}:", "", *lines, "", *failed, ""])


def page(results: dict[str, Any]) -> str:
    """All of it."""
    said = dict(results, versions=", ".join(f"{name} {version}" for name, version in results["versions"].items()))
    uses = "".join(f"| {name} | {PEERS[name].use} |\n" for name in results["versions"])
    head = HEAD.format(**said, enough=ENOUGH, repeated=PEERS[OURS].repeated)
    return "\n".join([head, *map(table, results["workloads"].values())]) + USES + uses
