"""Docstrings are plain text: what reStructuredText would take for markup is made plain before Sphinx reads it."""

import inspect
import re

from lyaphybrid.results.result import Result

CODE = re.compile(r"(``.*?``|`[^`]*`)")
NAME = re.compile(r"`lh\.((?:zoo\.|plots\.)?\w+)`")
DOCTEST = re.compile(r"^\s*(>>>|\.\.\. )")


def plain(line: str) -> str:
    """A line of prose in which only code in backticks is markup; names of the package lead to their pages."""
    parts = CODE.split(line)
    outside = [re.sub(r"([|*\\])", r"\\\1", part) for part in parts[::2]]
    outside = [re.sub(r"_(?=\W|$)", r"\\_", part) for part in outside]
    inside = [NAME.sub(r":obj:`lh.\1 <lyaphybrid.\1>`", part) for part in parts[1::2]]
    inside = [part if part.startswith((":", "``")) else f"`{part}`" for part in inside]
    return "".join(a + b for a, b in zip(outside, [*inside, ""], strict=True))


def process(app, what, name, obj, options, lines: list[str]) -> None:
    """Make the lines of a docstring plain, but for the examples in it (event autodoc-process-docstring)."""
    example = False
    for number, line in enumerate(lines):
        example = bool(line.strip()) and (example or bool(DOCTEST.match(line)))
        if not example:
            lines[number] = plain(line)


def signature(app, what, name, obj, options, arguments, returns):
    """Results are made by verbs, not by users: their constructors are not shown (event autodoc-process-signature)."""
    return ("", "") if inspect.isclass(obj) and issubclass(obj, Result) else None
