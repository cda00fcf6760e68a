"""Checkpoints of long runs on disk: a resumed run gives the same bits as one that was never interrupted.

A checkpoint is one NumPy file without pickled objects, replaced atomically. It holds the parts of a run (the transient
and the measured part), each as the leaves of the loop's state and of its block records; or the arrays of the steps of
another computation that are done. Tree structure and functions come from the call that resumes; hashes in the file tell
whether it is the same run.
"""

import json
import math
import os
import time
import uuid
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import require

__all__ = ["Checkpoint", "RunPart", "opened"]

SECONDS_BETWEEN_WRITES = 5.0  # least time between two writes, in seconds
FORMAT = 2
DAMAGED = "{} is no checkpoint of a run, or it is damaged: remove it, and begin anew."
NOT_READABLE = (ValueError, KeyError, EOFError, TypeError, AttributeError, IndexError, MemoryError, RecursionError)


class StoredPart(NamedTuple):
    """One part as it is stored."""

    leaves: list[np.ndarray]  # of (loop's state, records)
    given: int  # step attempts spent so far


class Checkpoint:
    """The file of one run."""

    def __init__(self, path: Path, header: dict[str, str], stretches: list[tuple[float, int]]):
        self.path, self.header, self.stretches = path, header, stretches
        self.parts: dict[int, StoredPart] = {}
        self.finished = False  # whether all stretches, (length, blocks) each, are done
        self.written, self.works = time.perf_counter(), True

    def part(self, number: int) -> "RunPart":
        """One part for `driver.drive`; number 0 is the transient."""
        return RunPart(self, number)

    def keep(self, number: int, leaves: list[np.ndarray], given: int = 0, now: bool = False) -> None:
        """Keep a part; write the file if `now`, or SECONDS_BETWEEN_WRITES after the last write."""
        self.parts[number] = StoredPart(leaves, given)
        if now or self.is_due():
            self.write()

    def is_due(self) -> bool:
        """Whether the last write is long ago."""
        return time.perf_counter() - self.written >= SECONDS_BETWEEN_WRITES

    def close(self) -> None:
        """Mark the run as finished and write the file."""
        self.finished = True
        self.write()

    def write(self) -> None:
        """Replace the file.

        Raises:
            OSError: if the file does not exist yet; later a failure is a warning, because the run can go on.
        """
        arrays: dict[str, Any] = {
            "header": np.array(json.dumps(self.header | {"format": str(FORMAT)})),
            "stretches": np.array(self.stretches, float),
            "finished": np.array(self.finished),
        }
        for number, state in self.parts.items():
            arrays[f"{number}.given"] = np.array(state.given)
            arrays |= {f"{number}.{i}": leaf for i, leaf in enumerate(state.leaves)}
        aside = self.path.with_name(f".{self.path.name}.{uuid.uuid4().hex}")
        try:
            with aside.open("wb") as file:
                np.savez(file, **arrays)
                file.flush()
                os.fsync(file.fileno())
            aside.replace(self.path)
        except OSError as error:
            aside.unlink(missing_ok=True)
            said = f"the checkpoint {self.path} cannot be written ({error.strerror or error})"
            if not self.path.exists():
                raise OSError(error.errno, said) from error
            if self.works:
                warnings.warn(f"{said}: it stays as it was, and the run goes on.", stacklevel=2)
            self.works = False
        self.written = time.perf_counter()


class RunPart(NamedTuple):
    """One part of a run."""

    checkpoint: Checkpoint
    number: int

    def begun(self, loop_state, shape_of_records: Callable[[], Any]):
        """The stored (loop's state, records, attempts); records is None if the part has not begun."""
        state = self.checkpoint.parts.get(self.number)
        if state is None:
            return loop_state, None, 0
        like = loop_state, shape_of_records()
        wanted = [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(like)]
        known = [(leaf.shape, leaf.dtype) for leaf in state.leaves]
        require(known == wanted, DAMAGED.format(self.checkpoint.path))
        loop_state, records = jax.tree.unflatten(jax.tree.structure(like), state.leaves)
        return jax.tree.map(jnp.asarray, loop_state), records, state.given

    def keep(self, loop_state, records, given: int, now: bool = False) -> None:
        """Store the present state if `now`, or if the last write is long ago; it replaces that before."""
        if now or self.checkpoint.is_due():
            leaves = [np.asarray(leaf) for leaf in jax.tree.leaves((loop_state, records))]
            self.checkpoint.keep(self.number, leaves, given, now=True)


