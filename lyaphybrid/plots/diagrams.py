"""Pictures of sections and bifurcation diagrams; public in `plots`."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..statuses import OK, STATUS
from .axes import COLOURS, Axes, axes_of, both_axes

__all__ = ["bifurcations", "diagram", "largest_exponent", "section"]

# Later dots are drawn smaller, so that earlier ones below them stay visible.
DOTS = {"random": ("0.25", 2.4), "up": (COLOURS[0], 1.5), "down": (COLOURS[1], 0.7)}
NAMES = {"random": "random starts", "up": "followed up", "down": "followed down"}


def section(points: Any, ax: Axes | None = None, i: int = 0, j: int = 1) -> Axes:
    """The points of a Poincaré section: component j against i (with one component, the next point against each).

    Args:
        points: a `PoincareSection`.
        ax: matplotlib axes; None: those of a new figure.
        i: index of the component on the horizontal axis.
        j: index of the component on the vertical axis.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> ax = lh.plots.section(lh.poincare_section(henon, [0.1, 0.2], 1.4, period=1, n=20))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('$x_{0}$', '$x_{1}$')
        >>> pyplot.close(ax.figure)
    """
    ax = axes_of(ax)
    x = np.asarray(points.x).reshape(len(points.x), -1)
    next_one = x.shape[1] == 1
    across, upwards = (x[:-1, 0], x[1:, 0]) if next_one else (x[:, i], x[:, j])
    ax.plot(across, upwards, linestyle="none", marker=".", markersize=2, mew=0, color=COLOURS[0], rasterized=True)
    labels = points.state_labels
    ax.set_xlabel(f"this point's {labels.axis(0)}" if next_one else labels.axis(i))
    ax.set_ylabel(f"the next point's {labels.axis(0)}" if next_one else labels.axis(j))
    return ax


def bifurcations(result: Any, ax: Axes | None = None, i: int = 0) -> Axes:
    """The last points of every run against the parameter; angles from −π to π.

    Args:
        result: a `BifurcationDiagram`.
        ax: matplotlib axes; None: those of a new figure.
        i: index of the component.

    Returns:
        The axes.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.bifurcation_diagram(
        ...     logistic, [[0.1], [0.9]], {"r": 0.0}, over={"r": [2.8, 3.2]}, t1=100, transient=50, samples=16
        ... )
        >>> ax = lh.plots.bifurcations(found)
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('r', '$x_{0}$')
        >>> pyplot.close(ax.figure)
    """
    ax = axes_of(ax, (7.2, 4.4))
    heights = result.points[..., i]
    if i in result.angles:
        heights = np.pi - np.mod(np.pi - heights, 2 * np.pi)
        ax.set_yticks([-np.pi, 0.0, np.pi], ["−π", "0", "π"])
        ax.set_ylim(-1.05 * np.pi, 1.05 * np.pi)
    smaller = min(1.0, np.sqrt(100 / len(result.values)))
    for kind, columns in _by_kind(result):
        colour, size = DOTS[kind]
        values = np.broadcast_to(result.values[:, None, None], heights[:, columns].shape)
        dots = {"linestyle": "none", "marker": "o", "markersize": smaller * size, "mew": 0, "rasterized": True}
        ax.plot(values.ravel(), heights[:, columns].ravel(), color=colour, label=NAMES[kind], **dots)
    ax.set_xlabel(result.parameter)
    ax.set_ylabel(result.state_labels.axis(i) + (" mod 2π" if i in result.angles else ""))
    _legend(ax, result)
    return ax


def largest_exponent(result: Any, ax: Axes | None = None) -> Axes:
    """The largest exponent of every run against the parameter, with error bars of one standard error.

    Coexisting attractors are dots at the same value; runs followed up and down are joined by lines. A cross at the
    bottom marks a failed run.

    Args:
        result: a `BifurcationDiagram`.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.bifurcation_diagram(
        ...     logistic, [[0.1], [0.9]], {"r": 0.0}, over={"r": [2.8, 3.2]}, t1=100, transient=50, samples=16
        ... )
        >>> ax = lh.plots.largest_exponent(found)
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('r', 'largest exponent λ$_1$')
        >>> pyplot.close(ax.figure)
    """
    ax = axes_of(ax, (7.2, 3.4))
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    exponents, errors = result.exponents[..., 0], result.stderr[..., 0]
    exponents = np.where(np.isfinite(exponents), exponents, np.nan)
    errors = np.where(np.isfinite(errors), errors, 0.0)
    for kind, columns in _by_kind(result):
        colour, _ = DOTS[kind]
        for column in columns:
            label = NAMES[kind] if column == columns[0] else None
            style = {"fmt": "o", "markersize": 2.4, "mew": 0, "zorder": 3}
            if kind != "random":
                style = {"fmt": "-", "linewidth": 0.9, "zorder": 2}
            bars = {"elinewidth": 0.6, "ecolor": colour, "color": colour}
            ax.errorbar(result.values, exponents[:, column], errors[:, column], label=label, **style, **bars)
    failed = np.any((result.status != OK) & (result.status != int(STATUS.terminated)), axis=1)
    if np.any(failed):
        where = {"transform": ax.get_xaxis_transform(), "clip_on": False}
        ax.plot(result.values[failed], np.full(np.sum(failed), 0.02), "x", color=COLOURS[1], markersize=4, **where)
    ax.set_xlabel(result.parameter)
    ax.set_ylabel("largest exponent λ$_1$")
    _legend(ax, result)
    return ax


def diagram(result: Any, axes: Sequence[Axes] | None = None, i: int = 0) -> Sequence[Axes]:
    """The points of a bifurcation diagram, and below them the largest exponent.

    Args:
        result: a `BifurcationDiagram`.
        axes: two matplotlib axes; None: those of a new figure.
        i: index of the component.

    Returns:
        Both axes.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.bifurcation_diagram(
        ...     logistic, [[0.1], [0.9]], {"r": 0.0}, over={"r": [2.8, 3.2]}, t1=100, transient=50, samples=16
        ... )
        >>> axes = lh.plots.diagram(found)
        >>> [ax.get_ylabel() for ax in axes]
        ['$x_{0}$', 'largest exponent λ$_1$']
        >>> pyplot.close(axes[0].figure)
    """
    axes = both_axes(axes, (7.2, 6.6), height_ratios=(3, 2))
    upper, lower = axes
    bifurcations(result, upper, i)
    largest_exponent(result, lower)
    upper.set_xlabel("")
    legend = lower.get_legend()
    if legend is not None:
        legend.remove()
    return upper, lower


def _by_kind(result):
    """(kind, columns) in the order of drawing."""
    found = [(kind, [c for c, own in enumerate(result.kinds) if own == kind]) for kind in DOTS]
    return [(kind, columns) for kind, columns in found if columns]


def _legend(ax, result) -> None:
    if len(set(result.kinds)) > 1:
        outside = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        ax.legend(frameon=False, ncols=3, markerscale=3, **outside)
