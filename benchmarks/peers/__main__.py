"""The command line: ``python -m benchmarks.peers [--only WORKLOAD …] [--quick] [--check | --record]``."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.machine import here
from benchmarks.peers import measuring, tables
from benchmarks.peers.workloads import WORKLOADS

FOLDER = Path(__file__).parents[1]
DATA, PAGE = FOLDER / "results.json", FOLDER / "RESULTS.md"


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "python -m benchmarks.peers",
        description="Our times against those of other programs, at the same error.",
        epilog="example: python -m benchmarks.peers --only lorenz --quick",
    )
    parser.add_argument("--only", metavar="WORKLOAD", nargs="+", choices=list(WORKLOADS), help=", ".join(WORKLOADS))
    parser.add_argument("--quick", action="store_true", help="shorter runs, fewer rounds")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--check", action="store_true", help="print ratios that are worse than recorded by over 25 %%")
    what.add_argument(
        "--record",
        action="store_true",
        help="write results.json and RESULTS.md into benchmarks/, of all workloads",
    )
    options = parser.parse_args(argv)
    if options.record and (options.only or options.quick):
        parser.error("--record is one run of all workloads at their full length: leave out --only and --quick.")
    return options


def described() -> dict[str, Any]:
    """When, where, and of which versions."""
    return here() | {"versions": measuring.versions()}


def main(argv: list[str] | None = None) -> int:
    """Measure and print; 1 where `--check` finds something worse, 2 where nothing is recorded."""
    options = _parse(argv)
    if options.check and not DATA.exists():
        print(f"benchmarks.peers: nothing is recorded in {DATA} yet; run it with --record first.", file=sys.stderr)
        return 2
    for peer in measuring.missing():
        print(f"{peer} is not installed: skipped.", file=sys.stderr)
    results = described() | {"workloads": {}}
    for name in options.only or WORKLOADS:
        results["workloads"][name] = measuring.measure(name, options.quick)
        print(tables.table(results["workloads"][name]), flush=True)
        if options.record:  # each when it is done: a run may be cut
            DATA.write_text(json.dumps(results, indent=1) + "\n")
            PAGE.write_text(tables.page(results))
    if options.check:
        found = list(tables.worse(results, json.loads(DATA.read_text())))
        print(
            "\n".join(["Worse than recorded by over 25 %:", *found] if found else ["Nothing is worse than recorded."])
        )
        return 1 if found else 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
