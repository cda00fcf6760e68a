"""The page of the command line: what `lyaphybrid COMMAND --help` prints."""

import argparse
import os
from pathlib import Path

from lyaphybrid import __main__ as command

HEAD = """# Command line

`lyaphybrid` and `python -m lyaphybrid` are the same. The exit status is 0 for success, 1 where a run or a check failed,
2 for wrong arguments, 130 after Ctrl-C. All commands compute in float64.

Four papers are computed again, with tables, figures and what becomes of their claims:

| command | paper |
|---|---|
| `lyaphybrid papers dinius` | Dinius' hard disks, Table I and Fig. 2; the command without a name does the same |
| `lyaphybrid papers fu` | Fu, Wang & Wang's dry friction, Figs. 1 to 4; exponents by its scheme, by synchronisation |
| `lyaphybrid papers linh` | Linh, Truong & Tuyen's DAEs, Tables 1 to 10 |
| `lyaphybrid papers skokos` | Skokos & Gerlach's tangent maps, Figs. 1 to 11, Table 1 |

What follows is what `--help` prints.
"""


def helps() -> dict[str, str]:
    """The help of the program and of each command, by what is typed."""
    parser = command._parser()
    found = {parser.prog: parser.format_help()}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= {one.prog: one.format_help() for one in action.choices.values()}
    return found


def pages(root: Path) -> dict[str, str]:
    """The one page."""
    before, os.environ["COLUMNS"] = os.environ.get("COLUMNS"), "88"
    try:
        parts = [f"\n## {typed}\n\n```text\n{text.rstrip()}\n```\n" for typed, text in helps().items()]
    finally:
        os.environ.pop("COLUMNS") if before is None else os.environ.update(COLUMNS=before)
    return {"reference/command_line.md": HEAD + "".join(parts)}
