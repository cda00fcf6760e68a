"""What the reproductions of all papers share: compute, check, report, draw, write."""

import abc
import dataclasses
import functools
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, ClassVar

from .claims import Check, Claim
from .output import save

__all__ = ["Reproduction", "computed", "write"]


@dataclasses.dataclass(frozen=True)
class Reproduction(abc.ABC):
    """A paper, computed and compared. Its fields are what was computed; it prints as its report.

    Attributes:
        name: of the paper, and of the file of its numbers.
    """

    name: ClassVar[str]

    @functools.cached_property
    def checks(self) -> list[Check]:
        """All checks."""
        return self.compared()

    @functools.cached_property
    def claims(self) -> list[Claim]:
        """The claims of the paper, item by item, with the findings."""
        return self.judged()

    @property
    def passed(self) -> bool:
        """Whether all checks hold."""
        return all(one.holds for one in self.checks)

    def __str__(self) -> str:
        return self.report()

    @abc.abstractmethod
    def compared(self) -> list[Check]:
        """Make the checks."""

    @abc.abstractmethod
    def judged(self) -> list[Claim]:
        """Make the claims."""

    @abc.abstractmethod
    def report(self) -> str:
        """The tables, checks and claims as text."""

    @abc.abstractmethod
    def data(self) -> dict:
        """All numbers, ready for JSON."""

    @abc.abstractmethod
    def figures(self) -> dict[str, Any]:
        """The figures by the names of their files."""


def write(result: Reproduction, folder: Path) -> list[Path]:
    """Figures (PNG, PDF) and numbers (JSON) into a folder; returns the files."""
    return save(folder, result.name, result.figures(), result.data())


def computed(tasks: Mapping[tuple, tuple], progress: Callable[[float], Any] | None = None) -> dict:
    """The results of tasks by name, each given as the program that it needs, a function and its arguments.

    Two threads: all tasks that need the same program run in one thread, which compiles it once.
    """
    programs: dict[Any, list[tuple]] = {}
    for name, (program, *task) in tasks.items():
        programs.setdefault(program, []).append((name, *task))
    done: dict[tuple, Any] = {}

    def run(all_of_it: list[tuple]) -> None:
        for name, function, *arguments in all_of_it:
            done[name] = function(*arguments)
            if progress is not None:
                progress(len(done) / len(tasks))

    with ThreadPoolExecutor(2) as threads:
        list(threads.map(run, programs.values()))
    return done