def opened(path: Any, resume: bool, header: dict[str, str], t1: float, blocks: int, extends: bool) -> Checkpoint:
    """The checkpoint of a run: a new one, or the one that an earlier call has written.

    Args:
        path: of the file.
        resume: whether to continue from an existing file.
        header: hashes that identify the run, by the name of what is hashed.
        t1: length of the run.
        blocks: number of blocks.
        extends: whether a finished run may be extended to a longer t1.

    Raises:
        ValueError: if the file exists and `resume` is False; if it is not a checkpoint, or that of another run.
        OSError: if it cannot be written.
    """
    path = Path(path)
    if not path.exists():
        checkpoint = Checkpoint(path, header, [(float(t1), blocks)])
        checkpoint.write()
        return checkpoint
    require(resume, f"{path} is there: resume=True goes on with it; for a new run give another path.")
    kept, stretches, finished, parts = _read(path)
    other = [name for name, value in header.items() if kept.get(name) != value]
    require(not other, f"{path} is the checkpoint of another run: another {', another '.join(other)}.")
    checkpoint = Checkpoint(path, header, stretches)
    checkpoint.finished, checkpoint.parts = finished, parts
    _extend(checkpoint, float(t1), extends)
    return checkpoint


def _read(path: Path) -> tuple[dict[str, str], list[tuple[float, int]], bool, dict[int, StoredPart]]:
    """The header of a file, its stretches, whether it is finished, and its parts.

    Raises:
        ValueError: if the file is not one that `Checkpoint.write` has written.
    """
    damaged = DAMAGED.format(path)
    require(path.is_file(), damaged)
    try:
        arrays = _arrays(path)
        header = json.loads(str(arrays["header"]))
        if header["format"] == str(FORMAT):
            stretches = [(float(length), int(count)) for length, count in arrays["stretches"]]
            given = {name.removesuffix(".given"): int(arrays[name]) for name in arrays if name.endswith(".given")}
            parts = {int(number): StoredPart(_leaves(arrays, number), spent) for number, spent in given.items()}
            return header, stretches, bool(arrays["finished"]), parts
    except (*NOT_READABLE, zipfile.BadZipFile) as error:
        raise ValueError(damaged) from error
    raise ValueError(f"{path} is a checkpoint of another version: remove it, and begin anew.")


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file; none takes more memory than it takes on the disk."""
    with zipfile.ZipFile(path) as file:
        entries = file.infolist()
        apart = sum(entry.file_size for entry in entries) <= path.stat().st_size
        if not apart or not all(_is_whole(file, entry) for entry in entries):
            raise ValueError("entries are compressed, overlap, or promise more than they hold: we write no such files")
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _is_whole(file: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bool:
    """Whether an entry holds the array that its header describes, as it is."""
    with file.open(entry) as stream:
        np.lib.format.read_magic(stream)
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
        wanted = stream.tell() + math.prod(shape) * dtype.itemsize
    return entry.compress_type == zipfile.ZIP_STORED and entry.file_size == wanted


def _leaves(arrays: dict[str, np.ndarray], number: str) -> list[np.ndarray]:
    count = sum(key.startswith(f"{number}.") for key in arrays) - 1
    return [arrays[f"{number}.{i}"] for i in range(count)]


def _extend(checkpoint: Checkpoint, t1: float, extends: bool) -> None:
    """If t1 is longer than before, add a stretch of blocks, about as long as the earlier ones."""
    reached, (length, count) = sum(length for length, _ in checkpoint.stretches), checkpoint.stretches[0]
    if np.isclose(t1, reached, rtol=1e-12):
        return
    there = f"{checkpoint.path} holds a run of t1 = {reached:.15g}"
    require(t1 > reached, f"{there}, longer than {t1:.15g}: take another path.")
    require(checkpoint.finished, f"{there} that is not finished: resume it with that t1, and then with {t1:.15g}.")
    require(extends, f"{there}: with times= or target_stderr= it cannot be extended to {t1:.15g}.")
    checkpoint.stretches.append((t1 - reached, max(2, round((t1 - reached) * count / length))))
    checkpoint.finished = False
