"""One run from each start of a grid, as the fields need it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .._arguments import attempts, require, require_values
from ..analysis.grids import box_of, grid_of
from ..engine import preparation
from ..statuses import STATUS
from ..systems.daes.semi_linear import DAE
from ..systems.labels import Labels, labels_of
from .sweeping import sweep

__all__ = ["Starts", "starts_of", "status_lines"]


class Starts(NamedTuple):
    """The starts of a grid."""

    grid: np.ndarray  # (starts, n)
    axes: dict[int, np.ndarray]  # the varied components, by index, and their values
    labels: Labels

    @property
    def cells(self) -> tuple[int, ...]:
        """The shape of the grid."""
        return tuple(len(values) for values in self.axes.values())

    def swept(self, run: Callable, args: Any, **how: Any) -> dict[str, np.ndarray]:
        """What run(args, x0) gives at all starts (starts, …); its status_code is "interrupted" where nothing is."""
        found = sweep(run, points={"x0": self.grid}, args=args, **how)
        values = {str(name): one.values for name, one in found.data_vars.items()}
        status = values["status_code"]
        values["status_code"] = np.where(status < 0, np.int32(STATUS.interrupted), status)
        return values


def starts_of(verb: str, system, x0, args, shape, *, t0, method, mode, max_steps) -> Starts:
    """The starts in a box, after a check of the arguments that all fields have."""
    require(not isinstance(system, DAE), f"{verb} takes no lh.DAE: starts of a box are not on its constraints.")
    require_values(verb, x0, args, t0)
    attempts(max_steps)
    grid, axes = grid_of(box_of(x0), shape)
    problem, *_ = preparation.prepare(system, grid[0], args, t0, method, mode)
    return Starts(grid, axes, labels_of(system, problem.shape))


def status_lines(result) -> list[str]:
    """The gravest status, and how many starts have which one where they differ."""
    codes, counts = np.unique(result.status_code, return_counts=True)
    said = [f"status {result.status}"]
    if len(codes) > 1:
        said += [f"{count} starts {STATUS(int(code)).name}" for code, count in zip(codes, counts, strict=True)]
    return said
