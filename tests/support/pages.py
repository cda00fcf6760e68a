"""The code on pages, run as a reader runs it: the blocks of a page one after the other, in one namespace.

A block ```` ```python ```` runs; a block ```` ```text ```` right after it is what it prints. What is only to be looked
at (code of other projects, of a cluster) is a block ```` ```{code-block} ````.
"""

import contextlib
import io
import math
import re
from typing import NamedTuple

import jax
from matplotlib import pyplot

BLOCK = re.compile(r"^```python\n(.*?)^```\n(?:\n?```text\n(.*?)^```\n)?", flags=re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])[-−+]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[-+]?\d+)?(?:\((\d+)\))?")
SIGMAS = 5  # of two values that carry errors
ERROR_OF_ERROR = 4  # factor between two estimates of an error
ROUNDING = 1e-9  # what is smaller is rounding, whatever it is
RELATIVE = 1e-5  # of numbers without an error
COUNTED = 0.05  # of the number of jumps in a chaotic run


class Block(NamedTuple):
    """A piece of code and what it prints; None: nothing is said about it."""

    code: str
    printed: str | None


def blocks(text: str) -> list[Block]:
    """The blocks of a page that run."""
    return [Block(code, printed or None) for code, printed in BLOCK.findall(text)]


def run(block: Block, names: dict) -> str:
    """What a block prints; its names are left in `names`."""
    printed = io.StringIO()
    with (
        contextlib.redirect_stdout(printed),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        exec(block.code, names)
    return printed.getvalue()


def differences(found: str, shown: str) -> list[str]:
    """Where what was printed is not what a page shows: words exactly, numbers within their errors."""
    if words(found) != words(shown):
        return [f"printed:\n{found}\nshown:\n{shown}"]
    pairs = zip(NUMBER.finditer(found), NUMBER.finditer(shown), strict=True)
    return [f"{a[0]} is not {b[0]}" for a, b in pairs if not same(a, b)]


def words(text: str) -> list[str]:
    """The text without its numbers."""
    return NUMBER.sub("#", text).split()


def same(a: re.Match, b: re.Match) -> bool:
    """Whether two numbers agree."""
    x, y = value(a), value(b)
    errors = error(a), error(b)
    if (errors[0] is None) != (errors[1] is None):
        return False
    if None not in errors:
        spread = max(errors) <= ERROR_OF_ERROR * min(errors)
        return spread and abs(x - y) <= SIGMAS * math.hypot(*errors)
    if max(abs(x), abs(y)) < ROUNDING:
        return True
    counted = a.string[a.end() :].startswith(" jumps")
    return abs(x - y) <= (COUNTED if counted else RELATIVE) * max(abs(x), abs(y))


def value(number: re.Match) -> float:
    """A printed number without its error."""
    return float(number[0].partition("(")[0].replace("−", "-"))


def error(number: re.Match) -> float | None:
    """The error of 0.1606(28) is 0.0028; None where none is printed."""
    if number[1] is None:
        return None
    decimals = number[0].partition("(")[0].partition(".")[2]
    return int(number[1]) * 10.0 ** -len(decimals)


def faults(text: str) -> list[str]:
    """What on a page does not run, or prints something else."""
    names, found = {}, []
    for block in blocks(text):
        printed = run(block, names)
        pyplot.close("all")
        if block.printed is not None:
            found += differences(printed, block.printed)
    return found
