"""Put the sources of the site together: pages of `docs`, notebooks, and pages that programs write."""

from collections.abc import Iterator
from pathlib import Path

from . import links
from .pages import (
    answers,
    bibliography,
    claims,
    command_line,
    evidence,
    many_points,
    problems,
    reference,
    scaling,
    words,
)

WRITTEN = ("start", "tutorials", "howto", "theory", "coming_from", "help", "reference", "evidence")  # folders of `docs`
GENERATORS = (reference, problems, command_line, words, bibliography, answers, claims, evidence, scaling, many_points)


def sources(root: Path) -> Iterator[tuple[str, bytes]]:
    """(path within the site, content) of every source, of a checkout at `root`."""
    docs = root / "docs"
    for path in [*docs.glob("*.md"), *(one for folder in WRITTEN for one in sorted((docs / folder).rglob("*.md")))]:
        yield path.relative_to(docs).as_posix(), path.read_bytes()
    for path in docs.glob("_static/*.png"):
        yield path.relative_to(docs).as_posix(), path.read_bytes()
    for path in sorted((root / "notebooks").glob("*.ipynb")):
        yield f"tutorials/{path.name}", links.linked_notebook(path.read_text()).encode()
    yield "help/changelog.md", (root / "CHANGELOG.md").read_bytes()
    for generator in GENERATORS:
        for name, text in generator.pages(root).items():
            yield name, text.encode()


def assemble(root: Path, source: Path) -> None:
    """Write the sources of a checkout at `root` into `source`; what has not changed keeps its date."""
    wanted = {
        name: links.linked(content.decode()).encode() if name.endswith(".md") else content
        for name, content in sources(root)
    }
    kept = {source / name for name in wanted}
    for old in [*source.rglob("*.md"), *source.rglob("*.rst"), *source.rglob("*.ipynb")] if source.exists() else []:
        made_by_sphinx = {"gallery", "api"} & set(old.relative_to(source).parts)
        if old not in kept and not made_by_sphinx:
            old.unlink()
    for name, content in wanted.items():
        path = source / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_bytes() != content:
            path.write_bytes(content)
