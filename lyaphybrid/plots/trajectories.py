"""Figures of trajectories."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._arguments import whole
from .._text import with_unit
from .axes import (
    COLOURS,
    Axes,
    Figures,
    colours,
    component,
    drawn_whole,
    ink,
    is_dark,
    panels,
    short_ticks,
    styled,
    time_label,
    whole_ticks,
)
from .axes import axes_of as _axes

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation

    from ..analysis.trajectories import Trajectory

__all__ = ["animation", "phase", "raster", "trajectory"]

# Background colours of modes.
MODE_COLOURS = ("#FFFFFF", "#E8E8E8", "#DCEBF7", "#FBEBDD", "#DDF2EA", "#F6E4EE", "#FBF6D5")
DARK_MODE_COLOURS = ("#14181F", "#2B313B", "#1B2C3D", "#3A2A1E", "#1B342B", "#372532", "#353119")  # on dark axes
MARKED = 60  # up to this number each event gets a line; more are ticks at the bottom
COMPONENTS_DRAWN = 4  # number of components drawn by default


@drawn_whole
def trajectory(
    trajectory: "Trajectory", ax: Axes | None = None, components: Sequence[int] | None = None, **style: Any
) -> Axes:
    """Components in time; events as vertical lines, modes as shades behind them.

    Components with several units get a panel for each unit, one below the other.

    Args:
        trajectory: a `Trajectory`.
        ax: matplotlib axes, for all components; None: those of a new figure.
        components: indices of those to draw; None: the first four.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes; of several panels the first, `ax.figure.axes` holds all.

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
    dimension = int(np.prod(trajectory.x.shape[1:]))
    shown = list(range(min(COMPONENTS_DRAWN, dimension)) if components is None else components)
    for index in shown:
        component("components", index, dimension)
    groups = [shown] if ax is not None else _by_unit(trajectory.state_labels, shown)
    axes = [_axes(ax)] if len(groups) == 1 else panels(len(groups), (6.4, 1.6 + 1.8 * len(groups)))
    samples = _with_gaps_at_events(trajectory)
    hues = dict(zip(shown, colours(len(shown), axes[0]), strict=True))
    for one, group in zip(axes, groups, strict=True):
        _panel(one, trajectory, samples, group, hues, style)
    axes[-1].set_xlabel(time_label("iteration" if _is_discrete(trajectory) else trajectory.state_labels.time_unit))
    short_ticks(axes[-1].xaxis)
    return axes[0]


def _by_unit(labels, shown: Sequence[int]) -> list[list[int]]:
    """The components by their units, in the order of the first of each."""
    units = [labels.units[i % len(labels.units)] if labels.units else "" for i in shown]
    return [[i for i, own in zip(shown, units, strict=True) if own == unit] for unit in dict.fromkeys(units)]


def _panel(ax, trajectory: "Trajectory", samples, shown: list[int], hues, style) -> None:
    """Some components in one axes."""
    labels, (t, x, mode) = trajectory.state_labels, samples
    _shade(ax, t, mode, trajectory.mode_names)
    _mark(ax, np.asarray(trajectory.events.t))
    usual: dict[str, Any] = {"linestyle": "none", "marker": "."} if _is_discrete(trajectory) else {"linewidth": 1.3}
    for i in shown:
        ax.plot(t, x[:, i], **styled("line", style, color=hues[i], label=labels.axis(i), **usual))
    ax.set_ylabel("state" if len(shown) > 1 else labels.axis(shown[0]))
    finite = t[np.isfinite(t)]
    if len(finite) > 1:
        ax.set_xlim(finite[0], finite[-1])
    if len(shown) > 1 or len(trajectory.mode_names) > 1:
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)


def _mark(ax, times) -> None:
    """The event times: lines if there are few, else ticks at the bottom."""
    top = 1.0 if len(times) <= MARKED else 0.03
    style = {"color": ink(ax, 0.45), "linewidth": 0.6, "linestyle": ":" if top == 1.0 else "-"}
    ax.vlines(times, 0.0, top, transform=ax.get_xaxis_transform(), **style)


