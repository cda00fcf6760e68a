"""Branches of periodic orbits: what a continuation found."""

import dataclasses

import numpy as np

from ... import plots
from ..orbits.periodic_orbits import Floquet
from .locating import Change

__all__ = ["Continuation", "Special"]


@dataclasses.dataclass(frozen=True)
class Special:
    """A periodic orbit at which something happens.

    Attributes:
        kind: "fold", "pitchfork", "transcritical", "period doubling", "Neimark–Sacker" or "grazing".
        parameter: its value there.
        orbit: an `lh.Floquet`.
        turns: multiple of the given period after which it closes.
        turns_there: that multiple on the branch that begins here.
        change: towards that branch, how the orbit's `base`, its period and the parameter move; None where none begins.
        largest: (n,) of each component over the orbit.
    """

    kind: str
    parameter: float
    orbit: Floquet
    turns: int
    turns_there: int
    change: Change | None
    largest: np.ndarray

    @property
    def x0(self):
        """(n,) the point of the orbit at t0."""
        return self.orbit.x0

    @property
    def period(self) -> float:
        """T."""
        return self.orbit.period

    @property
    def multipliers(self):
        """Complex (n,), the largest first."""
        return self.orbit.multipliers

    def __str__(self) -> str:
        return f"{self.kind} at {self.parameter:.12g}, T = {self.period:.9g}"

    __repr__ = __str__


@dataclasses.dataclass(frozen=True)
class Continuation:
    """A branch of periodic orbits.

    Attributes:
        parameter: its name, "conserved value" where a family is followed; values: (points,) along the branch, which may
            turn back.
        orbits: an `lh.Floquet` for each point.
        specials: tuple of `Special`, in the order of the branch.
        ends: why the branch ends at its first and at its last point: "range" (of `over`), "closed" (back at its start),
            "grazing" (an orbit touches a guard, and none follows), "max_points", "no convergence" (of Newton's method,
            whatever the step), "start" (a branch that begins at a `Special`).
        largest, smallest: (points, n) of each component over the orbit.
    """

    parameter: str
    values: np.ndarray
    orbits: tuple[Floquet, ...]
    specials: tuple[Special, ...]
    ends: tuple[str, str]
    largest: np.ndarray
    smallest: np.ndarray

    @property
    def x0(self) -> np.ndarray:
        """(points, n) a point of each orbit: at t0, where the system is forced."""
        return np.array([orbit.x0 for orbit in self.orbits])

    @property
    def period(self) -> np.ndarray:
        """(points,)."""
        return np.array([orbit.period for orbit in self.orbits])

    @property
    def multipliers(self) -> np.ndarray:
        """Complex (points, n), the largest first."""
        return np.array([orbit.multipliers for orbit in self.orbits])

    @property
    def exponents(self) -> np.ndarray:
        """(points, n) ln|μ|/T, descending; -inf where μ = 0."""
        return np.array([orbit.exponents for orbit in self.orbits])

    @property
    def stable(self) -> np.ndarray:
        """(points,) whether the orbit attracts."""
        return np.array([orbit.stable for orbit in self.orbits])

    def of_kind(self, kind: str) -> list[Special]:
        """The specials of a kind."""
        return [special for special in self.specials if special.kind == kind]

    def plot(self, axes=None):
        """The orbits, and below them their exponents, against the parameter."""
        return plots.continuation(self, axes)

    def __str__(self) -> str:
        low, high = float(np.min(self.values)), float(np.max(self.values))
        lines = [
            f"Branch of periodic orbits over {self.parameter} from {low:.6g} to {high:.6g}: {len(self.values)} points, "
            f"{int(np.sum(self.stable))} stable; ends: {self.ends[0]}, {self.ends[1]}"
        ]
        return "\n".join([*lines, *(f"  {special}" for special in self.specials)])

    __repr__ = __str__
