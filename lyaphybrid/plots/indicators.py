"""Figures of the indicators of chaos."""

from typing import TYPE_CHECKING

import numpy as np

from .axes import COLOURS, colours
from .axes import axes_of as _axes

if TYPE_CHECKING:
    from ..analysis.indicators import CovariantVectors, GALIResult, IndicatorResult, SpectralIntervals

__all__ = ["alignment", "angles", "growth", "intervals"]

PAIRS = 6  # angles that are drawn of covariant vectors


def alignment(found: "GALIResult", ax=None):
    """GALI_k or SALI against time, both logarithmic; values below the smallest float are drawn from their logarithms.

    Args:
        found: of `lh.gali` or `lh.sali`, of one run.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    ax = _axes(ax)
    time, logs = np.asarray(found.time), np.asarray(found.log_values).reshape(len(found.time), -1) / np.log(10)
    names = [f"GALI$_{{{k}}}$" for k in found.orders] or ["SALI"]
    for column, name, colour in zip(logs.T, names, colours(len(names)), strict=True):
        ax.plot(time, column, color=colour, linewidth=1.2, label=name)
    ax.set_xscale("log")
    ax.set_xlabel("time t")
    ax.set_ylabel("log$_{10}$ " + ("GALI$_k$" if found.orders else "SALI"))
    if found.orders:
        ax.legend(fontsize="small")
    return ax


def growth(found: "IndicatorResult", ax=None):
    """MEGNO with its mean, FLI, OFLI or OFLI2 against time.

    Args:
        found: of `lh.megno`, `lh.fli`, `lh.ofli` or `lh.ofli2`, of one run.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    ax = _axes(ax)
    ax.plot(found.time, found.values, color=COLOURS[0], linewidth=1.0, label="Y" if found.mean is not None else None)
    if found.mean is not None:
        ax.plot(found.time, found.mean, color=COLOURS[1], linewidth=1.4, label="its mean over time")
        ax.axhline(2.0, color="0.6", linewidth=0.8, zorder=0)
        ax.legend(fontsize="small")
    ax.set_xscale("log")
    ax.set_xlabel("time t")
    ax.set_ylabel(found.name)
    return ax


def intervals(found: "SpectralIntervals", axes=None):
    """Running averages and averages over windows against time, with the intervals that contain them.

    Args:
        found: of `lh.spectral_intervals`.
        axes: two matplotlib axes; None: those of a new figure.

    Returns:
        The two axes.
    """
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(2, 1, figsize=(6.4, 5.6), layout="constrained", sharex=True)[1]
    running, windows = axes
    for time, values, bounds, ax in (
        (found.time, found.running, found.lyapunov, running),
        (found.start, found.windows, found.sacker_sell, windows),
    ):
        names = [f"λ$_{{{i + 1}}}$" for i in range(bounds.shape[0])]
        for i, colour in enumerate(colours(len(names))):
            ax.plot(time, values[:, i], color=colour, linewidth=1.1, label=names[i])
            if np.all(np.isfinite(bounds[i])):
                ax.axhspan(float(bounds[i, 0]), float(bounds[i, 1]), color=colour, alpha=0.12, linewidth=0)
        ax.set_xscale("symlog", linthresh=found.window)
    running.set_ylabel(f"average over [0, t]\nper {found.unit}")
    windows.set_ylabel(f"average over [t, t + {found.window:g}]\nper {found.unit}")
    windows.set_xlabel("time t")
    running.legend(fontsize="small", frameon=False)
    return axes


def angles(found: "CovariantVectors", ax=None):
    """The angles between the first covariant vectors against time.

    Args:
        found: of `lh.covariant_vectors`.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.
    """
    ax = _axes(ax)
    pairs = list(zip(*np.triu_indices(found.vectors.shape[-1], 1), strict=True))[:PAIRS]
    for column, ((i, j), colour) in enumerate(zip(pairs, colours(len(pairs)), strict=True)):
        ax.plot(found.time, found.angles[:, column], color=colour, linewidth=1.0, label=f"{i + 1} and {j + 1}")
    ax.set_yticks([0.0, np.pi / 4, np.pi / 2], ["0", "π/4", "π/2"])
    ax.set_ylim(0.0, 0.52 * np.pi)
    ax.set_xlabel("time t")
    ax.set_ylabel("angle between vectors")
    if pairs:
        ax.legend(fontsize="small", frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ax
