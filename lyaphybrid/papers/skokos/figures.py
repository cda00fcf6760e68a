"""The pictures of the reproduction of Skokos & Gerlach: Figs. 1 to 11, panel by panel, and the energy errors."""

from typing import TYPE_CHECKING

import numpy as np

from ...plots.axes import COLOURS, colours
from . import checks as skokos_checks
from .cases import BEST, LOOSE, METHODS, ORBITS, STEP, TABLE, TIGHT, TRUSTED_METHODS, PaperOrbit

if TYPE_CHECKING:
    from . import reproduction as skokos

__all__ = ["figure"]

STEP_COLOURS = dict(zip((0.05, 0.1, 0.2, 0.5), COLOURS, strict=False))  # colours of step sizes
DRAWN_AS_ONE = 0.1  # energy errors that differ by less are drawn as one curve
BELOW = 2.0  # decades shown below the slowest curve in figures of GALIs


def figure(r: "skokos.Reproduction", number: int):
    """Fig. 1 to 11; 12: errors of the energy."""
    match number:
        case 1:
            return _section(r)
        case 2 | 7:
            return _exponents(r, {2: "R1", 7: "C2"}[number], METHODS, number)
        case 3:
            return _steps(r)
        case 4 | 8:
            return _indices(r, {4: "R1", 8: "C2"}[number], METHODS, number)
        case 5:
            return _sea(r)
        case 6:
            return _layer(r)
        case 9:
            return _exponents(r, "R2", BEST, number)
        case 10:
            return _indices(r, "R2", BEST, number)
        case 11:
            return _many(r)
        case 12:
            return _energies(r)
    raise ValueError(f"The figures are 1 to 12; got {number!r}.")


def _grid(rows: int, columns: int, title: str, size: tuple[float, float], **keywords):
    from matplotlib.figure import Figure

    made = Figure(figsize=size, layout="constrained")
    made.suptitle(title, fontsize="medium")
    return made, made.subplots(rows, columns, squeeze=False, **keywords)


def _letter(ax, letter: str, text: str) -> None:
    ax.set_title(f"({letter}) {text}", fontsize="small", loc="left")


def _logarithm(values):
    """log10 of what is positive."""
    values = np.asarray(values, float)
    return np.log10(np.where(values > 0, values, np.nan))


def _time_below(axes) -> None:
    for ax in axes:
        ax.set_xlabel("log$_{10}$ t")


# Sections.


def _points(r: "skokos.Reproduction", orbit: str):
    x = np.asarray(r.sections[orbit].x)
    return x[:, 1], x[:, 3]


def _on_section(ax, *, labels: bool = True) -> None:
    ax.set_xlabel("y")
    if labels:
        ax.set_ylabel("p$_y$")


def _section(r: "skokos.Reproduction"):
    made, [[ax]] = _grid(1, 1, "Fig. 1: section x = 0, p$_x$ ≥ 0 of Hénon–Heiles, H = 1/8", (5.6, 5.4))
    for orbit, colour, name in (("C1", "0.55", "C1, chaotic"), ("R1", COLOURS[1], "R1, regular")):
        ax.plot(*_points(r, orbit), linestyle="none", marker=".", markersize=2.2, mew=0, color=colour, label=name)
    ax.set_aspect("equal")
    _on_section(ax)
    ax.legend(loc="upper left", fontsize="small", markerscale=5, frameon=False)
    return made


def _layer(r: "skokos.Reproduction"):
    title = "Fig. 6: C2, weakly chaotic, at the border of small islands of stability"
    made, [[wide, close]] = _grid(1, 2, title, (9.4, 4.8))
    y, py = _points(r, "C2")
    wide.plot(*_points(r, "C1"), linestyle="none", marker=".", markersize=1.5, mew=0, color="0.75", label="C1")
    for ax in (wide, close):
        ax.plot(y, py, linestyle="none", marker=".", markersize=1.8, mew=0, color=COLOURS[0], label="C2")
    # The island on whose border the orbit starts.
    near = np.hypot(y - y[0], py - py[0]) < 0.005
    margin = 0.1 * np.array([np.ptp(y[near]), np.ptp(py[near])])
    close.set_xlim(y[near].min() - margin[0], y[near].max() + margin[0])
    close.set_ylim(py[near].min() - margin[1], py[near].max() + margin[1])
    wide.set_aspect("equal")
    wide.legend(loc="upper left", fontsize="small", markerscale=6, frameon=False)
    _letter(wide, "a", "whole section")
    _letter(close, "b", "the island where the orbit starts")
    close.locator_params(nbins=4)
    _on_section(wide)
    _on_section(close)
    return made


