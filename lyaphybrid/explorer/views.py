"""What is seen at given parameters and a given start: trajectory, section, exponents, and what went wrong in words."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from .._text import Table
from ..analysis.diagrams.sections import PoincareSection
from ..analysis.spectra import lyapunov_spectrum
from ..analysis.trajectories import Trajectory, trajectory
from ..errors import LyaphybridError
from ..results.result import RunResult
from ..results.spectrum import Spectrum
from ..statuses import STATUS
from ..systems.consistency import consistent_start
from ..systems.daes.semi_linear import DAE
from ..systems.kinds import System, iterates
from .sections import AbstractSection

__all__ = ["Setup", "View", "view_of"]

SEEN_PARTS = ("trajectory", "section", "spectrum")


@dataclasses.dataclass(frozen=True)
class Setup:
    """What stays while parameters and start change.

    Attributes:
        system: the system.
        how: what all verbs take: mode, method, t0, max_steps.
        of_spectrum: further arguments of `lyapunov_spectrum`: t1, transient, clock, ….
        window: length of the trajectory.
        settled: length of the section's transient.
        section: the kind of section, or None.
        samples: of the trajectory.
        points: of the section.
    """

    system: System
    how: Mapping[str, Any]
    of_spectrum: Mapping[str, Any]
    window: float
    settled: float
    section: AbstractSection | None
    samples: int
    points: int


class View(NamedTuple):
    """What a system does at some parameters and from some start; a part is None where it could not be computed.

    Attributes:
        trajectory: an `lh.Trajectory` from the start on.
        section: an `lh.PoincareSection`.
        spectrum: an `lh.Spectrum`.
        words: which parts did not end as ok, and why.
        refused: errors about arguments, where there were some.
        section_title: what the points of the section are.
    """

    trajectory: Trajectory | None
    section: PoincareSection | None
    spectrum: Spectrum | None
    words: tuple[str, ...]
    refused: tuple[Exception, ...] = ()
    section_title: str = ""

    def table(self) -> Table:
        """The exponents, and what there is to be said."""
        if self.spectrum is None:
            return Table("No exponents", notes=self.words)
        own, status = self.spectrum._table(), f"status {self.spectrum.status}"
        return own._replace(notes=[*(note for note in own.notes if note != status or not self.words), *self.words])


def view_of(setup: Setup, x0: Any, args: Any) -> View:
    """The view at these parameters from this start; failures of a run and of its arguments are words."""
    found: dict[str, Any] = dict.fromkeys(SEEN_PARTS)
    refused: dict[str, Exception] = {}

    def attempt(part: str, compute: Callable) -> Any:
        try:
            return compute()
        except (ValueError, LyaphybridError) as error:
            refused[part] = error
            return None

    if isinstance(setup.system, DAE):
        x0 = attempt("start", functools.partial(consistent_start, setup.system, x0, args, t0=setup.how["t0"]))
    if x0 is not None:
        for part, compute in (("trajectory", _trajectory), ("section", _section), ("spectrum", _spectrum)):
            found[part] = attempt(part, functools.partial(compute, setup, x0, args, found))
    said = [f"{part}: {error}" for part, error in _once_each(refused)]
    said += _said({part: result for part, result in found.items() if result is not None})
    title = setup.section.title if setup.section is not None else ""
    return View(**found, words=tuple(said), refused=tuple(refused.values()), section_title=title)


def _trajectory(setup: Setup, x0, args, found) -> Trajectory:
    n = min(setup.samples, int(setup.window)) if iterates(setup.system) else setup.samples
    return trajectory(setup.system, x0, args, t1=setup.window, n=n, throw=False, **setup.how)


def _section(setup: Setup, x0, args, found) -> PoincareSection | None:
    if setup.section is None or found["trajectory"] is None:
        return None
    return setup.section.points(
        dict(setup.how), setup.system, x0, args, found["trajectory"], setup.settled, setup.points
    )


def _spectrum(setup: Setup, x0, args, found) -> Spectrum:
    return lyapunov_spectrum(setup.system, x0, args, throw=False, **setup.of_spectrum, **setup.how)


def _once_each(refused: Mapping[str, Exception]) -> list[tuple[str, Exception]]:
    """Parts with their errors; of parts that have the same one the first."""
    texts: dict[str, tuple[str, Exception]] = {}
    for part, error in refused.items():
        texts.setdefault(str(error), (part, error))
    return list(texts.values())


def _said(results: Mapping[str, RunResult]) -> list[str]:
    """Statuses that are not ok, each with the parts that ended so."""
    parts: dict[STATUS, list[str]] = {}
    for part, result in results.items():
        parts.setdefault(STATUS(int(result.status)), []).append(part)
    return [f"{', '.join(names)}: {status}" for status, names in parts.items() if status != STATUS.ok]
