"""Branches of periodic orbits: the result of a continuation."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np

from ... import _renamed as renamed
from ... import plots
from ..._arguments import whole
from ..._text import Table, with_unit
from ...results.result import Data, Result, in_time, per_time
from ...results.resuming import Resumable
from ...systems.labels import Labels
from ..orbits.periodic_orbits import Floquet
from ..orbits.sides import BEYOND_GUARD
from .locating import OrbitChange

__all__ = ["Continuation", "OrbitsAlong", "Special", "SpecialOrbit"]


class SpecialOrbit(Result):
    """What special points of branches and of curves have in common: they are an orbit."""

    orbit: Floquet
    title: str

    @property
    def state_labels(self) -> Labels:
        """Names and units of the components of a state, and the unit of time."""
        return self.orbit.state_labels

    @property
    def multipliers(self):
        """Complex (n,), the largest first."""
        return self.orbit.multipliers

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The multipliers of its orbit in the complex plane, with the unit circle. `style` goes to what it draws."""
        return self.orbit.plot(ax, **style)

    def _table(self) -> Table:
        return Table(self.title)


class OrbitsAlong(Resumable, Result):
    """What branches and curves have in common: orbits, one after the other."""

    orbits: tuple[Floquet, ...]
    specials: tuple[Any, ...]

    def resume(
        self,
        *,
        max_points: int | None = None,
        over: Mapping[str, tuple[float, float]] | tuple[float, float] | None = None,
    ) -> Self:
        """Go on at both ends that are "max_points", "interrupted" or "range", with the same settings.

        With more points, or after Ctrl-C, it is bit by bit what one call gives. In a wider range it is the same branch
        or curve, but steps stay as long as they were, relative to the first range.

        Args:
            max_points: largest number of points to each side, in all; None: as before.
            over: the same names with wider ranges; None: as before.

        Returns:
            The whole branch or curve.

        Raises:
            ValueError: on arguments that do not fit; where this is not the object that `lh.continuation` or
                `lh.bifurcation_curve` has returned (a copy of it, or one out of a file).

        Example:
            >>> import lyaphybrid as lh
            >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
            >>> short = lh.continuation(logistic, [0.6], 2.5, over={"args": (2.4, 2.6)}, period=1)
            >>> short.resume(over={"args": (2.0, 3.5)}).specials
            (period doubling at 3, T = 1,)
        """
        go_on = self._goes_on("lh.continuation or lh.bifurcation_curve", "Begin at its last orbit, or at a special.")
        if max_points is not None:
            whole("max_points", max_points, least=2)
        return go_on(max_points, over)

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

    def of_kind(self, kind: str) -> list[Any]:
        """The specials of a kind."""
        return [special for special in self.specials if special.kind == kind]


@dataclasses.dataclass(frozen=True, repr=False)
class Special(SpecialOrbit):
    """A special point of a branch: a bifurcation, or grazing.

    Attributes:
        kind: "fold", "pitchfork", "transcritical", "period doubling", "Neimark–Sacker", "grazing", "border collision",
            or where the orbits shrink to an equilibrium "Hopf" and "boundary equilibrium".
        parameter: its value there.
        orbit: an `lh.Floquet`; at a Hopf point the equilibrium, with the period 2π/ω of the small orbits beside it.
        turns: multiple of the given period after which it closes.
        turns_there: the same multiple on the branch that begins here.
        change: direction to that branch: changes of the orbit's `base`, period and parameter; None if none begins.
        largest: (n,) largest value of each component over the orbit.
        sizes: (n,) of the components on the branch: here one may be zero.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> branch = lh.continuation(henon, [0.6, 0.2], 0.3, over={"args": (0.2, 0.5)}, period=1)
        >>> found = branch.specials[0]
        >>> found.kind, round(float(found.parameter), 6), round(float(min(found.multipliers.real)), 6)
        ('period doubling', 0.3675, -1.0)
    """

    kind: str
    parameter: float
    orbit: Floquet
    turns: int
    turns_there: int
    change: OrbitChange | None
    largest: np.ndarray
    sizes: np.ndarray

    @property
    def x0(self):
        """(n,) the point of the orbit at t0."""
        return self.orbit.x0

    @property
    def period(self) -> float:
        """T."""
        return self.orbit.period

    @property
    def title(self) -> str:
        """Kind, parameter and period in one line."""
        period = with_unit(f"{self.period:.9g}", self.state_labels.time_unit)
        return f"{self.kind} at {self.parameter:.12g}, T = {period}"

    def _data(self) -> Data:
        orbit = self.orbit._data()
        words = ("kind", "parameter", "turns", "turns_there")
        attributes = dict(orbit.attributes) | {word: getattr(self, word) for word in words}
        return Data(dict(orbit.variables) | {"largest": ("state", self.largest)}, orbit.coordinates, attributes)


