"""Figures of spectra."""

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._text import with_error
from .axes import COLOURS, Axes, Figures, colours, drawn_whole, ink, styled, time_label, whole_ticks
from .axes import axes_of as _axes

if TYPE_CHECKING:
    from ..analysis.indicators.exponent_bounds import ExponentBounds
    from ..analysis.synchronisation import MasterStability
    from ..results.solution_sets import Solutions
    from ..results.spectrum import Spectrum

__all__ = [
    "against_density",
    "bounds",
    "convergence",
    "master_stability",
    "running",
    "solutions",
    "spectra",
    "spectrum",
]


def spectrum(spectrum: "Spectrum", ax: Axes | None = None, **style: Any) -> Axes:
    """Exponents against their index, with error bars of one standard error.

    Exponents of -inf are arrows at the bottom of the axes.

    Args:
        spectrum: a `Spectrum`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the points, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> ax = lh.plots.spectrum(lh.lyapunov_spectrum(henon, [0.1, 0.2], 1.4, t1=1000))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('index i', 'exponent λ$_i$ per iteration')
        >>> pyplot.close(ax.figure)
    """
    return exponents(spectrum.exponents, spectrum.stderr, spectrum.unit, ax, **style)


def bounds(found: "ExponentBounds", ax: Axes | None = None, **style: Any) -> Axes:
    """Exponents against their index, with bars as long as their bounds.

    Args:
        found: of `lh.exponent_bounds`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the points, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> ax = lh.plots.bounds(lh.exponent_bounds(henon, [0.1, 0.2], 1.4, t1=50))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('index i', 'exponent λ$_i$ per iteration')
        >>> pyplot.close(ax.figure)
    """
    return exponents(found.exponents, found.bound, found.unit, ax, **style)


@drawn_whole
def exponents(exponents, bars, unit: str, ax: Axes | None = None, **style: Any) -> Axes:
    """Exponents (k,) against their index, with bars (k,) to both sides; those of -inf as arrows at the foot."""
    ax = _axes(ax)
    values, errors = np.asarray(exponents), np.asarray(bars)
    index = np.arange(1, len(values) + 1)
    finite = np.isfinite(values)
    ax.axhline(0.0, color=ink(ax, 0.6), linewidth=0.8, zorder=0)
    errors = np.where(np.isfinite(errors), errors, 0.0)
    look: Any = {"capsize": 2.5}
    look |= styled("line", style, marker="o", linestyle="none", markersize=4, color=COLOURS[0])
    ax.errorbar(index[finite], values[finite], errors[finite], **look)
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


def convergence(
    spectrum: "Spectrum", ax: Axes | None = None, exponents: Sequence[int] | None = None, **style: Any
) -> Axes:
    """The running exponents in time, and the final values as bands of one standard error to each side.

    Exponents of -inf are listed in the corner.

    Args:
        spectrum: a `Spectrum`.
        ax: matplotlib axes; None: those of a new figure.
        exponents: numbers of those to draw, from 1; None: all. Each keeps its colour.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> ax = lh.plots.convergence(lh.lyapunov_spectrum(henon, [0.1, 0.2], 1.4, t1=1000))
        >>> ax.get_xlabel(), len(ax.lines) >= 2
        ('iteration', True)
        >>> pyplot.close(ax.figure)
    """
    history = spectrum.history
    unit, counted = spectrum.unit, {"jumps": "jumps j", "hybrid": "max(t, j)"}
    ax = running(history.time, history.exponents, spectrum.exponents, spectrum.stderr, unit, ax, exponents, **style)
    if unit != "iteration" and spectrum.clock in counted:
        ax.set_xlabel(counted[spectrum.clock])
    return ax