def _shade(ax, t, mode, names) -> None:
    """A background colour for each mode, with the mode's name for the legend."""
    if len(names) < 2:
        return
    shades = DARK_MODE_COLOURS if is_dark(ax) else MODE_COLOURS
    for index, name in enumerate(names):
        ax.fill_between(
            t,
            0.0,
            1.0,
            where=mode == index,
            transform=ax.get_xaxis_transform(),
            facecolor=shades[index % len(shades)],
            edgecolor=ink(ax, 0.8),
            linewidth=0.4,
            label=name,
            zorder=0,
        )


@drawn_whole
def phase(trajectory: "Trajectory", ax: Axes | None = None, i: int = 0, j: int = 1, **style: Any) -> Axes:
    """Component j against component i; a jump leads from a ring to a dot.

    Args:
        trajectory: a `Trajectory`.
        ax: matplotlib axes; None: those of a new figure.
        i: index of the component on the horizontal axis.
        j: index of the component on the vertical axis.
        **style: of the lines, as matplotlib takes it.

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
    own, ax = ax is None, _axes(ax)
    if own:
        ax.locator_params(axis="x", nbins=6)  # numbers of many digits do not overlap
    t, x, mode = _with_gaps_at_events(trajectory)
    component("i", i, x.shape[1])
    component("j", j, x.shape[1])
    names = trajectory.mode_names
    if _is_discrete(trajectory):
        look = styled("line", style, linestyle="none", marker=".", markersize=2, color=COLOURS[0])
        ax.plot(x[:, i], x[:, j], **look)
    else:
        for index, (name, colour) in enumerate(zip(names, colours(len(names), ax), strict=True)):
            own = (mode == index)[:, None]
            path = np.where(own, x, np.nan)
            ax.plot(path[:, i], path[:, j], **styled("line", style, color=colour, linewidth=1.0, label=name))
        _draw_jumps(ax, trajectory.events, i, j)
    ax.set_xlabel(trajectory.state_labels.axis(i))
    ax.set_ylabel(trajectory.state_labels.axis(j))
    if len(names) > 1:
        ax.legend(frameon=False)
    return ax


@drawn_whole
def raster(trajectory: "Trajectory", ax: Axes | None = None, transition: int = 0, **style: Any) -> Axes:
    """A raster: which component of a vector guard fired, against time, as of spiking neurons.

    Args:
        trajectory: a `Trajectory`.
        ax: matplotlib axes; None: those of a new figure.
        transition: index of the transition whose events are drawn.
        **style: of the marks, as matplotlib takes it.

    Returns:
        The axes.

    Raises:
        ValueError: if one number does not say which guard it was, as for pairs of bodies.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> neurons = lh.zoo.integrate_and_fire(n=3)
        >>> ax = neurons.trajectory(t1=5.0).plot.raster()
        >>> ax.get_xlabel(), ax.get_ylabel(), len(ax.lines[0].get_xdata())
        ('time t', 'which', 17)
        >>> pyplot.close(ax.figure)
    """
    events = trajectory.events
    if np.ndim(events.which) != 1:
        raise ValueError("A raster needs events that one number tells apart; take trajectory.events as a table.")
    whole("transition", transition, least=0)
    wanted = np.asarray(events.transition) == transition
    which = np.asarray(events.which)[wanted]
    ax = _axes(ax)
    usual: dict[str, Any] = {"linestyle": "none", "marker": "|", "color": ink(ax)}
    ax.plot(np.asarray(events.t)[wanted], which, **styled("line", style, **usual))
    when = time_label(trajectory.state_labels.time_unit)
    ax.set(xlabel=when, ylabel="which", xlim=(trajectory.begun, trajectory.ended))
    ax.set_ylim(-0.5, np.max(which, initial=0) + 0.5)
    whole_ticks(ax.yaxis)
    return ax


def animation(
    trajectory: "Trajectory",
    ax: Axes | None = None,
    i: int = 0,
    j: int = 1,
    frames: int = 200,
    tail: float = 0.25,
    interval: float = 40.0,
    **style: Any,
) -> "FuncAnimation":
    """A film: the point of component j against component i, which moves along its path; colours are modes.

    Args:
        trajectory: a `Trajectory` of at least two components.
        ax: matplotlib axes; None: those of a new figure.
        i: index of the component on the horizontal axis.
        j: index of the component on the vertical axis.
        frames: number of pictures, at equal steps of the samples.
        tail: share of the whole path that is drawn behind the point.
        interval: milliseconds between two pictures.
        **style: of the path, as matplotlib takes it.

    Returns:
        A matplotlib `FuncAnimation`: ``.save("film.gif")``, ``.to_jshtml()`` for a notebook. Keep it in a variable as
        long as it is shown.

    Raises:
        ValueError: on components that the state does not have, and fewer than two pictures.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> swing = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0]]), names=("angle", "rate"))
        >>> ax = pyplot.figure().subplots()
        >>> film = lh.plots.animation(lh.trajectory(swing, [1.0, 0.0], t1=6.0, n=60), ax, frames=4)
        >>> film.to_jshtml().count("data:image/png"), ax.get_xlabel()
        (4, 'angle')
        >>> pyplot.close(ax.figure)
    """
    from matplotlib.animation import FuncAnimation

    whole("frames", frames, least=2)
    ax = phase(trajectory, ax, i, j, **({"alpha": 0.15} | style))
    t, x, mode = _with_gaps_at_events(trajectory)
    looks = colours(len(trajectory.mode_names), ax)
    own = styled("line", style, color=ink(ax), linewidth=1.4)
    (path,) = ax.plot([], [], **own)
    (point,) = ax.plot([], [], "o", markersize=6, zorder=5)
    seen = np.flatnonzero(np.isfinite(x).all(axis=1))  # a jump leaves a gap between its two sides
    ends = seen[np.linspace(0, len(seen) - 1, frames).round().astype(int)]
    length = round(tail * len(t))

    def draw(number: int):
        end = ends[number]
        past = slice(max(0, end - length), end + 1)
        path.set_data(x[past, i], x[past, j])
        point.set_data(x[[end], i], x[[end], j])
        point.set_color(looks[int(mode[end])])
        ax.set_title(
            f"t = {with_unit(f'{t[end]:.4g}', trajectory.state_labels.time_unit)}", loc="left", fontsize="medium"
        )
        return path, point

    draw(0)
    figure: Any = ax.figure
    return FuncAnimation(figure, draw, frames=frames, interval=interval)


def _flattened(states) -> np.ndarray:
    """States flattened to (m, n), also from the shape (m, N, d)."""
    states = np.asarray(states)
    return states.reshape(len(states), -1) if states.size else states.reshape(0, 0)


def _draw_jumps(ax, events, i, j) -> None:
    before, after = _flattened(events.x_before), _flattened(events.x_after)
    if not 0 < len(before) <= MARKED:
        return
    ends = np.stack([before, after, np.full_like(before, np.nan)], axis=1).reshape(-1, before.shape[1])
    ax.plot(ends[:, i], ends[:, j], color=ink(ax, 0.6), linewidth=0.6, linestyle=":", zorder=1)
    ax.plot(before[:, i], before[:, j], "o", markersize=3.5, color=ink(ax, 0.35), fillstyle="none", mew=0.7)
    ax.plot(after[:, i], after[:, j], "o", markersize=2.5, color=ink(ax, 0.35))


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


class TrajectoryPlots(Figures):
    """The figures of a trajectory: ``trajectory.plot()``, ``.plot.phase()``, ``.plot.raster()``."""

    def __init__(self, result: "Trajectory"):
        self._result = result

    def __call__(self, ax: Axes | None = None, components: Sequence[int] | None = None, **style: Any) -> Axes:
        """The components against time, with events and modes; of many the first four, or those that are asked for."""
        return trajectory(self._result, ax, components, **style)

    def phase(self, ax: Axes | None = None, i: int = 0, j: int = 1, **style: Any) -> Axes:
        """`plots.phase` of it: component j against component i."""
        return phase(self._result, ax, i, j, **style)

    def raster(self, ax: Axes | None = None, transition: int = 0, **style: Any) -> Axes:
        """`plots.raster` of it: which component of a guard fired, against time."""
        return raster(self._result, ax, transition, **style)
