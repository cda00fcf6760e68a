"""Many runs, one at each point of a grid or list: `sweep`."""

import dataclasses
import os
import time
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .. import devices
from .._tracing import traced
from ..checks import require, whole
from ..lanes import run_chains
from ..runs import reporter
from ..statuses import STATUS
from ..zoo.problem import Problem
from .answers import NOTES, dims_of, missing, named
from .clusters import run_on
from .plans import Lane, Plan, plan, raw
from .stores import StoreFailed, opened, problem_hash

__all__ = ["sweep"]

CHUNK = 256  # points that one thread takes at a time


def sweep(
    run: Callable | Problem,
    over: Mapping[str, Any] | None = None,
    *,
    points: Mapping[str, Any] | None = None,
    args: Any = None,
    chunk: int | None = None,
    store: Any = None,
    client: Any = None,
    progress: Any = True,
):
    """One run at each point of a grid, or of a list of points, as an `xarray.Dataset`.

    The run is compiled once. On a CPU each thread takes points of its own, and computes them one after the other: a
    branch that a point does not take costs it nothing. Elsewhere many points go side by side. Either way each point is
    what a single run gives.

    A point that fails does not stop the others: it has its status, and nan for its exponents.

    Args:
        run: ``args -> result``, a `Spectrum` or any pytree of arrays; ``(args, x0)``, ``(args, key)`` or all three
            where these are swept. Or a `Problem` of the zoo: its spectrum at other args.
        over: {name: values (m, …)}: the grid of all combinations, a dimension each. A name is an entry of args, "rho",
            "spring.rate" or "rates[2]"; "args" where args is a number; or "x0" (m, n), or "key" (m,) PRNG keys.
        points: the same for entries that change together, along one dimension "point".
        args: tree of parameters, which the entries are put into; None: those of the problem.
        chunk: points that are computed, and kept, together; None: some hundreds, less where there are few.
        store: path of a zarr store. Each chunk is written as soon as it is there; what a store holds of the same sweep
            is not computed again, so that a sweep that was killed is taken up by the same call. A chunk that was
            spoiled is computed anew. A store of another sweep is refused.
        client: a `dask.distributed.Client`: chunks are tasks of its workers (extra "cluster").
        progress: True for a bar with rate and time left, None, or a function of the fraction done.

    Returns:
        An `xarray.Dataset`. Of spectra: exponents, stderr, finite_exponents, losses (…, exponent), status, notes, time
        and jumps (…); of other results their leaves by name. Attributes say what the numbers in status and notes mean,
        the versions, a hash of the problem, and the seconds that it took. After Ctrl-C it holds what was computed, with
        nan or -1 elsewhere, and a warning says how much is missing.

    Raises:
        ValueError: on names, shapes and values that do not fit; where the store holds another sweep, or is in use.
        StoreFailed: (an OSError) where the store cannot be written: the disk is full, say. All that was computed is in
            its ``.dataset``.
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
        >>> round(float(found.exponents.sel(args=2.9)[0]), 6)  # ln|2 − r|
        -0.105361
    """
    xarray = _xarray()
    require(not traced((over, points, args)), "sweep compiles by itself: it cannot be used under jit, vmap or grad.")
    args = run.args if args is None and isinstance(run, Problem) else args
    function = _OfProblem(run) if isinstance(run, Problem) else run
    require(callable(function), f"run must be a function of args, or a zoo problem; got {run!r}.")
    grid = plan(over, points, args)
    if chunk is not None:
        whole("chunk", chunk, least=1)
    started = time.perf_counter()
    work = Work.of(Lane.of(function, grid, args), args, grid, chunk)
    attributes = _attributes(run, work)

    def dataset():
        return _dataset(xarray, work, attributes | {"seconds": time.perf_counter() - started})

    try:
        if store is None:
            work.compute(work.pieces(), lambda index, results: None, client, progress)
        else:
            _into(store, work, attributes, client, progress)
    except StoreFailed as error:
        error.dataset = dataset()
        raise
    if not np.all(work.done):
        warnings.warn(f"{np.sum(~work.done)} of {grid.size} points were not computed.", stacklevel=2)
    return dataset()


def _into(store, work: "Work", attributes, client, progress) -> None:
    """What a store lacks is computed and kept there."""
    header = {name: attributes[name] for name in ("problem", "dims", "shape")}
    with opened(store, header, work.variables, work.chunk) as kept:
        work.chunk = kept.chunk
        pieces = work.pieces()
        here = [kept.read(index, work.variables) for index in range(len(pieces))]
        for piece in (piece for piece, known in zip(pieces, here, strict=True) if known):
            work.done[piece] = True
        wanted = [index for index, known in enumerate(here) if not known]
        work.compute([pieces[i] for i in wanted], lambda i, results: kept.write(wanted[i], results), client, progress)


