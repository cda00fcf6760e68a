"""The pictures of the reproduction of Fu, Wang & Wang."""

from typing import TYPE_CHECKING

import numpy as np

from ... import plots
from ...plots.axes import COLOURS
from . import cases
from .report import outcomes

if TYPE_CHECKING:
    from . import reproduction as fu

__all__ = ["bifurcations", "motion"]

WINDOW = 12  # periods of the velocity that are shown
BANDS = {
    "coexisting": (COLOURS[2], "several cycles"),
    "beside chaos": (COLOURS[4], "cycles and chaos"),
    "undecided": ("0.6", "cycles and unsettled"),
    "transient": (COLOURS[3], "chaos that ended"),
}


def motion(found: "fu.FigureResults"):
    """Velocity against time, the running exponents, and the Poincaré map."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 8.4), layout="constrained")
    grid = figure.add_gridspec(3, 1, height_ratios=(1.0, 1.25, 1.5))
    velocity, exponents, section = (figure.add_subplot(grid[i]) for i in range(3))
    case = found.case
    figure.suptitle(f"Fig. {case.figure}: β = {case.beta:g}, α = {case.alpha:g}, {case.motion}", fontsize="medium")
    _velocity(found, velocity)
    _running(found, exponents)
    _section(found, section)
    _lettered((velocity, "a", "velocity"), (exponents, "b", "running exponents of (θ, θ', z)"))
    return figure


def _lettered(*panels) -> None:
    for ax, letter, what in panels:
        ax.set_title(f"({letter}) {what}", fontsize="small", loc="left")


def _velocity(found, ax) -> None:
    run = found.motion
    t = np.asarray(run.t)
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    ax.plot(t, np.asarray(run.x)[:, 1], color=COLOURS[0], linewidth=1.1)
    stuck = np.asarray(run.mode) == run.mode_names.index("sliding")
    if np.any(stuck):
        where = {"where": stuck, "transform": ax.get_xaxis_transform(), "step": "mid"}
        ax.fill_between(t, 0, 1, color=COLOURS[4], alpha=0.3, linewidth=0, label="sticks", **where)
        ax.legend(frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, fontsize="small")
    ax.set_xlim(0.0, WINDOW * cases.PERIOD)
    ax.set_xlabel("time t")
    ax.set_ylabel("velocity θ'")


def _running(found, ax) -> None:
    """The three exponents of (θ, θ', z); for an exponent −∞ the growth without the losses, dashed."""
    s = found.autonomous
    time, running, lost = ordered(s.history)
    values, finite = np.asarray(s.exponents), np.asarray(s.finite_exponents)
    for i, width in enumerate((1.3, 2.2, 1.1)):  # λ3 is drawn over λ2, with which it may coincide
        for part, style in ((~lost[:, i], "-"), (lost[:, i], "--")):
            ax.plot(time, np.where(part, running[:, i], np.nan), color=COLOURS[i], linewidth=width, linestyle=style)
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))
    height = np.inf
    for i, value in enumerate(values):
        lost = bool(np.isneginf(value))
        name = f"λ$_{i + 1}$ = " + ("−∞\n(dashed: between\nthe losses)" if lost else _value(value))
        height = min(running[-1, i], height - 0.09 * (high - low))
        place = {"transform": ax.get_yaxis_transform(), "va": "top" if lost else "center", "fontsize": "small"}
        ax.text(1.01, height + (0.04 * (high - low) if lost else 0.0), name, color=COLOURS[i], **place)
    if not np.any(np.isneginf(values)) and not found.case.cycle:
        text = f"λ$_{len(finite)}$ has not lost a direction yet; in the long run it is −∞"
        ax.text(0.99, 0.03, text, transform=ax.transAxes, ha="right", fontsize="small", color="0.25")
    ax.set_xscale("log")
    ax.set_xlim(time[0], time[-1])
    ax.set_xlabel("time t")
    ax.set_ylabel("per unit of time")


def ordered(history):
    """Time (m,), running λ1 ≥ λ2 ≥ λ3 (m, 3) without the losses, and whether there was one up to then; those last."""
    time, lost = np.asarray(history.time), np.cumsum(np.asarray(history.losses), axis=0) > 0
    running = np.cumsum(np.asarray(history.growth), axis=0) / time[:, None]
    order = np.lexsort((-running, lost), axis=1)
    sort = {"indices": order, "axis": 1}
    return time, np.take_along_axis(running, **sort), np.take_along_axis(lost, **sort)


def _value(value: float) -> str:
    return "0" if abs(value) < 1e-4 else f"{value:.4f}".replace("-", "−")