# Exponents.


def _exponents(r: "skokos.Reproduction", orbit: str, methods, number: int):
    """The exponents that are not negative above, the sums of pairs below."""
    runs, motion = r.of(orbit), ORBITS[orbit].motion
    title = f"Fig. {number}: exponents of {orbit} ({motion}), τ = 0.05; dashed: 1/t"
    size = (2.3 * len(methods) + 0.8, 5.2)
    made, axes = _grid(2, len(methods), title, size, sharex=True, sharey="row")
    for i, method in enumerate(methods):
        run, upper, lower = runs[method], axes[0, i], axes[1, i]
        half = run.sums.shape[1]
        for j in range(half):
            style = {"color": COLOURS[j], "linewidth": 1.1}
            upper.plot(np.log10(run.time), _logarithm(run.exponents[:, j]), label=f"λ$_{j + 1}$", **style)
            name = f"|λ$_{j + 1}$ + λ$_{2 * half - j}$|"
            # The sum of all is 0, so for two pairs both curves coincide.
            dashed = style | {"linestyle": (0, (5, 5)) if j == 1 else "-"}
            lower.plot(np.log10(run.time), _logarithm(np.abs(run.sums[:, j])), label=name, **dashed)
        _guide(upper, run)
        _letter(upper, "abcde"[i], method)
        _letter(lower, "abcdefghij"[i + len(methods)], method)
    axes[0, 0].set_ylabel("log$_{10}$ λ")
    axes[1, 0].set_ylabel("log$_{10}$ of the sum of a pair")
    for row in axes:
        row[0].legend(fontsize="small", loc="lower left", frameon=False)
    _time_below(axes[1])
    return made


def _guide(ax, run: "skokos.MethodRun") -> None:
    """The slope of 1/t."""
    ends = np.log10(run.time[[0, -1]])
    start = np.nanmax(_logarithm(run.exponents[0])) + 0.6
    ax.plot(ends, [start, start - ends[1] + ends[0]], color="0.5", linewidth=0.8, linestyle=(0, (4, 3)))


def _steps(r: "skokos.Reproduction"):
    title = "Fig. 3: λ$_1$ of R1 by steps of several lengths"
    made, [[sure, apart, rival]] = _grid(1, 3, title, (12.6, 4.2))
    best = r.of_r1("DOP853")
    style = {"color": COLOURS[0], "linewidth": 1.1}
    sure.plot(np.log10(best.time), _logarithm(best.exponents[:, 0]), label="DOP853, τ = 0.05", **style)
    for row, run in zip(TABLE, r.table, strict=True):
        style = {"color": STEP_COLOURS[row.step], "linewidth": 1.1, "label": f"{row.method}, τ = {row.step:g}"}
        if row.method == "TDHeps":
            rival.plot(np.log10(run.time), _logarithm(run.exponents[:, 0]), **style)
            rival.axhline(
                np.log10(skokos_checks.level(run)), color=STEP_COLOURS[row.step], linewidth=0.7, linestyle=":"
            )
        elif row.method in TRUSTED_METHODS and run is not best and row.threshold != TIGHT:
            dashes = {"linestyle": (0, (5, 2))} if row.method == "DOP853" else {}
            off = run.time * np.abs(run.exponents[:, 0] - best.exponents[:, 0])
            apart.plot(np.log10(run.time), _logarithm(np.maximum.accumulate(off)), **style, **dashes)
    for ax in (sure, rival):
        _guide(ax, best)
        ax.set_ylabel("log$_{10}$ λ$_1$")
    apart.set_ylabel("log$_{10}$ of the largest t |Δλ$_1$| so far")
    titles = (
        "by DOP853; dashed: 1/t",
        f"how far others are from it (δ = {_power(LOOSE)})",
        "TDHeps; dotted: levels; dashed: 1/t",
    )
    for ax, letter, text in zip((sure, apart, rival), "abc", titles, strict=True):
        _letter(ax, letter, text)
        ax.legend(fontsize="x-small", loc="upper left" if ax is apart else "lower left", frameon=False)
    low, high = apart.get_ylim()
    apart.set_ylim(low, high + 0.55 * (high - low))  # room for the legend
    _time_below((sure, apart, rival))
    return made


