"""Lanes: many runs of one compiled function.

On a CPU one lane follows the other, so that a branch that is not taken costs nothing (under `vmap` every lane computes
all of them: 9 to 17 times as long), and each thread has lanes of its own. Where lanes seldom part, as those of flows
without events, as many go at once as the vectors of the CPU hold. On accelerators they go side by side: `devices`.

A *chain* is a sequence of lanes in which each may begin where the one before has ended. Chains are cut into pieces
that take about a third of a second: between two there is room for progress and Ctrl-C. How they are cut, and which
thread takes which, changes no result: each lane is computed alone, by the same compiled loop.
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

from ..._jax.engines import compiled
from . import devices
from .reporting import reporter

__all__ = ["Program", "map_lanes", "run_chains", "short_chains"]

ROOM = 64  # lanes in one compiled call at most
SECONDS_PER_CALL = 0.3


def map_lanes(function: Callable, shared: Any, lanes: Any, *, progress: Any = None, threads: int | None = None):
    """Apply a function to every lane: independent runs.

    Args:
        function: ``(shared, lane) -> result``, pytrees of arrays; a lane that fails says so in its result.
        shared: what all lanes see: arrays are traced, everything else is static.
        lanes: pytree of arrays (m, …), one row a lane.
        progress: None, True for a bar, or a function of the fraction done.
        threads: None: one for each processor.

    Returns:
        The results, NumPy arrays (m, …), and (m,) which of them were computed: all, but after Ctrl-C.
    """
    chains = short_chains((), lanes, threads)
    results, done = run_chains(_Alone(function), shared, chains, progress=progress, threads=threads)
    return jax.tree.map(lambda *parts: np.concatenate(parts), *results), np.concatenate(done)


def short_chains(state: Any, lanes: Any, threads: int | None = None) -> list[tuple[Any, Any]]:
    """Lanes that do not depend on each other, as chains between which threads can share the work."""
    count = len(jax.tree.leaves(lanes)[0])
    size = max(1, min(ROOM, count // (4 * _threads(threads))))
    if devices.are_wanted():  # there lanes that begin alike are one batch, and chains go side by side
        size = 1 if jax.tree.leaves(state) else devices.lanes_at_once()
    return [(state, _rows(lanes, first, first + size)) for first in range(0, count, size)]


class _Alone(eqx.Module):
    """A function of a lane as one that hands nothing on."""

    function: Callable

    def __call__(self, shared, state, lane):
        return state, self.function(shared, lane)


def run_chains(
    function: Callable,
    shared: Any,
    chains: Sequence[tuple[Any, Any]],
    *,
    progress: Any = None,
    threads: int | None = None,
    finished: Callable[[int, Any], None] | None = None,
    program: "Program | None" = None,
) -> tuple[list, list]:
    """Run chains of lanes; those that are given first begin first.

    Args:
        function: ``(shared, state, lane) -> (state, result)``, pytrees of arrays.
        shared: what all lanes see: arrays are traced, everything else is static.
        chains: (state before the first lane, lanes): a lane's arrays have a leading axis, as long as the chain is.
        progress: None, True for a bar, or a function of the fraction done.
        threads: None: one for each processor.
        finished: ``(index, results)`` takes what has come out of a chain as soon as all of it has, one after the other;
            it is not kept then.
        program: the function compiled before, for the same shared values and lanes of the same shapes.

    Returns:
        For each chain the results, NumPy arrays with the leading axis of its lanes, and which of them were computed.
    """
    if devices.are_wanted():
        return devices.run_on_devices(function, shared, chains, progress, finished)
    pool = _Pool(program or Program(function, shared, chains[0]), chains, progress, finished)
    with concurrent.futures.ThreadPoolExecutor(_threads(threads)) as executor:
        running = [executor.submit(pool.run, i) for i in range(len(chains))]
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
    pool.hand_over()
    pool.report(pool.fraction)
    pool.report(None)
    return pool.kept(), pool.done


def _threads(threads: int | None) -> int:
    return threads or os.cpu_count() or 1


def _rows(tree, first, last):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[first:last], tree)


def _length(chain) -> int:
    return len(jax.tree.leaves(chain[1])[0])


@compiled(in_pieces=True)
def _piece(function: Callable, shared, state, lanes, count):
    """The first `count` lanes of so many."""
    shapes = eqx.filter_eval_shape(function, shared, state, _lane(lanes, 0))[1]
    room = len(jax.tree.leaves(lanes)[0])
    empty = jax.tree.map(lambda leaf: jnp.zeros((room, *leaf.shape), leaf.dtype), shapes)

    def one(carry):
        i, state, results = carry
        state, result = function(shared, state, _lane(lanes, i))
        return i + 1, state, jax.tree.map(lambda all, new: all.at[i].set(new), results, result)

    return jax.lax.while_loop(lambda carry: carry[0] < count, one, (jnp.zeros_like(count), state, empty))[1:]


@compiled()
def _one(function: Callable, shared, state, lane):
    """One lane."""
    return function(shared, state, lane)


def _lane(lanes, i):
    return jax.tree.map(lambda leaf: leaf[i], lanes)


class Program:
    """A function of lanes, compiled once, and not in a thread, where JAX's own settings are the global ones."""

    def __init__(self, function: Callable, shared: Any, chain: tuple[Any, Any]):
        state, lanes = chain
        self.fixed = function, shared
        operands = _arrays(state), _full(lanes, 0), np.int32(0)
        one = *self.fixed, operands[0], _arrays(_lane(operands[1], 0))
        # Where a lane begins where another has ended, the two cannot go at once.
        side_by_side = None if jax.tree.leaves(state) else _one.side_by_side(*one)
        self.at_once = 1 if side_by_side is None else side_by_side.lanes
        if side_by_side is None:
            compiled = _piece.prepared(*self.fixed, *operands)
            self.run = functools.partial(compiled, *self.fixed)
        else:
            self.run = lambda state, lanes, count: side_by_side(jax.tree.map(lambda leaf: leaf[:count], lanes))
        self.empty = jax.tree.map(np.asarray, self.run(*operands)[1])


