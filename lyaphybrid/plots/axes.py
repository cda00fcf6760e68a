"""Axes, and colours that colour-blind readers can tell apart (Okabe and Ito), for all figures.

The i-th exponent has the same colour in every figure. On dark axes black and the greys are mirrored.
"""

import functools
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar

import numpy as np

from .._text import in_brackets

if TYPE_CHECKING:
    from matplotlib.axes import Axes
else:
    Axes: TypeAlias = Any  # matplotlib takes long to import: only where a figure is drawn

Inputs = ParamSpec("Inputs")
Drawn = TypeVar("Drawn")

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
VARIES = 1e-6  # a component varies by more than this part of its size
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of red, green and blue


# What is asked of a figure and is no style of its lines, and what to do instead.
NO_STYLE = {
    **dict.fromkeys(
        ("component", "variable", "index"), "a component is i=…, on the other axis j=…, several components=[…]"
    ),
    **dict.fromkeys(("figsize", "dpi"), "draw into axes of your own, ax=pyplot.subplots(figsize=…)[1]"),
    **dict.fromkeys(
        ("title", "xlabel", "ylabel", "xlim", "ylim", "xscale", "yscale"), "the axes come back: .plot().set(title=…)"
    ),
    **dict.fromkeys(("save", "filename", "path"), "the axes come back: .plot().figure.savefig(…)"),
}


class Figures:
    """The figures of a result: the attribute `plot`, which is called, and has a method for each further figure."""

    def __getattr__(self, name: str):
        named = [f".plot.{known}()" for known in dir(type(self)) if not known.startswith("_")]
        motion = " The motion is drawn by lh.trajectory(…).plot()." if name in ("trajectory", "motion", "phase") else ""
        raise AttributeError(f"There is no figure {name!r} of this result; it has .plot(), {', '.join(named)}.{motion}")


def drawn_whole(draw: Callable[Inputs, Drawn]) -> Callable[Inputs, Drawn]:
    """A function that draws; where it fails it leaves no empty figure, which a notebook would show."""

    @functools.wraps(draw)
    def call(*args: Inputs.args, **kwargs: Inputs.kwargs) -> Drawn:
        before = _open_figures()
        try:
            return draw(*args, **kwargs)
        except BaseException:
            for number in _open_figures() - before:
                sys.modules["matplotlib.pyplot"].close(number)
            raise

    return call


def _open_figures() -> set[int]:
    pyplot = sys.modules.get("matplotlib.pyplot")
    return set(pyplot.get_fignums()) if pyplot else set()


def axes_of(ax: Axes | None, figsize: tuple[float, float] = (6.4, 4.0)) -> Axes:
    """The axes that were given, or those of a new figure."""
    if ax is not None:
        _check(ax)
        return ax
    from matplotlib import pyplot

    return pyplot.subplots(figsize=figsize, layout="constrained")[1]


def panels(count: int, figsize: tuple[float, float], **shape: Any) -> Sequence[Axes]:
    """Axes of a new figure, one below the other, with one horizontal axis."""
    from matplotlib import pyplot

    return tuple(pyplot.subplots(count, 1, figsize=figsize, layout="constrained", sharex=True, **shape)[1])


def both_axes(axes: Sequence[Axes] | None, figsize: tuple[float, float], **shape: Any) -> Sequence[Axes]:
    """The two axes that were given, or those of a new figure, one below the other."""
    if axes is not None:
        if not hasattr(axes, "__len__") or len(axes) != 2:
            raise ValueError(f"ax must be two axes, one above the other; got {axes!r}. pyplot.subplots(2) makes them.")
        for ax in axes:
            _check(ax)
        return axes
    return panels(2, figsize, **shape)


def _check(ax: Any) -> None:
    if not hasattr(ax, "errorbar"):
        raise ValueError(f"ax must be axes of matplotlib, or None; got {ax!r}. pyplot.subplots() makes some.")


def varying(values: np.ndarray) -> int:
    """The first component of values (…, n) that varies; the first one where none does."""
    flat = values.reshape(-1, values.shape[-1])
    flat = flat[np.all(np.isfinite(flat), axis=1)]
    ranges, sizes = (np.max(of, axis=0, initial=0.0) for of in (np.abs(flat - flat[:1]), np.abs(flat)))
    return int(np.argmax(ranges > VARIES * sizes))


def component(name: str, index: Any, dimension: int) -> int:
    """The index of a component to draw, if the state has it."""
    if not isinstance(index, int) or not -dimension <= index < dimension:
        raise ValueError(f"{name} must be the index of a component, 0 to {dimension - 1}; got {index!r}.")
    return index


def time_label(unit: str) -> str:
    """What stands at an axis of times that are counted in this unit, "" where it is not known."""
    return "iteration" if unit == "iteration" else in_brackets("time t", unit)


def whole_ticks(axis) -> None:
    """Marks at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(nbins=16, integer=True))


def short_ticks(axis) -> None:
    """Numbers at the marks that do not run into each other: of small and of large values a power of ten apart."""
    from matplotlib.ticker import ScalarFormatter

    if isinstance(formatter := axis.get_major_formatter(), ScalarFormatter):
        formatter.set_powerlimits((-3, 5))
        formatter.set_useMathText(True)


def is_dark(ax: Axes | None) -> bool:
    """Whether axes are darker than middle grey."""
    if ax is None:
        return False
    from matplotlib.colors import to_rgba

    face, behind = to_rgba(ax.get_facecolor()), to_rgba(ax.figure.get_facecolor())
    seen = [face[3] * one + (1 - face[3]) * other for one, other in zip(face[:3], behind[:3], strict=True)]
    return sum(share * one for share, one in zip(LUMINANCE, seen, strict=True)) < 0.5


def ink(ax: Axes, grey: float = 0.0) -> str:
    """A grey, 0 for what is most visible on these axes and 1 for their own colour."""
    return f"{1.0 - grey:.3g}" if is_dark(ax) else f"{grey:.3g}"


def colours(count: int, ax: Axes | None = None) -> list:
    """Colours for a number of curves: distinct ones if there are enough, else a colour map."""
    dark = is_dark(ax)
    if count <= len(COLOURS):
        return [*COLOURS[: min(count, 6)], *(["#F2F2F2" if dark else COLOURS[6]] if count == len(COLOURS) else [])]
    from matplotlib import colormaps

    low, high = (0.25, 1.0) if dark else (0.0, 0.92)
    return [colormaps["viridis"](low + (high - low) * i / (count - 1)) for i in range(count)]


def styled(artist: str, style: dict[str, Any], **usual: Any) -> dict[str, Any]:
    """What the user asks of an artist, `style`, and the usual look for all else; short names ("lw") are understood."""
    from matplotlib import cbook, collections, lines

    for name, value in style.items():
        if name in NO_STYLE:
            raise TypeError(f"{name}={value!r} is no style of what is drawn: {NO_STYLE[name]}.")
    kind = {"line": lines.Line2D, "collection": collections.Collection}[artist]
    return cbook.normalize_kwargs(usual, kind) | cbook.normalize_kwargs(style, kind)
