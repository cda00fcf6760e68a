"""A picture of what `lh.check` found."""

import textwrap
from collections.abc import Sequence
from typing import Any

from .axes import COLOURS, Axes, axes_of, drawn_whole, styled

__all__ = ["report"]

WIDTH = 96  # characters of a line of text
VERDICT_MARKS = {"right": ("o", 2), "note": ("^", 0), "wrong": ("X", 1)}  # marker and number of the colour of a verdict


@drawn_whole
def report(findings: Sequence[tuple[str, str, str]], ax: Axes | None = None, **style: Any) -> Axes:
    """The findings below each other: a mark for the verdict, the topic, and what was found.

    Args:
        findings: (verdict, topic, text) of each.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the marks, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
        >>> found = lh.check(logistic, [0.3], {"r": 3.9})
        >>> ax = lh.plots.report([(one.verdict, one.topic, one.text) for one in found.findings])
        >>> len(ax.texts) > 0
        True
        >>> pyplot.close(ax.figure)
    """
    lines = [textwrap.wrap(text, WIDTH) for _, _, text in findings]
    ax = axes_of(ax, (9.0, 0.6 + 0.2 * sum(map(len, lines)) + 0.1 * len(lines)))
    depth, places = 0.0, []
    for (verdict, topic, _), text in zip(findings, lines, strict=True):
        marker, colour = VERDICT_MARKS[verdict]
        middle = depth + 0.35 * (len(text) - 1)
        look = styled("line", style, marker=marker, linestyle="none", color=COLOURS[colour], label=verdict)
        ax.plot(0.0, middle, **look)
        ax.text(0.02, middle, "\n".join(text), va="center_baseline" if len(text) == 1 else "center", fontsize="small")
        places.append((middle, topic))
        depth += 1.0 + 0.7 * (len(text) - 1)
    ax.set(xlim=(-0.02, 1.0), ylim=(depth, -1.0), xticks=[])
    ax.set_yticks([place for place, _ in places], [topic for _, topic in places])
    ax.spines[["top", "right", "bottom"]].set_visible(False)
    handles, labels = ax.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    ax.legend(once.values(), once.keys(), ncols=len(once), loc="lower right", bbox_to_anchor=(1, 1), frameon=False)
    return ax
