"""The store of a sweep: a zarr group, written chunk by chunk, so that the process can be killed at any moment.

A chunk is written variable by variable, each file atomically (zarr writes and renames it), and then its digest. A chunk
without a digest, or with a wrong one, counts as not computed. A file lock, which the operating system releases when the
process ends, keeps other processes out.
"""

import contextlib
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._arguments import require
from .._jax.hashes import as_bytes
from ..errors import StoreFailedError
from .outputs import dims_of
from .plans import SweepPlan

__all__ = ["Store", "opened"]

FORMAT = 2
DIGESTS = "digest"


@contextlib.contextmanager
def opened(
    path: Any, attributes: Mapping[str, Any], grid: SweepPlan, variables: Mapping[str, np.ndarray], chunk: int
) -> Iterator["Store"]:
    """A store for these variables, (points, …) each: a new one, or that of an earlier run of the same problem.

    It also holds the values of the axes at each point, so that `xarray.open_zarr` reads it as a dataset.

    Raises:
        ValueError: if the path holds something else, or another process uses the store.
        StoreFailedError: if it cannot be created.
    """
    import filelock

    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(f"{path}.lock")
        lock.acquire(blocking=False)
    except filelock.Timeout:
        raise ValueError(
            f"{path} is in use by another process (its lock is {path}.lock): wait for it, or take another store."
        ) from None
    except OSError as error:
        raise _failed(path, error) from error
    try:
        try:
            if not path.exists():
                _create_empty(path, attributes, grid, variables, chunk)
        except OSError as error:
            raise _failed(path, error) from error
        yield Store(path, attributes, variables)
    finally:
        lock.release()


def _failed(path: Path, error: OSError) -> StoreFailedError:
    return StoreFailedError(error.errno, f"the store {path} cannot be written ({error.strerror or error})")


def _create_empty(
    path: Path, attributes: Mapping[str, Any], grid: SweepPlan, variables: Mapping[str, np.ndarray], chunk: int
) -> None:
    """Create an empty store under a temporary name and rename it: no other process sees a half-made one."""
    import zarr

    aside = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    where = grid.rows(np.arange(grid.size))
    own = {"format": FORMAT, "chunk": chunk, "coordinates": " ".join(where)}
    try:
        group = zarr.open_group(str(aside), mode="w", zarr_format=3, attributes={**attributes, **own})
        for name, values in where.items():
            dims = ("point", *(f"{name}_{i}" for i in range(values.ndim - 1)))
            group.create_array(name, data=values, dimension_names=dims, compressors=None)
        for name, values in variables.items():
            group.create_array(
                name, shape=values.shape, chunks=_chunks(values.shape, chunk), dtype=values.dtype,
                fill_value=_fill_value(values), dimension_names=("point", *dims_of(name, values.ndim - 1)),
                compressors=None,
            )  # fmt: skip
        count = -(-len(next(iter(variables.values()))) // chunk)
        group.create_array(
            DIGESTS, shape=(count,), chunks=(1,), dtype="uint64", fill_value=0, dimension_names=("chunk",),
            compressors=None,
        )  # fmt: skip
        os.rename(aside, path)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
        raise


def _chunks(shape: tuple[int, ...], points: int) -> tuple[int, ...]:
    """The shape of a chunk, each length at least 1; arrays may be empty, as the events of motions without any are."""
    return tuple(max(1, length) for length in (min(points, shape[0]), *shape[1:]))


def _fill_value(values: np.ndarray) -> Any:
    return values.reshape(-1)[0].item() if values.size else np.zeros((), values.dtype).item()


class Store:
    """An open store."""

    def __init__(self, path: Path, attributes: Mapping[str, Any], variables: Mapping[str, np.ndarray]):
        import zarr

        try:
            self.group = zarr.open_group(str(path), mode="r+")
        except (FileNotFoundError, ValueError, KeyError) as error:
            raise ValueError(f"{path} is there, and no store of a sweep: take another path.") from error
        self.path, kept = path, dict(self.group.attrs)
        version = kept.get("format")
        require(
            version == FORMAT, f"{path} is there, and no store of a sweep, or of another version: take another path."
        )
        for name in ("problem", "dims", "shape"):
            require(
                kept.get(name) == attributes[name],
                f"{path} holds another sweep: its {name} is {kept.get(name)!r}, here it is {attributes[name]!r}. "
                "Take another path, or what it was made with.",
            )
        try:
            self.chunk = int(str(kept["chunk"]))
            sound = self.chunk > 0 and all(self._is_sound(name, values) for name, values in variables.items())
        except (KeyError, ValueError, AttributeError, TypeError):
            sound = False
        require(sound, f"{path} is damaged: its arrays are not those of this sweep. Take another path.")

    def _is_sound(self, name: str, values: np.ndarray) -> bool:
        """Whether an array is as `_create_empty` makes it; a chunk then takes no more memory than it takes here."""
        array = self._array(name)
        chunks = _chunks(values.shape, self.chunk)
        same = (array.shape, array.chunks, array.dtype) == (values.shape, chunks, values.dtype)
        return same and not array.compressors and not array.filters

    def _array(self, name: str) -> Any:
        return self.group[name]

    def read(self, index: int, into: dict[str, np.ndarray]) -> bool:
        """Read a chunk into the arrays; whether it was there, complete and with the right digest."""
        rows = slice(index * self.chunk, (index + 1) * self.chunk)
        try:
            digest = int(np.asarray(self._array(DIGESTS)[index]))
            found = {name: np.asarray(self._array(name)[rows]) for name in into} if digest else {}
        except Exception:  # whatever the reason, a chunk that cannot be read counts as not computed
            return False
        if not digest or digest != _digest(found):
            return False
        for name, values in found.items():
            into[name][rows] = values
        return True

    def write(self, index: int, results: Mapping[str, np.ndarray]) -> None:
        """Write a chunk.

        Raises:
            StoreFailedError: if the file system fails.
        """
        rows = slice(index * self.chunk, (index + 1) * self.chunk)
        try:
            self._array(DIGESTS)[index] = 0  # invalid while files of an old and a new computation are mixed
            for name, values in results.items():
                self._array(name)[rows] = values
            self._array(DIGESTS)[index] = _digest(results)
        except OSError as error:
            raise _failed(self.path, error) from error


def _digest(results: Mapping[str, np.ndarray]) -> int:
    """The digest of a chunk (64 bits); never 0, which stands for none."""
    digest = hashlib.blake2b(digest_size=8)
    for name in sorted(results):
        digest.update(name.encode() + as_bytes(np.asarray(results[name])))
    return int.from_bytes(digest.digest(), "little") or 1
