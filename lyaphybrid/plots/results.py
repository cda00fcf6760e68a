"""Figures of spectra and trajectories."""

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._text import UNIT, with_error
from .axes import COLOURS, colours, whole_ticks
from .axes import axes_of as _axes

if TYPE_CHECKING:
    from ..analysis.indicators import ExponentBounds
    from ..analysis.trajectories import Trajectory
    from ..results.solution_sets import Solutions
    from ..results.spectrum import Spectrum

__all__ = [
    "against_density",
    "bounds",
    "convergence",
    "phase",
    "running",
    "solutions",
    "spectra",
    "spectrum",
    "trajectory",
]

MODE_COLOURS = (
    "#FFFFFF",
    "#E8E8E8",
    "#DCEBF7",
    "#FBEBDD",
    "#DDF2EA",
    "#F6E4EE",
    "#FBF6D5",
)  # background colours of modes
MARKED = 60  # up to this number each event gets a line; more are ticks at the bottom
COMPONENTS_DRAWN = 4  # number of components drawn by default


def spectrum(spectrum: "Spectrum", ax=None):
    """Exponents against their index, with error bars of one standard error.

    Exponents of -inf are arrows at the bottom of the axes.

    Args:
        spectrum: a `Spectrum`.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    return exponents(spectrum.exponents, spectrum.stderr, UNIT[spectrum.clock], ax)


def bounds(found: "ExponentBounds", ax=None):
    """Exponents against their index, with bars as long as their bounds.

    Args:
        found: of `lh.exponent_bounds`.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    return exponents(found.exponents, found.bound, found.unit, ax)


def exponents(exponents, bars, unit: str, ax=None, colour: str = COLOURS[0], label: str | None = None):
    """Exponents (k,) against their index, with bars (k,) to both sides; those of -inf as arrows at the foot."""
    ax = _axes(ax)
    values, errors = np.asarray(exponents), np.asarray(bars)
    index = np.arange(1, len(values) + 1)
    finite = np.isfinite(values)
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    errors = np.where(np.isfinite(errors), errors, 0.0)
    ax.errorbar(
        index[finite], values[finite], errors[finite], fmt="o", markersize=4, capsize=2.5, color=colour, label=label
    )
    ax.margins(y=0.08)
    _arrows(ax, index[np.isneginf(values)], finite)
    ax.set_xlabel("index i")
    ax.set_ylabel(f"exponent λ$_i$ per {unit}")
    ax.set_xlim(0.4, len(values) + 0.6)
    whole_ticks(ax.xaxis)
    return ax


def _arrows(ax, lost, finite) -> None:
    """Downward arrows with the label −∞, in extra space below the finite values."""
    if not len(lost):
        return
    if not np.any(finite):
        ax.set_yticks([0.0])
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.25 * (high - low), high)
    for i in lost:
        place = {"xycoords": ax.get_xaxis_transform(), "annotation_clip": False}
        arrow = {"arrowstyle": "-|>", "color": COLOURS[1], "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", (i, 0.01), xytext=(i, 0.13), arrowprops=arrow, **place)
        ax.annotate("−∞", (i, 0.14), ha="center", va="bottom", color=COLOURS[1], **place)


