"""The points of a sweep: axes over entries of args, starts x0 and PRNG keys; and `PointRun`, the run at one point."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._arguments import require, whole

__all__ = ["ArgsEntry", "PointRun", "Runnable", "SweepPlan", "places", "plan", "raw"]

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
        return {axis.path: raw(axis.values)[indices[axis.dim]] for axis in self.axes}

    def coordinates(self) -> dict[str, tuple]:
        """Coordinates for an `xarray.Dataset`: numbers label their dimension; vectors and keys get an index."""
        found: dict[str, tuple] = {}
        for axis in self.axes:
            values = raw(axis.values)
            if values.ndim == 1 and not _is_key(axis.values):
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
    if not _is_key(values):
        values = np.asarray(values)
        numeric = values.dtype.kind in "fiub" or (path == "key" and values.dtype.kind == "u")
        require(numeric, f"{path} must be an array of numbers; got {values.dtype}.")
        require(
            values.dtype.kind != "f" or bool(np.all(np.isfinite(values))), f"{path} must be finite; got {values!r}."
        )
    several = values.ndim >= 1 and len(values) > 0
    require(several, f"{path}, in over or points, must be an array of at least one value; got {values!r}.")
    known = places(args)
    if path in known:
        wanted = np.shape(known[path].of(args))
        inner = values.shape[1:]
        require(inner == wanted, f"{path} has the shape {wanted}: values need (m, *{wanted}); got {values.shape}.")
    else:
        names = ", ".join(known) or "nothing"
        there = f"args has {names}; x0 and key are given to a run that takes them"
        require(path in EXTRAS, f"{path!r} is no entry of args: {there}.")
    return Axis(path, dim, values)


class ArgsEntry(NamedTuple):
    """The place of an entry in args: the index of its leaf, and of a single number in that leaf (None: all of it)."""

    leaf: int
    index: tuple[int, ...] | None  # pyright: ignore[reportIncompatibleMethodOverride]

    def of(self, args) -> Any:
        """The value of the entry in args."""
        leaf = jax.tree.leaves(args)[self.leaf]
        return leaf if self.index is None else np.asarray(leaf)[self.index]


def places(args) -> dict[str, ArgsEntry]:
    """All entries by name: "rho", "spring.rate", "rates" and "rates[2]"; "args" if args is a number."""
    found: dict[str, ArgsEntry] = {}
    for i, (path, leaf) in enumerate(jax.tree_util.tree_leaves_with_path(args)):
        if not eqx.is_array_like(leaf):
            continue
        name = jax.tree_util.keystr(path, simple=True, separator=".") or "args"
        found[name] = ArgsEntry(i, None)
        found |= {f"{name}{list(at)}": ArgsEntry(i, at) for at in np.ndindex(*np.shape(leaf)) if at}
    return found


def _is_key(values) -> bool:
    return isinstance(values, jax.Array) and jnp.issubdtype(values.dtype, jax.dtypes.prng_key)


def raw(values) -> np.ndarray:
    """The values as a NumPy array; for PRNG keys their data."""
    return np.asarray(jax.random.key_data(values)) if _is_key(values) else np.asarray(values)


class PointRun(eqx.Module):
    """The run at one point of a sweep, as a function of args and of the values that vary."""

    run: Callable
    places: tuple[tuple[str, ArgsEntry], ...] = eqx.field(static=True)
    keys: tuple[str, ...] = eqx.field(static=True)  # paths of typed PRNG keys

    @staticmethod
    def of(run: Callable, plan: SweepPlan, args: Any) -> "PointRun":
        """The lane of a run for the points of a plan."""
        known = places(args)
        own = tuple((axis.path, known[axis.path]) for axis in plan.axes if axis.path in known)
        return PointRun(run, own, tuple(axis.path for axis in plan.axes if _is_key(axis.values)))

    def __call__(self, args, row: Mapping[str, Any]):
        """The result of the run with the values of `row` in place of those entries of args."""
        row = {path: jax.random.wrap_key_data(value) if path in self.keys else value for path, value in row.items()}
        leaves, structure = jax.tree.flatten(args)
        for path, place in self.places:
            value, leaf = row.pop(path), leaves[place.leaf]
            value = value if path in self.keys else _in_kind_of(leaf, value)
            leaves[place.leaf] = value if place.index is None else _with_entry(jnp.asarray(leaf), place.index, value)
        return self.run(jax.tree.unflatten(structure, leaves), **row)


def _in_kind_of(leaf: Any, value: Any):
    """A value of an axis in the precision of the entry that it replaces; whole entries take values that are not."""
    kind, value = jnp.result_type(leaf), jnp.asarray(value)
    fraction = jnp.issubdtype(value.dtype, jnp.inexact) and not jnp.issubdtype(kind, jnp.inexact)
    return value if kind == jnp.result_type(0) or fraction else value.astype(kind)


def _with_entry(array, index, value):
    """The array with one entry set to a value of `_in_kind_of`: one of integers takes the type of a float."""
    return (array.astype(value.dtype) if jnp.issubdtype(value.dtype, jnp.inexact) else array).at[index].set(value)
