"""A cache of machine code on disk, so that a second process need not compile.

The name of an entry is a hash of the module's text and of everything else that the code depends on (the CPU and its
features, LLVM, the optimisation level); lowering gives the same text for the same program in every process. An entry
begins with a hash of its code: a damaged one is compiled again. Entries are written under a temporary name and renamed,
so that several processes may share the folder. The least recently used ones are removed if it grows too large.

`LYAPHYBRID_CACHE` names another folder; "off" disables the cache.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import platformdirs

CACHE_VARIABLE = "LYAPHYBRID_CACHE"
MOST_BYTES = 256 * 2**20
LOOK_AFTER = 1 / 16  # the size of the folder is checked after this process has written this fraction of MOST_BYTES
_HASH = hashlib.sha256().digest_size


def folder() -> Path | None:
    """The folder of the entries; None if the cache is off."""
    chosen = os.environ.get(CACHE_VARIABLE, "")
    if chosen.lower() == "off":
        return None
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("lyaphybrid")) / "native"


def kept(description: str, compile_: Callable[[], bytes]) -> bytes:
    """The code for a description: from the disk if it is there, otherwise compiled and stored."""
    place, code = folder(), if_kept(description)
    if code is None:
        code = compile_()
        if place is not None:
            with contextlib.suppress(OSError):  # a full or read-only disk: work without the cache
                _write(_entry(place, description), code)
    return code


def if_kept(description: str) -> bytes | None:
    """The code for a description if it is on the disk, otherwise None."""
    place = folder()
    return None if place is None else _read(_entry(place, description))


def _entry(place: Path, description: str) -> Path:
    return place / f"{hashlib.sha256(description.encode()).hexdigest()}.o"


def _read(entry: Path) -> bytes | None:
    try:
        content = entry.read_bytes()
        entry.touch()  # the modification time is the time of the last use
    except OSError:
        return None
    code = content[_HASH:]
    return code if hashlib.sha256(code).digest() == content[:_HASH] else None


def _write(entry: Path, code: bytes) -> None:
    entry.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=entry.parent, suffix=".new")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(hashlib.sha256(code).digest() + code)
        os.replace(name, entry)
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise
    _written.unseen += len(code)
    if _written.unseen >= LOOK_AFTER * MOST_BYTES:
        _written.unseen = 0
        _make_room(entry.parent)


class _Written:
    """Bytes written since the last check of the folder's size, which is slow with thousands of files."""

    unseen = MOST_BYTES  # so that the folder is checked after the first entry


_written = _Written()


def _make_room(place: Path) -> None:
    """Remove the least recently used files, temporary ones included, until the folder is small enough."""
    entries = []
    for file in place.iterdir():
        with contextlib.suppress(OSError):  # another process has removed it
            about = file.stat()
            entries.append((about.st_mtime, about.st_size, file))
    total = sum(size for _, size, _ in entries)
    for _, size, file in sorted(entries, key=lambda entry: entry[0]):
        if total <= MOST_BYTES:
            return
        with contextlib.suppress(OSError):
            file.unlink()
        total -= size
