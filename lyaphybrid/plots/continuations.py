"""The figure of branches of periodic orbits; public as `plots.continuation`."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .axes import COLOURS, Axes, both_axes, component, ink, styled

__all__ = ["continuation"]

MARKS = {
    "fold": ("s", COLOURS[1]),
    "pitchfork": ("^", COLOURS[2]),
    "transcritical": ("v", COLOURS[2]),
    "period doubling": ("D", COLOURS[3]),
    "Neimark–Sacker": ("o", COLOURS[4]),
    "grazing": ("X", None),  # in ink
}
MARGIN = 1e-5  # tolerance for a multiplier of 1 at the end of a stable stretch
BRANCH_COLOURS = (COLOURS[0], None, COLOURS[5])  # colours of branches, used cyclically; None: grey


def continuation(branches: Any, axes: Sequence[Axes] | None = None, i: int = 0, **style: Any) -> Sequence[Axes]:
    """Branches of periodic orbits: the largest value of a component over each orbit, and below it the exponents.

    Lines are full where the orbits attract, else dashed. Exponents of −∞ are not drawn.

    Args:
        branches: a `Continuation`, or several of the same parameter.
        axes: two matplotlib axes; None: those of a new figure.
        i: index of the component.
        **style: of the lines, as matplotlib takes it.

    Returns:
        Both axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.continuation(henon, [0.6, 0.2], 0.3, over={"args": (0.2, 0.5)}, period=1)
        >>> axes = lh.plots.continuation(found)
        >>> [ax.get_ylabel() for ax in axes]
        ['largest $x_{0}$ of the orbit', 'exponents λ']
        >>> pyplot.close(axes[0].figure)
    """
    branches = [branches] if hasattr(branches, "orbits") else list(branches)
    axes = both_axes(axes, (7.2, 6.6), height_ratios=(3, 2))
    upper, lower = axes
    lower.axhline(0.0, color=ink(lower, 0.6), linewidth=0.8, zorder=0)
    for number, branch in enumerate(branches):
        colour = BRANCH_COLOURS[number % len(BRANCH_COLOURS)] or ink(upper, 0.35)
        exponents = np.where(np.isfinite(branch.exponents), branch.exponents, np.nan)
        place = component("i", i, branch.largest.shape[1])
        _lines(upper, branch, branch.largest[:, [place]], colour, style)
        _lines(lower, branch, exponents, colour, style)
        _marks(axes, branch, i)
    upper.set_ylabel(f"largest {branches[0].state_labels.axis(i)} of the orbit")
    lower.set_ylabel("exponents λ")
    lower.set_xlabel(branches[0].parameter)
    _legend(upper)
    return upper, lower


def _lines(ax, branch, heights, colour, own) -> None:
    """Full lines where both ends of a segment are stable or at the limit of stability; dashed ones elsewhere."""
    attracts = np.max(np.abs(branch.multipliers), axis=1) < 1 + MARGIN
    both = attracts[:-1] & attracts[1:]
    edges = np.flatnonzero(both[1:] != both[:-1]) + 1
    for first, last in zip([0, *edges], [*edges, len(both)], strict=True):
        kind = "-" if np.any(both[first:last]) else "--"
        stretch = slice(first, last + 1)
        look = styled("line", own, linestyle=kind, color=colour, linewidth=1.3)
        ax.plot(branch.values[stretch], heights[stretch], **look)


def _marks(axes, branch, i: int) -> None:
    """Markers of special points, on the lines of the orbits and of the exponents that vanish there."""
    upper, lower = axes
    for special in branch.specials:
        marker, colour = MARKS[special.kind]
        colour = colour or ink(upper)
        style = {"linestyle": "none", "marker": marker, "color": colour, "markersize": 6, "mec": "white", "zorder": 4}
        upper.plot(special.parameter, special.largest[i], label=special.kind, **style)
        if special.kind != "grazing":
            lower.plot(special.parameter, 0.0, **style)


def _legend(ax) -> None:
    """A legend above the axes with each kind once."""
    handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    if handles:
        outside = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        ax.legend(handles.values(), handles.keys(), frameon=False, ncols=len(handles), **outside)
