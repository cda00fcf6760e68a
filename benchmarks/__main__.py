"""The command line: ``python -m benchmarks [--quick] [--only NAME] [--json] [--side both|ours|c]``."""

import argparse
import json
import subprocess
import sys
from typing import Any

from benchmarks.cases import CASES, run_case
from benchmarks.harness import head, line
from benchmarks.references import NoCompilerError, compiler

SIDES = {"both": ("ours", "c"), "ours": ("ours",), "c": ("c",)}


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        "python -m benchmarks",
        description="Our times against hand-written C; each case is printed when it is done.",
        epilog="example: python -m benchmarks --quick --only lorenz_every10",
    )
    parser.add_argument("--quick", action="store_true", help="shorter runs, fewer rounds")
    parser.add_argument("--only", metavar="NAME", choices=list(CASES), help=f"one of {', '.join(CASES)}")
    parser.add_argument("--json", action="store_true", help="rows as JSON, nothing else on standard output")
    parser.add_argument("--side", choices=list(SIDES), default="both", help="time one side alone; c: the other one")
    return parser.parse_args(argv)


def _row_of_child(name: str, quick: bool, side: str) -> dict[str, Any]:
    """Run one case in a fresh process: its first call and its peak memory are then its own."""
    command = [sys.executable, "-m", "benchmarks", "--only", name, "--side", side, "--json"]
    done = subprocess.run(command + ["--quick"] * quick, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout)[0]


def main(argv: list[str] | None = None) -> int:
    """Run the benchmarks; returns the exit status."""
    options = _parse(argv)
    side, compiled = options.side, True
    names = [options.only] if options.only else list(CASES)
    if side != "ours":
        try:
            compiler()
        except NoCompilerError as reason:
            if any(CASES[name].against == "c" for name in names):
                print(f"benchmarks: {reason}", file=sys.stderr)
                if side == "c":
                    return 1
            compiled = False
    sides = {name: side if compiled or CASES[name].against != "c" else "ours" for name in names}
    rows = []
    if not options.json:
        print(head(list(CASES)), flush=True)
    for name in names:
        if options.only:
            rows.append(run_case(name, options.quick, SIDES[sides[name]]))
        else:
            rows.append(_row_of_child(name, options.quick, sides[name]))
        if not options.json:  # each as soon as it is there
            print(line(rows[-1], list(CASES)), flush=True)
    if options.json:
        print(json.dumps(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