@dataclasses.dataclass(frozen=True, repr=False)
class Continuation(OrbitsAlong):
    """A branch of periodic orbits.

    Attributes:
        parameter: its name, "conserved value" where a family is followed; values: (points,) along the branch, which may
            turn back.
        orbits: an `lh.Floquet` for each point.
        specials: tuple of `Special`, in the order of the branch.
        ends: why the branch ends at its first and at its last point: "range" (of `over`), "closed" (back at its start),
            "grazing" (an orbit touches a guard, and the branch does not go on), "Hopf" (the orbits of an autonomous
            system have shrunk to an equilibrium), "boundary equilibrium" (to one on a guard, with events until the
            end), "max_points", "no convergence" (of Newton's method, whatever the step; or fifty steps together get
            nowhere, as where the period grows without bound), "interrupted" (by Ctrl-C), "start" (a branch that begins
            at a `Special`).
        largest, smallest: (points, n) extreme values of each component over the orbit.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.continuation(henon, [0.6, 0.2], 0.3, over={"args": (0.2, 0.5)}, period=1)
        >>> found.ends, found.values.shape
        (('range', 'range'), (42,))
        >>> [(one.kind, round(float(one.parameter), 6)) for one in found.specials]  # 3 (1 − b)²/4, b = 0.3
        [('period doubling', 0.3675)]
    """

    parameter: str
    values: np.ndarray
    orbits: tuple[Floquet, ...]
    specials: tuple[Special, ...]
    ends: tuple[str, str]
    largest: np.ndarray
    smallest: np.ndarray
    state_labels: Labels = Labels()

    @property
    def exponents(self) -> np.ndarray:
        """(points, n) ln|μ|/T, descending; -inf where μ = 0."""
        return np.array([orbit.exponents for orbit in self.orbits])

    @property
    def stable(self) -> np.ndarray:
        """(points,) whether the orbit attracts."""
        return np.array([orbit.stable for orbit in self.orbits])

    @renamed.keywords(axes="ax")
    def plot(self, ax: Sequence[plots.Axes] | None = None, i: int | None = None, **style: Any) -> Sequence[plots.Axes]:
        """The largest value of component i over the orbits, and below it their exponents, on two axes.

        Without i it is the first component that varies along the branch. `style` goes to what it draws.
        """
        return plots.continuation(self, ax, i, **style)

    def _table(self) -> Table:
        low, high = float(np.min(self.values)), float(np.max(self.values))
        title = (
            f"Branch of periodic orbits over {self.parameter} from {low:.6g} to {high:.6g}: {len(self.values)} points, "
            f"{int(np.sum(self.stable))} stable; ends: {self.ends[0]}, {self.ends[1]}"
        )
        beyond = sum(BEYOND_GUARD in orbit.notes for orbit in self.orbits)
        more = [f"{beyond} of the orbits lie beyond a guard that they never fire, see their notes"] if beyond else []
        return Table(title, notes=[*(special.title for special in self.specials), *more])

    def _data(self) -> Data:
        along, unit = ("point", "state"), self.state_labels.time_unit
        variables = {
            "x0": (along, self.x0),
            "largest": (along, self.largest),
            "smallest": (along, self.smallest),
            "multipliers": (("point", "exponent"), self.multipliers),
            "exponents": (("point", "exponent"), self.exponents, per_time(unit)),
            "period": ("point", self.period, in_time(unit)),
            "stable": ("point", self.stable),
            "special": ("special", [special.parameter for special in self.specials]),
            "special_kind": ("special", [special.kind for special in self.specials]),
        }
        coordinates = {
            "state": self.state_labels.columns(self.largest.shape[1]),
            "exponent": np.arange(1, self.exponents.shape[1] + 1),
            self.parameter: ("point", self.values),
        }
        return Data(variables, coordinates, {"parameter": self.parameter, "ends": self.ends})
