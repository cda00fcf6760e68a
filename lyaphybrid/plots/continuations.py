"""Figures of branches of periodic orbits and of bifurcation curves; public in `plots`."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._text import per_unit
from .axes import COLOURS, Axes, axes_of, both_axes, component, drawn_whole, ink, styled, varying
from .sweep_arrays import label

__all__ = ["continuation", "curves"]

MARKS = {
    "fold": ("s", COLOURS[1]),
    "pitchfork": ("^", COLOURS[2]),
    "transcritical": ("v", COLOURS[2]),
    "period doubling": ("D", COLOURS[3]),
    "Neimark–Sacker": ("o", COLOURS[4]),
    "Hopf": ("*", COLOURS[5]),
    "boundary equilibrium": ("P", COLOURS[5]),
    "grazing": ("X", None),  # in ink
    "border collision": ("h", None),
}
CURVE_STYLES = {
    "fold": (COLOURS[1], "-"),
    "pitchfork": (COLOURS[2], "-"),
    "transcritical": (COLOURS[2], "--"),
    "period doubling": (COLOURS[3], "-"),
    "Neimark–Sacker": (COLOURS[4], "-"),
    "grazing": (None, "-"),  # in ink
    "edge": (None, "--"),
    "border": (None, ":"),
}
SPECIAL_MARKERS = {
    "cusp": "^",
    "fold–flip": "s",
    "1:1 resonance": "o",
    "1:2 resonance": "D",
    "1:3 resonance": "v",
    "1:4 resonance": "P",
    "Hopf": "*",
    "grazing": "X",
}
MARGIN = 1e-5  # tolerance for a multiplier of 1 at the end of a stable stretch
BRANCH_COLOURS = (COLOURS[0], None, COLOURS[5])  # colours of branches, used cyclically; None: grey


@drawn_whole
def continuation(
    branches: Any, axes: Sequence[Axes] | None = None, i: int | None = None, **style: Any
) -> Sequence[Axes]:
    """Branches of periodic orbits: the largest value of a component over each orbit, and below it the exponents.

    Lines are full where the orbits attract, else dashed. Exponents of −∞ are not drawn.

    Args:
        branches: a `Continuation`, or several of the same parameter.
        axes: two matplotlib axes; None: those of a new figure.
        i: index of the component; None: the first whose largest value varies, as one that a stop bounds does not.
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
    i = varying(np.asarray(branches[0].largest)) if i is None else i
    lower.axhline(0.0, color=ink(lower, 0.6), linewidth=0.8, zorder=0)
    for number, branch in enumerate(branches):
        colour = BRANCH_COLOURS[number % len(BRANCH_COLOURS)] or ink(upper, 0.35)
        exponents = np.where(np.isfinite(branch.exponents), branch.exponents, np.nan)
        place = component("i", i, branch.largest.shape[1])
        _lines(upper, branch, branch.largest[:, [place]], colour, style)
        _lines(lower, branch, exponents, colour, style)
        _marks(axes, branch, i)
    upper.set_ylabel(f"largest {branches[0].state_labels.axis(i)} of the orbit")
    lower.set_ylabel("exponents λ" + per_unit(branches[0].state_labels.time_unit))
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
        if special.kind not in ("grazing", "border collision", "boundary equilibrium"):
            lower.plot(special.parameter, 0.0, **style)


@drawn_whole
def curves(found: Any, ax: Axes | None = None, **style: Any) -> Axes:
    """Bifurcation curves in the plane of their parameters, alone or over a map of a sweep.

    The first parameter is along x, or, on axes that carry the names of both already, where its name stands. Each kind
    has its colour, each kind of special point its marker.

    Args:
        found: a `BifurcationCurve`, or several with the same two parameters, in either order.
        ax: matplotlib axes, such as those of `sweep_map`, which keep their limits; None: those of a new figure.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes.

    Raises:
        ValueError: where the curves have other parameters.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> cubic = lh.Map(lambda n, x, args: args["a"] + (1 + args["b"]) * x - x**3)
        >>> args = {"a": 0.0, "b": 0.75}
        >>> branch = lh.continuation(cubic, [0.9], args, over={"a": (-1.0, 1.0)}, period=1)
        >>> over = {"a": (-1.0, 1.0), "b": (-0.5, 1.0)}
        >>> fold = lh.bifurcation_curve(cubic, branch.of_kind("fold")[0], args, over=over, period=1)
        >>> ax = lh.plots.curves(fold)
        >>> ax.get_xlabel(), [text.get_text() for text in ax.get_legend().get_texts()]
        ('a', ['fold', 'cusp'])
        >>> pyplot.close(ax.figure)
    """
    found = [found] if hasattr(found, "orbits") else list(found)
    drawn_before = ax is not None and ax.has_data()
    ax = axes_of(ax, (6.0, 4.6))
    x, y = _order(ax, found)
    limits = ax.get_xlim(), ax.get_ylim()
    for curve in found:
        if set(curve.parameters) != {x, y}:
            raise ValueError(
                f"All curves must be in the plane of {x} and {y}; got one of {' and '.join(curve.parameters)}."
            )
        columns = [curve.parameters.index(name) for name in (x, y)]
        colour, kind = CURVE_STYLES[curve.kind]
        look = styled("line", style, color=colour or ink(ax), linestyle=kind, linewidth=1.4, label=curve.kind)
        ax.plot(*curve.values[:, columns].T, **look)
        for special in curve.specials:
            place = {"marker": SPECIAL_MARKERS[special.kind], "linestyle": "none", "label": special.kind}
            at = np.asarray(special.values)[columns]
            ax.plot(*at, **place, color=look["color"], markersize=6, mec=ink(ax, 1.0), zorder=4)
    if drawn_before:
        ax.set(xlim=limits[0], ylim=limits[1])
    ax.set(xlabel=ax.get_xlabel() or label(x), ylabel=ax.get_ylabel() or label(y))
    _legend(ax)
    return ax


def _order(ax: Axes, found: list) -> tuple[str, str]:
    """Which parameter is along which axis."""
    first, second = found[0].parameters
    turned = label(second) == ax.get_xlabel() and label(first) == ax.get_ylabel()
    return (second, first) if turned else (first, second)


def _legend(ax) -> None:
    """A legend above the axes with each kind once."""
    handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    if handles:
        outside = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        ax.legend(handles.values(), handles.keys(), frameon=False, ncols=min(len(handles), 5), **outside)
