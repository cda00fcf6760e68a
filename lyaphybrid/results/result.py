"""What every result has: it prints, shows itself in notebooks, and becomes a dataset with named dimensions."""

import abc
import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from .._jax.tracing import traced
from .._text import Table, as_html, as_text, known_unit
from ..statuses import STATUS, status_of
from ..systems.labels import Labels

if TYPE_CHECKING:
    import xarray

__all__ = ["Data", "Result", "RunResult", "exponents_along", "in_time", "per_time", "states_along"]


class Data(NamedTuple):
    """What a dataset is made of; what is None is left out."""

    variables: Mapping[str, tuple | None]  # name: (dimensions, values), or with {"units": …} for a third
    coordinates: Mapping[str, Any] = {}
    attributes: Mapping[str, Any] = {}


class Result(abc.ABC):
    """A result of a computation.

    All of them print as a table (`str`, and as HTML in notebooks), have documented attributes, and `to_xarray()`.
    Times are named alike: `t` is an instant, on the clock that the system sees; `time` is a length, counted from the
    start of what counts. `jumps` is a number of jumps; `events` is the list of them.

    Attributes:
        status_code: () or (m,) the numbers of `status`, for use under a transformation; of results of runs.
        unit: what exponents are counted per.
        mode_names: names of the modes, in the order of their indices.
        state_labels: names and units of the components of a state, and the unit of time.
    """

    @abc.abstractmethod
    def _table(self) -> Table:
        """What is printed."""

    @abc.abstractmethod
    def _data(self) -> Data:
        """What a dataset holds."""

    def to_xarray(self) -> "xarray.Dataset":
        """The result as an `xarray.Dataset` with named dimensions; what is no array is among its attributes.

        From there ``.to_dataframe()`` makes a table of pandas, ``.to_zarr(path)`` a store.

        Raises:
            ImportError: without the extra "xarray".
            ValueError: under jit, vmap or grad, where there are no values.
        """
        name = type(self).__name__
        try:
            import xarray
        except ImportError as error:
            raise ImportError(f"{name}.to_xarray needs xarray: pip install 'lyaphybrid[xarray]'.") from error
        if traced(self):
            raise ValueError(f"{name}.to_xarray is for results on the host, not under jit, vmap or grad.")
        data = self._data()
        variables = {name: _on_host(*own) for name, own in data.variables.items() if own is not None}
        time_unit = getattr(self, "state_labels", Labels()).time_unit or None
        attributes = {"result": name, "time_unit": time_unit, **data.attributes}
        if isinstance(self, RunResult):
            attributes["status"] = str(self.status)
        attributes = {name: _attribute(value) for name, value in attributes.items() if value is not None}
        return xarray.Dataset(variables, data.coordinates, attributes)

    def to_netcdf(self, path: "str | os.PathLike[str]") -> None:
        """Write what `to_xarray` gives to a NetCDF file, which ``xarray.open_dataset(path)`` reads.

        NetCDF has no complex numbers: a complex variable is written as two, ``multipliers_real`` and
        ``multipliers_imag``.

        Args:
            path: of the file, which is written anew.

        Raises:
            ImportError: without the extra "xarray".
            ValueError: under jit, vmap or grad, where there are no values.
        """
        data = self.to_xarray()
        for name, values in data.variables.items():
            if np.iscomplexobj(values):
                parts = {f"{name}_real": (values.dims, values.real), f"{name}_imag": (values.dims, values.imag)}
                place = data.assign_coords if name in data.coords else data.assign
                data = place(parts).drop_vars(str(name))
        data.to_netcdf(path)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return as_html(self._shown())

    def __str__(self) -> str:
        return as_text(self._shown())

    __repr__ = __str__

    def _shown(self) -> Table:
        return Table(f"{type(self).__name__}(under a transformation)") if traced(self) else self._table()


class RunResult(Result):
    """A result of a run, or of several, with a verdict."""

    status_code: Any  # () or (m,)

    @property
    def status(self) -> STATUS | Any:
        """How the run ended, an `lh.STATUS`; of several runs the gravest. Under a transformation the bare code."""
        return status_of(self.status_code)


def _on_host(dimensions, values, attributes: dict[str, str] | None = None) -> tuple:
    return dimensions, np.asarray(values), attributes or {}


def _attribute(value: Any) -> Any:
    """As files can hold it."""
    if isinstance(value, frozenset | set):
        value = sorted(map(str, value))
    if isinstance(value, np.ndarray | jax.Array):
        value = np.asarray(value)
        value = value if value.ndim else value.item()
    if isinstance(value, bool | np.bool_):
        return int(value)
    if isinstance(value, tuple | list):  # files of some kinds hold one text, but no list of texts and no empty list
        return "; ".join(value) if all(isinstance(one, str) for one in value) else list(value)
    return value


def in_time(unit: str) -> dict[str, str]:
    """The attributes of times in a dataset: their unit, where it is known."""
    return {"units": unit} if known_unit(unit) else {}


def per_time(unit: str) -> dict[str, str]:
    """The attributes of exponents in a dataset, likewise."""
    return {"units": f"1/{unit}"} if known_unit(unit) else {}


def exponents_along(count: int) -> dict[str, Any]:
    """The coordinate of exponents: 1 for the largest."""
    return {"exponent": np.arange(1, count + 1)}


def states_along(labels: Labels, d: int) -> dict[str, Any]:
    """The coordinates of the components of a state: their names, and their units where they are known."""
    units = {"unit": ("state", list(labels.units))} if labels.units else {}
    return {"state": labels.columns(d), **units}
