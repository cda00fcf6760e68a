"""`sweep`: one run at each point of a grid or list."""

import dataclasses
import itertools
import json
import os
import time
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.extend.core import ClosedJaxpr

from .._arguments import parameters, require, require_values, whole
from .._jax.hashes import hash_of_arrays, hash_of_jaxpr
from .._jax.jaxprs import needed
from .._jax.tracing import without_key_type
from .._keywords import explains_keywords, user_level
from .._version import __version__
from ..engine.host import devices
from ..engine.host.lanes import LaneProgram, run_sequences
from ..engine.host.reporting import reporter
from ..errors import LyaphybridError, StoreFailedError, UserFunctionError
from ..statuses import STATUS
from ..systems.validation import Call, check_signature, explained
from .clusters import run_on
from .outputs import NOTE_NAMES, dims_of, missing, named, outcome, spectra_in
from .plans import EXTRAS, PointRun, Runnable, SweepPlan, plan
from .stores import opened

if TYPE_CHECKING:
    import xarray

__all__ = ["sweep"]

CHUNK = 256  # points in a chunk, the unit of work of a thread, at most


@explains_keywords
def sweep(
    run: Callable | Runnable,
    over: Mapping[str, Any] | None = None,
    *,
    points: Mapping[str, Any] | None = None,
    args: Any = None,
    chunk: int | None = None,
    store: Any = None,
    client: Any = None,
    progress: Any = True,
) -> "xarray.Dataset":
    """One run at each point of a grid, or of a list of points, as an `xarray.Dataset`.

    The run is compiled once. On a CPU each thread computes its points one after the other, so that a point does not pay
    for branches that it does not take. If points rarely take different branches (flows without events, maps), several
    run at once in the lanes of the CPU's vector registers. On accelerators many points run in parallel, an equal share
    on each local device. In all cases each point gives the result of a single run, up to rounding.

    A point that fails does not stop the others: it has its status, and nan for its exponents.

    Args:
        run: ``args -> result``, a `Spectrum` or any pytree of arrays; ``(args, x0)``, ``(args, key)`` or all three
            where these are swept. Or a `Problem` of the zoo: its spectrum at other args.
        over: {name: values (m, …)}: the grid of all combinations, a dimension each. A name is an entry of args, "rho",
            "spring.rate" or "rates[2]"; "args" where args is a number; or "x0" (m, n), or "key" (m,) PRNG keys.
        points: the same for entries that change together, along one dimension "point".
        args: pytree of parameters in which the entries are replaced; None: those of the problem.
        chunk: number of points that are computed and stored together; None: chosen, on a CPU at most 256.
        store: path of a zarr store. Each chunk is written as soon as it is computed, and chunks that the store already
            holds of the same sweep are not computed again: the same call resumes a sweep that was killed. A damaged
            chunk is computed again. A store of another sweep is refused.
        client: a `dask.distributed.Client`: chunks are tasks of its workers (extra "cluster").
        progress: True for a bar with rate and remaining time, None, or a function of the fraction that is done.

    Returns:
        An `xarray.Dataset`. Of spectra: exponents, stderr, finite_exponents, losses (…, exponent), status, notes, time
        and jumps (…); of other results their leaves by name. Its attributes explain the numbers in status and notes;
        "outcome" counts them, as in ``8 ok, 2 zeno; notes: 3 grazing``. They hold system and method (if the run returns
        spectra), the versions, a hash of the problem, and the duration in seconds. After Ctrl-C it holds what was
        computed, with nan or -1 elsewhere, and a warning says how much is missing.

    Raises:
        ValueError: on names, shapes and values that do not fit; if the store holds another sweep, or is in use.
        StoreFailedError: (an OSError) if the store cannot be written, for example because the disk is full. Its
            ``.dataset`` holds all that was computed.
        ImportError: without the extra "sweep" (or "cluster").

    Example:
        >>> import numpy as np
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
        >>> def run(r):
        ...     return lh.lyapunov_spectrum(logistic, [0.3], r, transient=500, t1=1000)
        >>> found = lh.sweep(run, {"args": np.array([2.9, 3.9, 4.1])}, args=3.0, progress=False)
        >>> found.exponents.dims, [int(code) for code in found.status]  # beyond r = 4 the motion escapes
        (('args', 'exponent'), [0, 0, 5])
        >>> found.outcome
        '2 ok, 1 nonfinite'
        >>> round(float(found.exponents.sel(args=2.9)[0]), 6)  # ln|2 − r|
        -0.105361
    """
    require_values("sweep", over, points, args)
    function, args = function_of(run, args)
    work = Work.of(run, function, args, plan(over, points, args), chunk)
    return work.dataset(store, client, progress)


def function_of(run: Callable | Runnable, args: Any) -> tuple[Callable, Any]:
    """The function to run, and its args; both may come from a problem."""
    args = run.args if args is None and isinstance(run, Runnable) else args
    function = _OfProblem(run) if isinstance(run, Runnable) else run
    require(callable(function), f"run must be a function of args, or a zoo problem; got {run!r}.")
    for leaf in jax.tree.leaves(args):
        if isinstance(leaf, int):  # an integer beyond 64 bits
            parameters("args", leaf)
    return function, args