@drawn_whole
def running(
    time: Any,
    course: Any,
    exponents: Any,
    stderr: Any,
    unit: str,
    ax: Axes | None = None,
    shown: Sequence[int] | None = None,
    **style: Any,
) -> Axes:
    """Running exponents against time, and their last values as bands.

    Args:
        time: (times,).
        course: (times, k) the running exponents.
        exponents: (k,) the last ones; those of -inf are named in the corner.
        stderr: (k,) half widths of the bands.
        unit: which exponents are counted per; one of time is at the axis of time, too.
        ax: matplotlib axes; None: those of a new figure.
        shown: numbers of those to draw, from 1; None: all.
        **style: of the lines, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> time = jnp.arange(1.0, 101.0)
        >>> course = jnp.stack([1 + 1 / time, -2 - 1 / time], axis=1)
        >>> ax = lh.plots.running(time, course, course[-1], jnp.array([0.1, 0.1]), "time")
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('time t', 'running exponents per time')
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    time = np.ma.masked_invalid(np.atleast_2d(np.asarray(time))).mean(axis=0).filled(np.nan)
    reached = np.isfinite(time)  # a run that fails ends before
    time, course = time[reached], np.asarray(course)[reached]
    values, errors = np.asarray(exponents), np.asarray(stderr)
    finite = np.flatnonzero(np.isfinite(values))
    if shown is not None:
        finite = finite[np.isin(finite + 1, _numbers(shown, len(values)))]
    ax.axhline(0.0, color=ink(ax, 0.6), linewidth=0.8, zorder=0)
    for i, colour in zip(finite, np.array(colours(len(values), ax), object)[finite], strict=True):
        ax.plot(time, course[:, i], **styled("line", style, color=colour, linewidth=1.2))
        if np.isfinite(errors[i]):
            ax.axhspan(values[i] - errors[i], values[i] + errors[i], color=colour, alpha=0.18, linewidth=0)
    _label_ends(ax, values, errors, finite)
    wanted = range(1, len(values) + 1) if shown is None else shown
    lost = [f"λ$_{{{i + 1}}}$" for i in np.flatnonzero(np.isneginf(values)) if i + 1 in wanted]
    if lost:
        ax.text(0.98, 0.03, f"{', '.join(lost)} = −∞", transform=ax.transAxes, ha="right", color=ink(ax, 0.25))
    if np.all(time > 0) and len(time) > 4 and time[len(time) // 2] < 0.25 * time[-1]:
        ax.set_xscale("log")
        ax.set_xlim(time[0], time[-1])
    elif len(time):
        ax.set_xlim(0.0, time[-1])
    ax.set_xlabel(time_label(unit))
    ax.set_ylabel(f"running exponents per {unit}")
    return ax


def _numbers(shown: Sequence[int], k: int) -> list[int]:
    """The numbers of exponents to draw, if they are there."""
    numbers = [shown] if isinstance(shown, int) else list(shown)
    if not numbers or not all(isinstance(one, int | np.integer) and 1 <= one <= k for one in numbers):
        raise ValueError(f"exponents must be numbers of exponents, from 1 to {k}; got {shown!r}.")
    return [int(one) for one in numbers]


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


@drawn_whole
def spectra(spectra: "Mapping[int, Spectrum]", ax: Axes | None = None, **style: Any) -> Axes:
    """Spectra of systems of n bodies against i/n on one axes: as n grows they approach one curve.

    Of paired spectra only the upper half is drawn, with error bars of one standard error.

    Args:
        spectra: by n, the number of bodies.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the points, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> problems = {n: lh.zoo.hard_disks(n=n, aspect=1) for n in (2, 3)}
        >>> ax = lh.plots.spectra({n: problem.spectrum(t1=20.0, transient=5.0) for n, problem in problems.items()})
        >>> ax.get_xlabel(), [text.get_text() for text in ax.get_legend().get_texts()]
        ('i/N', ['N = 2', 'N = 3'])
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    ax.axhline(0.0, color=ink(ax, 0.6), linewidth=0.8, zorder=0)
    markers = itertools.cycle("os^Dv")
    for (n, found), colour, marker in zip(spectra.items(), colours(len(spectra), ax), markers, strict=False):
        half = found.x.shape[-1] // 2
        values, errors = (np.asarray(a)[:half] for a in (found.exponents, found.stderr))
        errors = np.where(np.isfinite(errors), errors, 0.0)
        size = 3.0 + 9.0 / np.sqrt(len(values))
        usual = {"color": colour, "marker": marker, "markersize": size, "linestyle": "none", "label": f"N = {n}"}
        look: Any = {"elinewidth": 0.8} | styled("line", style, **usual)
        ax.errorbar(np.arange(1, len(values) + 1) / n, values, errors, **look)
    ax.set_xlim(left=0.0)
    ax.set_xlabel("i/N")
    ax.set_ylabel(f"exponent λ$_i$ per {next(iter(spectra.values())).unit}")
    ax.legend(frameon=False)
    return ax


