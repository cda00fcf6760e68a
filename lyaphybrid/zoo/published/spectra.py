"""Recorded spectra of the published flows: what is stored of each, and how it is read."""

import dataclasses
import functools
import json
from importlib import resources
from typing import Any

import numpy as np

from ..problem import Reference, computed

__all__ = ["Known", "Recorded", "recorded"]

FILE = "spectra.json"
AGREE = 3.0  # combined standard errors
FLOOR = 1e-9  # of exponents that an error estimate of zero cannot resolve


@dataclasses.dataclass(frozen=True)
class Known:
    """Exponents as they were published.

    Attributes:
        exponents: descending; only the first where no more were given.
        error: half of the last digit, or the error that was given.
        source: where.
    """

    exponents: tuple[float, ...]
    error: float
    source: str


@dataclasses.dataclass(frozen=True)
class Recorded:
    """The spectrum of a flow by two methods.

    Attributes:
        kind: what the exponents say: "chaos", "hyperchaos", "torus", "cycle", "rest"; where volume is conserved
            "chaotic sea" or "regular".
        exponents, stderr: of both runs together, weighted by their errors; per unit of time, descending.
        runs: of each: method, start, time, exponents, stderr, |sum − mean divergence|, notes.
        starts: what other starts lead to: [how many, "the same" | "other" | "escaped" | "undecided", λ₁ of the first].
        transient: where the start leads to chaos that ends: "until" which time it had ended, and the "largest" exponent
            over that time; else None.
        ends: statuses of runs that did not come to their end, among them the first one.
        seconds: CPU time of all runs.
        version: of the library that computed it.
    """

    kind: str
    exponents: tuple[float, ...]
    stderr: tuple[float, ...]
    runs: tuple[dict[str, Any], ...]
    starts: tuple[tuple[int, str, float | None], ...]
    transient: dict[str, float] | None
    ends: tuple[str, ...]
    seconds: float
    version: str

    @property
    def deviation(self) -> float:
        """The largest difference of the two methods in combined standard errors."""
        first, second = (np.array(run["exponents"]) for run in self.runs)
        errors = np.hypot(*(np.array(run["stderr"]) for run in self.runs))
        return float(np.max(np.abs(first - second) / (errors + FLOOR)))

    @property
    def agrees(self) -> bool:
        """Whether both methods agree within three combined standard errors."""
        return self.deviation <= AGREE

    def reference(self) -> Reference:
        """The exponents as the reference of a problem."""
        ways = " and ".join(run["method"] for run in self.runs)
        return computed(self.exponents, self.stderr, source=f"recorded: {ways}")


@functools.cache
def recorded() -> dict[str, Recorded]:
    """The recorded spectra by the names of the flows."""
    file = resources.files("lyaphybrid.zoo.published").joinpath(FILE)
    if not file.is_file():
        return {}
    rows = json.loads(file.read_text(encoding="utf-8"))
    return {name: Recorded(**{key: _as_tuples(value) for key, value in row.items()}) for name, row in rows.items()}


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value