def _section(found, ax) -> None:
    x = np.asarray(found.section.x)
    theta = np.pi - np.mod(np.pi - x[:, 0], 2 * np.pi)
    title = "Poincaré map, t = 0 mod 2π/ω"
    if found.orbit is not None:
        loop, point = np.asarray(found.loop.x), np.asarray(found.orbit.x0)
        ax.plot(loop[:, 0], loop[:, 1], color="0.7", linewidth=1.0, label="the cycle")
        ax.plot(theta, x[:, 1], ".", color=COLOURS[0], markersize=4, mew=0, label="points, from the start on")
        ax.plot(*point, "o", color=COLOURS[1], markersize=6, mfc="none", label="point of the cycle")
        ax.legend(frameon=False, loc="center", bbox_to_anchor=(0.55, 0.28), fontsize="small")
        title += f"; the cycle's point ({point[0]:.6f}, {point[1] + 0.0:.6f})".replace("-", "−")
    else:
        ax.plot(theta, x[:, 1], linestyle="none", marker=".", markersize=2, mew=0, color=COLOURS[0], rasterized=True)
        ax.set_xlim(-np.pi, np.pi)
        ax.set_xticks([-np.pi, 0.0, np.pi], ["−π", "0", "π"])
    ax.set_xlabel("θ mod 2π")
    ax.set_ylabel("velocity θ'")
    _lettered((ax, "c", title))


def bifurcations(diagram):
    """Fig. 4: attractors against β, the largest exponent below, and where runs ended differently."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    grid = figure.add_gridspec(3, 1, height_ratios=(4.2, 0.18, 2.6))
    upper = figure.add_subplot(grid[0])
    strip, lower = (figure.add_subplot(grid[i], sharex=upper) for i in (1, 2))
    plots.diagram(diagram, (upper, lower))
    for ax in (upper, lower):
        for beta, _ in cases.BIFURCATIONS:
            ax.axvline(beta, color="0.55", linewidth=0.5, linestyle=(0, (4, 3)), zorder=0)
    _names(upper, cases.BIFURCATIONS)
    _strip(strip, diagram)
    figure.suptitle("Fig. 4: α = 0.01; dashed: bifurcations of cycles, at which λmax is 0", fontsize="medium")
    runs = upper.get_legend_handles_labels()
    legend = upper.get_legend()
    if legend is not None:
        legend.remove()
    look = {"frameon": False, "fontsize": "small", "title_fontsize": "small", "alignment": "left"}
    look |= {"columnspacing": 1.0, "handletextpad": 0.4, "handlelength": 0.9}
    figure.legend(*runs, loc="outside lower left", ncols=3, markerscale=4, title="Points and exponents", **look)
    bands = strip.get_legend_handles_labels()
    if bands[0]:
        title = "Band between the panels: not all runs end alike"
        figure.legend(*bands, loc="outside lower right", ncols=len(bands[0]), title=title, **look)
    for drawn in lower.containers:  # so that both lines and the dots are visible where they coincide
        line = drawn[0]
        line.set_markersize(1.6)
        line.set_linewidth(2.0 if drawn.get_label() == "followed up" else 0.9)
    upper.set_ylabel("θ at t = 0 mod 2π/ω")
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("viscous damping β")
    lower.set_ylabel("largest exponent λmax of (θ, θ')\nper unit of time")
    lower.set_xlim(diagram.values[0], diagram.values[-1])
    for ax, letter in ((upper, "a"), (lower, "b")):
        ax.text(0.99, 0.97, f"({letter})", transform=ax.transAxes, ha="right", va="top")
    return figure


def _names(ax, bifurcations) -> None:
    """Vertical labels above the axes, shifted apart where they are close."""
    apart, places = 0.0088, []
    for beta, _ in bifurcations:
        places.append(max(beta, places[-1] + apart) if places else beta)
    # Groups that were shifted to the right are centred again.
    shift = np.zeros(len(places))
    start = 0
    for i in range(1, len(places) + 1):
        if i == len(places) or places[i] - places[i - 1] > apart + 1e-9:
            shift[start:i] = np.mean([places[j] - bifurcations[j][0] for j in range(start, i)])
            start = i
    transform = ax.get_xaxis_transform()
    for (beta, name), place in zip(bifurcations, np.array(places) - shift, strict=True):
        line = {"transform": transform, "clip_on": False, "color": "0.55", "linewidth": 0.5}
        ax.plot([beta, place], [1.0, 1.035], **line)
        text = {"rotation": 90, "ha": "center", "va": "bottom", "fontsize": 6.5, "color": "0.25"}
        ax.text(place, 1.04, name, transform=transform, **text)


def _strip(ax, diagram) -> None:
    """A band that marks the values where runs ended on different attractors."""
    found, half = outcomes(diagram), 0.5 * (diagram.values[1] - diagram.values[0])
    for name, (colour, label) in BANDS.items():
        for beta in diagram.values[[kind == name for kind in found]]:
            ax.axvspan(beta - half, beta + half, color=colour, linewidth=0, label=label)
            label = None
    ax.set_yticks([])
    ax.tick_params(labelbottom=False, bottom=False)
    for side in ("top", "right", "left", "bottom"):
        ax.spines[side].set_visible(False)
