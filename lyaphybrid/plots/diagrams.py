"""Pictures of sections and bifurcation diagrams; public in `plots`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _renamed as renamed
from .._text import per_unit, with_unit
from ..statuses import OK, STATUS
from .axes import COLOURS, Axes, Figures, axes_of, both_axes, colours, component, drawn_whole, ink, styled, varying
from .sweep_arrays import edges

if TYPE_CHECKING:
    from ..analysis.basins import Basins, BasinShares
    from ..sweeps import AngleField, FTLEField

__all__ = [
    "angle_field",
    "basin_shares",
    "basins",
    "bifurcations",
    "diagram",
    "ftle_field",
    "largest_exponent",
    "section",
]

AREA_OF_DOTS = 2e4  # of all dots of a field together, in square points
# Later dots are drawn smaller, so that earlier ones below them stay visible.
DOTS = {"random": (None, 2.4), "up": (COLOURS[0], 1.5), "down": (COLOURS[1], 0.7)}
NAMES = {"random": "random starts", "up": "followed up", "down": "followed down"}


@drawn_whole
def section(points: Any, ax: Axes | None = None, i: int = 0, j: int = 1, **style: Any) -> Axes:
    """The points of a Poincaré section: component j against i (with one component, the next point against each).

    Args:
        points: a `PoincareSection`.
        ax: matplotlib axes; None: those of a new figure.
        i: index of the component on the horizontal axis.
        j: index of the component on the vertical axis.
        **style: of the dots, as matplotlib takes it.

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
    n = x.shape[1]
    across, upwards = (x[:-1, 0], x[1:, 0]) if next_one else (x[:, component("i", i, n)], x[:, component("j", j, n)])
    usual = {"linestyle": "none", "marker": ".", "markersize": 2, "mew": 0, "color": COLOURS[0], "rasterized": True}
    ax.plot(across, upwards, **styled("line", style, **usual))
    labels = points.state_labels
    ax.set_xlabel(f"this point's {labels.axis(0)}" if next_one else labels.axis(i))
    ax.set_ylabel(f"the next point's {labels.axis(0)}" if next_one else labels.axis(j))
    return ax


@drawn_whole
def bifurcations(result: Any, ax: Axes | None = None, i: int | None = None, **style: Any) -> Axes:
    """The last points of every run against the parameter; angles from −π to π.

    Args:
        result: a `BifurcationDiagram`.
        ax: matplotlib axes; None: those of a new figure.
        i: index of the component; None: the first that varies, as one on a section does not.
        **style: of the dots, as matplotlib takes it.

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
    i = varying(np.asarray(result.points)) if i is None else i
    heights = result.points[..., component("i", i, result.points.shape[-1])]
    if i in result.angles:
        heights = np.pi - np.mod(np.pi - heights, 2 * np.pi)
        ax.set_yticks([-np.pi, 0.0, np.pi], ["−π", "0", "π"])
        ax.set_ylim(-1.05 * np.pi, 1.05 * np.pi)
    smaller = min(1.0, np.sqrt(100 / len(result.values)))
    for kind, columns in _by_kind(result):
        colour, size = DOTS[kind]
        colour = colour or ink(ax, 0.25)
        values = np.broadcast_to(result.values[:, None, None], heights[:, columns].shape)
        dots = {"linestyle": "none", "marker": "o", "markersize": smaller * size, "mew": 0, "rasterized": True}
        look = styled("line", style, color=colour, label=NAMES[kind], **dots)
        ax.plot(values.ravel(), heights[:, columns].ravel(), **look)
    ax.set_xlabel(result.parameter)
    ax.set_ylabel(result.state_labels.axis(i) + (" mod 2π" if i in result.angles else ""))
    _legend(ax, result)
    return ax


@drawn_whole
def largest_exponent(result: Any, ax: Axes | None = None, **style: Any) -> Axes:
    """The largest exponent of every run against the parameter, with error bars of one standard error.

    Coexisting attractors are dots at the same value; runs followed up and down are joined by lines. At the bottom a
    triangle marks an exponent of −∞, and a cross a failed run.

    Args:
        result: a `BifurcationDiagram`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the lines and points, as matplotlib takes it.

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
    ax.axhline(0.0, color=ink(ax, 0.6), linewidth=0.8, zorder=0)
    exponents, errors = result.exponents[..., 0], result.stderr[..., 0]
    lost = np.any(np.isneginf(exponents), axis=1)
    exponents = np.where(np.isfinite(exponents), exponents, np.nan)
    errors = np.where(np.isfinite(errors), errors, 0.0)
    for kind, columns in _by_kind(result):
        colour = DOTS[kind][0] or ink(ax, 0.25)
        for column in columns:
            label = NAMES[kind] if column == columns[0] else None
            usual: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 2.4, "mew": 0, "zorder": 3}
            if kind != "random":
                usual = {"linewidth": 0.9, "zorder": 2}
            bars = {"elinewidth": 0.6, "ecolor": colour}
            look = bars | styled("line", style, color=colour, label=label, **usual)
            ax.errorbar(result.values, exponents[:, column], errors[:, column], **look)
    failed = np.any((result.status != OK) & (result.status != int(STATUS.terminated)), axis=1)
    where: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "clip_on": False, "linestyle": "none"}
    for at, marker, colour in ((failed, "x", COLOURS[1]), (lost & ~failed, "v", ink(ax, 0.3))):
        if np.any(at):
            ax.plot(result.values[at], np.full(np.sum(at), 0.02), marker=marker, color=colour, markersize=4, **where)
    if np.any(lost & ~failed):
        first, beside = result.values[lost & ~failed][0], {"xytext": (0, 4), "textcoords": "offset points"}
        ax.annotate("−∞", (first, 0.02), xycoords=ax.get_xaxis_transform(), ha="center", fontsize="small", **beside)
    ax.set_xlabel(result.parameter)
    ax.set_ylabel("largest exponent λ$_1$" + per_unit(result.state_labels.time_unit))
    _legend(ax, result)
    return ax


