"""The result of `solutions`: all solutions from one initial state, the choices that lead to each, their exponents."""

import dataclasses
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .. import plots
from .._text import Table, numbered
from ..statuses import STATUS
from .result import Data, Result, exponents_along, per_time
from .spectrum import Spectrum

__all__ = ["Choice", "Solution", "Solutions"]


@dataclasses.dataclass(frozen=True)
class Choice:
    """The choice that was made where a solution can be continued in several ways.

    Attributes:
        t: time of the choice.
        kind: "order", of simultaneous events, or "mode", on a repelling surface and at a two-fold.
        options: the possible choices: "event 1 first" …, in the order of the guards; or names of modes.
        taken: the chosen option.
    """

    t: float
    kind: str
    options: tuple[str, ...]
    taken: str

    def __str__(self) -> str:
        return f"t = {self.t:.6g}: {self.taken} (of {', '.join(self.options)})"


class Solution(Result, eqx.Module):
    """One solution.

    Attributes:
        choices: the choices that lead to it, in order of time.
        spectrum: its `lh.Spectrum`; the status is deadlock if the solution cannot be continued.
        exponents: (k,) exponents of the spectrum, descending; +inf if the solution ends sliding along a repelling
            surface, because neighbouring states leave the surface at once.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def field(rate, away):
        ...     return lambda t, x, args: jnp.stack([rate * x[0], away + 0 * x[1]])
        >>> apart = lh.filippov(field(1.0, 1.0), field(-0.5, -1.0), lambda t, x, args: x[1])
        >>> found = lh.solutions(apart, [0.0, 0.0], t1=2.0).solutions[0]
        >>> len(found.choices), found.choices[0].taken
        (1, 'plus')
        >>> found.exponents.round(6).tolist()
        [1.0, 0.0]
    """

    choices: tuple[Choice, ...] = eqx.field(static=True)
    spectrum: Spectrum
    exponents: Float[np.ndarray, " k"]

    @property
    def status(self) -> STATUS:
        """How the run along it ended."""
        return self.spectrum.status

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The spectrum against its index. `style` goes to what it draws."""
        return self.spectrum.plot(ax, **style)

    def _table(self) -> Table:
        rows = [
            (name, f"{value:.6g}")
            for name, value in zip(numbered("λ", len(self.exponents)), self.exponents, strict=True)
        ]
        return Table(
            f"Solution after {len(self.choices)} choices", rows, [*map(str, self.choices), f"status {self.status}"]
        )

    def _data(self) -> Data:
        choices = [str(choice) for choice in self.choices]
        return Data(
            {"exponents": ("exponent", self.exponents, per_time(self.spectrum.unit))},
            exponents_along(len(self.exponents)),
            {"choices": choices, "status": str(self.status)},
        )


class Solutions(Result, eqx.Module):
    """The solutions from one start, as far as they were followed.

    Attributes:
        solutions: one `Solution` each.
        complete: whether these are all solutions. False if there are more than `most`, or if a choice can be made at
            any later time: a repelling surface may be left at any time, and after a two-fold sliding may go on; or
            where the order of the later jumps of one instant matters, of which that of the first one alone is varied.
        mode_names: names of the system's modes.

    Example:
        Two fields that point away from y = 0, where x grows with 1, or with −0.5:

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def field(rate, away):
        ...     return lambda t, x, args: jnp.stack([rate * x[0], away + 0 * x[1]])
        >>> apart = lh.filippov(field(1.0, 1.0), field(-0.5, -1.0), lambda t, x, args: x[1])
        >>> found = lh.solutions(apart, [0.0, 0.0], t1=10.0)
        >>> found.exponents[:, 0].round(6).tolist()
        [1.0, 0.0, inf]
        >>> found.complete  # it may slide for a while, and leave then
        False
    """

    solutions: tuple[Solution, ...]
    complete: bool = eqx.field(static=True)
    mode_names: tuple[str, ...] = eqx.field(static=True)

    @property
    def exponents(self) -> Float[np.ndarray, "solutions k"]:
        """(solutions, k) one row per solution, descending; nan if the solution ended at its start."""
        return np.stack([one.exponents for one in self.solutions])

    @property
    def lower(self) -> Float[np.ndarray, " k"]:
        """(k,) the smallest exponents of solutions that reached the end of the run; nan where none did."""
        return self._extreme(np.min)

    @property
    def upper(self) -> Float[np.ndarray, " k"]:
        """(k,) the largest exponents of solutions that reached the end of the run; nan where none did."""
        return self._extreme(np.max)

    def _extreme(self, of):
        gone_on = [one.spectrum.status is STATUS.ok for one in self.solutions]
        rows = self.exponents
        return of(rows[gone_on], axis=0) if any(gone_on) else np.full(rows.shape[1], np.nan)

    def __len__(self) -> int:
        return len(self.solutions)

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The exponents of each solution against their index. `style` goes to what it draws."""
        return plots.solutions(self, ax, **style)

    def _table(self) -> Table:
        more = "all there are" if self.complete else "there are more"
        lines = []
        for one in self.solutions:
            exponents = ", ".join(f"{value:.6g}" for value in one.exponents)
            lines.append(f"exponents {exponents}  {one.status.name}")
            lines += [f"  {choice}" for choice in one.choices]
        pairs = zip(self.lower, self.upper, strict=True)
        lines.append("between " + ", ".join(f"[{low:.6g}, {high:.6g}]" for low, high in pairs))
        return Table(f"{len(self)} solutions from one start ({more})", notes=lines)

    def _data(self) -> Data:
        count, k = self.exponents.shape
        per = per_time(self.solutions[0].spectrum.unit)
        variables = {
            "exponents": (("solution", "exponent"), self.exponents, per),
            "lower": ("exponent", self.lower, per),
            "upper": ("exponent", self.upper, per),
            "status": ("solution", [int(one.status) for one in self.solutions]),
            "choices": ("solution", ["; ".join(map(str, one.choices)) for one in self.solutions]),
        }
        return Data(variables, {"solution": np.arange(count), **exponents_along(k)}, {"complete": self.complete})
