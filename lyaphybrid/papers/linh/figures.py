"""The pictures of the reproduction of Linh, Truong & Tuyen."""

from typing import TYPE_CHECKING

import numpy as np

from ...plots.axes import COLOURS
from . import checks as linh_checks
from .orders import COUNTS, ORDERS
from .tables import EXAMPLES, OFFSETS, TOLERANCES, limits

if TYPE_CHECKING:
    from . import reproduction as linh

__all__ = ["figure"]

GUIDE = {"color": "0.6", "linewidth": 0.8, "linestyle": (0, (4, 3))}


def figure(r: "linh.Reproduction", name: str):
    """The figure "errors", "orders", "convergence" or "linearisation"."""
    made = {"errors": _errors, "orders": _orders, "convergence": _convergence, "linearisation": _linearisation}
    if name not in made:
        raise ValueError(f"The figures are {', '.join(made)}; got {name!r}.")
    return made[name](r)


def _grid(columns: int, title: str, size: tuple[float, float], **keywords):
    from matplotlib.figure import Figure

    made = Figure(figsize=size, layout="constrained")
    made.suptitle(title, fontsize="medium")
    return made, made.subplots(1, columns, squeeze=False, **keywords)[0]


def _letter(ax, letter: str, text: str) -> None:
    ax.set_title(f"({letter}) {text}", fontsize="small", loc="left")


def _errors(r: "linh.Reproduction"):
    """The larger error over the tolerance; crosses: the published rows with T = 1000."""
    made, axes = _grid(2, "Errors of the exponents against the exact finite-time values", (9.4, 4.4), sharey=True)
    numbers = {"discrete": (1, 5, 6), "continuous": (2, 7, 8)}
    for ax, letter, algorithm in zip(axes, "ab", OFFSETS, strict=True):
        for colour, example, number in zip(COLOURS, EXAMPLES, numbers[algorithm], strict=False):
            scaled = np.max(r.accuracy[example, algorithm], axis=1) / TOLERANCES
            ax.loglog(TOLERANCES, scaled, "o-", color=colour, markersize=4, linewidth=1.1, label=_named(example))
            rows = linh_checks.rows_at(r, number)
            published = [linh_checks.off(row, row.exponents) for row in rows]
            ax.loglog([row.tolerance for row in rows], published, "x", color=colour, markersize=6, label="_paper")
        ax.loglog([], [], "x", color="0.3", label="in the paper")
        ax.axhline(1, **GUIDE)
        ax.set_xlabel("TOL")
        ax.invert_xaxis()
        _letter(ax, letter, f"{algorithm} QR")
    axes[0].set_ylabel("max$_i$ |λ$_i$ − exact| / TOL")
    low, high = axes[0].get_ylim()
    axes[0].set_ylim(low / 3, high)  # room for the legend
    axes[0].legend(fontsize="small", loc="lower left", frameon=False)
    return made


def _named(example: str) -> str:
    return EXAMPLES[example].removeprefix("Example ")


def _orders(r: "linh.Reproduction"):
    made, [ax] = _grid(
        1, "Half-explicit Dormand–Prince, equal steps: error at t = 1; dashed: h$^3$, h$^4$, h$^5$", (6.2, 4.6)
    )
    steps = 1 / np.array(COUNTS)
    texts = {
        "propagated": "with (9)",
        "embedded": "with (9), embedded",
        "without (9)": "without (9)",
        "without (9), constant E": "without (9), E constant",
    }
    for colour, mark, (name, text) in zip(COLOURS, "os^D", texts.items(), strict=False):
        errors = r.orders[name]
        label = f"{text}, Example {ORDERS[name][0]}: order {linh_checks.order(errors):.1f}"
        ax.loglog(steps, errors, color=colour, marker=mark, markersize=4.5, linewidth=1.1, label=label)
    fine = steps[-linh_checks.FINEST :]
    for name, power in (("propagated", 5), ("embedded", 4), ("without (9)", 3)):
        ax.loglog(fine, 0.4 * r.orders[name][-1] * (fine / fine[-1]) ** power, **GUIDE)
    ax.set_xlabel("h")
    ax.set_ylabel("max$_i$ |error of x$_i$|")
    ax.set_xticks(steps, [f"1/{count}" for count in COUNTS])
    ax.minorticks_off()
    ax.legend(fontsize="small", loc="upper left", frameon=False)
    low, high = ax.get_ylim()
    ax.set_ylim(low, 100 * high)  # room for the legend
    return made


def _convergence(r: "linh.Reproduction"):
    """Distances from the limits, and C/t."""
    made, axes = _grid(2, "Example 5.1: λ$_i$(t), and its limit, which it nears as C$_i$/t (dashed)", (9.4, 4.2))
    ends = limits()
    for i, (ax, letter) in enumerate(zip(axes, "ab", strict=True)):
        for colour, (algorithm, (time, exponents)) in zip(COLOURS, r.running.items(), strict=False):
            text = "ln R(t$_0$) counted" if algorithm == "discrete" else "not counted"
            away = np.abs(exponents[:, i] - ends[i])
            ax.loglog(time, away, ".", color=colour, markersize=5, label=f"{algorithm} QR, {text}")
            ax.loglog(time, np.abs(OFFSETS[algorithm][i]) / time, color=colour, linewidth=0.9, linestyle="--")
        _letter(ax, letter, f"λ$_{i + 1}$, limit {ends[i]:.7f}".replace("-", "−"))
        ax.set_xlabel("t")
        ax.set_ylabel(f"|λ$_{i + 1}$(t) − λ$_{i + 1}$|")
    axes[1].legend(fontsize="small", loc="upper right", frameon=False)
    return made


def _linearisation(r: "linh.Reproduction"):
    found, slope = r.linearisation, linh_checks.slope_of_linearisation(r)
    made, [ax] = _grid(1, "Theorem 4.1 on Example 5.1: the linearisation along a computed motion", (6.0, 4.4))
    style = {"markersize": 4.5, "linewidth": 1.1}
    bound = found.bound * found.distance
    ax.loglog(TOLERANCES, bound, "s-", color=COLOURS[1], label="bound N ε", **style)
    label = f"max |f$_x$(ψ) − f$_x$(φ)|: TOL$^{{{slope:.2f}}}$"
    ax.loglog(TOLERANCES, found.difference, "o-", color=COLOURS[0], label=label, **style)
    ax.loglog(TOLERANCES, TOLERANCES, label="TOL", **GUIDE)
    ax.set_xlabel("TOL")
    ax.invert_xaxis()
    ax.legend(fontsize="small", loc="upper right", frameon=False)
    return made
