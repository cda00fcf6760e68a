"""The picture of a branch of periodic orbits; `plots` hands it on."""

from typing import Any

import numpy as np

from ._axes import COLOURS

__all__ = ["continuation"]

MARKS = {
    "fold": ("s", COLOURS[1]),
    "pitchfork": ("^", COLOURS[2]),
    "transcritical": ("v", COLOURS[2]),
    "period doubling": ("D", COLOURS[3]),
    "Neimark–Sacker": ("o", COLOURS[4]),
    "grazing": ("X", COLOURS[6]),
}


def continuation(branches: Any, axes=None, i: int = 0):
    """Branches of periodic orbits: the largest value of a component over each orbit, and below the exponents.

    Where orbits are stable the lines are full, else dashed. Exponents of −∞ are not drawn.

    Args:
        branches: a `Continuation`, or several.
        axes: two matplotlib axes; None: those of a new figure.
        i: index of the component.

    Returns:
        Both axes.
    """
    branches = [branches] if hasattr(branches, "orbits") else list(branches)
    if axes is None:
        from matplotlib import pyplot

        shape = {"height_ratios": (3, 2), "sharex": True}
        axes = pyplot.subplots(2, 1, figsize=(7.2, 6.6), layout="constrained", **shape)[1]
    upper, lower = axes
    lower.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    for branch, colour in zip(branches, _shades(len(branches)), strict=True):
        exponents = np.where(np.isfinite(branch.exponents), branch.exponents, np.nan)
        _lines(upper, branch, branch.largest[:, i : i + 1], colour)
        _lines(lower, branch, exponents, colour)
    _marks(axes, branches, i)
    upper.set_ylabel(f"largest $x_{{{i + 1}}}$")
    lower.set_ylabel("exponents of the orbit")
    lower.set_xlabel(branches[0].parameter)
    return upper, lower


def _shades(count: int) -> list:
    return [COLOURS[0], "0.25", COLOURS[5]][:count] if count < 4 else [COLOURS[0]] * count


def _lines(ax, branch, heights, colour) -> None:
    """Full lines where both ends of a stretch are stable, dashed ones elsewhere."""
    both = branch.stable[:-1] & branch.stable[1:]
    edges = np.flatnonzero(np.diff(both)) + 1
    for first, last in zip([0, *edges], [*edges, len(both)], strict=True):
        stretch = slice(first, last + 1)
        style = "-" if both[first] else "--"
        ax.plot(branch.values[stretch], heights[stretch], style, color=colour, linewidth=1.2)


def _marks(axes, branches, i: int) -> None:
    """The special points, once each kind in the legend."""
    raise NotImplementedError
