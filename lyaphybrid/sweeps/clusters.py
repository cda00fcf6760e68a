"""Chunks of a sweep as tasks of a dask cluster.

A worker receives the function once, compiles it once, and then computes chunk after chunk. The process that called
writes the results, as without a cluster. If a worker dies, dask computes its chunk again.
"""

import threading
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from ..engine.host.lanes import LaneProgram, run_sequences

__all__ = ["run_on"]

RETRIES = 5  # of a chunk whose worker died
_programs: dict[str, LaneProgram] = {}  # compiled on this worker, by hash
_compiling = threading.Lock()


def run_on(
    client: Any,
    name: str,
    program: str,
    function: Callable,
    shared: Any,
    sequences: Sequence[tuple[Any, Any]],
    *,
    report: Callable,
    finished: Callable[[int, Any], None],
) -> None:
    """Run sequences of lanes on the workers of a client; the names of the tasks begin with `name`.

    A worker compiles functions with the same hash `program` once. `finished` is called with each sequence's index and
    results as they arrive. If a task raises, or on Ctrl-C, all other tasks are cancelled.
    """
    try:
        from distributed import as_completed
    except ImportError as error:
        raise ImportError("client= needs dask and distributed: pip install 'lyaphybrid[cluster]'.") from error

    problem = client.scatter(
        (program, function, shared, bool(jax.config.read("jax_enable_x64"))), broadcast=True, hash=False
    )
    keys = [f"{name}-points-{i}" for i in range(len(sequences))]
    futures = client.map(_chunk, [problem] * len(sequences), sequences, key=keys, retries=RETRIES, pure=False)
    numbers, ready = {future.key: i for i, future in enumerate(futures)}, 0
    try:
        for future, results in as_completed(futures, with_results=True):
            finished(numbers[future.key], results)
            future.release()
            ready += 1
            report(ready / len(sequences))
    except KeyboardInterrupt:
        warnings.warn("interrupted: the result holds what was computed until then.", stacklevel=5)
    finally:
        client.cancel(futures)


def _chunk(problem, sequence):
    """The results of one chunk as NumPy arrays; runs on a worker."""
    own, function, shared, wide = problem
    with jax.enable_x64(wide):
        with _compiling:
            if own not in _programs:
                _programs[own] = LaneProgram(function, shared, sequence)
        results, done = run_sequences(function, shared, [sequence], threads=1, program=_programs[own])
    if not np.all(done[0]):
        raise RuntimeError("a worker was interrupted")
    return results[0]
