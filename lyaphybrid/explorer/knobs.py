"""What can be varied: the numbers in args and the entries of the start, each with its range and what it is called."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._arguments import is_number, require
from .._entries import ArgsEntry, described, entries, entry_named
from ..systems.labels import Labels

__all__ = ["Knob", "knobs_of", "replaced"]

SLIDERS_SHOWN = 40  # sliders that are made unasked
# A positive value that is this factor from 1 gets a logarithmic scale, over as large a factor to both sides.
FAR_FROM_ONE = 100.0


class Knob(NamedTuple):
    """One number that can be varied.

    Attributes:
        name: "rho", "spring.rate", "rates[2]" of args, or "x0[1]" of the start.
        label: what it is called, with its unit.
        value: at the beginning.
        low, high: the range.
        logarithmic: whether its logarithm is varied evenly.
        place: an `ArgsEntry`, or the index of a component of x0.
    """

    name: str
    label: str
    value: float
    low: float
    high: float
    logarithmic: bool
    place: ArgsEntry | int


def knobs_of(args: Any, x0: np.ndarray, labels: Labels, over: Any, extent: np.ndarray) -> tuple[Knob, ...]:
    """The knobs of parameters and of a flat start x0 (n,).

    Args:
        args: pytree of parameters.
        x0: (n,) start.
        labels: of its components.
        over: None, names, or {name: (low, high)}; see `explore`.
        extent: (n,) how far the motion goes in each component: the range of starts.

    Raises:
        ValueError: on names that are not there, and ranges that are none.
    """
    of_start = {f"x0[{i}]": i for i in range(len(x0))}
    if over is None:
        scalars = [name for name, entry in entries(args).items() if _is_real(entry.of(args))]
        chosen = dict.fromkeys([*scalars, *of_start][:SLIDERS_SHOWN])
    else:
        chosen = _chosen(over)
    made = []
    for name, asked in chosen.items():
        place = of_start[name] if name in of_start else _number_named(args, name, of_start)
        if isinstance(place, int):
            value, label = float(x0[place]), f"start {_with_unit(labels, place)}"
            low, high, logarithmic = value - extent[place], value + extent[place], False
        else:
            value, label = float(place.of(args)), name
            low, high, logarithmic = _range_around(value)
        if asked is not None:
            (low, high), logarithmic = _checked(name, asked), False
        ends = min(low, value), max(high, value)
        made.append(Knob(name, label, value, *ends, logarithmic, place))
    return tuple(made)


def replaced(args: Any, x0: np.ndarray, knobs: Sequence[Knob], values: Mapping[str, float]) -> tuple[Any, np.ndarray]:
    """The parameters and the start (n,) with these values of the knobs.

    Every number that has a knob becomes a float, so that it may be any.
    """
    x0 = np.array(x0)
    for knob in knobs:
        value = float(values[knob.name])
        if isinstance(knob.place, int):
            x0[knob.place] = value
        else:
            args = knob.place.placed(args, value)
    return args, x0


def _number_named(args: Any, name: str, others: Iterable[str]) -> ArgsEntry:
    entry = entry_named(args, name)
    if entry is None or not _is_real(entry.of(args)):
        there = f"{described(args)}, {', '.join(others)}"
        raise ValueError(f"over names {name!r}, which is none of what can be varied: {there}.")
    return entry


def _is_real(value: Any) -> bool:
    return is_number(value) and math.isfinite(value)


def _with_unit(labels: Labels, i: int) -> str:
    unit = labels.units[i % len(labels.units)] if labels.units else ""
    return labels.name(i) + (f" ({unit})" if unit else "")


def _range_around(value: float) -> tuple[float, float, bool]:
    """(low, high, logarithmic): from 0 to twice the value, by factors where the value is very small or large."""
    if value > 0 and not 1 / FAR_FROM_ONE < value < FAR_FROM_ONE:
        return value / FAR_FROM_ONE, value * FAR_FROM_ONE, True
    far = 2 * value if value else 1.0
    return (min(0.0, far), max(0.0, far), False) if value else (-far, far, False)


def _chosen(over: Any) -> dict[str, Any]:
    """{name: range or None} of what was asked for."""
    if isinstance(over, Mapping):
        return dict(over)
    names = (over,) if isinstance(over, str) else over
    good = isinstance(names, Sequence) and all(isinstance(name, str) for name in names)
    require(good, f'over must be names, or {{name: (low, high)}}, such as {{"rho": (0, 60)}}; got {over!r}.')
    return dict.fromkeys(names)


def _checked(name: str, asked: Any) -> tuple[float, float]:
    """The two ends of a range."""
    good = isinstance(asked, Sequence) and len(asked) == 2 and all(map(_is_real, asked)) and asked[0] < asked[1]
    require(good, f"The range of {name} in over must be (low, high), or None for one that is chosen; got {asked!r}.")
    return float(asked[0]), float(asked[1])
