"""Checks and claims of a paper with their outcomes, which end every reproduction."""

import collections
import dataclasses
import textwrap
from collections.abc import Iterable

__all__ = ["AGREED", "CORRECTED", "NOT_REPRODUCIBLE", "Check", "Claim", "check_lines", "claim_lines"]

AGREED, CORRECTED, NOT_REPRODUCIBLE = "agreed", "corrected", "not reproducible"
LINE_WIDTH = 118


@dataclasses.dataclass(frozen=True)
class Check:
    """A number that a reproduction must find.

    Attributes:
        name: what is compared; wanted: its value, or bounds; found: the result; holds: whether they agree.
    """

    name: str
    wanted: str
    found: str
    holds: bool


@dataclasses.dataclass(frozen=True)
class Claim:
    """A statement of a paper.

    Attributes:
        item: the figure, equation or remark; says: what the paper claims there; found: what is found here.
        outcome: `AGREED`, `CORRECTED` or `NOT_REPRODUCIBLE`.
        why: the evidence of a correction, or the reason why it cannot be reproduced; else empty.
    """

    item: str
    says: str
    found: str
    outcome: str
    why: str = ""

    def __post_init__(self):
        if self.outcome not in (AGREED, CORRECTED, NOT_REPRODUCIBLE):
            raise ValueError(f"An outcome is one of {(AGREED, CORRECTED, NOT_REPRODUCIBLE)}; got {self.outcome!r}.")
        if self.outcome != AGREED and not self.why:
            raise ValueError(f"{self.item}: {self.outcome!r} needs its evidence or reason.")


def check_lines(checks: Iterable[Check]) -> list[str]:
    """One line for each check: name, wanted, found, whether they agree."""
    rows = [(one.name, one.wanted, one.found, "yes" if one.holds else "NO") for one in checks]
    rows = [("check", "wanted", "found", "agree"), *rows]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    return ["  ".join([*(row[i].ljust(widths[i]) for i in range(3)), row[3]]) for row in rows]


def claim_lines(claims: Iterable[Claim]) -> list[str]:
    """The claims by outcome: agreed, corrected with evidence, not reproducible with the reason."""
    claims = list(claims)
    counts = collections.Counter(one.outcome for one in claims)
    lines = []
    for outcome, why in ((AGREED, ""), (CORRECTED, "evidence: "), (NOT_REPRODUCIBLE, "reason: ")):
        lines.append(f"{outcome}: {counts[outcome]} of {len(claims)} claims of the paper")
        for one in claims:
            if one.outcome == outcome:
                lines += _wrapped(f"{one.item}. Paper: {one.says}. Here: {one.found}.")
                lines += _wrapped(f"{why}{one.why}.", "    ") if one.why else []
    return lines


def _wrapped(text: str, indent: str = "  ") -> list[str]:
    return textwrap.wrap(text, LINE_WIDTH, initial_indent=indent, subsequent_indent="    ")
