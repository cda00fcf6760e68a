"""The command line: ``python -m benchmarks.capabilities [--only CAPABILITY …] [--record]``."""

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax

from benchmarks.capabilities import CAPABILITIES
from benchmarks.capabilities.rows import measure
from benchmarks.capabilities.tables import line
from benchmarks.machine import here

DATA = Path(__file__).parents[1] / "capabilities.json"


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "python -m benchmarks.capabilities",
        description="Each capability against what is known exactly or otherwise, with its cost; takes some minutes.",
        epilog="example: python -m benchmarks.capabilities --only curves noise",
    )
    parser.add_argument(
        "--only", metavar="CAPABILITY", nargs="+", choices=list(CAPABILITIES), help=", ".join(CAPABILITIES)
    )
    parser.add_argument("--record", action="store_true", help=f"write benchmarks/{DATA.name}, which has all rows")
    options = parser.parse_args(argv)
    if options.record and options.only:
        parser.error("--record is one run of all capabilities: leave out --only.")
    return options


def measured(names: list[str]) -> dict[str, Any]:
    """All rows of these capabilities, each printed when it is done, as compiled for the first time."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        os.environ["LYAPHYBRID_CACHE"] = folder  # machine code of earlier runs would make first calls cheap
        for name in names:
            module = CAPABILITIES[name]
            print(f"{module.TITLE}:", flush=True)
            found[name] = {"title": module.TITLE, "rows": []}
            for row in module.ROWS:
                found[name]["rows"].append(measure(row))
                print("  " + line(found[name]["rows"][-1]), flush=True)
    return found


def main(argv: list[str] | None = None) -> int:
    """Measure and print; 1 where an error is above what is wanted."""
    options = _parse(argv)
    jax.config.update("jax_enable_x64", True)
    results, began = here(), time.process_time()
    results["capabilities"] = measured(options.only or list(CAPABILITIES))
    results["seconds"] = time.process_time() - began
    rows = [row for one in results["capabilities"].values() for row in one["rows"]]
    missed = sum(not row["passed"] for row in rows)
    print(f"{len(rows)} rows in {results['seconds']:.0f} s of CPU, {missed} missed.")
    if options.record:
        DATA.write_text(json.dumps(results, indent=1) + "\n")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
