"""Pages of evidence, from files that tests and programs keep."""

import json
import lzma
import re
from collections import Counter
from pathlib import Path

AUTOMATA = """# Random hybrid automata

`tests/data/automata.json.xz` holds {count} random hybrid automata with {events} events. Event times, states and
fundamental matrices come from a program that shares no code with this package and computes with 84 digits.
`python tests/automata.py` runs all of them and prints how many events were missed; the tests ask for none, for the
right order, and for times, states, tangent maps and exponents to the bounds that stand there.

| family | variant | automata | events |
|---|---|---|---|
"""


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
        "evidence/automata.md": automata(root),
        "evidence/papers.md": moved((root / "tests/papers.md").read_text()),
        "evidence/conformance.md": moved((root / "tests/conformance/README.md").read_text()),
    }