def _energies(r: "skokos.Reproduction"):
    title = "Relative errors of the energy of R1 (Table 1)"
    made, [[methods, steps, tolerances]] = _grid(1, 3, title, (12.6, 4.2), sharey=True)
    names = {"DOP853": "DOP853", "TDHeps": "TDHeps: two steps of τ/2", "TM": "TM, TDHcc, TDHes: one orbit"}
    for (method, name), colour in zip(names.items(), COLOURS, strict=False):
        _error(methods, r.of_r1(method), color=colour, label=name)
    for row, run in zip(TABLE, r.table, strict=True):
        style = {"color": STEP_COLOURS[row.step]}
        if row.method == "TM":
            _error(steps, run, label=f"τ = {row.step:g}", **style)
        elif row.method == "DOP853" and row.threshold == LOOSE:
            tight = [
                one
                for other, one in zip(TABLE, r.table, strict=True)
                if (other.step, other.threshold) == (row.step, TIGHT)
            ]
            # If only τ matters, both thresholds share one curve.
            apart = [one for one in tight if not np.isclose(one.energy, run.energy, rtol=DRAWN_AS_ONE)]
            both = f" and {_power(TIGHT)}" if len(tight) > len(apart) else ""
            _error(tolerances, run, label=f"τ = {row.step:g}, δ = {_power(row.threshold)}{both}", **style)
            for one in apart:
                _error(tolerances, one, label=f"τ = {row.step:g}, δ = {_power(TIGHT)}", linestyle=(0, (5, 2)), **style)
    for ax, letter, text in (
        (methods, "a", f"methods, τ = {STEP:g}, δ = {_power(LOOSE)}"),
        (steps, "b", "TM"),
        (tolerances, "c", "DOP853"),
    ):
        _letter(ax, letter, text)
        ax.legend(fontsize="x-small", loc="upper left", frameon=False)
    low, high = methods.get_ylim()
    methods.set_ylim(low, high + 0.35 * (high - low))  # room for the legends
    methods.set_ylabel("log$_{10}$ of the largest |H(t) − H(0)| / H(0) so far")
    _time_below((methods, steps, tolerances))
    return made


def _error(ax, run: "skokos.MethodRun", **style) -> None:
    """The largest error so far, because fluctuating errors pass through 0."""
    ax.plot(np.log10(run.time), _logarithm(np.maximum.accumulate(np.abs(run.drift))), linewidth=1.1, **style)


def _sea(r: "skokos.Reproduction"):
    made, [[first, second, third]] = _grid(1, 3, "Fig. 5: the chaotic orbit C1 by DOP853", (11.6, 3.9))
    run, found = r.of("C1")["DOP853"], r.indices["C1"]["DOP853"]
    for j, name in enumerate(("λ$_1$", "|λ$_2$|")):
        first.plot(np.log10(run.time), _logarithm(np.abs(run.exponents[:, j])), color=COLOURS[j], label=name)
        pair = f"|λ$_{j + 1}$ + λ$_{4 - j}$|"
        dashed = {"linestyle": (0, (5, 5)) if j else "-"}
        second.plot(np.log10(run.time), _logarithm(np.abs(run.sums[:, j])), color=COLOURS[j], label=pair, **dashed)
    logs = np.asarray(found.log_values) / np.log(10)
    for k, column, colour in zip(found.orders, logs.T, COLOURS, strict=False):
        third.plot(np.asarray(found.time), column, color=colour, label=f"GALI$_{k}$")
    # By the laws of chaos with the largest exponent alone: λ2 = λ3 = 0, λ4 = −λ1.
    shown = 1000.0
    ends = np.array([0.0, shown])
    for k in (1, 2, 4):
        third.plot(ends, -k * run.exponents[-1, 0] * ends / np.log(10), color="0.5", linewidth=0.8, linestyle=":")
    third.set_xlim(0, shown)
    third.set_ylim(-4.4 * run.exponents[-1, 0] * shown / np.log(10), 1)
    titles = ("exponents", "sums of pairs", "GALIs; dotted: the law")
    for ax, letter, text in zip((first, second, third), "abc", titles, strict=True):
        _letter(ax, letter, text)
        ax.legend(fontsize="small", loc="lower left", frameon=False)
    first.set_ylabel("log$_{10}$ λ")
    third.set_ylabel("log$_{10}$ GALI$_k$")
    third.set_xlabel("t")
    _time_below((first, second))
    return made


