"""The page of statuses and notes, from what the package itself says."""

import re
from pathlib import Path

from lyaphybrid import STATUS
from lyaphybrid.results.spectrum import NOTE_TEXTS

HEAD = """# Statuses and notes

How a run ended is its `status`, a member of `lh.STATUS`: data, not an exception. `print(result)` says it in words,
`result.status.failed` says whether it is a failure. With `throw=True` (the default of most verbs) a failure raises
`lh.RunFailedError`, which holds the result so far in `.result`. Under `jax.jit`, `jax.vmap` and in sweeps nothing is
raised: look at the status of each lane or point.
"""
NOTES = """
## Notes

`spectrum.notes` holds names of observations that come with every status; `print(spectrum)` explains them.

"""


def listed(meaning: str) -> str:
    """A meaning with its causes (a), (b), … as lines of a list."""
    first, *causes = re.split(r"[:;,.]? \(([a-e])\) ", meaning)
    items = [f"   - {text.rstrip(';, ')}" for text in causes[1::2]]
    return "\n".join([first + (":" if items else ""), *([""] if items else []), *items])


def status(member: STATUS) -> str:
    """The section of a status."""
    failed = "a failure" if member.failed else "no failure"
    said = f"Code {member.value}, {failed}: {listed(member.meaning)}."
    return f"\n(status-{member.name})=\n## {member.name}\n\n{said}\n"


def pages(root: Path) -> dict[str, str]:
    """The one page."""
    notes = "".join(f"`{name}`\n: {text}\n\n" for name, text in NOTE_TEXTS.items())
    return {"reference/statuses.md": HEAD + "".join(map(status, STATUS)) + NOTES + notes}
