"""What the components of a state are called, and in which units they and the time are measured."""

import copy
from collections.abc import Sequence
from typing import Any, NamedTuple

from .._arguments import require

__all__ = ["Labels", "check_labels", "labels_of", "time_word", "unlabelled", "words"]


class Labels(NamedTuple):
    """Names and units of the components of a state, and the unit of time; without names they are x0, x1, ….

    Attributes:
        names: one a component; of many bodies, whose state is (N, d), one a column. Empty: none were given.
        units: likewise.
        rows: whether the state is (N, d).
        time_unit: the unit of time. Empty: none was given.
    """

    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    rows: bool = False
    time_unit: str = ""

    def name(self, i: int) -> str:
        """What component i of the flat state is called."""
        if not self.names:
            return f"x{i}"
        body, own = divmod(i, len(self.names))
        return f"{self.names[own]}[{body}]" if self.rows else self.names[own]

    def columns(self, d: int) -> list[str]:
        """What the d components of a state, or of one of its rows, are called."""
        return list(self.names) or [f"x{i}" for i in range(d)]

    def axis(self, i: int) -> str:
        """Component i with its unit, as an axis of a picture says it."""
        name = self.name(i) if self.names else f"$x_{{{i}}}$"
        unit = self.units[i % len(self.units)] if self.units else ""
        return f"{name} ({unit})" if unit else name


def words(given: Any) -> Any:
    """Names or units as a tuple.

    Raises:
        ValueError: unless they are a sequence of strings, or None.
    """
    listed = (
        isinstance(given, Sequence) and not isinstance(given, str | bytes) and all(isinstance(x, str) for x in given)
    )
    require(
        given is None or listed,
        f"names must be a sequence of strings, one for each component of the state, and so must units; got {given!r}.",
    )
    return None if given is None else tuple(given)


def time_word(given: Any) -> str | None:
    """A unit of time.

    Raises:
        ValueError: unless it is a string that is not blank, or None.
    """
    good = given is None or (isinstance(given, str) and bool(given.strip()))
    require(good, f'time_unit must be a string, such as "ms"; got {given!r}.')
    return given


def check_labels(names: Any, units: Any) -> None:
    """Raise a ValueError unless the names are all different, and the units as many."""
    if names is not None:
        require(len(set(names)) == len(names), f"names must be different from each other; got {names!r}.")
        require("" not in names, f"names must not be empty; got {names!r}.")
    if units is not None and names is not None:
        message = f"There must be as many units as names, {len(names)}; got {len(units)}: {units!r}."
        require(len(units) == len(names), message)


def labels_of(system: Any, shape: tuple[int, ...]) -> Labels:
    """The labels of a system whose state has this shape.

    Raises:
        ValueError: where there are more or fewer names than components.
    """
    n, rows = shape[-1], len(shape) > 1
    for word, given in (("names", system.names), ("units", system.units)):
        what = f"d = {n} columns of the state, which has one row a body" if rows else f"n = {n} components of the state"
        fits = given is None or len(given) == n
        require(fits, f"{word} must have one entry for each of the {what}; got {len(given or ())}: {given!r}.")
    return Labels(system.names or (), system.units or (), rows, system.time_unit or "")


def unlabelled(system: Any) -> Any:
    """The system without names and units: they change nothing of what is computed, and compile nothing."""
    given = [word for word in ("names", "units", "time_unit") if getattr(system, word) is not None]
    if not given:
        return system
    plain = copy.copy(system)
    for word in given:
        object.__setattr__(plain, word, None)  # static: no leaf, which `equinox.tree_at` could replace
    return plain
