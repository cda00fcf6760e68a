"""Figures of trajectories."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .axes import COLOURS, Axes, colours
from .axes import axes_of as _axes

if TYPE_CHECKING:
    from ..analysis.trajectories import Trajectory

__all__ = ["phase", "trajectory"]

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


def trajectory(trajectory: "Trajectory", ax: Axes | None = None, components: Sequence[int] | None = None) -> Axes:
    """Components in time; events as vertical lines, modes as shades behind them.

    Args:
        trajectory: a `Trajectory`.
        ax: matplotlib axes; None: those of a new figure.
        components: indices of those to draw; None: the first four.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        ...     names=("height", "speed"),
        ... )
        >>> ax = lh.plots.trajectory(lh.trajectory(ball, [0.5, 0.0], t1=4.0, n=200), components=[0])
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('time t', 'height')
        >>> pyplot.close(ax.figure)
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


def phase(trajectory: "Trajectory", ax: Axes | None = None, i: int = 0, j: int = 1) -> Axes:
    """Component j against component i; a jump leads from a ring to a dot.

    Args:
        trajectory: a `Trajectory`.
        ax: matplotlib axes; None: those of a new figure.
        i: index of the component on the horizontal axis.
        j: index of the component on the vertical axis.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        ...     names=("height", "speed"),
        ... )
        >>> ax = lh.plots.phase(lh.trajectory(ball, [0.5, 0.0], t1=4.0, n=200))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('height', 'speed')
        >>> pyplot.close(ax.figure)
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
