"""Lanes: many runs of one compiled function.

On a CPU each thread runs its lanes one after another, so that a branch that is not taken costs nothing (under `vmap`
every lane would compute all branches). Where lanes rarely take different branches, as in flows without events, as many
run at once as a vector register holds. On accelerators lanes run in parallel, see `devices`.

In a *sequence* of lanes each may start from the final state of the one before. Sequences are divided into
pieces that take about SECONDS_PER_CALL; between pieces the host reports progress and handles Ctrl-C. The division and
the assignment to threads change no result: each lane is computed independently by the same compiled loop.
"""

import concurrent.futures
import functools
import os
import queue
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import SideBySide, compiled
from ..._jax.tracing import as_jax
from . import devices
from .reporting import reporter

__all__ = ["LaneProgram", "map_lanes", "run_sequences", "short_sequences", "side_by_side"]

MOST_LANES = 64  # most lanes in one compiled call
SECONDS_PER_CALL = 0.3


def map_lanes(function: Callable, shared: Any, lanes: Any, *, progress: Any = None, threads: int | None = None):
    """Apply a function to every lane: independent runs.

    Args:
        function: ``(shared, lane) -> result``, pytrees of arrays; a lane that fails says so in its result.
        shared: arguments common to all lanes: arrays are traced, everything else is static.
        lanes: pytree of arrays (m, …), one row per lane.
        progress: None, True for a bar, or a function of the fraction done.
        threads: None: one for each processor.

    Returns:
        The results, NumPy arrays (m, …), and (m,) bool, which of them were computed: all, except after Ctrl-C.
    """
    sequences = short_sequences((), lanes, threads)
    results, done = run_sequences(_Alone(function), shared, sequences, progress=progress, threads=threads)
    return jax.tree.map(lambda *parts: np.concatenate(parts), *results), np.concatenate(done)


