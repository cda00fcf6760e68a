"""Compute the four papers again and keep their checks and claims: `python -m docs.reproduced`, about ten minutes.

It writes docs/evidence/reproduced.json, from which a page of the site is made.
"""

import json
import sys
import tempfile
from pathlib import Path

from lyaphybrid.__main__ import main as command

KEPT = Path(__file__).parent / "evidence" / "reproduced.json"
PAPERS = ("dinius", "fu", "linh", "skokos")


def kept(report: dict) -> dict:
    """What the page needs of what `lyaphybrid papers` writes: the paper, {check: whether it holds}, the claims."""
    checks = report["checks"]
    holds = checks if isinstance(checks, dict) else {check["name"]: check["holds"] for check in checks}
    return {"paper": report["paper"], "checks": holds, "claims": report["claims"]}


def main() -> int:
    """Run all papers in their short form."""
    found, ended = {}, 0
    with tempfile.TemporaryDirectory() as folder:
        for name in PAPERS:
            ended |= command(["papers", name, "--quick", "--out", folder])
            found[name] = kept(json.loads((Path(folder) / f"{name}.json").read_text()))
    KEPT.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n")
    return ended


if __name__ == "__main__":
    sys.exit(main())
