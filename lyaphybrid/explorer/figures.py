"""The figure of a view: the motion, its section, and its exponents side by side."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import plots
from .views import View

__all__ = ["figure_of"]

FIGURE_SIZE = (12.6, 3.9)  # inches
CONSTANT_BELOW = (
    1e-9  # spread, relative to the largest entry, below which a component of a section's points is constant
)


def figure_of(view: View, phase: bool = True, components: Sequence[int] | None = None) -> Any:
    """A matplotlib `Figure` of three panels, which pyplot does not know, so that nothing is left open.

    Args:
        view: what is seen.
        phase: the trajectory as one component against another; else against time.
        components: two that are drawn; None: the first ones, and of a section the first ones that vary.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=FIGURE_SIZE, layout="constrained")
    panels = figure.subplots(1, 3)
    for ax, draw in zip(panels, (_draw_motion, _draw_section, _draw_exponents), strict=True):
        draw(ax, view, phase, components)
    return figure


def _draw_motion(ax, view: View, phase: bool, components) -> None:
    ax.set_title("motion from the start", loc="left", fontsize="medium")
    run = view.trajectory
    if run is None or not np.any(np.isfinite(np.asarray(run.t))):
        return _say(ax, "no trajectory")
    dimension = int(np.prod(run.x.shape[1:]))
    i, j = components or (0, 1)
    if phase and dimension > 1:
        return _in_phase(ax, run, i, j)
    plots.trajectory(run, ax, components=(i, j)[:dimension] if components or dimension == 1 else None)
    legend = ax.get_legend()
    if legend is not None:  # beside the panel there is another one
        legend.set(loc="upper right", bbox_to_anchor=None)
    return None


def _in_phase(ax, run, i: int, j: int) -> None:
    plots.phase(run, ax, i, j)
    x = np.asarray(run.x).reshape(len(run.x), -1)
    ax.plot(x[:1, i], x[:1, j], "o", color="#D55E00", markersize=4, zorder=4)


def _draw_section(ax, view: View, phase: bool, components) -> None:
    ax.set_title(view.section_title or "section", loc="left", fontsize="medium")
    points = view.section
    reached = 0 if points is None else int(np.sum(np.isfinite(np.asarray(points.t))))
    if points is None or reached == 0:
        return _say(ax, "no points" if view.section_title else "none of one component")
    i, *rest = components or _varying(points, reached)
    if rest:
        plots.section(points, ax, i, rest[0])
    else:  # only one component varies: the next point against this one
        plots.section(_of_one(points, i), ax)
    return None


def _varying(points, reached: int) -> list[int]:
    """The first two components that are not the same at all points: on a guard some are."""
    x = np.asarray(points.x).reshape(len(points.x), -1)[:reached]
    free = np.flatnonzero(np.ptp(x, axis=0) > CONSTANT_BELOW * np.max(np.abs(x)))
    return [int(i) for i in free[:2]] or [0]


def _of_one(points, i: int):
    """The points with component i alone."""
    labels, x = points.state_labels, np.asarray(points.x).reshape(len(points.x), -1)
    units = (labels.units[i % len(labels.units)],) if labels.units else ()
    own = labels._replace(names=(labels.name(i),), units=units, rows=False)
    return dataclasses.replace(points, x=x[:, [i]], state_labels=own)


def _draw_exponents(ax, view: View, phase: bool, components) -> None:
    ax.set_title("running exponents", loc="left", fontsize="medium")
    if view.spectrum is None or not np.any(np.isfinite(np.asarray(view.spectrum.history.exponents))):
        return _say(ax, "no exponents")
    plots.convergence(view.spectrum, ax)
    return None


def _say(ax, what: str) -> None:
    ax.text(0.5, 0.5, what, transform=ax.transAxes, ha="center", va="center")
    ax.set(xticks=[], yticks=[])
