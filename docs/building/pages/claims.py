"""The page of what becomes of the claims of the four papers, from what `python -m docs.reproduced` keeps."""

import json
import re
from collections import Counter
from pathlib import Path

HEAD = """# What becomes of the papers' claims

Four papers are computed again by `lyaphybrid papers NAME`; this page is what the short form (`--quick`) found, kept by
`python -m docs.reproduced`. Each claim of a paper ends in one of three ways: *agreed*, *corrected*, *not reproducible*.
"""
OPEN = "**not found again**"


def plain(text: str) -> str:
    """Text of a report as Markdown in a cell of a table."""
    return re.sub(r"([\\*_\[\]<>$|#`])", r"\\\1", text)


def section(paper: dict) -> str:
    """The claims of a paper, and how many checks hold."""
    outcomes = Counter(claim["outcome"] for claim in paper["claims"])
    counted = ", ".join(f"{count} {outcome}" for outcome, count in sorted(outcomes.items()))
    failed = [name for name, holds in paper["checks"].items() if not holds]
    checks = f"{len(paper['checks']) - len(failed)} of {len(paper['checks'])} checks hold"
    lost = "".join(f"\n- {OPEN}: {plain(name)}" for name in failed)
    rows = "".join(
        f"| {plain(claim['item'])} | {plain(claim['says'])} | {plain(claim['found'])} | {claim['outcome']} "
        f"| {plain(claim['why'] or '')} |\n"
        for claim in paper["claims"]
    )
    head = "| item | the paper says | found here | outcome | evidence or reason |\n|---|---|---|---|---|\n"
    return f"\n## {plain(paper['paper'])}\n\n{checks}; claims: {counted}.{lost}\n\n{head}{rows}"


def pages(root: Path) -> dict[str, str]:
    """The one page."""
    papers = json.loads((root / "docs/evidence/reproduced.json").read_text())
    return {"evidence/claims.md": HEAD + "".join(map(section, papers.values()))}