@drawn_whole
def diagram(result: Any, axes: Sequence[Axes] | None = None, i: int | None = None, **style: Any) -> Sequence[Axes]:
    """The points of a bifurcation diagram, and below them the largest exponent.

    Args:
        result: a `BifurcationDiagram`.
        axes: two matplotlib axes; None: those of a new figure.
        i: index of the component; None: the first that varies, as one on a section does not.
        **style: of the dots of the points, as matplotlib takes it.

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
    bifurcations(result, upper, i, **style)
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


class DiagramPlots(Figures):
    """The figures of a bifurcation diagram: ``diagram.plot()``, and ``.bifurcations()``, ``.largest_exponent()``."""

    def __init__(self, result: Any):
        self._result = result

    def __call__(self, ax: Sequence[Axes] | None = None, i: int | None = None, **style: Any) -> Sequence[Axes]:
        """Component i of the points, and below it the largest exponent, against the parameter, on two axes."""
        if "axes" in style:
            renamed.warn("BifurcationDiagram.plot(axes=…)", "ax=")
            ax = style.pop("axes")
        return diagram(self._result, ax, i, **style)

    def bifurcations(self, ax: Axes | None = None, i: int | None = None, **style: Any) -> Axes:
        """`plots.bifurcations` of it."""
        return bifurcations(self._result, ax, i, **style)

    def largest_exponent(self, ax: Axes | None = None, **style: Any) -> Axes:
        """`plots.largest_exponent` of it."""
        return largest_exponent(self._result, ax, **style)


@drawn_whole
def basins(found: "Basins", ax: Axes | None = None, **style: Any) -> Axes:
    """The classes of starts over a grid of two components; what is no attractor is grey.

    Args:
        found: of `lh.basins`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the map, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> wells = lh.Flow(lambda t, x, a: jnp.stack([x[1], x[0] - x[0] ** 3 - 0.5 * x[1]]))
        >>> ax = lh.plots.basins(lh.basins(wells, [[-2.0, -1.0], [2.0, 1.0]], shape=(20, 10), t1=80.0))
        >>> pyplot.close(ax.figure)
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    ax = axes_of(ax)
    (first, across), (second, up) = found.axes.items()
    paint = _of_classes(found.names, ax)
    look = {"cmap": ListedColormap(paint), "vmin": -0.5, "vmax": len(paint) - 0.5, "rasterized": True}
    ax.pcolormesh(across, up, found.labels.T, **(look | style))
    for attractor, colour in zip(found.attractors, paint, strict=False):
        ax.plot(attractor.points[:, first], attractor.points[:, second], ".", color=ink(ax, 1.0), markersize=5)
        ax.plot(attractor.points[:, first], attractor.points[:, second], ".", color=colour, markersize=2)
    marks = [Patch(facecolor=colour, label=name) for name, colour in zip(found.names, paint, strict=True)]
    ax.legend(handles=marks, fontsize="small", loc="upper right")
    ax.set_xlim(*edges(across)[[0, -1]])  # to the borders of the outermost cells
    ax.set_ylim(*edges(up)[[0, -1]])
    ax.set_xlabel(found.state_labels.axis(first))
    ax.set_ylabel(found.state_labels.axis(second))
    return ax


def _of_classes(names: Sequence[str], ax: Axes) -> list:
    """A colour for each attractor, and greys for other classes."""
    count = sum(name.startswith("attractor") for name in names)
    others = len(names) - count
    return [*colours(count, ax), *(str(0.35 + 0.5 * i / max(1, others)) for i in range(others))]


