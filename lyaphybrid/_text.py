"""Formatting of numbers, units and tables, shared by all results, axes and messages."""

import html
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

__all__ = [
    "UNIT",
    "Table",
    "as_html",
    "as_text",
    "in_brackets",
    "in_full",
    "known_unit",
    "numbered",
    "per_unit",
    "with_error",
    "with_unit",
]

UNIT = {"time": "unit of time", "jumps": "jump", "hybrid": "unit of max(t, j)"}
NO_UNITS = ("iteration", *UNIT, *UNIT.values())  # what is counted, of which nobody said how long it is

MOST_ROWS = 40  # rows that are shown; of more, the first and the last ones
NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?(\(\d+\))?|inf|nan)(e[-+]?\d+)?")


class Table(NamedTuple):
    """What a result says in print: a title, rows of cells, and lines below them."""

    title: str
    rows: Sequence[Sequence[str]] = ()
    notes: Sequence[str] = ()
    heads: Sequence[str] = ()  # of the columns; none where the rows speak for themselves


def with_error(value: float, error: float) -> str:
    """0.90587(15): two digits of the error, in units of the last digits shown."""
    if not np.isfinite(value):
        return "-inf" if value < 0 else str(value)
    if not np.isfinite(error) or error <= 0:
        return f"{value:.12g}"
    last = int(np.floor(np.log10(error)))
    digits = max(0, 1 - last)
    if digits > 12:
        return f"{value:.12f}" if abs(value) >= 1e-12 else _small_with_error(value, error, last)
    return f"{value:.{digits}f}({error * 10**digits:.0f})" if digits else f"{value:.0f}({error:.0f})"


def _small_with_error(value: float, error: float, last: int) -> str:
    """2.2(18)e-16: what is small itself, with its own power of ten; the error begins at 10^last."""
    if value == 0:
        return "0"
    power = max(last, int(np.floor(np.log10(abs(value)))))
    return f"{value * 10.0**-power:.{power - last + 1}f}({error * 10.0 ** (1 - last):.0f})e{power}"


def known_unit(unit: str) -> str:
    """The unit in which a system measures its time; "" where it gave none, and where something else is counted."""
    return "" if unit in NO_UNITS else unit


def in_brackets(name: str, unit: str) -> str:
    """What stands at an axis or above a column of times, with their unit where it is known."""
    return f"{name} ({unit})" if known_unit(unit) else name


def per_unit(unit: str) -> str:
    """What follows a rate of which one says no more, " per ms", where the unit is known."""
    return f" per {unit}" if known_unit(unit) else ""


def with_unit(number: str, unit: str) -> str:
    """A time in print, with its unit where that is known."""
    return f"{number} {known_unit(unit)}".rstrip()


def in_full(value: float) -> str:
    """1000000, not 1e+06: whole numbers with all digits, others with six."""
    return f"{value:.0f}" if value.is_integer() and abs(value) < 1e15 else f"{value:.6g}"


def numbered(symbol: str, count: int) -> list[str]:
    """Names such as λ1, λ2, λ3."""
    return [f"{symbol}{i + 1}" for i in range(count)]


def as_text(table: Table) -> str:
    """A table for the terminal: columns aligned, numbers at their decimal points."""
    rows = _shortened([list(map(str, row)) for row in table.rows])
    columns = [_aligned(column) for column in zip(*rows, strict=True)]
    if table.heads:
        columns = [[head, *column] for head, column in zip(table.heads, columns, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    lines = ["  ".join(map(str.ljust, cells, widths)).rstrip() for cells in zip(*columns, strict=True)]
    return "\n".join([table.title, *(f"  {line}" for line in [*lines, *table.notes])])


def as_html(table: Table) -> str:
    """The same table for a notebook."""
    rows = [_row("td", cells) for cells in _shortened([list(map(str, row)) for row in table.rows])]
    heads = [_row("th", table.heads)] if table.heads else []
    notes = "".join(f"<div>{html.escape(note)}</div>" for note in table.notes)
    title = f"<caption style='text-align: left; white-space: nowrap'>{html.escape(table.title)}</caption>"
    return f"<table>{title}{''.join([*heads, *rows])}</table>{notes}"


def _row(kind: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{kind}>{html.escape(str(cell))}</{kind}>" for cell in cells) + "</tr>"


def _shortened(rows: list[list[str]]) -> list[list[str]]:
    if len(rows) <= MOST_ROWS:
        return rows
    return [*rows[: MOST_ROWS // 2], ["…"] * len(rows[0]), *rows[-MOST_ROWS // 2 :]]


def _aligned(column: Sequence[str]) -> list[str]:
    """Cells of one width: numbers with their decimal points below each other, words at the left."""
    parts = [_split(cell) for cell in column]
    before = max((len(whole) for whole, _, number in parts if number), default=0)
    cells = [(whole.rjust(before) if number else whole) + rest for whole, rest, number in parts]
    width = max(map(len, cells), default=0)
    return [cell.ljust(width) for cell in cells]


def _split(cell: str) -> tuple[str, str, bool]:
    """What stands before the decimal point, the rest, and whether it is a number."""
    if not NUMBER.fullmatch(cell):
        return cell, "", False
    if "inf" in cell or "nan" in cell:
        return cell, "", True
    end = re.search(r"[.(e]", cell)
    cut = end.start() if end else len(cell)
    return cell[:cut], cell[cut:], True
