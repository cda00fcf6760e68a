"""From what was measured (`capabilities.json`) to lines and tables."""

from typing import Any

from benchmarks.peers.tables import duration

HEAD = """# What it can do, how right, at what cost

Written by `python -m benchmarks.capabilities --record` on {date}, commit {commit}: {machine}. Load at the beginning:
{load}. {count} rows in {seconds:.0f} s of CPU, {missed} with an error above what is wanted; the command ends with 1
where there is one.

Beyond the exponents of [the comparison with other programs](peers.md). Each row is computed anew and compared with a
closed form, or with what is found in another way: an exact map from event to event, the spectrum of a whole network,
finite kicks of whole motions, an integration by SciPy. Errors are the largest of all that is compared, in the unit of
the values unless said otherwise; "se" are standard errors. The cost is that of our calls alone, in seconds of CPU: of
the first one, in a process that keeps no machine code of earlier ones, and of the second one. Rows of one kind share
what is compiled.
"""
TABLE = "| what | truth | error | wanted | first call | second call |\n|---|---|---|---|---|---|\n"


def number(value: float, unit: str) -> str:
    """An error with two digits."""
    return f"{value:.2g} {unit}".rstrip()


def line(row: dict[str, Any]) -> str:
    """A row in a line."""
    found = f"{number(row['error'], row['unit'])} (wanted {number(row['wanted'], row['unit'])})"
    costs = f"{duration(row['first'])}, {duration(row['second'])}"
    words = [row["name"], row["truth"], found, costs, row["remark"], "" if row["passed"] else "MISSED"]
    return "; ".join(filter(None, words))


def cells(row: dict[str, Any]) -> str:
    """A row of a table in Markdown."""
    what = f"{row['name']}: {row['remark']}" if row["remark"] else row["name"]
    error = number(row["error"], row["unit"])
    said = [what, row["truth"], error if row["passed"] else f"**{error}**", number(row["wanted"], row["unit"])]
    said += [duration(row["first"]), duration(row["second"])]
    escaped = [one.replace("|", "\\|") for one in said]  # a bar would end the cell
    return f"| {' | '.join(escaped)} |\n"


def page(results: dict[str, Any]) -> str:
    """All of it, a table a capability."""
    rows = [row for one in results["capabilities"].values() for row in one["rows"]]
    missed = sum(not row["passed"] for row in rows)
    text = HEAD.format(**results | {"count": len(rows), "missed": missed})
    for one in results["capabilities"].values():
        text += f"\n## {one['title']}\n\n{TABLE}" + "".join(map(cells, one["rows"]))
    return text
