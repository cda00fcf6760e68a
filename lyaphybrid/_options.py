"""The commands of the command line, their options, and their help with examples."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

__all__ = ["TYPED", "parser_of"]

OUT = "lyaphybrid-out"

# What the help of each command ends with: lines that can be typed, and what they do.
TYPED = {
    "": (
        ("lyaphybrid", f"Table I and Fig. 2 of Dinius into ./{OUT}"),
        ("lyaphybrid list", "which problems there are"),
        ("lyaphybrid spectrum lorenz63", "the exponents of one of them"),
        ("lyaphybrid sweep --help", "what a command takes"),
    ),
    "list": (("lyaphybrid list", "all problems, with the numbers that are known of them"),),
    "spectrum": (
        ("lyaphybrid spectrum lorenz63 --set rho=40 --t1 2000", "with another parameter, and longer"),
        ("lyaphybrid spectrum hard_disks --set n=16 --k 3 --seed 7", "three exponents, from another random start"),
        ("lyaphybrid spectrum rossler --replicates 8 --rtol 1e-11", "errors from eight runs, small tolerance"),
        ("lyaphybrid spectrum henon_map --json", "for another program"),
    ),
    "sweep": (
        ("lyaphybrid sweep logistic_map --over r=3.5:4:101 --t1 5000", "101 values of r"),
        (
            "lyaphybrid sweep impact_oscillator --over omega=2:3:61 --over restitution=0.6:0.9:31 --store map.zarr",
            "a grid that is kept in a store",
        ),
        (
            "lyaphybrid sweep impact_oscillator --over omega=2:3:61 --over restitution=0.6:0.9:31 --store map.zarr "
            "--resume",
            "goes on where it ended",
        ),
    ),
    "reference": (
        ("lyaphybrid reference halvorsen", "its recorded spectrum, by which methods, and what was published"),
        ("lyaphybrid reference", "one line for each published flow"),
        ("lyaphybrid reference sprott_s --json", "for another program"),
    ),
    "validate": (
        ("lyaphybrid validate --quick", "all problems, shorter"),
        ("lyaphybrid validate lorenz63 chua --out found.json", "two of them, and all numbers into a file"),
    ),
    "papers": (
        ("lyaphybrid papers fu --quick", "dry friction, shorter runs"),
        ("lyaphybrid papers skokos --out figures", "figures, tables and numbers into ./figures"),
    ),
}  # fmt: skip


def parser_of(runs: Mapping[str, Callable]) -> argparse.ArgumentParser:
    """The parser; options hold the function of `runs` that belongs to the command as `run`."""
    parser = argparse.ArgumentParser(
        prog="lyaphybrid",
        description="Lyapunov exponents of hybrid dynamical systems.",
        epilog=_epilog("", f"Without a command: the hard disks of Dinius, Table I and Fig. 2, into ./{OUT}.\n\n"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {_version()}")
    parser.set_defaults(run=runs["papers"], paper="dinius", quick=False, out=Path(OUT), progress=None)
    commands = parser.add_subparsers(metavar="COMMAND")

    def command(name: str, short: str, long: str = "") -> Any:
        added = commands.add_parser(
            name,
            help=short,
            description=long or f"{short[0].upper()}{short[1:]}.",
            epilog=_epilog(name),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        added.set_defaults(run=runs[name])
        return added

    command("list", "the named problems")
    _add_spectrum(command)
    _add_sweep(command)
    _add_reference(command)
    _add_validate(command)
    _add_papers(command)
    return parser


def _epilog(name: str, before: str = "") -> str:
    """The examples of a command, each with what it does below it."""
    return f"{before}examples:\n" + "\n".join(f"  {typed}\n      {what}" for typed, what in TYPED[name])


def _add_spectrum(command: Callable) -> None:
    own = command(
        "spectrum",
        "the exponents of a named problem",
        "The Lyapunov exponents of a named problem; lengths are in the problem's own unit.",
    )
    _add_lengths(own)
    own.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    _add_progress(own)


def _add_sweep(command: Callable) -> None:
    own = command(
        "sweep",
        "the exponents of a named problem over a grid of its parameters",
        'The Lyapunov exponents of a named problem over a grid of its parameters (extra "sweep").',
    )
    _add_lengths(own)
    option = own.add_argument
    option("--over", metavar="KEY=LOW:HIGH:COUNT", action="append", default=[], help="an axis; may be repeated")
    option("--store", type=Path, metavar="DIR", help="zarr store that keeps each chunk as soon as it is computed")
    option("--resume", action="store_true", help="go on with the store of an earlier sweep")
    option("--chunk", type=int, help="points that are computed and kept together")
    option("--workers", type=int, help='processes of a local dask cluster (extra "cluster")')
    _add_progress(own)


def _add_reference(command: Callable) -> None:
    own = command(
        "reference",
        "the recorded spectra of published chaotic flows",
        "The recorded spectrum of a published flow: exponents with errors by two methods, what other starts lead to,\n"
        "what was published, the source, and the command that computes it again.",
    )
    own.add_argument("name", metavar="NAME", nargs="?", help="one of the flows (default: a line for each)")
    own.add_argument("--json", action="store_true", help="one JSON object instead of text")


def _add_validate(command: Callable) -> None:
    own = command(
        "validate",
        "every named problem against its reference, by two methods and at two tolerances",
        "Every named problem against its reference, by two methods and at two tolerances; each is printed when it is\n"
        "done. The exit status is 1 if an exponent is off by more than five standard errors.",
    )
    own.add_argument("names", metavar="NAME", nargs="*", help="problems (default: all)")
    own.add_argument("--quick", action="store_true", help="two ways each, and long runs at a tenth of their length")
    own.add_argument("--out", type=Path, metavar="FILE", help="write all numbers as JSON")


def _add_papers(command: Callable) -> None:
    own = command("papers", "a paper's tables and figures")
    own.add_argument("paper", metavar="PAPER", help="dinius, fu, linh or skokos")
    own.add_argument("--quick", action="store_true", help="shorter runs, nothing else")
    own.add_argument("--out", type=Path, default=Path(OUT), metavar="DIR", help=f"folder (default: {OUT})")
    _add_progress(own)


def _add_progress(own: argparse.ArgumentParser) -> None:
    own.add_argument(
        "--progress",
        action=argparse.BooleanOptionalAction,
        help="say on standard error how far it is (default: where that is a terminal)",
    )


def _add_lengths(command: argparse.ArgumentParser) -> None:
    """Options that `spectrum` and `sweep` share."""
    option = command.add_argument
    option("name", metavar="NAME", help="one of `lyaphybrid list`")
    option("--set", metavar="KEY=VALUE", action="append", default=[], help="a parameter; may be repeated")
    option("--t1", type=float, help="length of the run")
    option("--transient", type=float, help="length before growth is counted")
    option("--k", type=int, help="number of exponents (default: all)")
    option("--replicates", type=int, help="so many runs at once; they give the error")
    option("--seed", type=int, default=0, help="of random starts (default: 0)")
    option("--rtol", type=float, help="relative tolerance of the integration")
    option("--atol", type=float, help="absolute tolerance of the integration")
    option("--every", type=float, help="orthonormalise each so many steps or jumps, or so much time")
    option("--max-steps", type=int, help="most attempts of a step")


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("lyaphybrid")
    except PackageNotFoundError:
        return "(a source tree that is not installed)"