class _TracedRun(NamedTuple):
    """The run of one point, traced once for all that has to be known of it before."""

    jaxpr: ClosedJaxpr  # of (arrays of args, row); JAX sorts the row by name
    shapes: dict[str, jax.ShapeDtypeStruct]  # of the named results
    words: list[tuple[str, str, str]]  # system, method and unit of the spectra that it returns


def _traced(named: "_Named", run: Callable, args: Any, row: Mapping[str, Any]) -> _TracedRun:
    """Trace the run of one point; an error names the line of the user's."""
    call = Call("run", run, {"args": args, **{name: row[name] for name in EXTRAS if name in row}})
    check_signature(call)
    arrays, fixed = eqx.partition(args, eqx.is_array_like)
    words: list[tuple[str, str, str]] = []

    def of_arrays(arrays, row):
        returned, results = named.with_result(eqx.combine(arrays, fixed), row)
        words[:] = [(one.about.system, one.about.method, one.unit) for one in spectra_in(returned)]
        return results

    try:
        closed, shapes = jax.make_jaxpr(of_arrays, return_shape=True)(arrays, dict(row))
        return _TracedRun(closed, shapes, words)
    except LyaphybridError:
        raise
    except UserFunctionError as error:  # of a function within the run: it is the one to be named
        raise UserFunctionError(str(error)) from None
    except Exception as error:
        raise UserFunctionError(explained(call, error)) from None


def xarray_module():
    """The package xarray."""
    try:
        import xarray
    except ImportError as error:
        raise ImportError("lh.sweep needs xarray and zarr: pip install 'lyaphybrid[sweep]'.") from error
    return xarray


class _OfProblem(eqx.Module):
    """The spectrum of a problem of the zoo, as a function of args and of the start."""

    problem: Any = eqx.field(static=True)

    def __call__(self, args, **changes):
        return self.problem.spectrum(args=args, throw=False, **changes)


class _Named(eqx.Module):
    """A lane with named results, in the form (args, state, row) -> (state, results) of `lanes.run_sequences`."""

    lane: PointRun
    function: str = eqx.field(static=True, default="")  # its hash: what it reads may have changed since it was compiled

    def __call__(self, args, state, row):
        return state, named(self.lane(args, row))

    def with_result(self, args, row):
        """What the run returns, and the same as named arrays."""
        result = self.lane(args, row)
        return result, named(result)