def short_sequences(state: Any, lanes: Any, threads: int | None = None) -> list[tuple[Any, Any]]:
    """Divide independent lanes into sequences, so that threads can share the work."""
    count = len(jax.tree.leaves(lanes)[0])
    size = max(1, min(MOST_LANES, count // (4 * _threads(threads))))
    if devices.are_wanted():  # lanes without a state are one batch; sequences run in parallel
        size = 1 if jax.tree.leaves(state) else devices.lanes_at_once()
    return [(state, _rows(lanes, first, first + size)) for first in range(0, count, size)]


class _Alone(eqx.Module):
    """A function (shared, lane) -> result in the form for sequences, with an unchanged state."""

    function: Callable

    def __call__(self, shared, state, lane):
        return state, self.function(shared, lane)


def run_sequences(
    function: Callable,
    shared: Any,
    sequences: Sequence[tuple[Any, Any]],
    *,
    progress: Any = None,
    threads: int | None = None,
    finished: Callable[[int, Any], None] | None = None,
    program: "LaneProgram | None" = None,
) -> tuple[list, list]:
    """Run sequences of lanes; they are started in the order in which they are given.

    Args:
        function: ``(shared, state, lane) -> (state, result)``, pytrees of arrays.
        shared: arguments common to all lanes: arrays are traced, everything else is static.
        sequences: (state before the first lane, lanes) each; arrays of the lanes have a leading axis (length,).
        progress: None, True for a bar, or a function of the fraction done.
        threads: None: one for each processor.
        finished: ``(index, results)`` is called for each sequence as soon as it is complete, one call at a time; its
            results are then not stored.
        program: the function compiled earlier, for the same shared values and lanes of the same shapes.

    Returns:
        For each sequence the results, NumPy arrays with the leading axis of its lanes, and which of them were computed.
    """
    if devices.are_wanted():
        return devices.run_on_devices(function, shared, sequences, progress, finished)
    program, threads = program or LaneProgram(function, shared, sequences[0]), _threads(threads)
    pool = _Pool(program, sequences, threads, progress, finished)
    with concurrent.futures.ThreadPoolExecutor(threads) as executor:
        running = [executor.submit(pool.run, i) for i in range(len(sequences))]
        try:
            while concurrent.futures.wait(running, 0.1, concurrent.futures.FIRST_EXCEPTION).not_done:
                pool.hand_over()
                pool.report(pool.fraction)
                if any(future.done() and future.exception() for future in running):
                    break
        except KeyboardInterrupt:
            warnings.warn("interrupted: the result holds what was computed until then.", stacklevel=3)
        finally:
            pool.stopped = True
            executor.shutdown(cancel_futures=True)
    for future in running:
        if not future.cancelled():
            future.result()
    program.ended()
    pool.hand_over()
    pool.report(pool.fraction)
    pool.report(None)
    return pool.kept(), pool.done


def _threads(threads: int | None) -> int:
    return threads or os.cpu_count() or 1


def _rows(tree, first, last):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[first:last], tree)


def _length(sequence) -> int:
    return len(jax.tree.leaves(sequence[1])[0])


@compiled(in_pieces=True)
def _run_piece(function: Callable, shared, state, lanes, count):
    """Run the first `count` of the lanes (MOST_LANES, …); returns (state, results)."""
    of_lane = jax.jit(lambda state, lane: function(shared, state, lane))  # traced once, for shapes and loop
    shapes = jax.eval_shape(of_lane, state, _lane(lanes, 0))[1]
    room = len(jax.tree.leaves(lanes)[0])
    empty = jax.tree.map(lambda leaf: jnp.zeros((room, *leaf.shape), leaf.dtype), shapes)

    def one(carry):
        i, state, results = carry
        state, result = of_lane(state, _lane(lanes, i))
        return i + 1, state, jax.tree.map(lambda all, new: all.at[i].set(new), results, result)

    return jax.lax.while_loop(lambda carry: carry[0] < count, one, (jnp.zeros_like(count), state, empty))[1:]


@compiled()
def _run_lane(function: Callable, shared, state, lane):
    """Run one lane; returns (state, result)."""
    return function(shared, state, lane)


def _lane(lanes, i):
    return jax.tree.map(lambda leaf: leaf[i], lanes)


def side_by_side(function: Callable, shared: Any, lane: Any) -> SideBySide | None:
    """A program for many lanes at once that start from no state; None if they branch differently too often."""
    return _run_lane.side_by_side(function, shared, (), _arrays(lane))


class LaneProgram:
    """A function of lanes, compiled once, in the calling thread, whose JAX settings do not hold in others."""

    def __init__(self, function: Callable, shared: Any, sequence: tuple[Any, Any]):
        state, lanes = sequence
        self.fixed = function, shared
        operands = _arrays(state), _padded(lanes, 0), np.int32(0)
        # Lanes that start from the final state of another lane cannot run at once.
        wide = None if jax.tree.leaves(state) else side_by_side(*self.fixed, _lane(operands[1], 0))
        self.at_once = 1 if wide is None else wide.lanes
        if wide is None:
            compiled = _run_piece.prepared(*self.fixed, *operands)
            self.run = functools.partial(compiled, *self.fixed)
            self.ahead = lambda seconds: _run_piece.ahead(seconds, *self.fixed, *operands)
            self.ended = lambda: _run_piece.ended(np.inf, *self.fixed, *operands)
        else:
            self.run = lambda state, lanes, count: wide(jax.tree.map(lambda leaf: leaf[:count], lanes))
            self.ahead, self.ended = wide.ahead, wide.ended
        self.empty = jax.tree.map(np.asarray, self.run(*operands)[1])


class _Pool:
    """The pieces of all sequences and their results; shared by the threads."""

    def __init__(self, program, sequences, threads, progress, finished):
        self.program, self.sequences, self.finished = program, sequences, finished
        self.report, self.wide = reporter(progress), bool(jax.config.read("jax_enable_x64"))
        self.complete: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.lanes, self.threads = sum(map(_length, sequences)), threads
        self.done = [np.zeros(_length(sequence), bool) for sequence in sequences]
        self.ready, self.stopped, self.size, self.lock = 0, False, 1.0, threading.Lock()
        self.results: list[Any] = [None] * len(sequences)

    @property
    def fraction(self) -> float:
        return self.ready / self.lanes

    def hand_over(self) -> None:
        """Pass complete sequences to `finished`."""
        while self.finished is not None and not self.complete.empty():
            index = self.complete.get()
            results, self.results[index] = self.results[index], None
            self.finished(index, results)

    def kept(self) -> list:
        """The results of all sequences; zeros where none were computed."""
        if self.finished is not None:
            return self.results
        return [
            _zeros(self.program.empty, done) if one is None else one
            for one, done in zip(self.results, self.done, strict=True)
        ]

    def run(self, index: int) -> None:
        """Run one sequence with the precision (x64) of the calling thread."""
        with jax.enable_x64(self.wide):
            self._run_sequence(index)

    def _run_sequence(self, index: int) -> None:
        """Run the pieces of one sequence in turn."""
        state, lanes = self.sequences[index]
        self.results[index] = _zeros(self.program.empty, self.done[index])
        state, first, length = _arrays(state), 0, _length(self.sequences[index])
        while first < length and not self.stopped:
            at_once = self.program.at_once
            count = min(length - first, MOST_LANES, at_once * max(1, int(self.size / at_once)))
            clock = time.perf_counter()
            whole = -(-count // at_once) * at_once  # rounded up to full vectors
            state, results = self.program.run(state, _padded(lanes, first), np.int32(whole))
            results = jax.tree.map(np.asarray, results)
            seconds = time.perf_counter() - clock
            with self.lock:
                for into, new in zip(jax.tree.leaves(self.results[index]), jax.tree.leaves(results), strict=True):
                    into[first : first + count] = new[:count]
                self.done[index][first : first + count] = True
                self.ready += count
                self.size = min(MOST_LANES, 4 * count, count * SECONDS_PER_CALL / seconds)
                left = (self.lanes - self.ready) * seconds / count / self.threads
            self.program.ahead(left)
            first += count
        if first == length:
            self.complete.put(index)


def _zeros(like, done):
    """Arrays of zeros for the results of one sequence."""
    return jax.tree.map(lambda leaf: np.zeros((len(done), *leaf.shape[1:]), leaf.dtype), like)


def _arrays(tree):
    """JAX arrays, the type that a compiled call returns, so that all calls have arguments of the same type."""
    return jax.tree.map(jnp.asarray, as_jax(tree))  # of numbers, too


def _padded(lanes, first):
    """MOST_LANES rows starting at `first`, padded with copies of the last row, which are not run."""

    def rows(leaf):
        leaf = np.asarray(leaf)
        return leaf[np.minimum(np.arange(first, first + MOST_LANES), len(leaf) - 1)]

    return jax.tree.map(rows, lanes)
