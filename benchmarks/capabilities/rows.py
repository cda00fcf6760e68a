"""A row of the closing table, the clock by which it is timed, and how far something is from its truth."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

Found = TypeVar("Found")


class Row(NamedTuple):
    """What a row has found.

    Attributes:
        name: what was computed.
        truth: what it was compared with, and where that comes from.
        error: how far it is from the truth; wanted: how far it may be.
        unit: of both; nothing where they have the unit of the values.
        remark: what else was measured.
    """

    name: str
    truth: str
    error: float
    wanted: float
    unit: str = ""
    remark: str = ""


class Stopwatch:
    """Runs what it is given twice, and adds up the seconds of CPU of first and second calls."""

    def __init__(self):
        self.first = self.second = 0.0

    def __call__(self, run: Callable[[], Found]) -> Found:
        first, _ = timed(run)
        second, found = timed(run)
        self.first += first
        self.second += second
        return found


def timed(run: Callable[[], Found]) -> tuple[float, Found]:
    """Seconds of CPU of a call that is waited for, which the load of the machine moves least, and its result."""
    began = time.process_time()
    found = jax.block_until_ready(run())
    return time.process_time() - began, found


def measure(row: Callable[[Stopwatch], Row]) -> dict[str, Any]:
    """A row as plain data; one that fails says why, and has an error beyond all bounds."""
    clock = Stopwatch()
    try:
        found = row(clock)
    except Exception as reason:  # the other rows are still wanted
        words = f"{type(reason).__name__}: {reason}".replace("\n", " ")
        found = Row(row.__name__.replace("_", " "), "", np.inf, 0.0, remark=words)
    passed = bool(found.error <= found.wanted)
    data = found._asdict() | {"error": float(found.error), "wanted": float(found.wanted)}
    return {"row": row.__name__} | data | {"passed": passed, "first": clock.first, "second": clock.second}


def apart(found, truth) -> float:
    """The largest difference of two arrays."""
    return float(np.max(np.abs(np.asarray(found) - np.asarray(truth))))


def off(found, truth) -> float:
    """The largest relative difference of two arrays."""
    return float(np.max(np.abs(np.asarray(found) / np.asarray(truth) - 1)))


def errors_away(found, truth, stderr) -> float:
    """The largest difference in standard errors."""
    return float(np.max(np.abs(np.asarray(found) - np.asarray(truth)) / np.asarray(stderr)))
