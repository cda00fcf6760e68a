"""Style sheets for print, for notebooks and for dark pages; the settings of matplotlib stay as they are."""

from contextlib import AbstractContextManager
from typing import Any

__all__ = ["STYLES", "style"]

DARK, LIGHT_INK = "#14181F", "#E6E6E6"
_NARROW = {"axes.linewidth": 0.6, "xtick.major.width": 0.6, "ytick.major.width": 0.6, "legend.frameon": False}
STYLES: dict[str, dict[Any, Any]] = {
    "print": {
        "font.size": 8.0,
        "axes.labelsize": 8.0,
        "axes.titlesize": 8.0,
        "legend.fontsize": 7.0,
        "figure.dpi": 150.0,
        "savefig.dpi": 300.0,
        "pdf.fonttype": 42,  # text stays text, as journals want it
        "svg.fonttype": "none",
        **_NARROW,
    },
    "notebook": {
        "font.size": 11.0,
        "axes.labelsize": 11.0,
        "axes.titlesize": 11.0,
        "figure.dpi": 110.0,
        "axes.spines.top": False,
        "axes.spines.right": False,
        **_NARROW,
    },
    "dark": {
        "font.size": 11.0,
        "figure.dpi": 110.0,
        **dict.fromkeys(("figure.facecolor", "axes.facecolor", "savefig.facecolor", "legend.facecolor"), DARK),
        **dict.fromkeys(
            ("text.color", "axes.labelcolor", "axes.edgecolor", "axes.titlecolor", "xtick.color", "ytick.color"),
            LIGHT_INK,
        ),
        "grid.color": "#3A414C",
        **_NARROW,
    },
}


def style(name: str) -> AbstractContextManager:
    """A context in which figures have one of our styles; after it the settings of matplotlib are those of before.

    Args:
        name: "print" (one or two columns of a journal, text that stays text), "notebook", or "dark".

    Returns:
        A context manager.

    Raises:
        ValueError: on another name.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> run = lh.zoo.henon_map().trajectory(t1=50)
        >>> with lh.plots.style("dark"):
        ...     ax = run.plot()
        >>> ax.get_facecolor() == pyplot.rcParams["axes.facecolor"]
        False
        >>> pyplot.close(ax.figure)
    """
    if name not in STYLES:
        raise ValueError(f"The styles are {', '.join(STYLES)}; got {name!r}.")
    from matplotlib import rc_context

    return rc_context(STYLES[name])
