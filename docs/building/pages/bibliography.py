"""The bibliography: the sources that docstrings of public names cite."""

import inspect
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import lyaphybrid as lh

from .reference import TASKS

HEAD = """# Bibliography

The sources that the docstrings of public names cite, and where. Those of inner functions stand in the code.

"""
SECTION = re.compile(r"^Source:\n((?: {4}.*\n?|\n(?= {4}))+)", flags=re.MULTILINE)
YEAR = re.compile(r"\b(1[89]|20)\d\d\b")
DOI = re.compile(r"doi:(10\.\d{4,}/[^\s,;]*[^\s,;.])")
ARXIV = re.compile(r"arXiv:(\d{4}\.\d{4,5})")


def cited() -> Iterator[tuple[str, str]]:
    """(reference, public name that cites it)."""
    for task in TASKS.values():
        for name in task.names:
            owner = lh if task.module == "lyaphybrid" else getattr(lh, task.module.rpartition(".")[2])
            section = SECTION.search(inspect.getdoc(getattr(owner, name)) or "")
            for text in section[1].split(";") if section else ():
                reference = " ".join(text.split()).rstrip(".")
                if YEAR.search(reference):
                    yield reference, f"{task.module}.{name}"


def entry(reference: str, names: list[str]) -> str:
    """A line of the list: the reference with its links, and the names that cite it."""
    plain = re.sub(r"([*_|\[\]<>$])", r"\\\1", reference)
    plain = DOI.sub(lambda found: f"[doi:{found[1]}](https://doi.org/{found[1]})", plain.replace("\\_", "_"))
    linked = ARXIV.sub(r"[arXiv:\1](https://arxiv.org/abs/\1)", plain)
    where = ", ".join(f"[`{name.rpartition('.')[2]}`](api/{name}.rst)" for name in sorted(names))
    return f"- {linked}. Cited by {where}.\n"


def pages(root: Path) -> dict[str, str]:
    """The one page, by the first author's family name."""
    where = defaultdict(list)
    for reference, name in cited():
        where[reference].append(name)
    family = re.compile(r"(?:[A-ZÀ-Ž][\w.]*[.-] ?)*(?:(?:de|van|von|der|le) )*(.*)")
    order = sorted(where, key=lambda reference: (family.match(reference) or [0, reference])[1].casefold())
    return {"reference/bibliography.md": HEAD + "".join(entry(one, where[one]) for one in order)}
