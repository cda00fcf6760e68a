"""The picture of branches of periodic orbits; `plots` hands it on."""

from typing import Any

import numpy as np

from .axes import COLOURS

__all__ = ["continuation"]

MARKS = {
    "fold": ("s", COLOURS[1]),
    "pitchfork": ("^", COLOURS[2]),
    "transcritical": ("v", COLOURS[2]),
    "period doubling": ("D", COLOURS[3]),
    "Neimark–Sacker": ("o", COLOURS[4]),
    "grazing": ("X", COLOURS[6]),
}
MARGIN = 1e-5  # by which a multiplier of 1 may be larger
SHADES = (COLOURS[0], "0.35", COLOURS[5])  # of branches; more begin again


def continuation(branches: Any, axes=None, i: int = 0):
    """Branches of periodic orbits: the largest value of a component over each orbit, and below it the exponents.

    Lines are full where the orbits attract, else dashed. Exponents of −∞ are not drawn.

    Args:
        branches: a `Continuation`, or several of the same parameter.
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
    for number, branch in enumerate(branches):
        colour = SHADES[number % len(SHADES)]
        exponents = np.where(np.isfinite(branch.exponents), branch.exponents, np.nan)
        _lines(upper, branch, branch.largest[:, i : i + 1], colour)
        _lines(lower, branch, exponents, colour)
        _marks(axes, branch, i)
    upper.set_ylabel(f"largest $x_{{{i + 1}}}$ of the orbit")
    lower.set_ylabel("exponents λ")
    lower.set_xlabel(branches[0].parameter)
    _legend(upper)
    return upper, lower


def _lines(ax, branch, heights, colour) -> None:
    """Full lines where both ends of a stretch attract, or are about to lose that; dashed ones elsewhere."""
    attracts = np.max(np.abs(branch.multipliers), axis=1) < 1 + MARGIN
    both = attracts[:-1] & attracts[1:]
    edges = np.flatnonzero(both[1:] != both[:-1]) + 1
    for first, last in zip([0, *edges], [*edges, len(both)], strict=True):
        style = "-" if np.any(both[first:last]) else "--"
        stretch = slice(first, last + 1)
        ax.plot(branch.values[stretch], heights[stretch], style, color=colour, linewidth=1.3)


def _marks(axes, branch, i: int) -> None:
    """The special points, on the lines of the orbits and on those of the exponents that vanish there."""
    upper, lower = axes
    for special in branch.specials:
        marker, colour = MARKS[special.kind]
        style = {"linestyle": "none", "marker": marker, "color": colour, "markersize": 6, "mec": "white", "zorder": 4}
        upper.plot(special.parameter, special.largest[i], label=special.kind, **style)
        if special.kind != "grazing":
            lower.plot(special.parameter, 0.0, **style)


def _legend(ax) -> None:
    """Each kind once, above the axes."""
    handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    if handles:
        outside = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        ax.legend(handles.values(), handles.keys(), frameon=False, ncols=len(handles), **outside)
