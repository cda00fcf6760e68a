"""What a unit costs at an error: between two settings of a method, on a line in logarithms."""

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

TARGETS = (1e-3, 1e-6, 1e-9)
ENOUGH = 0.05  # seconds of a run, of which what a call costs by itself is a small part


class Point(NamedTuple):
    """One setting of one method."""

    method: str
    error: float
    cost: float


def cost_at(points: Iterable[Point], target: float) -> float | None:
    """The cheapest method at this error; None where none reaches it.

    Where a setting is as good as wanted and no coarser one is worse, its cost counts as it is.
    """
    by_method: dict[str, list[Point]] = {}
    for point in points:
        by_method.setdefault(point.method, []).append(point)
    costs = [cost for found in by_method.values() if (cost := _cost(found, target)) is not None]
    return min(costs, default=None)


def _cost(ladder: list[Point], target: float) -> float | None:
    """Of one method, from coarse to fine."""
    costs = [point.cost for point in ladder if point.error <= target]
    for coarse, fine in pairwise(ladder):
        if fine.error <= target < coarse.error and fine.error > 0.0:
            share = math.log(coarse.error / target) / math.log(coarse.error / fine.error)
            costs.append(math.exp((1 - share) * math.log(coarse.cost) + share * math.log(fine.cost)))
    return min(costs, default=None)


def wanted(errors: dict[str, float], targets: Iterable[float]) -> list[int]:
    """Which settings of a ladder have to be timed for these targets: those next to them on either side, by method.

    `errors` are by name, which begins with the method, from coarse to fine.
    """
    chosen = set()
    names = list(errors)
    for method in {method_of(name) for name in names}:
        own = [i for i, name in enumerate(names) if method_of(name) == method]
        for target in targets:
            good = next((i for i in own if errors[names[i]] <= target), None)
            if good is not None:
                chosen |= {good, max(good - 1, own[0])}
    return sorted(chosen)


def method_of(name: str) -> str:
    """The first word of a setting's name."""
    return name.split(maxsplit=1)[0].rstrip(",")
