"""Figures of the indicators of chaos."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .axes import COLOURS, Axes, both_axes, colours, drawn_whole, ink, styled, time_label
from .axes import axes_of as _axes

if TYPE_CHECKING:
    from ..analysis.indicators.alignment import GALIResult
    from ..analysis.indicators.covariant import CovariantVectors
    from ..analysis.indicators.growth import IndicatorResult
    from ..analysis.indicators.intervals import SpectralIntervals

__all__ = ["alignment", "angles", "growth", "intervals"]

PAIRS = 6  # angles that are drawn of covariant vectors


@drawn_whole
def alignment(found: "GALIResult", ax: Axes | None = None, **style: Any) -> Axes:
    """GALI_k or SALI against time, both logarithmic; values below the smallest float are drawn from their logarithms.

    Args:
        found: of `lh.gali` or `lh.sali`, of one run.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> ax = lh.plots.alignment(lh.sali(henon, [0.1, 0.2], 1.4, t1=100, blocks=16))
        >>> ax.get_xscale(), ax.get_yscale()
        ('log', 'linear')
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    time, logs = np.asarray(found.time), np.asarray(found.log_values).reshape(len(found.time), -1) / np.log(10)
    names = [f"GALI$_{{{k}}}$" for k in found.orders] or ["SALI"]
    for column, name, colour in zip(logs.T, names, colours(len(names), ax), strict=True):
        ax.plot(time, column, **styled("line", style, color=colour, linewidth=1.2, label=name))
    ax.set_xscale("log")
    ax.set_xlabel(time_label(found.unit))
    ax.set_ylabel("log$_{10}$ " + ("GALI$_k$" if found.orders else "SALI"))
    if found.orders:
        ax.legend(fontsize="small")
    return ax


@drawn_whole
def growth(found: "IndicatorResult", ax: Axes | None = None, **style: Any) -> Axes:
    """MEGNO with its mean, FLI, OFLI or OFLI2 against time.

    Args:
        found: of `lh.megno`, `lh.fli`, `lh.ofli` or `lh.ofli2`, of one run.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the line, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> ax = lh.plots.growth(lh.megno(henon, [0.1, 0.2], 1.4, t1=100, blocks=16))
        >>> [text.get_text() for text in ax.get_legend().get_texts()]
        ['Y', 'its mean over time']
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    name = "Y" if found.mean is not None else None
    ax.plot(found.time, found.values, **styled("line", style, color=COLOURS[0], linewidth=1.0, label=name))
    if found.mean is not None:
        ax.plot(found.time, found.mean, color=COLOURS[1], linewidth=1.4, label="its mean over time")
        ax.axhline(2.0, color=ink(ax, 0.6), linewidth=0.8, zorder=0)
        ax.legend(fontsize="small")
    ax.set_xscale("log")
    ax.set_xlabel(time_label(found.unit))
    ax.set_ylabel(found.name)
    return ax


@drawn_whole
def intervals(found: "SpectralIntervals", axes: Sequence[Axes] | None = None, **style: Any) -> Sequence[Axes]:
    """Running averages and averages over windows against time, with the intervals that contain them.

    Args:
        found: of `lh.spectral_intervals`.
        axes: two matplotlib axes; None: those of a new figure.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The two axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.spectral_intervals(henon, [0.1, 0.2], 1.4, t1=200, window=20, tau=20)
        >>> axes = lh.plots.intervals(found)
        >>> len(axes), axes[1].get_xlabel()
        (2, 'iteration')
        >>> pyplot.close(axes[0].figure)
    """
    axes = both_axes(axes, (6.4, 5.6))
    running, windows = axes
    for time, values, bounds, ax in (
        (found.time, found.running, found.lyapunov, running),
        (found.start, found.windows, found.sacker_sell, windows),
    ):
        names = [f"λ$_{{{i + 1}}}$" for i in range(bounds.shape[0])]
        for i, colour in enumerate(colours(len(names), ax)):
            ax.plot(time, values[:, i], **styled("line", style, color=colour, linewidth=1.1, label=names[i]))
            if np.all(np.isfinite(bounds[i])):
                ax.axhspan(float(bounds[i, 0]), float(bounds[i, 1]), color=colour, alpha=0.12, linewidth=0)
        ax.set_xscale("symlog", linthresh=found.window)
    running.set_ylabel(f"average over [0, t]\nper {found.unit}")
    windows.set_ylabel(f"average over [t, t + {found.window:g}]\nper {found.unit}")
    windows.set_xlabel(time_label(found.unit))
    running.legend(fontsize="small", frameon=False)
    return axes


@drawn_whole
def angles(found: "CovariantVectors", ax: Axes | None = None, **style: Any) -> Axes:
    """The angles between the first covariant vectors against time.

    Args:
        found: of `lh.covariant_vectors`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> ax = lh.plots.angles(lh.covariant_vectors(henon, [0.1, 0.2], 1.4, t1=20, blocks=20))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('iteration', 'angle between vectors')
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    pairs = list(zip(*np.triu_indices(found.vectors.shape[-1], 1), strict=True))[:PAIRS]
    for column, ((i, j), colour) in enumerate(zip(pairs, colours(len(pairs), ax), strict=True)):
        look = styled("line", style, color=colour, linewidth=1.0, label=f"{i + 1} and {j + 1}")
        ax.plot(found.time, found.angles[:, column], **look)
    ax.set_yticks([0.0, np.pi / 4, np.pi / 2], ["0", "π/4", "π/2"])
    ax.set_ylim(0.0, 0.52 * np.pi)
    ax.set_xlabel(time_label(found.unit))
    ax.set_ylabel("angle between vectors")
    if pairs:
        ax.legend(fontsize="small", frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ax
