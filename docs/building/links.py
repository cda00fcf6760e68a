"""Public names on pages lead to their pages of the reference."""

import json
import re

from .pages.reference import TASKS

FENCE = re.compile(r"(^[ ]*(`{3,})(?!\{flowchart\})[^\n]*\n.*?^[ ]*\2`*[ ]*$)", flags=re.DOTALL | re.MULTILINE)
NAME = re.compile(r"(?<!\[)`lh\.((?:zoo\.)?\w+)(\([^`]*\))?`(?!\])")
PAGES = {
    f"{task.module}.{name}".removeprefix("lyaphybrid."): f"/reference/api/{task.module}.{name}.rst"
    for task in TASKS.values()
    for name in task.names
}


def linked(text: str) -> str:
    """A page of Markdown in which `lh.name` and `lh.name(…)`, outside of code, are links."""
    parts = FENCE.split(text)  # prose, a fence, its backticks, prose, …
    parts[::3] = [NAME.sub(link, prose) for prose in parts[::3]]
    return "".join(part for number, part in enumerate(parts) if number % 3 != 2)


def link(found: re.Match) -> str:
    """The link for a name, or the name where it has no page."""
    page = PAGES.get(found[1])
    return f"[{found[0]}]({page})" if page else found[0]


def linked_notebook(text: str) -> str:
    """The same for the cells of text in a notebook."""
    notebook = json.loads(text)
    for cell in notebook["cells"]:
        if cell["cell_type"] == "markdown":
            cell["source"] = linked("".join(cell["source"]))
    return json.dumps(notebook)
