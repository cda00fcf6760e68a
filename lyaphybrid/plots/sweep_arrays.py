"""The data of a sweep for figures, as NumPy arrays; nothing here draws.

Only the dataset is used, so that a sweep read from a file can be drawn like a new one.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .._arguments import require
from ..statuses import STATUS

__all__ = ["NO_VALUE", "Swept", "axes_scale", "edges", "label", "list_or_grid", "nearest", "one_parameter"]

GREEK: dict[str, str] = dict(
    zip(
        "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu "
        "nu xi omicron pi rho sigma tau upsilon phi chi psi omega".split(),
        "αβγδεζηθικλμνξοπρστυφχψω",
        strict=True,
    )
)
NO_VALUE = -1  # code of points that were not computed
PIXELS = (600, 450)  # size of the figure of a list of points, in pixels
NEIGHBOURS, FARTHEST = 4, 1.2  # pixels farther than FARTHEST times the widest gap to a fourth neighbour are empty


class Swept(NamedTuple):
    """A sweep over some parameters, or over a list of points."""

    names: tuple[str, ...]
    parameters: tuple[np.ndarray, ...]  # (m,) each, rising in a grid
    numbers: np.ndarray  # (k,) of the exponents
    exponents: np.ndarray  # (…, k)
    stderr: np.ndarray  # (…, k)
    codes: np.ndarray  # (…) statuses, or NO_VALUE


def one_parameter(dataset: Any, exponents: Any = None) -> Swept:
    """A sweep over one parameter: exponents (m, k), averaged over r replicates, and codes (m, r).

    Raises:
        ValueError: on more parameters, or on exponents that are not there.
    """
    dims = _dims(dataset)
    over = [dim for dim in dims if dim != "key"] if len(dims) == 2 else list(dims)
    require(
        len(over) == 1,
        f"sweep_lines draws against one parameter; the dataset has {_sizes(dataset, dims)}. {_select(dims, 1)}",
    )
    name, values = _parameter(dataset, over[0])
    numbers, found, errors, codes = _arrays(dataset, (*over, *(dim for dim in dims if dim not in over)), exponents)
    if len(dims) == 1:
        found, errors, codes = found[:, None], errors[:, None], codes[:, None]
    order = np.argsort(values, kind="stable")
    means, errors = _averaged(found[order], errors[order])
    return Swept((name,), (values[order],), numbers, means, errors, codes[order])


def list_or_grid(dataset: Any, exponent: Any) -> Swept:
    """One exponent at the points of a grid (m, n, 1), or of a list (m, 1) of points in a plane.

    Raises:
        ValueError: on fewer or more parameters, or on an exponent that is not there.
    """
    dims = _dims(dataset)
    require(
        len(dims) in (1, 2),
        f"sweep_map draws over two parameters; the dataset has {_sizes(dataset, dims)}. {_select(dims, 2)}",
    )
    arrays = _arrays(dataset, dims, exponent)
    if len(dims) == 1:
        names = _coordinates(dataset, dims[0])
        require(
            len(names) == 2,
            f"sweep_map draws over two parameters; along the dimension {dims[0]!r} the dataset has "
            f"{', '.join(names) or 'none'}. " + _advice(names, dims[0]),
        )
        return Swept(tuple(names), tuple(np.asarray(dataset[name], float) for name in names), *arrays)
    (first, x), (second, y) = (_parameter(dataset, dim) for dim in dims)
    rows, columns = np.argsort(x, kind="stable"), np.argsort(y, kind="stable")
    numbers, *others = arrays
    return Swept((first, second), (x[rows], y[columns]), numbers, *(one[rows][:, columns] for one in others))


def _advice(names: Sequence[str], dim: str) -> str:
    if len(names) < 2:
        return "Draw it with sweep_lines."
    return f"Leave two of them, as by dataset.drop_vars({names[-1]!r})."


def _dims(dataset: Any) -> tuple[str, ...]:
    """The swept dimensions."""
    swept = hasattr(dataset, "data_vars") and hasattr(dataset, "sizes")
    require(swept, f"Give the xarray.Dataset that lh.sweep returns; got {type(dataset).__name__}.")
    has = ", ".join(map(str, dataset.data_vars)) or "nothing"
    require(
        "exponents" in dataset.data_vars,
        f"The dataset has no exponents, it has {has}: the run of the sweep must return a Spectrum. Where it is one of "
        "several results, take it out with dataset.rename({'name.exponents': 'exponents', …}).",
    )
    return tuple(dim for dim in dataset["exponents"].dims if dim != "exponent")


def _sizes(dataset: Any, dims: Sequence[str]) -> str:
    return ", ".join(f"{dim} ({dataset.sizes[dim]})" for dim in dims) or "none: all were selected"


def _select(dims: Sequence[str], wanted: int) -> str:
    """Text of an error: how to reduce the number of dimensions."""
    if len(dims) <= wanted:
        return "Take what lh.sweep returned, before .sel and .isel."
    choices = " and ".join(f"{dim}=…" for dim in dims[wanted:])
    other = ", or draw both with sweep_map" if len(dims) == 2 else ""
    return f"Select values of the others first, as dataset.sel({choices}) or dataset.isel({dims[-1]}=0){other}."


def _coordinates(dataset: Any, dim: str) -> list[str]:
    """The numeric coordinates of a dimension, without a mere count of points."""
    along = [name for name, one in dataset.coords.items() if one.dims == (dim,) and one.dtype.kind in "fiub"]
    return [name for name in along if name != "point"]


def _parameter(dataset: Any, dim: str) -> tuple[str, np.ndarray]:
    """Name and values of the parameter along a dimension."""
    names = _coordinates(dataset, dim)
    if dim in names or not names:
        return dim, np.asarray(dataset[dim], float)
    require(
        len(names) == 1,
        f"{', '.join(names)} change together along the dimension {dim!r}. Choose one to draw against, as "
        f"dataset.swap_dims({dim}={names[0]!r})" + (", or draw them with sweep_map." if len(names) == 2 else "."),
    )
    return names[0], np.asarray(dataset[names[0]], float)


def _arrays(dataset: Any, dims: Sequence[str], chosen: Any):
    """Numbers (k,) of the chosen exponents, their values and errors (…, k), and codes (…)."""
    found = (_with_exponents(dataset, name) for name in ("exponents", "stderr"))
    exponents, stderr = (one.transpose(*dims, "exponent") for one in found)
    known = np.asarray(exponents["exponent"], int)
    numbers = known if chosen is None else np.atleast_1d(np.asarray(chosen))
    require(
        len(numbers) > 0 and bool(np.all(np.isin(numbers, known))),
        f"The dataset has the exponents {', '.join(map(str, known))}, numbered from 1; got {chosen!r}.",
    )
    places = [int(np.flatnonzero(known == number)[0]) for number in numbers]
    values, errors = (np.asarray(one, float)[..., places] for one in (exponents, stderr))
    status = dataset["status"].transpose(*dims) if "status" in dataset else np.zeros(values.shape[:-1])
    codes = np.nan_to_num(np.asarray(status, float), nan=NO_VALUE).astype(int)
    fine = (codes == int(STATUS.ok)) | (codes == int(STATUS.terminated))
    return numbers, values, errors, np.where(fine & np.all(np.isnan(values), axis=-1), NO_VALUE, codes)


def _with_exponents(dataset: Any, name: str):
    """A variable with its dimension "exponent", which .sel(exponent=1) takes away."""
    found = dataset[name] if name in dataset else np.nan * dataset["exponents"]
    if "exponent" not in found.dims:
        found = found.expand_dims("exponent")
    return found if "exponent" in found.coords else found.assign_coords(exponent=1 + np.arange(found.sizes["exponent"]))


def _averaged(values, errors):
    """Means (m, k) over replicates (m, r, k) and their standard errors; for one replicate its own error."""
    if values.shape[1] == 1:
        return values[:, 0], errors[:, 0]
    known = ~np.isnan(values)
    count = np.sum(known, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):  # no finite value: nan; one: an error of nan
        mean = np.sum(np.where(known, values, 0.0), axis=1) / count
        squares = np.sum(np.where(known, values - mean[:, None], 0.0) ** 2, axis=1)
        return mean, np.sqrt(squares / (count - 1) / count)


# --- names, and cells in the plane -------------------------------------------------------------------------------


def label(name: str) -> str:
    """The label of an axis: the last part of a name, with Greek letters; "spring.omega[1]" is ω[1]."""
    word, bracket, index = str(name).rpartition(".")[2].partition("[")
    letter = GREEK.get(word.strip("_").lower())
    if letter is not None:
        word = letter.upper() if word[0].isupper() else letter
    return word + bracket + index


def axes_scale(values: np.ndarray) -> str:
    """The scale "log" for values in equal ratios over more than a decade, else "linear"."""
    if len(values) < 4 or values[0] <= 0 or values[-1] < 10 * values[0]:
        return "linear"
    steps = np.diff(np.log(values))
    return "log" if np.allclose(steps, np.mean(steps), rtol=1e-2, atol=0) else "linear"


def edges(values: np.ndarray, scale: str = "linear") -> np.ndarray:
    """The borders (m + 1,) of cells around rising values (m,): midway; the outermost cells are symmetric."""
    if scale == "log":
        return np.exp(edges(np.log(values)))
    half = np.diff(values) / 2
    first, last = (half[0], half[-1]) if len(half) else (0.5, 0.5)
    return np.concatenate([[values[0] - first], values[:-1] + half, [values[-1] + last]])


def nearest(x: np.ndarray, y: np.ndarray):
    """Pixels over points (m,) in the plane: their borders along both axes, and the index of the nearest point of each.

    Pixels far from all points, relative to the widest gap between neighbours, have the index -1.
    """
    from scipy.spatial import KDTree

    low, span = (np.array([f(x), f(y)]) for f in (np.min, np.ptp))
    span = np.where(span > 0, span, 1.0)
    tree = KDTree((np.stack([x, y], axis=1) - low) / span)
    borders = [np.linspace(0.0, 1.0, pixels + 1) for pixels in PIXELS]
    centres = np.stack(np.meshgrid(*((one[1:] + one[:-1]) / 2 for one in borders)), axis=-1)
    distance, index = tree.query(centres)
    count = min(NEIGHBOURS, len(x) - 1)
    gaps = tree.query(tree.data, k=count + 1)[0][:, -1] if count else np.inf
    index = np.where(distance <= FARTHEST * np.max(gaps), index, -1)
    across, upwards = (a + d * one for a, d, one in zip(low, span, borders, strict=True))
    return across, upwards, index
