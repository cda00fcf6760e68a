"""The picture of the reproduction of Dinius' hard disks."""

import dataclasses
from typing import TYPE_CHECKING

import jax
import numpy as np

from ... import plots
from ...plots.axes import COLOURS
from .collisions import MISTAKES
from .table import SCATTER, N

if TYPE_CHECKING:
    from . import reproduction as dinius

__all__ = ["figure"]

LOOK = {"frameon": False, "fontsize": "small", "title_fontsize": "small", "alignment": "left"}


def figure(r: "dinius.Reproduction"):
    """(a) The spectrum, with the wrong rules; (b) one run as in the paper; (c) the errors of such runs against time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 10.6), layout="constrained")
    grid = figure.add_gridspec(3, 1, height_ratios=(1.15, 1.1, 0.9))
    spectrum, course, error = (figure.add_subplot(grid[i]) for i in range(3))
    figure.suptitle(f"Dinius, Table I and Fig. 2: {N} hard disks, t = {r.t1:g}", fontsize="medium")
    _spectrum(r, spectrum)
    plots.convergence(_without_start(r.singles[0]), course)
    _errors(r, error)
    panels = (
        (spectrum, "a", f"exponents, {len(r.singles)} runs"),
        (course, "b", "running exponents of one run from unit vectors, orthonormalised every 0.01"),
        (error, "c", f"how far runs of a length are off, root mean square of {len(r.singles)} runs"),
    )
    for ax, letter, what in panels:
        ax.set_title(f"({letter}) {what}", fontsize="small", loc="left")
    return figure


def _without_start(single):
    """A run from t = 1 on: before there are only a few collisions."""
    history = single.history
    late = np.asarray(history.time) >= 1.0
    return dataclasses.replace(single, history=jax.tree.map(lambda leaf: np.asarray(leaf)[late], history))


def _spectrum(r, ax) -> None:
    values, _ = r.reference
    index = np.arange(1, 4 * N + 1)
    wrong = []
    for mistake, found, colour, marker in zip(MISTAKES, r.mistakes, COLOURS[1:5], "v^sD", strict=True):
        style = {"marker": marker, "markersize": 3.5, "linewidth": 0.7, "color": colour}
        wrong += ax.plot(index, found.exponents, label=mistake.name.replace("_c", "$_c$"), **style)
    (reference,) = ax.plot(index, values, "o", markersize=9, fillstyle="none", color="0.3", label="reference")
    plots.spectrum(r.spectrum, ax)
    ours = ax.containers[-1]
    ours.set_label("here, right rule")
    first = ax.legend(handles=[reference, ours], loc="lower left", **LOOK)
    ax.add_artist(first)
    ax.legend(handles=wrong, loc="upper right", title="wrong rules at collisions", **LOOK)


def _errors(r, ax) -> None:
    """λ1 and λ5 with the laws of their scatter, and the zeros beside 1/t."""
    time, running = r.running
    late = time >= 1.0
    time, running = time[late], running[:, late]
    for i, colour in ((0, COLOURS[0]), (4, COLOURS[1])):
        off = np.sqrt(np.mean((running[..., i] - r.reference[0][i]) ** 2, axis=0))
        ax.plot(time, off, color=colour, linewidth=1.2, label=f"λ$_{i + 1}$")
        law = {"color": colour, "linewidth": 0.9, "linestyle": "--"}
        ax.plot(time, SCATTER[i] / np.sqrt(time), label=f"{SCATTER[i]:.2f}/√t, the reference's", **law)
    zeros = np.sqrt(np.mean(running[..., 5:11] ** 2, axis=(0, 2)))
    ax.plot(time, zeros, color=COLOURS[2], linewidth=1.2, label="λ$_6$ … λ$_{11}$, which are 0")
    scale = 0.5 * zeros[-1] * time[-1]  # shifted so that it does not cover the curve
    law = {"color": COLOURS[2], "linewidth": 0.9, "linestyle": "--"}
    ax.plot(time, scale / time, label=f"{scale:.1f}/t, for comparison", **law)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(time[0], time[-1])
    ax.set_xlabel("time t")
    ax.set_ylabel("off, per unit of time")
    ax.legend(loc="lower left", ncols=1, **LOOK)
