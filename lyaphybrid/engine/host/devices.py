"""Lanes on accelerators: a batch of lanes is divided equally among the local devices and runs in parallel."""

import itertools
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from .reporting import reporter

__all__ = ["are_wanted", "lanes_at_once", "run_on_devices"]

SEQUENCES_PER_CALL = 16_384  # sequences per call and device; larger batches mainly need more memory
OUT_OF_MEMORY = "RESOURCE_EXHAUSTED"  # in what XLA says


def are_wanted() -> bool:
    """Whether the backend is an accelerator; on a CPU threads are used instead."""
    return jax.default_backend() != "cpu"


def lanes_at_once() -> int:
    """The number of lanes that occupies all devices in one call."""
    return SEQUENCES_PER_CALL * jax.local_device_count()


class Batch(NamedTuple):
    """Chains of the same length that run in one call."""

    states: Any  # (m, …)
    lanes: Any  # (m, length, …)
    room: int  # number of sequences of the compiled call, at least m
    belongs: list[int]  # indices of the given sequences; a single index: the whole batch are lanes of that sequence


def run_on_devices(
    function: Callable, shared: Any, sequences: Sequence[tuple[Any, Any]], progress: Any, finished: Callable | None
) -> tuple[list, list]:
    """`lanes.run_sequences` on all local devices; lanes of sequences without a state are independent of each other."""
    report, ready, results = reporter(progress), 0, [None] * len(sequences)
    done = [np.zeros(_length(lanes), bool) for _, lanes in sequences]
    alone = not jax.tree.leaves([state for state, _ in sequences])
    mesh, room = Mesh(np.array(jax.local_devices()), ("lanes",)), _Room()
    try:
        for batch in _of_lanes(sequences) if alone else _of_sequences(sequences):
            found = _computed(function, shared, batch, mesh, room)
            for row, i in enumerate(batch.belongs):
                part = slice(None) if alone else row
                results[i] = jax.tree.map(lambda leaf, part=part: leaf[part, 0] if alone else leaf[part], found)
                done[i][:] = True
                ready += len(done[i])
                if finished is not None:
                    finished(i, results[i])
                    results[i] = None
            report(ready / sum(map(len, done)))
    except KeyboardInterrupt:
        missing = [i for i in range(len(sequences)) if not np.all(done[i])]
        like = next((result for result in results if result is not None), None)
        if finished is None and like is None:
            raise
        warnings.warn("interrupted: the result holds what was computed until then.", stacklevel=4)
        for i in missing if finished is None else ():
            results[i] = jax.tree.map(lambda leaf, i=i: np.zeros((len(done[i]), *leaf.shape[1:]), leaf.dtype), like)
    report(None)
    return results, done


def _length(lanes) -> int:
    return len(jax.tree.leaves(lanes)[0])


def _of_lanes(sequences) -> Iterator[Batch]:
    """Independent lanes: each given sequence becomes a batch of sequences of one lane."""
    room = _rounded_up(max(_length(lanes) for _, lanes in sequences))
    for i, (state, lanes) in enumerate(sequences):
        yield Batch(state, jax.tree.map(lambda leaf: np.asarray(leaf)[:, None], lanes), room, [i])


def _of_sequences(sequences) -> Iterator[Batch]:
    """Batches of sequences of the same length."""
    by_length = sorted(range(len(sequences)), key=lambda i: _length(sequences[i][1]))
    for _, group in itertools.groupby(by_length, key=lambda i: _length(sequences[i][1])):
        members = list(group)
        room = _rounded_up(min(lanes_at_once(), len(members)))
        for own in (members[i : i + room] for i in range(0, len(members), room)):
            states, lanes = (_stacked([sequences[i][part] for i in own]) for part in (0, 1))
            yield Batch(states, lanes, room, own)


def _rounded_up(count: int) -> int:
    """The count rounded up to a multiple of the number of devices."""
    devices = jax.local_device_count()
    return -(-count // devices) * devices


def _stacked(trees):
    return jax.tree.map(lambda *rows: np.stack(rows), *trees)


class _Room:
    """How many sequences one call takes; halved where the devices' memory does not suffice."""

    def __init__(self):
        self.most: int | None = None  # None: as many as the batch wants

    def of(self, batch: Batch) -> int:
        return batch.room if self.most is None else min(batch.room, self.most)

    def halve(self, size: int, error: Exception) -> None:
        """Make do with half of a size that was too much; raises the error where one sequence a device is."""
        if size <= jax.local_device_count():
            error.add_note("The memory of a device does not hold a single run: take fewer blocks, columns or samples.")
            raise error
        self.most = _rounded_up(size // 2)
        warnings.warn(
            f"{size} runs at once need more memory than the devices have: going on with {self.most}.", stacklevel=5
        )


def _computed(function, shared, batch: Batch, mesh: Mesh, room: _Room) -> Any:
    """The results of a batch, NumPy arrays (m, length, …); in several calls if one needs too much memory."""
    count, first, parts = _length(batch.lanes), 0, []
    while first < count:
        size = room.of(batch)
        try:
            parts.append(_in_one_call(function, shared, batch, mesh, range(first, min(first + size, count)), size))
        except jax.errors.JaxRuntimeError as error:
            if OUT_OF_MEMORY not in str(error):
                raise
            room.halve(size, error)
        else:
            first += size
    return jax.tree.map(lambda *rows: np.concatenate(rows), *parts)


def _in_one_call(function, shared, batch: Batch, mesh: Mesh, which: range, size: int) -> Any:
    """The results of some sequences of a batch; copies of the last one fill the call."""
    filled = np.minimum(np.arange(size) + which.start, which.stop - 1)
    along = NamedSharding(mesh, PartitionSpec("lanes"))
    states, lanes = jax.tree.map(
        lambda leaf: jax.device_put(np.asarray(leaf)[filled], along), (batch.states, batch.lanes)
    )
    found = _together(function, shared, states, lanes, mesh)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(which)], found)


@eqx.filter_jit
def _together(function: Callable, shared, states, lanes, mesh: Mesh):
    arrays, fixed = eqx.partition(shared, eqx.is_array)
    across, everywhere = PartitionSpec("lanes"), PartitionSpec()

    def share(arrays, states, lanes):
        whole = eqx.combine(arrays, fixed)

        def sequence(state, lanes):
            return jax.lax.scan(lambda state, lane: function(whole, state, lane), state, lanes)[1]

        return jax.vmap(sequence)(states, lanes)

    # Each device runs its own loops without synchronisation.
    return jax.shard_map(share, mesh=mesh, in_specs=(everywhere, across, across), out_specs=across, check_vma=False)(
        arrays, states, lanes
    )
