"""Chunks of a sweep as tasks of a dask cluster.

A worker gets the function once, compiles it once, and then answers for chunk after chunk; what comes back is written by
the process that asked, as without a cluster. dask tries a chunk again where its worker died.
"""

import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from ..engine.host.lanes import Program, run_chains

__all__ = ["run_on"]

RETRIES = 5  # of a chunk whose worker dies
_programs: dict[str, Program] = {}  # of this worker, by their hashes
_compiling = threading.Lock()


def run_on(
    client: Any,
    name: str,
    program: str,
    function: Callable,
    shared: Any,
    chains: Sequence[tuple[Any, Any]],
    *,
    report: Callable,
    finished: Callable[[int, Any], None],
) -> None:
    """Run chains of lanes on the workers of a client; the names of the tasks begin with `name`.

    A worker compiles once what has the same hash, `program`.

    Where a task raises, all others are cancelled, as by Ctrl-C; what has come until then has been handed over.
    """
    try:
        from distributed import as_completed
    except ImportError as error:
        raise ImportError("client= needs dask and distributed: pip install 'lyaphybrid[cluster]'.") from error

    problem = client.scatter(
        (program, function, shared, bool(jax.config.read("jax_enable_x64"))), broadcast=True, hash=False
    )
    keys = [f"{name}-points-{i}" for i in range(len(chains))]
    futures = client.map(_chunk, [problem] * len(chains), chains, key=keys, retries=RETRIES, pure=False)
    numbers, ready = {future.key: i for i, future in enumerate(futures)}, 0
    try:
        for future, results in as_completed(futures, with_results=True):
            finished(numbers[future.key], results)
            future.release()
            ready += 1
            report(ready / len(chains))
    except KeyboardInterrupt:
        warnings.warn("interrupted: the result holds what was computed until then.", stacklevel=5)
    finally:
        client.cancel(futures)


def _chunk(problem, chain):
    """On a worker: the results of one chunk, NumPy arrays."""
    own, function, shared, wide = problem
    with jax.enable_x64(wide):
        with _compiling:
            if own not in _programs:
                _programs[own] = Program(function, shared, chain)
        results, done = run_chains(function, shared, [chain], threads=1, program=_programs[own])
    if not np.all(done[0]):
        raise RuntimeError("a worker was interrupted")
    return results[0]