@drawn_whole
def basin_shares(found: "BasinShares", ax: Axes | None = None, **style: Any) -> Axes:
    """The parts of a box that lead to each attractor along a parameter, one above the other; others are grey.

    Args:
        found: of `lh.basin_shares`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the areas, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax, jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> tilted = lh.Flow(lambda t, x, a: x - x**3 + a["tilt"])
        >>> how = {"over": {"tilt": [0.0, 0.2]}, "t1": 60.0, "starts": 100, "key": jax.random.key(0)}
        >>> ax = lh.plots.basin_shares(lh.basin_shares(tilted, [[-1.5], [1.5]], {"tilt": 0.0}, **how))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('tilt', 'share of the starts')
        >>> pyplot.close(ax.figure)
    """
    ax = axes_of(ax)
    paint = _of_classes(found.names, ax)
    ax.stackplot(found.values, found.shares.T, **({"labels": found.names, "colors": paint, "linewidth": 0} | style))
    ax.legend(fontsize="small", loc="upper right")
    ax.set_xlabel(found.parameter)
    ax.set_ylabel("share of the starts")
    ax.set_xlim(found.values[0], found.values[-1])
    ax.set_ylim(0.0, 1.0)
    return ax


@drawn_whole
def ftle_field(found: "FTLEField", ax: Axes | None = None, exponent: int = 1, **style: Any) -> Axes:
    """A finite-time exponent over a grid of two components, with a colour bar; where a run failed the axes show.

    Args:
        found: of `lh.ftle_field`.
        ax: matplotlib axes; None: those of a new figure.
        exponent: which one, from 1, the largest.
        **style: of the map, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> pendulum = lh.Flow(lambda t, x, a: jnp.stack([x[1], -jnp.sin(x[0])]), names=("θ", "ω"))
        >>> ax = lh.plots.ftle_field(lh.ftle_field(pendulum, [[-3.0, -2.0], [3.0, 2.0]], t1=5.0, shape=(12, 8)))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('θ', 'ω')
        >>> pyplot.close(ax.figure)
    """
    ax = axes_of(ax)
    values = found.exponents[..., component("exponent", exponent - 1, found.exponents.shape[-1])]
    unit = found.state_labels.time_unit
    t1 = with_unit(f"{found.t1:g}", unit)
    label = f"finite-time exponent $\\lambda_{exponent}${per_unit(unit)}, t$_1$ = {t1}"
    mesh = ax.pcolormesh(*found.axes.values(), values.T, **({"cmap": "viridis", "rasterized": True} | style))
    _over_starts(found, ax, mesh, label)
    return ax


@drawn_whole
def angle_field(found: "AngleField", ax: Axes | None = None, within: float = 1e-3, **style: Any) -> Axes:
    """Angles between covariant vectors over a grid of two components, with a colour bar.

    With `inverse` they are drawn over the starts; without it at the points where they are found.

    Args:
        found: of `lh.angle_field`.
        ax: matplotlib axes; None: those of a new figure.
        within: angles whose remainder is larger are left out.
        **style: of the map or the points, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]), names=("x", "y"))
        >>> found = lh.angle_field(henon, [[-0.1, -0.1], [0.1, 0.1]], 1.4, shape=(8, 6), transient=30)
        >>> ax = lh.plots.angle_field(found)
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('x', 'y')
        >>> pyplot.close(ax.figure)
    """
    ax = axes_of(ax)
    angles = np.where(found.remainder <= within, found.angles, np.nan)
    look: dict[str, Any] = {"cmap": "cividis", "vmin": 0.0, "vmax": np.pi / 2, "rasterized": True}
    if found.missed is None:
        dots: dict[str, Any] = {"s": np.clip(AREA_OF_DOTS / angles.size, 0.3, 20.0), "linewidths": 0.0}
        x, y = (found.where[..., i].ravel() for i in found.axes)
        drawn = ax.scatter(x, y, c=angles.ravel(), **(look | dots | style))
    else:
        drawn = ax.pcolormesh(*found.axes.values(), angles.T, **(look | style))
    bar = _over_starts(found, ax, drawn, "angle between vectors")
    bar.set_ticks([0.0, np.pi / 4, np.pi / 2], labels=["0", "π/4", "π/2"])
    return ax


def _over_starts(found: "FTLEField | AngleField", ax: Axes, drawn: Any, label: str) -> Any:
    """The names of the varied components and a colour bar, which comes back."""
    ax.set_xlabel(found.state_labels.axis(list(found.axes)[0]))
    ax.set_ylabel(found.state_labels.axis(list(found.axes)[1]))
    return ax.figure.colorbar(drawn, ax=ax, label=label)