def convergence(spectrum: "Spectrum", ax=None):
    """The running exponents in time, and the final values as bands of one standard error to each side.

    Exponents of -inf are listed in the corner.

    Args:
        spectrum: a `Spectrum`.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    history = spectrum.history
    ax = running(history.time, history.exponents, spectrum.exponents, spectrum.stderr, UNIT[spectrum.clock], ax)
    ax.set_xlabel({"time": "time t", "jumps": "jumps j", "hybrid": "max(t, j)"}[spectrum.clock])
    return ax


def running(time, course, exponents, stderr, unit: str, ax=None):
    """Running exponents against time, and their last values as bands.

    Args:
        time: (times,).
        course: (times, k) the running exponents.
        exponents: (k,) the last ones; those of -inf are named in the corner.
        stderr: (k,) half widths of the bands.
        unit: which exponents are counted per.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    ax = _axes(ax)
    time, course = np.nanmean(np.atleast_2d(np.asarray(time)), axis=0), np.asarray(course)
    values, errors = np.asarray(exponents), np.asarray(stderr)
    finite = np.flatnonzero(np.isfinite(values))
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    for i, colour in zip(finite, colours(len(finite)), strict=True):
        ax.plot(time, course[:, i], color=colour, linewidth=1.2)
        if np.isfinite(errors[i]):
            ax.axhspan(values[i] - errors[i], values[i] + errors[i], color=colour, alpha=0.18, linewidth=0)
    _label_ends(ax, values, errors, finite)
    lost = [f"λ$_{{{i + 1}}}$" for i in np.flatnonzero(np.isneginf(values))]
    if lost:
        ax.text(0.98, 0.03, f"{', '.join(lost)} = −∞", transform=ax.transAxes, ha="right", color="0.25")
    if np.all(time > 0) and len(time) > 4 and time[len(time) // 2] < 0.25 * time[-1]:
        ax.set_xscale("log")
        ax.set_xlim(time[0], time[-1])
    else:
        ax.set_xlim(0.0, time[-1])
    ax.set_xlabel("iteration" if unit == "iteration" else "time t")
    ax.set_ylabel(f"running exponents per {unit}")
    return ax


def _label_ends(ax, values, errors, finite) -> None:
    """Labels at the right margin: with values if there are few; else neighbours share a label."""
    low, high = ax.get_ylim()
    apart = 0.035 * (high - low)
    few = len(finite) <= len(COLOURS)
    clusters: list[list[int]] = []
    for i in finite:
        if clusters and not few and values[clusters[-1][0]] - values[i] < apart:
            clusters[-1].append(i)
        else:
            clusters.append([i])
    height = np.inf
    for cluster in clusters:
        first, last = cluster[0], cluster[-1]
        name = f"λ$_{{{first + 1}}}$" if first == last else f"λ$_{{{first + 1}–{last + 1}}}$"
        text = f"{name} = {with_error(values[first], errors[first])}".replace("-", "−") if few else name
        height = min(float(values[first]), height - apart)
        ax.annotate(
            text,
            (1.0, height),
            xycoords=ax.get_yaxis_transform(),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize="small",
        )


def spectra(spectra: "Mapping[int, Spectrum]", ax=None):
    """Spectra of systems of n bodies against i/n on one axes: as n grows they approach one curve.

    Of paired spectra only the upper half is drawn, with error bars of one standard error.

    Args:
        spectra: by n, the number of bodies.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    ax = _axes(ax)
    ax.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    markers = itertools.cycle("os^Dv")
    for (n, found), colour, marker in zip(spectra.items(), colours(len(spectra)), markers, strict=False):
        half = found.x.shape[-1] // 2
        values, errors = (np.asarray(a)[:half] for a in (found.exponents, found.stderr))
        errors = np.where(np.isfinite(errors), errors, 0.0)
        size = 3.0 + 9.0 / np.sqrt(len(values))
        style = {"color": colour, "marker": marker, "markersize": size, "linestyle": "none", "elinewidth": 0.8}
        ax.errorbar(np.arange(1, len(values) + 1) / n, values, errors, label=f"N = {n}", **style)
    ax.set_xlim(left=0.0)
    ax.set_xlabel("i/N")
    clock = next(iter(spectra.values())).clock
    ax.set_ylabel(f"exponent λ$_i$ per {UNIT[clock]}")
    ax.legend(frameon=False)
    return ax


def against_density(densities: Sequence[float], spectra: "Sequence[Spectrum]", n: int, ax=None):
    """The largest exponent, and the entropy h per body (the sum of the positive ones over n), against density.

    Args:
        densities: one for each spectrum.
        spectra: of systems of n bodies.
        n: number of bodies.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes; error bars of one standard error.
    """
    ax = _axes(ax)
    first = np.array([(float(s.exponents[0]), float(s.stderr[0])) for s in spectra])
    entropy = np.array([(float(s.ks_entropy()), s.ks_entropy_stderr()) for s in spectra]) / n
    for series, label, colour, marker in (
        (first, "λ$_1$", COLOURS[0], "o"),
        (entropy, f"h$_{{KS}}$/N, N = {n}", COLOURS[1], "s"),
    ):
        style = {"color": colour, "marker": marker, "markersize": 5, "linewidth": 1.0, "capsize": 2.5}
        ax.errorbar(densities, *series.T, label=label, **style)
    ax.set_xlim(left=0.0)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("number density ρσ$^d$")
    ax.set_ylabel(f"per {UNIT[spectra[0].clock]}")
    ax.legend(frameon=False, loc="upper left")
    return ax


def solutions(found: "Solutions", ax=None):
    """The exponents of each solution against their index.

    Args:
        found: of `lh.solutions`.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    ax = _axes(ax)
    for number, (one, colour) in enumerate(zip(found.solutions, colours(len(found)), strict=True)):
        values = np.where(np.isposinf(one.exponents), np.nan, one.exponents)
        exponents(values, np.zeros(len(values)), UNIT["time"], ax, colour, f"solution {number}, {one.status.name}")
    ax.legend(frameon=False, fontsize="small")
    return ax


def trajectory(trajectory: "Trajectory", ax=None, components: Sequence[int] | None = None):
    """Components in time; events as vertical lines, modes as shades behind them.

    Args:
        trajectory: a `Trajectory`.
        ax: matplotlib axes; None: those of a new figure.
        components: indices of those to draw; None: the first four.

    Returns:
        The axes.
    """
    ax = _axes(ax)
    dimension = int(np.prod(trajectory.x.shape[1:]))
    labels = trajectory.state_labels
    shown = range(min(COMPONENTS_DRAWN, dimension)) if components is None else components
    discrete = _is_discrete(trajectory)
    t, x, mode = _with_gaps_at_events(trajectory)
    _shade(ax, t, mode, trajectory.mode_names)
    _mark(ax, np.asarray(trajectory.events.t))
    style: dict[str, Any] = {"linestyle": "none", "marker": "."} if discrete else {"linewidth": 1.3}
    for i, colour in zip(shown, colours(len(shown)), strict=True):
        ax.plot(t, x[:, i], color=colour, label=labels.axis(i), **style)
    ax.set_xlabel("iteration" if discrete else "time t")
    ax.set_ylabel("state" if len(shown) > 1 else labels.axis(shown[0]))
    finite = t[np.isfinite(t)]
    if len(finite) > 1:
        ax.set_xlim(finite[0], finite[-1])
    if len(shown) > 1 or len(trajectory.mode_names) > 1:
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return ax


def _mark(ax, times) -> None:
    """The event times: lines if there are few, else ticks at the bottom."""
    top = 1.0 if len(times) <= MARKED else 0.03
    style = {"color": "0.45", "linewidth": 0.6, "linestyle": ":" if top == 1.0 else "-"}
    ax.vlines(times, 0.0, top, transform=ax.get_xaxis_transform(), **style)


def _shade(ax, t, mode, names) -> None:
    """A background colour for each mode, with the mode's name for the legend."""
    if len(names) < 2:
        return
    for index, name in enumerate(names):
        ax.fill_between(
            t,
            0.0,
            1.0,
            where=mode == index,
            transform=ax.get_xaxis_transform(),
            facecolor=MODE_COLOURS[index % len(MODE_COLOURS)],
            edgecolor="0.8",
            linewidth=0.4,
            label=name,
            zorder=0,
        )


def phase(trajectory: "Trajectory", ax=None, i: int = 0, j: int = 1):
    """Component j against component i; a jump leads from a ring to a dot.

    Args:
        trajectory: a `Trajectory`.
        ax: matplotlib axes; None: those of a new figure.
        i: index of the component on the horizontal axis.
        j: index of the component on the vertical axis.

    Returns:
        The axes.
    """
    ax = _axes(ax)
    t, x, mode = _with_gaps_at_events(trajectory)
    names = trajectory.mode_names
    if _is_discrete(trajectory):
        ax.plot(x[:, i], x[:, j], linestyle="none", marker=".", markersize=2, color=COLOURS[0])
    else:
        for index, (name, colour) in enumerate(zip(names, colours(len(names)), strict=True)):
            own = (mode == index)[:, None]
            path = np.where(own, x, np.nan)
            ax.plot(path[:, i], path[:, j], color=colour, linewidth=1.0, label=name)
        _draw_jumps(ax, trajectory.events, i, j)
    ax.set_xlabel(trajectory.state_labels.axis(i))
    ax.set_ylabel(trajectory.state_labels.axis(j))
    if len(names) > 1:
        ax.legend(frameon=False)
    return ax


def _flattened(states) -> np.ndarray:
    """States flattened to (m, n), also from the shape (m, N, d)."""
    states = np.asarray(states)
    return states.reshape(len(states), -1) if states.size else states.reshape(0, 0)


def _draw_jumps(ax, events, i, j) -> None:
    before, after = _flattened(events.x_before), _flattened(events.x_after)
    if not 0 < len(before) <= MARKED:
        return
    ends = np.stack([before, after, np.full_like(before, np.nan)], axis=1).reshape(-1, before.shape[1])
    ax.plot(ends[:, i], ends[:, j], color="0.6", linewidth=0.6, linestyle=":", zorder=1)
    ax.plot(before[:, i], before[:, j], "o", markersize=3.5, color="0.35", fillstyle="none", mew=0.7)
    ax.plot(after[:, i], after[:, j], "o", markersize=2.5, color="0.35")


def _with_gaps_at_events(trajectory: "Trajectory"):
    """Samples and both sides of every event in order of time, with nan between the sides.

    Returns times (m,), states (m, n) and the mode of each (m,).
    """
    events = trajectory.events
    t, mode, jumps = (np.asarray(a) for a in (trajectory.t, trajectory.mode, trajectory.j))
    x = _flattened(trajectory.x)
    reached = np.isfinite(t)
    t, x, mode, jumps = t[reached], x[reached], mode[reached], jumps[reached]
    if _is_discrete(trajectory) or not len(events):
        return t, x, mode
    when, count = np.asarray(events.t), len(events)
    before, after = _flattened(events.x_before), _flattened(events.x_after)
    times = np.concatenate([t, when, when, when])
    states = np.concatenate([x, before, np.full_like(before, np.nan), after])
    modes = np.concatenate([mode, events.mode_before, events.mode_before, events.mode_after])
    # A sample after j jumps comes after event j; at equal times the number of jumps gives the order.
    order = np.arange(count)
    place = np.concatenate([3 * jumps, 3 * order + 1, 3 * order + 2, 3 * order + 3])
    kind = np.concatenate([np.ones(len(t)), np.full(2 * count, 2), np.zeros(count)])
    order = np.lexsort((kind, place, times))
    return times[order], states[order], modes[order]


def _is_discrete(trajectory: "Trajectory") -> bool:
    """Whether these are iterates of a map: one jump for each sample and no log of events."""
    return len(trajectory.events) == 0 and int(np.max(trajectory.j)) > 0