def _xarray():
    try:
        import xarray
    except ImportError as error:
        raise ImportError("lh.sweep needs xarray and zarr: pip install 'lyaphybrid[sweep]'.") from error
    return xarray


class _OfProblem(eqx.Module):
    """The spectrum of a problem of the zoo at other args, from another start."""

    problem: Any = eqx.field(static=True)

    def __call__(self, args, **changes):
        return self.problem.spectrum(args=args, throw=False, **changes)


class _Named(eqx.Module):
    """A lane whose result has names; as `lanes.run_chains` wants it."""

    lane: Lane

    def __call__(self, args, state, row):
        return state, named(self.lane(args, row))


@dataclasses.dataclass
class Work:
    """What is to be computed, and what has been."""

    lane: _Named
    args: Any
    grid: Plan
    chunk: int
    variables: dict[str, np.ndarray]  # (points, …)
    done: np.ndarray  # (points,)
    problem: str  # its hash

    @staticmethod
    def of(lane: Lane, args: Any, grid: Plan, chunk: int | None) -> "Work":
        """Nothing computed yet: all variables hold what stands for none."""
        named, row = _Named(lane), {path: values[0] for path, values in grid.rows(np.arange(1)).items()}
        shapes = eqx.filter_eval_shape(named, args, (), row)[1]
        twice = sorted(set(shapes) & set(grid.coordinates()))
        require(not twice, f"The run returns {', '.join(twice)}, which is the name of an axis: give it another name.")
        variables = {
            name: np.full((grid.size, *one.shape), missing(np.dtype(one.dtype)), one.dtype)
            for name, one in shapes.items()
        }
        arrays, fixed = eqx.partition(args, eqx.is_array_like)
        data = {f"over.{axis.path}": raw(axis.values) for axis in grid.axes}
        data |= {f"args.{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(arrays))}
        hashed = problem_hash(lambda arrays, row: named(eqx.combine(arrays, fixed), (), row)[1], arrays, row, data=data)
        at_once = devices.lanes_at_once() if devices.are_wanted() else CHUNK
        chunk = chunk or max(1, min(at_once, -(-grid.size // (4 * (os.cpu_count() or 1)))))
        return Work(named, args, grid, chunk, variables, np.zeros(grid.size, bool), hashed)

    def pieces(self) -> list[np.ndarray]:
        """The points of each chunk."""
        return [np.arange(i, min(i + self.chunk, self.grid.size)) for i in range(0, self.grid.size, self.chunk)]

    def compute(self, pieces: list[np.ndarray], keep: Callable[[int, Any], None], client, progress) -> None:
        """Fill in the points of these chunks; each is kept as soon as it is there."""
        if not pieces:
            return
        report, before, more = reporter(progress, self.grid.size, "point"), np.mean(self.done), sum(map(len, pieces))

        def fraction(part: float) -> None:
            report(before + part * more / self.grid.size)

        def finished(index: int, results) -> None:
            for name, values in results.items():
                self.variables[name][pieces[index]] = values
            self.done[pieces[index]] = True
            keep(index, results)

        chains = [((), self.grid.rows(piece)) for piece in pieces]
        try:
            if client is None:
                run_chains(self.lane, self.args, chains, progress=fraction, finished=finished)
            else:
                name = f"lyaphybrid-{self.problem[:8]}"
                run_on(client, name, self.lane, self.args, chains, report=fraction, finished=finished)
        finally:
            report(None)


def _attributes(run, work: Work) -> dict[str, Any]:
    from .. import __version__  # known only when all of the package is

    name = getattr(run, "name", None) or getattr(run, "__qualname__", type(run).__name__)
    return {
        "run": name,
        "problem": work.problem,
        "dims": list(work.grid.dims),
        "shape": list(work.grid.shape),
        "lyaphybrid": __version__,
        "jax": jax.__version__,
        "notes": ", ".join(f"{1 << i}: {note}" for i, note in enumerate(NOTES)),
        "statuses": ", ".join(f"{int(one)}: {one.name}" for one in STATUS),
    }


def _dataset(xarray, work: Work, attributes):
    grid = work.grid
    data = {
        name: ((*grid.dims, *dims_of(name, values.ndim - 1)), values.reshape(*grid.shape, *values.shape[1:]))
        for name, values in work.variables.items()
    }
    coordinates = grid.coordinates()
    if "exponents" in data:
        coordinates["exponent"] = (("exponent",), np.arange(1, data["exponents"][1].shape[-1] + 1))
    return xarray.Dataset(data, coordinates, attributes)
