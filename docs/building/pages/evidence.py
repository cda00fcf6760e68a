"""Pages of evidence, from files that tests and programs keep."""

import functools
import json
import lzma
import re
from collections import Counter
from pathlib import Path

from benchmarks.capabilities import tables as capability_tables
from benchmarks.peers import tables
from lyaphybrid.zoo.published import accounts
from lyaphybrid.zoo.published.spectra import recorded
from lyaphybrid.zoo.published.table import entry_of
from lyaphybrid.zoo.reference_checks import Comparison

NOT_YET = """# Ours and theirs, the same work at the same error

`python -m benchmarks.peers --record` has not been run yet: it writes this page.
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

GRAZING = """# Growth beside an orbit that grazes

An impact oscillator whose wall stands at the amplitude of its steady motion, started so that it meets the wall once,
and slowly. The saltation matrix grows like one over the impact speed and magnifies the error of the motion, until no
digit is left. What is promised: growth right to two digits, or the note `grazing`. The truth is computed with 40
digits (`tests/support/grazing.py`).

A cell holds the largest relative error of the growth factors $e^{{\\lambda_i t}}$ among {cases} orbits, with speeds 5,
2 and 1 times the lower end of the decade and coefficients of restitution 1, 0.8 and 0.3: first of those without the
note, then of those with it, and their number. Silently wrong by more than {stated:.0e}: {wrong} of {count} results.
`python -m tests.near_grazing` computes the table again.

"""

FLOWS = """# Reference spectra of {count} published chaotic flows

Flows of the literature, those that the dysts collection keeps (W. Gilpin,
[arXiv:2110.05266](https://arxiv.org/abs/2110.05266)), with equations written anew. All fields and parameters were
compared with that collection and are the same, but for a sign of `burke_shaw` and the frequency of
`forced_van_der_pol`; few were compared with the papers. Where a text with others was found, the source of the flow says
so. `lh.zoo.flow("{first}")` is one of them as a problem; `lyaphybrid reference {first}` prints how its spectrum was
found, its source, and what was published.

Each spectrum is that of two runs: discrete QR in an explicit method of order 8, and, from where that ended,
continuous QR in a method of order 5; where motions leave the attractor in the end, the longest of runs from several
starts. Errors are standard errors from blocks, and one over the length of the run, which no run knows better. In
{agree} of {count} the two agree within three combined errors in all exponents. {chaotic} are chaotic. Of a flow that
is driven by time the exponent 0 of its phase is left out. Other starts are random points around the attractor: how
many lead to the same exponents, to others, or to infinity. `python -m benchmarks.reference_flows`
computes the table again; it took {minutes:.0f} minutes of CPU time.

| flow | kind | exponents per unit of time | published λ₁ | other starts |
|---|---|---|---|---|
"""
GRAZING_STATED = 1e-2  # two digits


def flows() -> str:
    """The recorded spectra, a line a flow."""
    found = recorded()
    rows = "".join(f"| {name} | {' | '.join(accounts.cells(name))} |\n" for name in found)
    chaotic = sum("chao" in one.kind for one in found.values())
    minutes, agree = sum(one.seconds for one in found.values()) / 60, sum(one.agrees for one in found.values())
    head = FLOWS.format(count=len(found), first=next(iter(found)), agree=agree, chaotic=chaotic, minutes=minutes)
    return head + rows + "".join(f"\n- **{name}**: {escaped(entry_of(name).source)}." for name in found) + "\n"


def escaped(source: str) -> str:
    """A source as Markdown: the brackets of an old DOI are no HTML."""
    return source.replace("<", "&lt;").replace(">", "&gt;")


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


def grazing(root: Path) -> str:
    """A line a method, a column a decade of impact speeds."""
    rows = json.loads((root / "tests/near_grazing.json").read_text())
    decades = sorted({row["decade"] for row in rows})
    table = {(row["method"], row["decade"]): row for row in rows}
    wrong = sum(row["cases"] - row["noted"] for row in rows if row["without"] > GRAZING_STATED)
    count, cases = sum(row["cases"] for row in rows), rows[0]["cases"]
    speeds = " | ".join(f"1e-{d}" for d in decades)
    head = f"| method | speeds from {speeds} |\n|---|{'---|' * len(decades)}\n"
    lines = (
        f"| {name} | {' | '.join(beside_grazing(table[name, decade]) for decade in decades)} |\n"
        for name in dict.fromkeys(row["method"] for row in rows)
    )
    text = GRAZING.format(cases=cases, stated=GRAZING_STATED, wrong=wrong, count=count)
    return text + head + "".join(lines)


def beside_grazing(row: dict) -> str:
    """A cell: the error without the note, and that with it."""
    silent = f"{row['without']:.0e}" if row["noted"] < row["cases"] else ""
    noted = f"{row['with']:.0e} ({row['noted']} noted)" if row["noted"] else ""
    return ", ".join(filter(None, (silent, noted)))


def peers(root: Path) -> str:
    """Other programs at the same error."""
    data = root / "benchmarks/results.json"
    return tables.page(json.loads(data.read_text())) if data.exists() else NOT_YET


def capabilities(root: Path) -> str:
    """The closing table of capabilities, a line a row."""
    return capability_tables.page(json.loads((root / "benchmarks/capabilities.json").read_text()))


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
        "evidence/flows.md": flows(),
        "evidence/automata.md": automata(root),
        "evidence/grazing.md": grazing(root),
        "evidence/portability.md": portability(root),
        "evidence/peers.md": peers(root),
        "evidence/capabilities.md": capabilities(root),
        "evidence/mutants.md": moved((root / "tests/mutants.md").read_text()),
        "evidence/papers.md": moved((root / "tests/papers.md").read_text()),
        "evidence/conformance.md": moved((root / "tests/conformance/README.md").read_text()),
    }
