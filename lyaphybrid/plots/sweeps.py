"""Figures of sweeps, drawn from their datasets alone; public in `plots`."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..statuses import STATUS
from .axes import COLOURS, Axes, axes_of, colours, drawn_whole, ink, styled
from .sweep_arrays import NO_VALUE, Swept, axes_scale, edges, label, list_or_grid, nearest, one_parameter

__all__ = ["sweep_lines", "sweep_map"]


class StatusStyle(NamedTuple):
    """How points with a status are drawn: as markers below lines, and as cells of a map."""

    name: str
    marker: str
    grey: str
    hatch: str


STATUS_STYLES = {
    int(status): StatusStyle(status.name, *look)
    for status, look in {
        STATUS.max_steps: ("s", "0.78", "---"),
        STATUS.zeno: ("^", "0.66", "..."),
        STATUS.deadlock: ("X", "0.54", "xxx"),
        STATUS.nonfinite: ("x", "0.84", "///"),
        STATUS.inconsistent_start: ("D", "0.60", "|||"),
        STATUS.singular_dae: ("P", "0.48", "+++"),
        STATUS.constraint_drift: ("*", "0.72", "ooo"),
        STATUS.step_underflow: (">", "0.42", "\\\\\\"),
        STATUS.stalled: ("<", "0.88", "++"),
        STATUS.no_more_jumps: ("p", "0.30", "oo.."),
        STATUS.no_orbit: ("h", "0.96", "xx.."),
    }.items()
}
STATUS_STYLES[NO_VALUE] = StatusStyle("no value", ".", "0.92", "")
UNKNOWN_STATUS = ("d", "0.36", "**")  # for an unknown status

# Colours from −∞ through white at zero; one hue for each sign.
SCALE = ("#00304D", COLOURS[0], "#8CC1DE", "#FFFFFF", "#F3B78E", COLOURS[1], "#662C00")
UNDER = "#000000"
PERCENTILE = 98  # of the values of each sign: larger ones have the last colour
LEAST_RATIO = 0.1  # least ratio of the colour ranges of both signs, so that errors around zero stay pale
ROW = 0.045  # height of a row of markers, in units of the axes' height
DOTTED = 3000  # largest number of points that are drawn as dots
ROWS = 4  # rows for exponents of −∞; more share one
ENTRY, LETTER = 0.45, 0.058  # widths of a legend's entry and letter, inches


@drawn_whole
def sweep_lines(dataset: Any, exponents: Sequence[int] | None = None, ax: Axes | None = None, **style: Any) -> Axes:
    """Exponents against the parameter of a sweep, with bands of one standard error.

    Exponents of −∞ are triangles at the bottom, in the colour of their line. At failed points the lines have gaps, and
    markers at the bottom show the status. With a second dimension "key" the lines are means over it, and the bands
    their standard errors, sd/√m of m runs.

    The axis is named after the coordinate; ``dataset.rename(args="r")`` gives it another name.

    Args:
        dataset: what `lh.sweep` returned, or `xarray.open_dataset` read, with one swept dimension (and "key").
        exponents: numbers of those to draw, from 1; None: all.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes.

    Raises:
        ValueError: where the dataset has other dimensions (select with .sel or .isel first), no exponents, or not
            those.

    Example:
        >>> import numpy as np
        >>> from matplotlib import pyplot
        >>> import lyaphybrid as lh
        >>> from lyaphybrid import plots
        >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
        >>> def run(r):
        ...     return lh.lyapunov_spectrum(logistic, [0.3], r, transient=100, t1=200)
        >>> found = lh.sweep(run, {"args": np.linspace(3.8, 4.2, 9)}, args=3.0, progress=False)
        >>> ax = plots.sweep_lines(found.rename(args="r"))
        >>> ax.get_xlabel(), [text.get_text() for text in ax.get_legend().get_texts()]
        ('r', ['nonfinite (4)'])
        >>> pyplot.close(ax.figure)
    """
    swept = one_parameter(dataset, exponents)
    ax = axes_of(ax, (7.2, 3.8))
    x = swept.parameters[0]
    _curves(ax, swept, style)
    ax.margins(x=0.02, y=0.08)
    ax.set_xscale(axes_scale(x))
    _status_markers(ax, swept)
    ax.set_xlabel(label(swept.names[0]))
    several = len(swept.numbers) > 1
    ax.set_ylabel(("exponents λ$_i$" if several else f"exponent {_exponent(swept.numbers[0])}") + _per(dataset))
    _legend(ax, ax.get_legend_handles_labels()[0])
    return ax


def _exponent(number) -> str:
    return f"λ$_{{{number}}}$"


def _per(dataset: Any) -> str:
    """The unit of the exponents, where the sweep knows it and all its spectra have the same."""
    unit = dataset.attrs.get("unit", "")
    return f" per {unit}" if unit and ";" not in unit else ""


def _colours(numbers, ax) -> list:
    """Each exponent has a fixed colour, whatever else is drawn; many exponents use a colour map."""
    if max(numbers) <= len(COLOURS):
        fixed = colours(len(COLOURS), ax)
        return [fixed[number - 1] for number in numbers]
    return colours(len(numbers), ax)


def _curves(ax, swept: Swept, style: dict[str, Any]) -> None:
    """A line and a band for each exponent; isolated points are dots."""
    x, numbers = swept.parameters[0], swept.numbers
    named = set(numbers) if len(numbers) <= len(COLOURS) else {numbers[0], numbers[-1]}
    ax.axhline(0.0, color=ink(ax, 0.6), linewidth=0.8, zorder=0)
    for i, (number, colour) in enumerate(zip(numbers, _colours(numbers, ax), strict=True)):
        y, error = (np.where(np.isfinite(one[:, i]), one[:, i], np.nan) for one in (swept.exponents, swept.stderr))
        apart = np.pad(np.isnan(y), 1, constant_values=True)
        alone = ~apart[1:-1] & apart[:-2] & apart[2:]
        name = _exponent(number) if number in named and len(numbers) > 1 else None
        ax.fill_between(x, y - error, y + error, color=colour, alpha=0.25, linewidth=0)
        ax.plot(x, y, **styled("line", style, color=colour, linewidth=1.2, label=name))
        if np.any(alone):
            ax.errorbar(x[alone], y[alone], np.nan_to_num(error[alone]), fmt="o", markersize=2.5, color=colour)


def _status_markers(ax, swept: Swept) -> None:
    """Rows of markers in extra space below the curves: statuses, and above them −∞."""
    x, kinds, lost = swept.parameters[0], _present(swept.codes), _lost(ax, swept)
    height = (bool(kinds) + len(lost)) * ROW
    low, high = ax.get_ylim()
    ax.set_ylim(low - (high - low) * height / (1 - height), high)

    def draw(where, row, marker, **style) -> None:
        heights = np.full(np.sum(where), (row + 0.5) * ROW)
        place = {"transform": ax.get_xaxis_transform(), "linestyle": "none", "markersize": 4.5, "zorder": 3}
        ax.plot(x[where], heights, marker, **place, **style)

    for code, kind in kinds.items():
        name = f"{kind.name} ({np.sum(swept.codes == code)})"
        draw(np.any(swept.codes == code, axis=1), 0, kind.marker, color=ink(ax, 0.3), mfc="none", mew=0.9, label=name)
    for row, (where, colour, name) in enumerate(lost, start=bool(kinds)):
        draw(where, row, "v", color=colour, label=name)


def _lost(ax, swept: Swept) -> list[tuple]:
    """Where exponents are −∞, with colours and names."""
    lost = np.isneginf(swept.exponents)
    rows = [
        (where, colour, f"{_exponent(number)} = −∞")
        for where, colour, number in zip(lost.T, _colours(swept.numbers, ax), swept.numbers, strict=True)
        if np.any(where)
    ]
    return rows if len(rows) <= ROWS else [(np.any(lost, axis=1), ink(ax, 0.3), "some λ$_{i}$ = −∞")]


def _present(codes) -> dict[int, StatusStyle]:
    """The kinds of points that failed, by code."""
    fine = (int(STATUS.ok), int(STATUS.terminated))
    found = [int(code) for code in np.unique(codes) if code not in fine]
    return {code: STATUS_STYLES.get(code, StatusStyle(f"status {code}", *UNKNOWN_STATUS)) for code in found}


@drawn_whole
def sweep_map(dataset: Any, exponent: int = 1, ax: Axes | None = None, **style: Any) -> Axes:
    """One exponent over two parameters of a sweep, in colours; points that failed in greys, by their status.

    White is zero, one hue is above and one below. The colour range leaves out the few largest values, so that the rest
    does not become pale. An exponent of −∞ is black. For a list of points (``lh.sweep(points={…})``) each point fills
    the part of the plane that is nearest to it; places far from all points stay empty.

    Args:
        dataset: what `lh.sweep` returned, or `xarray.open_dataset` read: two swept dimensions, or one dimension of
            points with two coordinates.
        exponent: its number, from 1.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the mesh, as matplotlib takes it.

    Returns:
        The axes.

    Raises:
        ValueError: where the dataset has other dimensions (select with .sel or .isel first), no exponents, or not this
            one.

    Example:
        >>> import jax.numpy as jnp
        >>> import numpy as np
        >>> from matplotlib import pyplot
        >>> import lyaphybrid as lh
        >>> from lyaphybrid import plots
        >>> cosine = lh.Map(lambda n, x, args: args["beta"] + args["gain"] * jnp.cos(x))
        >>> def run(args):
        ...     return lh.lyapunov_spectrum(cosine, [0.3], args, transient=100, t1=200)
        >>> over = {"beta": np.linspace(0.0, 1.0, 5), "gain": np.linspace(0.5, 2.5, 4)}
        >>> found = lh.sweep(run, over, args={"beta": 0.0, "gain": 0.0}, progress=False)
        >>> ax = plots.sweep_map(found)
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('β', 'gain')
        >>> pyplot.close(ax.figure)
    """
    swept = list_or_grid(dataset, exponent)
    ax = axes_of(ax, (6.4, 4.4))
    cells = _nearest_cells(ax, swept) if swept.codes.ndim == 1 else _grid_cells(ax, swept)
    ax.set_xlim(cells.across[0], cells.across[-1])
    ax.set_ylim(cells.upwards[0], cells.upwards[-1])
    values = swept.exponents[..., 0]
    _colour_bar(ax, _mesh(ax, cells, _limits(values), style), values, _exponent(swept.numbers[0]) + _per(dataset))
    _overlay(ax, cells, swept.codes)
    ax.set_xlabel(label(swept.names[0]))
    ax.set_ylabel(label(swept.names[1]))
    return ax


class Cells(NamedTuple):
    """Rectangular cells that fill the axes."""

    across: np.ndarray  # (m + 1,) borders
    upwards: np.ndarray  # (n + 1,)
    values: np.ndarray  # (n, m), nan: none
    codes: np.ndarray  # (n, m)


def _grid_cells(ax, swept: Swept) -> Cells:
    scales = [axes_scale(values) for values in swept.parameters]
    ax.set_xscale(scales[0])
    ax.set_yscale(scales[1])
    across, upwards = (edges(values, scale) for values, scale in zip(swept.parameters, scales, strict=True))
    return Cells(across, upwards, swept.exponents[..., 0].T, swept.codes.T)


def _nearest_cells(ax, swept: Swept) -> Cells:
    """Pixels with the value of the nearest point; the points are drawn as dots if there are few."""
    x, y = swept.parameters
    if len(x) <= DOTTED:
        ax.plot(x, y, ".", markersize=1.6, mew=0, color="0.15", alpha=0.6, zorder=3)
    across, upwards, index = nearest(x, y)
    values = np.where(index >= 0, swept.exponents[index, 0], np.nan)
    return Cells(across, upwards, values, np.where(index >= 0, swept.codes[index], int(STATUS.ok)))


def _limits(values) -> tuple[float, float]:
    """The ends of the colour range, below and above zero."""
    finite = values[np.isfinite(values)]
    signs = (-finite[finite < 0], finite[finite > 0])
    below, above = (float(np.percentile(one, PERCENTILE)) if len(one) else 0.0 for one in signs)
    largest = max(below, above)
    if not largest:
        return -1.0, 1.0
    return -max(below, LEAST_RATIO * largest), max(above, LEAST_RATIO * largest)


def _mesh(ax, cells: Cells, limits, style: dict[str, Any]):
    from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm

    low, high = limits
    lost = np.isneginf(cells.values)
    # Only −∞ has the colour below the range; finite values beyond it have the last colour.
    drawn = np.where(lost, 2 * low, np.maximum(cells.values, low))
    scale = LinearSegmentedColormap.from_list("exponents", SCALE, N=511)
    if np.any(lost):
        scale = scale.with_extremes(under=UNDER)
    usual = {"cmap": scale, "norm": TwoSlopeNorm(0.0, low, high), "rasterized": True, "zorder": 1}
    return ax.pcolormesh(cells.across, cells.upwards, np.ma.masked_invalid(drawn), **(usual | style))


def _colour_bar(ax, mesh, values, name: str) -> None:
    from matplotlib.ticker import MaxNLocator

    low, high = mesh.norm.vmin, mesh.norm.vmax
    beyond = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}
    extend = beyond[bool(np.any(values < low)), bool(np.any(values > high))]
    bar = ax.figure.colorbar(mesh, ax=ax, extend=extend, label=f"exponent {name}")
    ticks = np.concatenate([MaxNLocator(4).tick_values(low, 0.0), MaxNLocator(4).tick_values(0.0, high)])
    ticks = np.unique(ticks[(low <= ticks) & (ticks <= high)])
    bar.set_ticks(ticks, labels=[f"{tick:.6g}".replace("-", "−") for tick in ticks])
    below, above = (np.any(np.isfinite(values) & one) for one in (values < 0, values > 0))
    if below != above:
        bar.ax.set_ylim(low if below else 0.0, high if above else 0.0)
    if np.any(np.isneginf(values)):
        bar.ax.annotate("−∞", (0.5, -0.06), xycoords="axes fraction", ha="center", va="top")


def _overlay(ax, cells: Cells, codes) -> None:
    """The cells of failed points, and a legend with their numbers."""
    from matplotlib import rc_context
    from matplotlib.patches import PathPatch

    patches = []
    with rc_context({"hatch.linewidth": 0.6}):
        for code, kind in _present(codes).items():
            name = f"{kind.name} ({np.sum(codes == code)})"
            style = {"facecolor": kind.grey, "edgecolor": "0.3", "hatch": kind.hatch, "linewidth": 0, "zorder": 2}
            patches.append(ax.add_patch(PathPatch(_outline(cells, code), label=name, **style)))
    _legend(ax, patches)


def _legend(ax, handles) -> None:
    """A legend above the axes, with as many columns as fit."""
    if not handles:
        return
    widest = max(len(handle.get_label().replace("$_{", "").replace("}$", "")) for handle in handles)
    columns = max(1, int(ax.bbox.width / ax.figure.dpi / (ENTRY + LETTER * widest)))
    outside = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2, "frameon": False}
    ax.legend(handles=handles, ncols=columns, fontsize="small", columnspacing=1.2, handletextpad=0.5, **outside)


def _outline(cells: Cells, code: int):
    """The cells of a code as one path, one box for each run in a row, so that no seams are visible."""
    from matplotlib.path import Path

    steps = np.diff(np.pad(cells.codes == code, ((0, 0), (1, 1))).astype(int), axis=1)
    (rows, first), (_, last) = np.nonzero(steps == 1), np.nonzero(steps == -1)
    left, right = cells.across[first], cells.across[last]
    low, high = cells.upwards[rows], cells.upwards[rows + 1]
    corners = [(left, low), (right, low), (right, high), (left, high), (left, low)]
    vertices = np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)
    codes = [Path.MOVETO, Path.LINETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY]
    return Path(vertices.reshape(-1, 2), np.tile(codes, len(rows)))
