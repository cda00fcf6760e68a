"""The points of a sweep: axes over entries of args, starts x0 and PRNG keys; and `PointRun`, the run at one point."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import numpy as np

from .._arguments import require, whole
from .._entries import ArgsEntry, described, entry_named
from .._jax.tracing import is_typed_key, without_key_type

__all__ = ["PointRun", "Runnable", "SweepPlan", "plan"]

EXTRAS = ("x0", "key")  # arguments of a run besides args that can be swept
POINT = "point"


@runtime_checkable
class Runnable(Protocol):
    """An object that can be swept directly, such as a problem of the zoo: it has args and a spectrum."""

    @property
    def args(self) -> Any:
        """Its parameters."""
        ...

    def spectrum(self, **changes: Any) -> Any:
        """The spectrum, with other args or from another start."""
        ...


class Axis(NamedTuple):
    """The values of one entry."""

    path: str  # name of the entry
    dim: str  # name of the dimension
    values: Any  # (m, …); typed PRNG keys for "key"


class SweepPlan(NamedTuple):
    """All points of a sweep, in the order of a C array over its dimensions."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    axes: tuple[Axis, ...]

    @property
    def size(self) -> int:
        """The number of points."""
        return int(np.prod(self.shape))

    def rows(self, points: np.ndarray) -> dict[str, Any]:
        """The values of all axes at the points of these indices (m,): arrays (m, …) by path."""
        indices = dict(zip(self.dims, np.unravel_index(points, self.shape), strict=True))
        return {axis.path: without_key_type(axis.values)[indices[axis.dim]] for axis in self.axes}

    def coordinates(self) -> dict[str, tuple]:
        """Coordinates for an `xarray.Dataset`: numbers label their dimension; vectors and keys get an index."""
        found: dict[str, tuple] = {}
        for axis in self.axes:
            values = without_key_type(axis.values)
            if values.ndim == 1 and not is_typed_key(axis.values):
                found[axis.path] = ((axis.dim,), values)
                continue
            if axis.dim == axis.path:
                found[axis.dim] = ((axis.dim,), np.arange(len(values)))
            name = f"{axis.path}_value" if axis.dim == axis.path else axis.path
            inner = tuple(f"{axis.path}_{i}" for i in range(values.ndim - 1))
            found[name] = ((axis.dim, *inner), values)
        if POINT in self.dims:
            found.setdefault(POINT, ((POINT,), np.arange(self.shape[self.dims.index(POINT)])))
        return found


def plan(over: Mapping[str, Any] | None, points: Mapping[str, Any] | None, args: Any) -> SweepPlan:
    """The product of all axes of `over` and of the list `points`, whose entries change together.

    Raises:
        ValueError: if nothing is varied, an entry does not exist, or arrays do not fit.
    """
    for name, given in (("over", over), ("points", points)):
        kind = type(given).__name__
        require(given is None or isinstance(given, Mapping), f"{name} must be a dict {{name: values}}; got a {kind}.")
    over, listed = dict(over or {}), dict(points or {})
    require(bool(over or listed), "Nothing to sweep: give over={name: values} or points={name: values}.")
    both = sorted(set(over) & set(listed))
    require(not both, f"{', '.join(both)} are in over and in points: name each parameter in one of them.")
    axes = [_axis(path, path, values, args) for path, values in over.items()]
    axes += [_axis(path, POINT, values, args) for path, values in listed.items()]
    lengths: dict[str, int] = {}
    for axis in axes:
        known = lengths.setdefault(axis.dim, len(axis.values))
        wanted = f"All of points must have one length; {axis.path} has {len(axis.values)}, others {known}."
        require(known == len(axis.values), wanted)
    product = " × ".join(map(str, lengths.values()))
    whole(f"the number of points, {product},", math.prod(lengths.values()), least=1, each=1)
    return SweepPlan(tuple(lengths), tuple(lengths.values()), tuple(axes))


def _axis(path: str, dim: str, values, args) -> Axis:
    require(isinstance(path, str), f"Names in over and points are strings; got {path!r}.")
    if not is_typed_key(values):
        values = np.asarray(values)
        numeric = values.dtype.kind in "fiub" or (path == "key" and values.dtype.kind == "u")
        require(numeric, f"{path} must be an array of numbers; got {values.dtype}.")
        require(
            values.dtype.kind != "f" or bool(np.all(np.isfinite(values))), f"{path} must be finite; got {values!r}."
        )
    several = values.ndim >= 1 and len(values) > 0
    require(several, f"{path}, in over or points, must be an array of at least one value; got {values!r}.")
    if entry := entry_named(args, path):
        wanted = np.shape(entry.of(args))
        inner = values.shape[1:]
        require(inner == wanted, f"{path} has the shape {wanted}: values need (m, *{wanted}); got {values.shape}.")
    else:
        there = f"args has {described(args)}; x0 and key are given to a run that takes them"
        require(path in EXTRAS, f"{path!r} is no entry of args: {there}.")
    return Axis(path, dim, values)


class PointRun(eqx.Module):
    """The run at one point of a sweep, as a function of args and of the values that vary."""

    run: Callable
    entries: tuple[tuple[str, ArgsEntry], ...] = eqx.field(static=True)
    keys: tuple[tuple[str, str], ...] = eqx.field(static=True)  # paths of typed PRNG keys, and their kinds

    @staticmethod
    def of(run: Callable, plan: SweepPlan, args: Any) -> "PointRun":
        """The lane of a run for the points of a plan."""
        own = tuple((axis.path, entry) for axis in plan.axes if (entry := entry_named(args, axis.path)))
        keys = [(axis.path, axis.values) for axis in plan.axes if is_typed_key(axis.values)]
        return PointRun(run, own, tuple((path, str(jax.random.key_impl(values))) for path, values in keys))

    def __call__(self, args, row: Mapping[str, Any]):
        """The result of the run with the values of `row` in place of those entries of args."""
        row = dict(row)
        for path, kind in self.keys:
            row[path] = jax.random.wrap_key_data(row[path], impl=kind)
        for path, entry in self.entries:
            args = entry.placed(args, row.pop(path))
        return self.run(args, **row)
