"""`refine`: adaptive refinement of a sweep where its classification changes."""

import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._arguments import require, whole
from ..statuses import STATUS
from .outputs import outcome
from .plans import POINT, Runnable, plan
from .sweeping import Work, function_of, xarray_module

if TYPE_CHECKING:
    import xarray

__all__ = ["chaotic", "refine"]

LEVEL = "level"  # the variable that is added
Site = tuple[int, ...]  # a point of the finest lattice


def chaotic(dataset) -> np.ndarray:
    """The default classes (points,) of `refine`: status of failed runs; else whether λ₁ > 2 standard errors."""
    status, leading = dataset.status.values, dataset.exponents.isel(exponent=0).values
    error = np.nan_to_num(dataset.stderr.isel(exponent=0).values)
    over = (status == int(STATUS.ok)) | (status == int(STATUS.terminated))
    return np.where(over, -1 - (leading > 2 * error), status)


def refine(
    dataset: "xarray.Dataset",
    run: Callable | Runnable,
    *,
    args: Any = None,
    levels: int = 3,
    classify: Callable[[Any], Any] = chaotic,
    chunk: int | None = None,
    store: Any = None,
    client: Any = None,
    progress: Any = True,
) -> "xarray.Dataset":
    """Add points to a sweep where a classification changes: boundaries as sharp as those of a much finer grid.

    A cell of the grid whose corners have different classes is halved along each axis; so are those of its parts that
    have different classes, down to `levels` halvings. If a new point on the boundary of a neighbouring cell differs
    from that cell's class, the neighbour is halved too. A region that is smaller than the cells of the grid and
    contains no grid point is not found.

    Args:
        dataset: of `lh.sweep` over a grid of numbers, one dimension each.
        run: the same as there.
        args: the same as there.
        levels: number of halvings: boundaries are found to 1/2^levels of the grid's spacing.
        classify: dataset with one dimension "point" -> classes (points,), of any type with ==. The default classes are
            the status of failed runs and, for the others, whether λ₁ exceeds two standard errors.
        chunk: as for `lh.sweep`.
        store: path of a directory with a zarr store for each step, so that an interrupted refinement can be resumed.
        client: as for `lh.sweep`.
        progress: True for a bar for each step, None, or a function of the fraction of a step that is done.

    Returns:
        An `xarray.Dataset` of all points, old and new, along the dimension "point", with the entries swept as
        coordinates, and the variable "level" at which a point was added (0: in the grid). Its attribute
        "points_of_grid" is the number of points of an equally fine grid.

    Raises:
        ValueError: if the dataset is not that of a grid or was made with another run; otherwise as `lh.sweep`.
        StoreFailedError: as `lh.sweep`; what was computed before is in the stores.

    Example:
        >>> import numpy as np
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
        >>> def run(r):
        ...     return lh.lyapunov_spectrum(logistic, [0.3], r, transient=500, t1=1000)
        >>> grid = lh.sweep(run, {"args": np.linspace(2.5, 3.7, 4)}, args=3.0, progress=False)
        >>> found = lh.refine(grid, run, args=3.0, levels=7, progress=False)  # chaos begins at 3.5699
        >>> float(found.args.where(found.exponents[:, 0] > 0).min()) < 3.58
        True
        >>> found.point.size, found.attrs["points_of_grid"]
        (11, 385)
    """
    whole("levels", levels, least=1)
    kind = type(dataset).__name__
    require(isinstance(dataset, xarray_module().Dataset), f"dataset must be one that lh.sweep returned; got a {kind}.")
    require(callable(classify), f"classify must be a function of a dataset; got {classify!r}.")
    function, args = function_of(run, args)
    axes = _axes_of(dataset)
    lattice = Lattice(list(axes.values()), levels)
    parts = [_as_points(dataset, axes)]
    sites = [*itertools.product(*(range(0, size, lattice.step) for size in lattice.shape))]
    classes = dict(zip(sites, _classes(classify, parts[0]), strict=True))
    program = None
    for number, (level, wanted) in enumerate(lattice.wanted(classes), 1):
        points = dict(zip(axes, lattice.values(wanted).T, strict=True))
        work = Work.of(run, function, args, plan(None, points, args), chunk)
        same = work.function == dataset.attrs.get("function")
        require(same, "This dataset was made with another run, other args or other versions: sweep again.")
        work.program = program
        own = None if store is None else Path(store) / f"{number:03d}.zarr"
        found = work.dataset(own, client, progress)
        program = work.program
        parts.append(found.drop_vars(POINT).assign({LEVEL: (POINT, np.full(len(wanted), level))}))
        classes |= zip(wanted, _classes(classify, parts[-1]), strict=True)
        if not np.all(work.done):  # after Ctrl-C
            break
    return _joined(dataset, parts, lattice)