class _Pool:
    """The pieces of all chains, and what has come out of them."""

    def __init__(self, program, chains, progress, finished):
        self.program, self.chains, self.finished = program, chains, finished
        self.report, self.wide = reporter(progress), bool(jax.config.read("jax_enable_x64"))
        self.complete: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.lanes = sum(map(_length, chains))
        self.done = [np.zeros(_length(chain), bool) for chain in chains]
        self.ready, self.stopped, self.size, self.lock = 0, False, 1.0, threading.Lock()
        self.results: list[Any] = [None] * len(chains)

    @property
    def fraction(self) -> float:
        return self.ready / self.lanes

    def hand_over(self) -> None:
        """What is complete, to whoever asked for it."""
        while self.finished is not None and not self.complete.empty():
            index = self.complete.get()
            results, self.results[index] = self.results[index], None
            self.finished(index, results)

    def kept(self) -> list:
        """The results of all chains; room where none were computed."""
        if self.finished is not None:
            return self.results
        return [
            _blank(self.program.empty, done) if one is None else one
            for one, done in zip(self.results, self.done, strict=True)
        ]

    def run(self, index: int) -> None:
        """One chain, with the precision of the thread that asked."""
        with jax.enable_x64(self.wide):
            self._pieces(index)

    def _pieces(self, index: int) -> None:
        """One chain, piece after piece."""
        state, lanes = self.chains[index]
        self.results[index] = _blank(self.program.empty, self.done[index])
        state, first, length = _arrays(state), 0, _length(self.chains[index])
        while first < length and not self.stopped:
            at_once = self.program.at_once
            count = min(length - first, ROOM, at_once * max(1, int(self.size / at_once)))
            clock = time.perf_counter()
            whole = -(-count // at_once) * at_once  # the last vector is full in any case
            state, results = self.program.run(state, _full(lanes, first), np.int32(whole))
            results = jax.tree.map(np.asarray, results)
            seconds = time.perf_counter() - clock
            with self.lock:
                for into, new in zip(jax.tree.leaves(self.results[index]), jax.tree.leaves(results), strict=True):
                    into[first : first + count] = new[:count]
                self.done[index][first : first + count] = True
                self.ready += count
                self.size = min(ROOM, 4 * count, count * SECONDS_PER_CALL / seconds)
            first += count
        if first == length:
            self.complete.put(index)


def _blank(like, done):
    """Room for the results of one chain."""
    return jax.tree.map(lambda leaf: np.zeros((len(done), *leaf.shape[1:]), leaf.dtype), like)


def _arrays(tree):
    """As a compiled call returns them, so that what goes in is always of one kind."""
    return jax.tree.map(jnp.asarray, tree)


def _full(lanes, first):
    """Rows from `first` on, so many as one call takes; behind the end stands the last one again, not to be run."""

    def rows(leaf):
        leaf = np.asarray(leaf)
        return leaf[np.minimum(np.arange(first, first + ROOM), len(leaf) - 1)]

    return jax.tree.map(rows, lanes)
