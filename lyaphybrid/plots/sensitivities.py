"""Pictures of derivatives of exponents, and of what a design has tried."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .._text import per_unit
from .axes import COLOURS, Axes, colours, drawn_whole, ink, styled, whole_ticks
from .axes import axes_of as _axes

if TYPE_CHECKING:
    from ..analysis.sensitivity import Design, Gradient

__all__ = ["design", "gradient"]

GROUP_WIDTH = 0.8  # of the group of bars of one parameter


@drawn_whole
def gradient(found: "Gradient", ax: Axes | None = None, **style: Any) -> Axes:
    """The derivatives of each exponent by each parameter, with error bars of one standard error.

    Args:
        found: of `lh.lyapunov_gradient`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the bars, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> ax = lh.plots.gradient(lh.lyapunov_gradient(logistic, [0.3], {"r": 2.9}, t1=500))
        >>> [text.get_text() for text in ax.get_xticklabels()]
        ['r']
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    slopes, errors = found.by_parameter()
    errors = np.where(np.isfinite(errors), errors, 0.0)
    k, places = len(slopes), np.arange(slopes.shape[1])
    for i, colour in enumerate(colours(k, ax)):
        offset = GROUP_WIDTH * ((i + 0.5) / k - 0.5)
        bars: dict[str, Any] = {"width": GROUP_WIDTH / k, "color": colour, "ecolor": ink(ax), "capsize": 2.0}
        ax.bar(places + offset, slopes[i], yerr=errors[i], label=f"λ$_{{{i + 1}}}$", **(bars | style))
    ax.axhline(0.0, color=ink(ax, 0.6), linewidth=0.8)
    ax.set_xticks(places, found.names)
    ax.set_ylabel("derivative of the exponent" + per_unit(found.time_unit))
    ax.set_title("" if found.trust else "not to be trusted", color=COLOURS[1], fontsize="medium")
    ax.margins(x=0.1)
    ax.legend(frameon=False, fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ax


@drawn_whole
def design(found: "Design", ax: Axes | None = None, **style: Any) -> Axes:
    """The exponents of the points that were tried, in their order; lines are those of the result.

    Args:
        found: of `lh.design`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> ax = lh.plots.design(lh.design(logistic, [0.3], {"r": 2.8}, -0.5, over="r", t1=500))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('point', 'exponent')
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    tried = np.asarray(found.history)[:, len(found.parameters) :]
    for i, colour in enumerate(colours(tried.shape[1], ax)):
        look = styled("line", style, marker="o", color=colour, markersize=3.5, label=f"λ$_{{{i + 1}}}$")
        ax.plot(np.arange(1, len(tried) + 1), tried[:, i], **look)
        ax.axhline(float(found.exponents[i]), color=colour, linewidth=0.8, linestyle=":")
    whole_ticks(ax.xaxis)
    ax.set_xlabel("point")
    ax.set_ylabel("exponent" + per_unit(found.time_unit))
    ax.legend(frameon=False, fontsize="small")
    return ax
