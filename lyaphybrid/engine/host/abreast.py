"""Sequences of lanes that run side by side: each starts from its own state, so they do not wait for each other."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..._jax.engines import SideBySide
from . import devices, lanes

__all__ = ["run_abreast"]


def run_abreast(
    function: Callable, shared: Any, sequences: Sequence[tuple[Any, Any]], *, progress: Any = None
) -> tuple[list, list]:
    """Run sequences of one length, as many at once as a vector register holds, where lanes rarely branch differently.

    Args:
        function: ``(shared, state, lane) -> (state, result)``, pytrees of arrays.
        shared: as in `lanes.run_sequences`.
        sequences: (state before the first lane, lanes) each, of the same shapes.
        progress: as in `lanes.run_sequences`.

    Returns:
        As `lanes.run_sequences`.
    """
    state, rows = sequences[0]
    both = _OfBoth(function), shared, (state, _lane(rows, 0))
    code = None if devices.are_wanted() else lanes.side_by_side(*both)
    if code is None:
        return lanes.run_sequences(function, shared, sequences, progress=progress)
    bundles = [sequences[first : first + code.lanes] for first in range(0, len(sequences), code.lanes)]
    together = [_bundled([*bundle, *[bundle[-1]] * (code.lanes - len(bundle))]) for bundle in bundles]
    found, done = lanes.run_sequences(
        function, shared, together, progress=progress, program=_Abreast(code, together[0])
    )
    results = [
        jax.tree.map(lambda leaf, place=place: leaf[:, place], result)
        for bundle, result in zip(bundles, found, strict=True)
        for place in range(len(bundle))
    ]
    return results, [computed.copy() for bundle, computed in zip(bundles, done, strict=True) for _ in bundle]


class _OfBoth(eqx.Module):
    """A function (shared, state, lane) in the form (shared, nothing, (state, lane)): what differs comes last."""

    function: Callable

    def __call__(self, shared, nothing, both):
        del nothing
        return self.function(shared, *both)


def _lane(rows, i: int):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[i], rows)


def _bundled(sequences) -> tuple[Any, Any]:
    """Several sequences as one: states (sequences, …), lanes (length, sequences, …)."""
    states, rows = zip(*sequences, strict=True)
    return (
        jax.tree.map(lambda *leaves: np.stack(leaves), *states),
        jax.tree.map(lambda *leaves: np.stack(leaves, axis=1), *rows),
    )


class _Abreast(lanes.LaneProgram):
    """The program of a bundle of sequences, in the form of a `lanes.LaneProgram`."""

    at_once = 1  # lanes of a bundle follow one another

    def __init__(self, code: SideBySide, bundle: tuple[Any, Any]):
        self.code, self.ahead, self.ended = code, code.ahead, code.ended
        state, rows = bundle
        _, result = code(jax.tree.map(lambda leaf: leaf[:0], (state, _lane(rows, 0))))  # of no lanes: their shapes
        self.empty = jax.tree.map(lambda leaf: np.empty((0, code.lanes, *leaf.shape[1:]), leaf.dtype), result)

    def run(self, state, rows, count):
        """The state after the first `count` lanes, and their results."""
        results = []
        for i in range(count):
            state, result = self.code((state, _lane(rows, i)))
            results.append(result)
        return state, jax.tree.map(lambda *leaves: np.stack(leaves), *results)