@drawn_whole
def against_density(
    densities: Sequence[float], spectra: "Sequence[Spectrum]", n: int, ax: Axes | None = None, **style: Any
) -> Axes:
    """The largest exponent, and the entropy h per body (the sum of the positive ones over n), against density.

    Args:
        densities: one for each spectrum.
        spectra: of systems of n bodies.
        n: number of bodies.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the points, as matplotlib takes it.

    Returns:
        The axes; error bars of one standard error.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> densities = [0.2, 0.4]
        >>> found = [lh.zoo.hard_disks(n=2, density=d, aspect=1).spectrum(t1=20.0, transient=5.0) for d in densities]
        >>> ax = lh.plots.against_density(densities, found, n=2)
        >>> ax.get_xlabel(), [text.get_text() for text in ax.get_legend().get_texts()]
        ('number density ρσ$^d$', ['λ$_1$', 'h$_{KS}$/N, N = 2'])
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    first = np.array([(float(s.exponents[0]), float(s.stderr[0])) for s in spectra])
    entropy = np.array([(float(s.ks_entropy()), s.ks_entropy_stderr()) for s in spectra]) / n
    for series, label, colour, marker in (
        (first, "λ$_1$", COLOURS[0], "o"),
        (entropy, f"h$_{{KS}}$/N, N = {n}", COLOURS[1], "s"),
    ):
        look: Any = {"capsize": 2.5}
        look |= styled("line", style, color=colour, marker=marker, markersize=5, linewidth=1.0, label=label)
        ax.errorbar(densities, *series.T, **look)
    ax.set_xlim(left=0.0)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("number density ρσ$^d$")
    ax.set_ylabel(f"per {spectra[0].unit}")
    ax.legend(frameon=False, loc="upper left")
    return ax


@drawn_whole
def solutions(found: "Solutions", ax: Axes | None = None, **style: Any) -> Axes:
    """The exponents of each solution against their index.

    Args:
        found: of `lh.solutions`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the points, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> def field(away):
        ...     return lambda t, x, args: jnp.stack([x[0], away + 0 * x[1]])
        >>> apart = lh.filippov(field(1.0), field(-1.0), lambda t, x, args: x[1])
        >>> ax = lh.plots.solutions(lh.solutions(apart, [0.0, 0.0], t1=2.0))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('index i', 'exponent λ$_i$ per unit of time')
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    for number, (one, colour) in enumerate(zip(found.solutions, colours(len(found), ax), strict=True)):
        values = np.where(np.isposinf(one.exponents), np.nan, one.exponents)
        look = {"color": colour, "label": f"solution {number}, {one.status.name}"} | style
        exponents(values, np.zeros(len(values)), one.spectrum.unit, ax, **look)
    ax.legend(frameon=False, fontsize="small")
    return ax


class SpectrumPlots(Figures):
    """The figures of a spectrum: ``spectrum.plot()``, ``spectrum.plot.spectrum()``, ``spectrum.plot.convergence()``."""

    def __init__(self, result: "Spectrum"):
        self._result = result

    def __call__(self, ax: Axes | None = None, kind: str = "spectrum", **style: Any) -> Axes:
        """The spectrum against its index, or (kind="convergence") its history in time."""
        kinds = {"spectrum": spectrum, "convergence": convergence}
        if kind not in kinds:
            raise ValueError(f"kind must be one of {tuple(kinds)}; got {kind!r}.")
        return kinds[kind](self._result, ax, **style)

    def spectrum(self, ax: Axes | None = None, **style: Any) -> Axes:
        """`plots.spectrum` of it."""
        return spectrum(self._result, ax, **style)

    def convergence(self, ax: Axes | None = None, exponents: Sequence[int] | None = None, **style: Any) -> Axes:
        """`plots.convergence` of it; exponents: numbers of those to draw, from 1."""
        return convergence(self._result, ax, exponents, **style)


@drawn_whole
def master_stability(found: "MasterStability", ax: Axes | None = None, **style: Any) -> Axes:
    """The largest exponent against real α with its standard error; of complex α its sign and size over the plane.

    Args:
        found: of `lh.master_stability`.
        ax: matplotlib axes; None: those of a new figure.
        **style: of the line, or of the points in the plane, as matplotlib takes it.

    Returns:
        The axes.

    Example:
        >>> import lyaphybrid as lh
        >>> from matplotlib import pyplot
        >>> rule = lambda n, x, r: r * x * (1 - x)
        >>> found = lh.master_stability(lh.Map(rule), rule, [0.3], 4.0, at=[-0.8, -0.2], t1=1000)
        >>> ax = found.plot()
        >>> ax.get_xlabel()
        'α = strength × eigenvalue'
        >>> pyplot.close(ax.figure)
    """
    ax = _axes(ax)
    at, largest = np.asarray(found.at), np.asarray(found.largest)
    if np.iscomplexobj(at):
        limit = np.nanmax(np.abs(largest[np.isfinite(largest)]), initial=1e-12)
        look = styled("collection", style, cmap="RdBu_r")
        points = ax.scatter(np.real(at), np.imag(at), 12, largest, vmin=-limit, vmax=limit, **look)
        ax.figure.colorbar(points, ax=ax, label=f"largest exponent per {found.unit}")
        ax.set_xlabel("Re α")
        ax.set_ylabel("Im α")
        return ax
    order = np.argsort(at)
    errors = np.nan_to_num(np.asarray(found.stderr)[order, 0])
    look = {"capsize": 2.0, **styled("line", style, marker="o", markersize=3, linewidth=1.2, color=COLOURS[0])}
    ax.axhline(0.0, color=ink(ax, 0.6), linewidth=0.8, zorder=0)
    ax.errorbar(at[order], largest[order], errors, **look)
    ax.set_xlabel("α = strength × eigenvalue")
    ax.set_ylabel(f"largest exponent per {found.unit}")
    return ax
