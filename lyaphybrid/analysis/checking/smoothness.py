"""Where functions jump within a mode: a `where`, `sign`, `floor` or `mod` that the motion crosses without an event."""

from collections.abc import Callable, Iterable

import numpy as np

from .functions import Function
from .report import Finding, in_short, noted, right, wrong

__all__ = ["check_smoothness"]

SUSPECTS = 4  # pairs of neighbouring states of each kind that are looked at closely
HALVINGS = 40
JUMP = 1e-4  # a change over a vanishing distance, relative to the size of the function there, that is a jump
STAYS_LARGE = 1e-6  # of the change between two states: what is left of it over a vanishing distance, at a jump
OF_ROUNDING = 1e-12  # of the largest size of a function: smaller jumps, and jumps of its changes, are rounding


def check_smoothness(functions: Iterable[Function], t, x, mode, jumps) -> list[Finding]:
    """Each field and guard, and its derivative, between neighbouring states (m,), (m, n) of one stretch of flow."""
    found, looked = [], 0
    for one in functions:
        if one.name.startswith("reset"):
            continue
        own = np.ones(len(t), bool) if one.modes is None else np.isin(mode, one.modes)
        pairs = np.flatnonzero(own[:-1] & own[1:] & (jumps[:-1] == jumps[1:]) & (mode[:-1] == mode[1:]))
        if not len(pairs):
            continue
        looked += 1
        found += _of_function(one, t, x, pairs)
    if found:
        return found
    return [right("smoothness", "no field and no guard jumps within a mode along the run")] if looked else []


def _of_function(one: Function, t, x, pairs) -> list[Finding]:
    def values(t, x, dt, dx):
        return one.at(t, x, dx)[0]

    def slopes(t, x, dt, dx):
        _, along, by_time = one.at(t, x, dx)
        return along + dt[:, None] * by_time

    place = _jump(values, t, x, pairs)
    if place is not None:
        return [
            wrong("smoothness", f"The {one.name} jumps {place} without an event. Give each smooth piece a mode, with a "
                  "guard where it ends (lh.filippov for a field with a switch); else steps crawl there, and exponents "
                  "lack what the jump does to perturbations.")
        ]  # fmt: skip
    least = OF_ROUNDING * np.max(np.abs(values(t[pairs], x[pairs], t[pairs], x[pairs])), initial=0.0)
    place = _jump(slopes, t, x, pairs, least)
    if place is None:
        return []
    return [
        noted("smoothness", f"The {one.name} has a kink {place}: its derivative jumps. Where the field is continuous "
              "exponents are right, but steps are short there.")
    ]  # fmt: skip


def _jump(of: Callable, t, x, pairs, least: float = 0.0) -> str | None:
    """Where between neighbouring states a function jumps by more than `least`, in words; None: nowhere."""
    starts, ends = ((t[i], x[i]) for i in (pairs, pairs + 1))
    across = tuple(end - start for start, end in zip(starts, ends, strict=True))
    low, high = (of(*side, *across) for side in (starts, ends))
    size = np.max(np.abs([low, high]), initial=0.0)  # a guard may be zero wherever a stretch begins
    if not np.all(np.isfinite([low, high])) or size == 0:
        return None
    worst = _suspects(low, high, of(starts[0], ends[1], *across))
    starts, ends, across = ([one[worst] for one in both] for both in (starts, ends, across))
    low, high = low[worst], high[worst]
    change = np.max(np.abs(high - low), axis=1)
    for _ in range(HALVINGS):
        middle = [0.5 * (start + end) for start, end in zip(starts, ends, strict=True)]
        values = of(*middle, *across)
        first = np.max(np.abs(values - low), axis=1) >= np.max(np.abs(high - values), axis=1)  # it jumps in this half
        starts = [_chosen(first, start, half) for start, half in zip(starts, middle, strict=True)]
        ends = [_chosen(first, half, end) for half, end in zip(middle, ends, strict=True)]
        low, high = _chosen(first, low, values), _chosen(first, values, high)
    rest = np.max(np.abs(high - low), axis=1)
    here = np.max(np.maximum(np.abs(low), np.abs(high)), axis=1)
    jumps = (rest > JUMP * here) & (rest > STAYS_LARGE * change) & (rest > max(least, OF_ROUNDING * size))
    if not np.any(jumps):
        return None
    i = int(np.argmax(np.where(jumps, rest, 0.0)))
    return f"by {rest[i]:.3g} at t = {starts[0][i]:.6g}, x = {in_short(starts[1][i])}"


def _suspects(low, high, earlier) -> np.ndarray:
    """The pairs with the largest changes: absolute, relative, and those that the time alone makes.

    `earlier` are the values at the second states, at the times of the first ones. Where a function is huge elsewhere,
    as at spikes, the absolute changes show those places only.
    """
    change, of_time = (np.max(np.abs(high - other), axis=1) for other in (low, earlier))
    here = np.max(np.maximum(np.abs(low), np.abs(high)), axis=1)
    kinds = change, change / np.maximum(here, np.finfo(float).tiny), of_time
    return np.unique(np.concatenate([np.argsort(kind)[-SUSPECTS:] for kind in kinds]))


def _chosen(which, one, other):
    return np.where(which.reshape(-1, *[1] * (one.ndim - 1)), one, other)
