"""Pictures of single orbits: multipliers, tangent maps, hybrid time domains."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .._text import in_brackets
from .axes import COLOURS, Axes, colours, drawn_whole, ink, styled, time_label, whole_ticks
from .axes import axes_of as _axes

if TYPE_CHECKING:
    from ..analysis.orbits.periodic_orbits import Floquet
    from ..analysis.orbits.phase_responses import PhaseResponse
    from ..results.time_domains import TimeDomain

__all__ = ["matrix", "multipliers", "phase_responses", "time_domain"]

WRITTEN = 8  # rows of a matrix up to which its entries are written


@drawn_whole
def multipliers(found: "Floquet", ax: Axes | None = None, **style: Any) -> Axes:
    """Multipliers in the complex plane; those inside the unit circle decay.

    Args:
        found: of `lh.floquet`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the points, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> ax = lh.plots.multipliers(lh.floquet(henon, [0.6, 0.2], 1.4, period=1))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('Re μ', 'Im μ')
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax, (4.4, 4.4))
    turn = np.linspace(0.0, 2 * np.pi, 361)
    ax.plot(np.cos(turn), np.sin(turn), color=ink(ax, 0.6), linewidth=0.8, zorder=0)
    values: np.ndarray = np.asarray(found.multipliers)
    inside = np.abs(values) < 1
    for own, colour in ((inside, COLOURS[0]), (~inside, COLOURS[1])):
        look = styled("line", style, marker="o", linestyle="none", color=colour, markersize=5)
        ax.plot(np.real(values[own]), np.imag(values[own]), **look)
    reach = 1.15 * max(1.0, float(np.max(np.abs(values), initial=0.0)))
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach, reach)
    ax.set_aspect("equal")
    ax.set_xlabel("Re μ")
    ax.set_ylabel("Im μ")
    return ax


@drawn_whole
def phase_responses(found: "PhaseResponse", ax: Axes | None = None, **style: Any) -> Axes:
    """The phase response of each component against the phase, from 0 to the period.

    Args:
        found: of `lh.phase_response`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> clock = lh.Flow(lambda t, x, a: x * (1 - x @ x) + jnp.stack([-x[1], x[0]]))
        >>> ax = lh.plots.phase_responses(lh.phase_response(clock, [1.0, 0.2], phases=8))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('phase θ', '∂θ/∂x')
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    names = found.state_labels.columns(found.x.shape[1])
    ax.axhline(0.0, color=ink(ax, 0.6), linewidth=0.8, zorder=0)
    for column, name, colour in zip(found.response.T, names, colours(len(names), ax), strict=True):
        ax.plot(found.t, column, **styled("line", style, color=colour, linewidth=1.2, label=name))
    ax.set_xlim(0.0, found.period)
    ax.set_xlabel(in_brackets("phase θ", found.state_labels.time_unit))
    ax.set_ylabel("∂θ/∂x" if len(names) > 1 else f"∂θ/∂{names[0]}")
    if len(names) > 1:
        ax.legend(fontsize="small", title="component")
    return ax


@drawn_whole
def matrix(matrix: np.ndarray, labels: Any, ax: Axes | None = None, **style: Any) -> Axes:
    """A tangent map, entry by entry, blue below zero and red above.

    Args:
        matrix: (n, n), rows at the end and columns at the start.
        labels: of the state.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the image, as matplotlib takes it.

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
        >>> found = lh.tangent_map(ball, [0.5, 0.0], t1=1.5)
        >>> ax = lh.plots.matrix(found.matrix, found.state_labels)
        >>> [text.get_text() for text in ax.get_yticklabels()]
        ['height', 'speed']
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax, (4.8, 4.0))
    size = float(np.max(np.abs(matrix), initial=0.0)) or 1.0
    shown = ax.imshow(matrix, **({"cmap": "RdBu_r", "vmin": -size, "vmax": size} | style))
    ax.figure.colorbar(shown, ax=ax)
    if len(matrix) <= WRITTEN:
        places, names = range(len(matrix)), [labels.name(i) for i in range(len(matrix))]
        ax.set_xticks(places, names)
        ax.set_yticks(places, names)
        for (i, j), entry in np.ndenumerate(matrix):
            colour = "white" if abs(entry) > 0.6 * size else "black"
            ax.text(j, i, f"{entry:.3g}", ha="center", va="center", fontsize="small", color=colour)
    ax.set_xlabel("perturbation of the start")
    ax.set_ylabel("perturbation of the end")
    return ax


@drawn_whole
def time_domain(domain: "TimeDomain", ax: Axes | None = None, **style: Any) -> Axes:
    """The number of jumps against time: an interval of flow at each number, and a rise at each jump.

    Args:
        domain: of a trajectory.
        ax: matplotlib axes; None: those of a new figure.
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
        >>> ax = lh.plots.time_domain(lh.trajectory(ball, [0.5, 0.0], t1=4.0, n=8).domain)
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('time t', 'jumps j')
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    ends = np.stack([domain.starts, domain.ends], axis=1).ravel()
    counts = np.repeat(np.arange(len(domain.ends)), 2)
    ax.plot(ends, counts, color=ink(ax, 0.6), linewidth=0.8, linestyle=":", zorder=0)
    look = styled("collection", style, color=COLOURS[0], linewidth=1.6)
    ax.hlines(np.arange(len(domain.ends)), domain.starts, domain.ends, **look)
    whole_ticks(ax.yaxis)
    ax.set_xlabel(time_label(domain.time_unit))
    ax.set_ylabel("jumps j")
    ax.set_title(domain.case, fontsize="medium")
    return ax