# GALIs.


def _foot(found: dict, orders) -> float:
    """log10 GALI where a picture ends: below the method whose curves fall least; lower values are not shown."""
    least = [np.asarray(one.log_values)[:, [one.orders.index(k) for k in orders]].min() for one in found.values()]
    return BELOW * max(least) / np.log(10)


def _curves(ax, found, orders, lowest: float) -> None:
    time, logs = np.asarray(found.time), np.asarray(found.log_values) / np.log(10)
    for k, colour in zip(orders, colours(len(orders)), strict=True):
        values = logs[:, found.orders.index(k)]
        ax.plot(np.log10(time), values, color=colour, linewidth=1.1, label=f"GALI$_{{{k}}}$")
    ax.set_ylim(lowest, -0.04 * lowest)


def _laws(ax, orbit: PaperOrbit, found, orders) -> None:
    """Powers of t, through the point in the middle of the curve."""
    time, logs = np.log10(np.asarray(found.time)), np.asarray(found.log_values) / np.log(10)
    late = time > time[-1] - skokos_checks.DECADES[orbit.name]
    for k, power in zip(orbit.orders, skokos_checks.law(orbit), strict=True):
        if k in orders and power < 0:
            middle = np.mean((logs[:, found.orders.index(k)] - power * time)[late]) - 0.8
            ax.plot(time[late], power * time[late] + middle, color="0.55", linewidth=0.8, linestyle=(0, (4, 3)))


def _indices(r: "skokos.Reproduction", orbit: str, methods, number: int):
    which, found = ORBITS[orbit], r.indices[orbit]
    title = f"Fig. {number}: GALIs of {orbit} ({which.motion}), τ = 0.05" + (
        "; dashed: the powers of t" if which.torus else ""
    )
    size = (2.3 * len(methods) + 0.8, 3.6)
    made, [axes] = _grid(1, len(methods), title, size, sharex=True, sharey=True)
    for i, (ax, method) in enumerate(zip(axes, methods, strict=True)):
        _curves(ax, found[method], which.orders, _foot(found, which.orders))
        if which.torus and method in TRUSTED_METHODS:
            _laws(ax, which, found[method], which.orders)
        _letter(ax, "abcde"[i], method)
    axes[0].set_ylabel("log$_{10}$ GALI$_k$")
    axes[0].legend(fontsize="small", loc="lower left", frameon=False)
    _time_below(axes)
    return made


def _many(r: "skokos.Reproduction"):
    which, found = ORBITS["R3"], r.indices["R3"]
    title = "Fig. 11: GALIs of R3, on a torus of 4 dimensions, τ = 0.05; dashed: the powers of t"
    made, axes = _grid(2, 3, title, (9.4, 7.0), sharex=True, sharey="row")
    for row, orders in enumerate((range(2, 9), range(9, 17))):
        foot = _foot(found, orders)
        for column, method in enumerate(BEST):
            ax = axes[row, column]
            _curves(ax, found[method], list(orders), foot)
            if method in TRUSTED_METHODS:
                _laws(ax, which, found[method], orders)
            _letter(ax, "abcdef"[3 * row + column], method)
        axes[row, 0].set_ylabel("log$_{10}$ GALI$_k$")
        axes[row, 0].legend(fontsize="x-small", loc="lower left", frameon=False, ncols=2)
    _time_below(axes[1])
    return made


def _power(value: float | None) -> str:
    """A power of ten, raised; "none" for the threshold of a method that has none."""
    return "none" if value is None else f"$10^{{{round(np.log10(value))}}}$"
