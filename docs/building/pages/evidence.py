"""Pages of evidence, from files that tests and programs keep."""

import functools
import json
import lzma
import re
from collections import Counter
from pathlib import Path

from benchmarks.peers import tables
from lyaphybrid.zoo.reference_checks import Comparison

NOT_YET = """# Ours and theirs, the same work at the same error

`python -m benchmarks.peers` has not been run as a whole yet: it writes this page.
"""

AUTOMATA = """# Random hybrid automata

`tests/data/automata.json.xz` holds {count} random hybrid automata with {events} events. Event times, states and
fundamental matrices come from a program that shares no code with this package and computes with 84 digits.
`python tests/automata.py` runs all of them and prints how many events were missed; the tests ask for none, for the
right order, and for times, states, tangent maps and exponents to the bounds that stand there.

| family | variant | automata | events |
|---|---|---|---|
"""

VALIDATION = """# The zoo against its references

What `lyaphybrid validate --quick` found, in `docs/evidence/validation.json`: every problem of the zoo, in two ways,
against a reference that is known independently of this package. A deviation is the largest of all exponents, in
standard errors of both sides together; more than five is a miss. {runs} runs of {problems} problems, {missed} missed.

| problem | way | deviation | status | against |
|---|---|---|---|---|
"""
PORTABILITY = """# Pythons, JAXs and ways to run

What `python -m tests.portability` found, in `tests/portability.json`: in each row a fresh environment with the
installed package, in each column a way to run it. A number is that of the tests that passed.

"""


def validation(root: Path) -> str:
    """What the command found, a line a run."""
    runs = json.loads((root / "docs/evidence/validation.json").read_text())
    compared = [Comparison(**run | {"deviation": float(run["deviation"])}) for run in runs]
    rows = "".join(
        f"| [`{one.problem}`](../reference/api/lyaphybrid.zoo.{one.problem}.rst) | {one.way} | {one.deviation:.1f} "
        f"| {one.status} | {'its reference' if one.has_reference else 'the first way'} |\n"
        for one in compared
    )
    missed = sum(not one.agrees for one in compared)
    return VALIDATION.format(runs=len(runs), problems=len({one.problem for one in compared}), missed=missed) + rows


def portability(root: Path) -> str:
    """The matrix as a table."""
    rows = json.loads((root / "tests/portability.json").read_text())
    ways = list(dict.fromkeys(way for row in rows for way in row.get("ways", {})))
    head = f"| Python | jax | {' | '.join(ways)} |\n|---|---|{'---|' * len(ways)}\n"
    return PORTABILITY + head + "".join(map(functools.partial(cells, ways), rows))


def cells(ways: list[str], row: dict) -> str:
    """A line of the matrix."""
    versions = row.get("versions", {})
    said = [verdict(row.get("ways", {}).get(way)) for way in ways]
    python, jax = versions.get("python", row["python"]), versions.get("jax", row["jax"])
    return f"| {python} | {jax} | {' | '.join(said)} |\n"


def verdict(cell: dict | None) -> str:
    """A cell of the matrix: how many tests passed, or that it is red."""
    if cell is None:
        return "–"
    return f"{cell.get('passed', 0)}" if cell["green"] else f"**red**, {cell.get('failed', 0)} failed"


def peers(root: Path) -> str:
    """Other programs at the same error."""
    data = root / "benchmarks/results.json"
    return tables.page(json.loads(data.read_text())) if data.exists() else NOT_YET


def automata(root: Path) -> str:
    """How many automata and events of each family there are."""
    with lzma.open(root / "tests/data/automata.json.xz", "rt") as file:
        systems = json.load(file)["systems"]
    count, events = Counter(), Counter()
    for one in systems:
        kind = (one["family"], one["variant"])
        count[kind] += 1
        events[kind] += one["n_events"]
    rows = "".join(f"| {family} | {variant} | {count[family, variant]} | {events[family, variant]} |\n"
                   for family, variant in sorted(count))  # fmt: skip
    return AUTOMATA.format(count=sum(count.values()), events=sum(events.values())) + rows


def moved(text: str) -> str:
    """A document of the repository as a page: links to files, which the site does not have, become code."""
    return re.sub(r"\[([^\]]+)\]\((?!https?:)[^)#]+\)", r"`\1`", text)


def pages(root: Path) -> dict[str, str]:
    """The pages by name."""
    return {
        "evidence/validation.md": validation(root),
        "evidence/automata.md": automata(root),
        "evidence/portability.md": portability(root),
        "evidence/peers.md": peers(root),
        "evidence/mutants.md": moved((root / "tests/mutants.md").read_text()),
        "evidence/papers.md": moved((root / "tests/papers.md").read_text()),
        "evidence/conformance.md": moved((root / "tests/conformance/README.md").read_text()),
    }