@dataclasses.dataclass
class Work:
    """The state of a sweep: its points, the function, and the results so far."""

    lane: _Named
    args: Any
    grid: SweepPlan
    chunk: int
    variables: dict[str, np.ndarray]  # (points, …)
    done: np.ndarray  # (points,) whether a point is computed
    function: str  # hash of the function and its args
    problem: str  # hash of these and of the points
    about: dict[str, str]  # attributes of the dataset that describe the run
    program: LaneProgram | None = None
    threads: int | None = None  # None: one per processor

    @staticmethod
    def of(run: Any, function: Callable, args: Any, grid: SweepPlan, chunk: int | None) -> "Work":
        """A sweep of which nothing is computed: all variables hold their fill values."""
        if chunk is not None:
            whole("chunk", chunk, least=1)
        named, row = _Named(PointRun.of(function, grid, args)), _first_values(grid)
        traced = _traced(named, function, args, row)
        _warn_of_idle(traced.jaxpr, sorted(row))
        along = (dims_of(name, one.ndim) for name, one in traced.shapes.items())
        twice = ", ".join(sorted({*traced.shapes, *itertools.chain(*along)} & set(grid.coordinates())))
        require(not twice, f"The run returns {twice}, which is the name of an axis: give one of them another name.")
        variables = {
            name: np.full((grid.size, *one.shape), missing(np.dtype(one.dtype)), one.dtype)
            for name, one in traced.shapes.items()
        }
        chunk = chunk or _chunk(grid.size)
        hashes, about = _hashes(traced.jaxpr, args, grid), _about(run, traced.words)
        named = dataclasses.replace(named, function=hashes[0])
        return Work(named, args, grid, chunk, variables, np.zeros(grid.size, bool), *hashes, about)

    def pieces(self) -> list[np.ndarray]:
        """The indices of the points of each chunk."""
        return [np.arange(i, min(i + self.chunk, self.grid.size)) for i in range(0, self.grid.size, self.chunk)]

    def dataset(self, store, client, progress):
        """Compute the missing points; an `xarray.Dataset` of all points."""
        xarray, started = xarray_module(), time.perf_counter()

        def found():
            return self._as_dataset(xarray, time.perf_counter() - started)

        try:
            if store is None:
                self.compute(self.pieces(), lambda index, results: None, client, progress)
            else:
                self._compute_into_store(store, client, progress)
        except StoreFailedError as error:
            error.dataset = found()
            raise
        if not np.all(self.done):
            warnings.warn(
                f"{np.sum(~self.done)} of {self.grid.size} points were not computed.", stacklevel=user_level()
            )
        return found()

    def _compute_into_store(self, store, client, progress) -> None:
        """Read the chunks that a store holds; compute the others and write them to it."""
        with opened(store, self._attributes(), self.grid, self.variables, self.chunk) as kept:
            self.chunk = kept.chunk
            pieces = self.pieces()
            here = [kept.read(index, self.variables) for index in range(len(pieces))]
            for piece in (piece for piece, known in zip(pieces, here, strict=True) if known):
                self.done[piece] = True
            wanted = [index for index, known in enumerate(here) if not known]
            self.compute(
                [pieces[i] for i in wanted], lambda i, results: kept.write(wanted[i], results), client, progress
            )

    def compute(self, pieces: list[np.ndarray], keep: Callable[[int, Any], None], client, progress) -> None:
        """Compute these chunks; `keep(index, results)` is called for each as soon as it is finished."""
        if not pieces:
            return
        sequences = [((), self.grid.rows(piece)) for piece in pieces]
        if client is None and self.program is None and not devices.are_wanted():
            self.program = LaneProgram(
                self.lane, self.args, sequences[0]
            )  # compile before the progress bar starts its clock
        report, before, more = reporter(progress, self.grid.size, "point"), np.mean(self.done), sum(map(len, pieces))

        def fraction(part: float) -> None:
            report(before + part * more / self.grid.size)

        def finished(index: int, results) -> None:
            for name, values in results.items():
                self.variables[name][pieces[index]] = values
            self.done[pieces[index]] = True
            keep(index, results)

        try:
            if client is None:
                options = {"threads": self.threads, "program": self.program}
                run_sequences(self.lane, self.args, sequences, progress=fraction, finished=finished, **options)
            else:
                names = f"lyaphybrid-{self.problem[:8]}", self.function
                run_on(client, *names, self.lane, self.args, sequences, report=fraction, finished=finished)
        finally:
            report(None)

    def _attributes(self) -> dict[str, Any]:
        grid = {"dims": list(self.grid.dims), "shape": list(self.grid.shape)}
        return {**self.about, "function": self.function, "problem": self.problem, **grid}

    def _as_dataset(self, xarray, seconds: float):
        grid = self.grid
        data = {
            name: ((*grid.dims, *dims_of(name, values.ndim - 1)), values.reshape(*grid.shape, *values.shape[1:]))
            for name, values in self.variables.items()
        }
        coordinates = grid.coordinates()
        if "exponents" in data:
            coordinates["exponent"] = (("exponent",), np.arange(1, data["exponents"][1].shape[-1] + 1))
        # NetCDF has no lists of words.
        dims = {"dims": json.dumps(list(grid.dims), ensure_ascii=False)}
        found = dims | {"seconds": seconds, "outcome": outcome(self.variables)}
        return xarray.Dataset(data, coordinates, self._attributes() | found)


def _chunk(points: int) -> int:
    """The size of a chunk: as many points as accelerators run at once; on a CPU at least 4 chunks per thread."""
    if devices.are_wanted():
        return min(points, devices.lanes_at_once())
    return min(CHUNK, -(-points // (4 * (os.cpu_count() or 1))))


def _first_values(grid: SweepPlan) -> dict[str, Any]:
    """The values of all axes at the first point."""
    return {path: values[0] for path, values in grid.rows(np.arange(1)).items()}


def _warn_of_idle(jaxpr: ClosedJaxpr, paths: list[str]) -> None:
    """Warn of axes that change nothing, because the run does not use the entries that they set: the last inputs."""
    used, own = needed(jaxpr), jaxpr.jaxpr.invars[-len(paths) :]
    idle = [path for path, one in zip(paths, own, strict=True) if one not in used]
    if idle:
        warnings.warn(
            f"The run does not depend on {', '.join(idle)}: each point of that axis gives the same. Does run use the "
            "args that it is given?",
            stacklevel=user_level(),
        )


def _hashes(jaxpr: ClosedJaxpr, args: Any, grid: SweepPlan) -> tuple[str, str]:
    """Two hashes: of the function with its args, and of these and the points."""
    arrays = jax.tree.leaves(eqx.filter(args, eqx.is_array_like))
    leaves = {f"args.{i}": without_key_type(leaf) for i, leaf in enumerate(arrays)}
    function = hash_of_arrays(leaves, begun=hash_of_jaxpr(jaxpr))
    return function, hash_of_arrays({axis.path: without_key_type(axis.values) for axis in grid.axes}, begun=function)


def _about(run, words: list[tuple[str, str, str]]) -> dict[str, str]:
    """What was run, in words, and the versions: attributes of the dataset."""

    def each(i: int) -> str:
        return "; ".join(dict.fromkeys(one[i] for one in words if one[i]))

    return {
        "run": getattr(run, "name", None) or getattr(run, "__qualname__", type(run).__name__),
        "system": each(0),
        "method": each(1),
        "unit": each(2),
        "lyaphybrid": __version__,
        "jax": jax.__version__,
        "notes": ", ".join(f"{1 << i}: {note}" for i, note in enumerate(NOTE_NAMES)),
        "statuses": ", ".join(f"{int(one)}: {one.name}" for one in STATUS),
    }
