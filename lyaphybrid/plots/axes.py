"""Axes, and colours that colour-blind readers can tell apart (Okabe and Ito), for all figures."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes: TypeAlias = Any  # matplotlib takes long to import: only where a figure is drawn

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


def axes_of(ax: Axes | None, figsize: tuple[float, float] = (6.4, 4.0)) -> Axes:
    """The axes that were given, or those of a new figure."""
    if ax is not None:
        return ax
    from matplotlib import pyplot

    return pyplot.subplots(figsize=figsize, layout="constrained")[1]


def both_axes(axes: Sequence[Axes] | None, figsize: tuple[float, float], **shape: Any) -> Sequence[Axes]:
    """The two axes that were given, or those of a new figure, one below the other."""
    if axes is not None:
        return axes
    from matplotlib import pyplot

    return tuple(pyplot.subplots(2, 1, figsize=figsize, layout="constrained", sharex=True, **shape)[1])


def whole_ticks(axis) -> None:
    """Marks at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(nbins=16, integer=True))


def colours(count: int) -> list:
    """Colours for a number of curves: distinct ones if there are enough, else a colour map."""
    if count <= len(COLOURS):
        return list(COLOURS[:count])
    from matplotlib import colormaps

    return [colormaps["viridis"](0.92 * i / (count - 1)) for i in range(count)]
