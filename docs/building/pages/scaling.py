"""The page of how costs grow, from what `python -m benchmarks.scaling --record` has kept."""

import io
import json
import math
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from lyaphybrid import plots

TEXT = """# How costs grow

Measured by `python -m benchmarks.scaling --record` on {date}, commit {commit}: {machine}, one thread. Load at the
beginning: {load}. The cost of a unit of work is the difference of two runs of different length, the fastest of several
each; the last column is the exponent of the size in it, between the smallest and the largest. What a size touches grows
with it, from caches of a core to memory. That an impact is dearer in a long run comes from the rounding of late times
([sharp bits](../help/sharp_bits.md)).

```{{image}} scaling.svg
:alt: Costs of a unit of work against sizes, in logarithms; the numbers are in the table below.
:class: only-light
```

```{{image}} scaling_dark.svg
:alt: Costs of a unit of work against sizes, in logarithms; the numbers are in the table below.
:class: only-dark
```

| system | size | cost of a unit | exponent |
|---|---|---|---|
"""


def written(seconds: float) -> str:
    """A time with two digits, in the unit that makes it a small number."""
    power = min(3, max(1, -math.floor(math.log10(seconds) / 3)))
    value, unit = seconds * 1000.0**power, {1: "ms", 2: "µs", 3: "ns"}[power]
    return f"{value:.0f} {unit}" if value >= 10 else f"{value:.1f} {unit}"


def row(law: dict) -> str:
    """A law as a line of the table."""
    costs = ", ".join(f"{size}: {written(seconds)}" for size, seconds in zip(law["sizes"], law["seconds"], strict=True))
    return f"| {law['title']} | {law['size']} | one {law['unit']}: {costs} | {law['power']:.2f} |\n"


def picture(laws: dict[str, dict], dark: bool) -> str:
    """All laws in three panels, by what grows, as SVG."""
    panels: dict[str, list[dict]] = {"size of the system": [], "number of exponents": [], "length of the run": []}
    for law in laws.values():
        kinds = {"k": "number of exponents", "n": "size of the system", "N": "size of the system"}
        kind = kinds.get(law["size"], "length of the run")
        panels[kind].append(law)
    with plots.style("dark" if dark else "notebook"), rc_context({"svg.hashsalt": "scaling"}):
        figure = Figure(figsize=(10.5, 4.6), layout="constrained")
        for ax, (kind, shown) in zip(figure.subplots(1, 3, width_ratios=(1.5, 1, 1)), panels.items(), strict=True):
            for law in shown:
                ax.loglog(law["sizes"], law["seconds"], "o-", ms=4, label=law["title"])
            ax.set_xlabel(kind)
            ax.grid(alpha=0.3)
            ax.legend(fontsize=7, frameon=False, loc="upper left")
            low, high = ax.get_ylim()
            ax.set_ylim(low, high * (high / low) ** 0.45)  # room for the legend
        figure.axes[0].set_ylabel("cost of a step, an event, a point (s)")
        kept = io.StringIO()
        figure.savefig(kept, format="svg", metadata={"Date": None})
    return kept.getvalue()


def pages(root: Path) -> dict[str, str]:
    """The page and its pictures by name."""
    found = json.loads((root / "benchmarks/scaling.json").read_text())
    laws = found["laws"]
    return {
        "evidence/scaling.md": TEXT.format(**found) + "".join(map(row, laws.values())),
        "evidence/scaling.svg": picture(laws, dark=False),
        "evidence/scaling_dark.svg": picture(laws, dark=True),
    }
