"""`basin_shares`: how much of a box leads to each attractor, along a parameter."""

import functools
import os
import warnings
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np

from ... import plots
from ..._arguments import Key, Progress, Real, require, require_values
from ..._entries import number_of
from ..._keywords import explains_keywords, user_level
from ..._text import Table, with_error
from ...engine import preparation
from ...engine.host.reporting import reporter
from ...integrators.base import Method
from ...results.result import Data, Result
from ...statuses import STATUS
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.smooth import Flow, Map
from ..diagrams.diagrams import only_parameter
from .basins import ATTEMPTS_OF_START, LAST_SAMPLES, BasinRun, Basins
from .keeping import KeptSteps
from .recognition import Attractor, Metric, arrived, distances

__all__ = ["BasinShares", "basin_shares"]

OTHER_VALUES = "{} holds other values: number {} of {} is {:.15g} there, and {:.15g} here. Take another path."
SAME_ATTRACTOR = 0.25  # distance, relative to the scale, up to which an attractor is the same as at the value before


class BasinShares(Result, eqx.Module):
    """The parts of a box of starts that lead to each attractor, along a parameter.

    Attributes:
        parameter: its name; values: (m,).
        names: of the classes (c,): "attractor 0", … numbered as they appear, then statuses and "undecided".
        shares: (m, c); stderr: (m, c) of independent starts.
        basins: (m,) what `lh.basins` found at each value, with its own numbers.

    Example:
        >>> import jax, jax.numpy as jnp, lyaphybrid as lh
        >>> tilted = lh.Flow(lambda t, x, a: x - x**3 + a["tilt"])
        >>> found = lh.basin_shares(
        ...     tilted, [[-1.5], [1.5]], {"tilt": 0.0}, over={"tilt": [0.0, 0.2, 0.5]}, t1=60.0, starts=400,
        ...     key=jax.random.key(0),
        ... )
        >>> found.names, sorted(found.shares[-1].tolist())  # beyond 2/√27 = 0.385 one well is left
        (('attractor 0', 'attractor 1'), [0.0, 1.0])
    """

    parameter: str = eqx.field(static=True)
    values: np.ndarray
    names: tuple[str, ...] = eqx.field(static=True)
    shares: np.ndarray
    stderr: np.ndarray
    basins: tuple[Basins, ...]

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The shares, one above the other. `style` goes to what it draws."""
        return plots.basin_shares(self, ax, **style)

    def _table(self) -> Table:
        rows = [
            (f"{value:.6g}", *(with_error(share, error) for share, error in zip(shares, errors, strict=True)))
            for value, shares, errors in zip(self.values, self.shares, self.stderr, strict=True)
        ]
        return Table(
            f"Shares of {self.basins[0].labels.size} starts along {self.parameter}", rows, [], ("", *self.names)
        )

    def _data(self) -> Data:
        along = (self.parameter, "class")
        variables = {"shares": (along, self.shares), "stderr": (along, self.stderr)}
        return Data(variables, {self.parameter: self.values, "class": list(self.names)})


@explains_keywords
def basin_shares(
    system: Flow | Map | Hybrid | EventDriven,
    x0: Any,
    args: Any,
    *,
    over: Mapping[str, Any],
    t1: Real,
    starts: int,
    key: Key,
    period: Real | None = None,
    angles: Any = (),
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    max_steps: int = ATTEMPTS_OF_START,
    progress: Progress = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
) -> BasinShares:
    """`basins` of the same random starts at several values of a parameter, their attractors matched.

    An attractor is the same as one at the value before to which a point of that one leads, or, of those left over, if
    each lies within a quarter of the attractors' extent of the other, in the mean over its points; the nearest are
    matched first. One that vanishes and comes again keeps its number.

    Args:
        system: as in `basins`.
        x0: (2, n) corners of the box of starts.
        args: pytree of parameters.
        over: ``{"beta": values}``, the entry of args to change ("beta", "spring.rate", "rates[2]"; "args" where args
            is a number), and its values (values,) in order.
        t1: length of each run before samples count.
        starts: number of random starts, the same at each value.
        key: a `jax.random.key`, to draw them.
        period: as in `basins`.
        angles: as in `basins`.
        t0: as in `basins`.
        mode: as in `basins`.
        method: as for `lh.lyapunov_spectrum`.
        max_steps: most attempts of a step in one run.
        progress: True for a bar, or a function of the fraction done.
        checkpoint: path of a file which keeps what is done, every few seconds and after Ctrl-C.
        resume: go on from that file, if it is there: the result is that of a run that never stopped. A run that is
            finished goes on to values that follow those before.

    Returns:
        A `BasinShares` with `.names`, `.shares`, `.stderr`, `.basins`, `.plot()`; after Ctrl-C of the values before.
        Shares count starts and have no derivatives: their slope is that of a line through several values.

    Raises:
        ValueError: on arguments that do not fit; where `checkpoint` is the file of another run.
        OSError: where `checkpoint` cannot be written from the start.

    Source:
        G. Datseris, K. Luiz Rossi & A. Wagemakers, Framework for global stability analysis of dynamical systems, Chaos
        33 (2023) 073151, doi:10.1063/5.0159675.

    Example:
        x' = x − x³ + a: starts above the middle fixed point go up.

        >>> import jax, jax.numpy as jnp, lyaphybrid as lh
        >>> tilted = lh.Flow(lambda t, x, a: x - x**3 + a["tilt"])
        >>> how = {"t1": 60.0, "starts": 1000, "key": jax.random.key(1)}
        >>> found = lh.basin_shares(tilted, [[-1.5], [1.5]], {"tilt": 0.0}, over={"tilt": [0.1, 0.3]}, **how)
        >>> middle = jnp.array([-0.10103, -0.33894])  # roots of x − x³ + a
        >>> up = int(found.basins[0].attractors[1].points[0, 0] > 0)  # which of the two is above
        >>> exact = (1.5 - middle) / 3
        >>> bool(abs(found.shares[:, up] - exact).max() < 4 * found.stderr.max())
        True
    """
    require_values("basin_shares", x0, args)
    name, values = only_parameter(over)
    entry, known, found, numbers = number_of(args, name), [], [], []
    how = {"period": period, "angles": angles, "t0": t0, "mode": mode, "method": method, "max_steps": max_steps}

    def run_at(value) -> BasinRun:
        return BasinRun.of(system, x0, entry.placed(args, float(value)), t1, (None, starts, key), **how)

    report = reporter(progress, len(values), "value")
    with run_at(values[0]).kept(checkpoint, resume) as steps:
        for i, value in enumerate(values):
            (kept,) = steps(lambda value=value: [np.asarray(value)])
            require(bool(kept == value), OTHER_VALUES.format(checkpoint, i, name, float(kept), float(value)))
            run = run_at(value)
            here = run.found(steps)
            (led,) = steps(functools.partial(_led_to, known, here, run, mode is not None, steps))
            if steps.interrupted:  # what was computed before is returned
                break
            found.append(here)
            numbers.append(_matched(here.attractors, known, here.metric, led))
            report((i + 1) / len(values))
    report(None)
    if not found:
        raise KeyboardInterrupt
    if len(found) < len(values):
        warnings.warn(f"interrupted: {len(found)} of {len(values)} values were computed.", stacklevel=user_level())
    values = values[: len(found)]
    names = [f"attractor {i}" for i in range(len(known))]
    names += sorted({one for each in found for one in each.names[len(each.attractors) :]})
    shares = np.zeros((len(values), len(names)))
    for row, each, own in zip(shares, found, numbers, strict=True):
        places = [*own, *(names.index(one) for one in each.names[len(each.attractors) :])]
        row[places] = each.shares
    stderr = np.sqrt(shares * (1 - shares) / starts)
    return BasinShares(name, values, tuple(names), shares, stderr, tuple(found))


def _led_to(known: list[Attractor], here: Basins, run: BasinRun, in_modes: bool, steps: KeptSteps) -> list[np.ndarray]:
    """To which attractor here a point of each known one leads; −1 for none."""
    labels, sampling = np.full(len(known), -1), run.sampling
    modes = np.array([int(one.modes[-1]) if in_modes else -1 for one in known], int)
    for mode in [] if steps.interrupted else np.unique(modes):
        these = np.flatnonzero(modes == mode)
        rows, given = np.array([known[i].points[-1] for i in these]), None if mode < 0 else int(mode)
        _, _, t0, given = preparation.prepare(sampling.system, rows[0], sampling.args, run.t0, sampling.method, given)
        last = sampling(rows, float(t0), given, run.transient, LAST_SAMPLES)
        steps.interrupted |= bool(np.any(last.status == STATUS.interrupted))
        at = arrived(last.points, last.modes, here.metric, here.attractors)
        labels[these] = np.where(last.status == STATUS.ok, at, -1)
    return [labels]


def _matched(attractors, known: list[Attractor], metric: Metric, led: np.ndarray) -> list[int]:
    """The number of each attractor among the known ones, which are replaced by them, or which they join."""
    apart = {(i, j): _apart(one, other, metric) for i, one in enumerate(attractors) for j, other in enumerate(known)}
    nearest_first = sorted(apart.items(), key=lambda item: item[1])
    numbers: dict[int, int] = {}
    for by_leading in (True, False):
        for (i, j), distance in nearest_first:
            same = led[j] == i if by_leading else distance < SAME_ATTRACTOR
            if same and i not in numbers and j not in numbers.values():
                numbers[i] = j
    for i, one in enumerate(attractors):
        if i not in numbers:
            numbers[i] = len(known)
            known.append(one)
        else:
            known[numbers[i]] = one
    return [numbers[i] for i in range(len(attractors))]


def _apart(one: Attractor, other: Attractor, metric: Metric) -> float:
    """The mean distance of the points of each from the other, the larger of the two."""
    there = np.mean(distances(other, one.points, one.modes, metric))
    return float(max(there, np.mean(distances(one, other.points, other.modes, metric))))
