"""What `lh.check` found."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ... import plots
from ..._text import Table
from ...results.result import Data, Result

__all__ = ["Finding", "Report", "in_short", "noted", "right", "wrong"]


class Finding(NamedTuple):
    """One thing that was looked at.

    Attributes:
        verdict: "right"; "note", worth knowing; or "wrong", a mistake.
        topic: what was looked at: "functions", "derivatives", "constraints", "smoothness", "clocks", "jumps", "run",
            "saltation", "flow direction", "tolerance", "stiffness", "precision", "prediction", "instants", "promises".
        text: what was found, and what to do.
    """

    verdict: str
    topic: str
    text: str


def right(topic: str, text: str) -> Finding:
    """Something that is as it should be."""
    return Finding("right", topic, text)


def noted(topic: str, text: str) -> Finding:
    """Something that is worth knowing."""
    return Finding("note", topic, text)


def wrong(topic: str, text: str) -> Finding:
    """A mistake."""
    return Finding("wrong", topic, text)


def in_short(values) -> str:
    """Some numbers, as they stand in a text."""
    return np.array2string(np.atleast_1d(np.asarray(values)), precision=4, threshold=6)


class Report(Result):
    """What `lh.check` found, in the order in which it looked.

    Attributes:
        findings: a tuple of `Finding`, each with `verdict`, `topic` and `text`.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.check(logistic, [0.3], {"r": 3.9})
        >>> found.ok, sorted({one.verdict for one in found.findings})
        (True, ['right'])
    """

    def __init__(self, findings: Sequence[Finding]):
        self.findings = tuple(findings)

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong; there may be notes."""
        return all(one.verdict != "wrong" for one in self.findings)

    @property
    def notes(self) -> tuple[Finding, ...]:
        """The findings that are not right: notes, and what is wrong."""
        return tuple(one for one in self.findings if one.verdict != "right")

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The findings below each other, each with a mark for its verdict. `style` goes to what it draws."""
        return plots.report(self.findings, ax, **style)

    def _table(self) -> Table:
        errors, notes = (sum(one.verdict == verdict for one in self.findings) for verdict in ("wrong", "note"))
        said = f"{errors} wrong, {notes} note{'s' * (notes != 1)}"
        rows = [(one.verdict, one.topic, one.text) for one in self.findings]
        return Table(f"Check of a system: {'ok' if self.ok else 'not ok'} ({said})", rows)

    def _data(self) -> Data:
        columns = zip(*self.findings, strict=True)
        variables = {name: ("finding", np.array(one)) for name, one in zip(Finding._fields, columns, strict=True)}
        return Data(variables, {}, {"ok": self.ok})