def _axes_of(dataset) -> dict[str, np.ndarray]:
    """The values of each axis of a grid."""
    dims = dataset.attrs.get("dims")
    require(
        dims is not None,
        "refine takes a dataset as lh.sweep returns it; this one has lost its attribute 'dims': keep the attributes.",
    )
    dims = json.loads(dims) if isinstance(dims, str) else dims  # a list in datasets of before
    require(
        POINT not in dims,
        "refine takes a sweep over a grid; this one has a list of points: sweep with over={…} instead of points={…}. "
        'Where an entry of args itself is called "point", give it another name.',
    )
    taken = "refine adds a variable of the name level, and this sweep has one: give that entry another name."
    require(LEVEL not in dataset.variables, taken)
    for dim in dims:
        values = dataset[dim]
        whole_numbers = values.dtype.kind in "iub"
        require(not whole_numbers, f"refine looks between the values of {dim}, which are integers: sweep over floats.")
        plain = f"{dim}_value" not in dataset.coords and dim in dataset.dims
        require(
            plain and values.size > 1, f"refine needs a grid of numbers, two or more along each axis; not so {dim}."
        )
    return {dim: dataset[dim].values for dim in dims}


def _as_points(dataset, axes):
    """The grid as a list of points, with level 0."""
    flat = dataset.stack({POINT: list(axes)}).reset_index(POINT).transpose(POINT, ...)
    return flat.assign({LEVEL: (POINT, np.zeros(flat.sizes[POINT], int))})


def _classes(classify, dataset) -> list:
    found = np.asarray(classify(dataset))
    count = dataset.sizes[POINT]
    require(found.shape == (count,), f"classify must return one class for each of {count} points; got {found.shape}.")
    return found.tolist()


def _joined(dataset, parts, lattice: "Lattice"):
    import xarray

    joined = xarray.concat(parts, POINT, combine_attrs="drop")
    about = {name: value for name, value in dataset.attrs.items() if name not in ("dims", "shape", "problem")}
    sizes = {"levels": lattice.levels, "points_of_grid": int(np.prod(lattice.shape))}
    seconds = sum(part.attrs.get("seconds", 0.0) for part in parts)
    ended = outcome({str(name): values.values for name, values in joined.data_vars.items()})
    return joined.assign_attrs(about | sizes | {"seconds": seconds, "outcome": ended})


class Lattice:
    """The finest lattice on which points may lie."""

    def __init__(self, axes: Sequence[np.ndarray], levels: int):
        self.axes, self.levels, self.step = axes, levels, 2**levels
        self.shape = tuple(self.step * (len(axis) - 1) + 1 for axis in axes)

    def values(self, sites: Sequence[Site]) -> np.ndarray:
        """The values (sites, axes) of lattice sites, interpolated linearly between the grid's values."""
        at = np.asarray(sites) / self.step
        return np.stack([np.interp(at[:, i], np.arange(len(axis)), axis) for i, axis in enumerate(self.axes)], axis=1)

    def wanted(self, classes: dict[Site, Any]) -> Iterator[tuple[int, list[Site]]]:
        """Yield (level, sites to compute); the caller adds their classes to `classes` before it continues."""
        cells = [*itertools.product(*(range(0, size - 1, self.step) for size in self.shape))]
        for level in range(1, self.levels + 1):
            half, divided = self.step >> level, []
            while True:
                mixed = [cell for cell in cells if _is_mixed(classes, cell, half)]
                if not mixed:
                    break
                chosen = set(mixed)
                divided, cells = divided + mixed, [cell for cell in cells if cell not in chosen]
                sites = {site for cell in mixed for site in _sites(cell, half, 3)}
                new = sorted(sites - classes.keys())
                if new:
                    yield level, new
            cells = [part for cell in divided for part in _sites(cell, half, 2)]


def _sites(cell: Site, half: int, count: int) -> list[Site]:
    """The lower corners of the 2^d parts of a cell (count = 2), or all corners of these parts (3)."""
    return [*itertools.product(*(range(low, low + count * half, half) for low in cell))]


def _is_mixed(classes: dict[Site, Any], cell: Site, half: int) -> bool:
    """Whether the known classes of a cell, at its corners and halfway between them, differ."""
    known = [classes[site] for site in _sites(cell, half, 3) if site in classes]
    return any(one != known[0] for one in known)
