"""Machine code kept on disk, so that a second process compiles nothing.

An entry's name is a hash of the module's text and of all else that the code depends on (the CPU and its features, LLVM,
the level of optimisation); lowering gives the same text for the same program in every process. An entry begins with a
hash of its code: one that is damaged is compiled anew. Entries are written under another name first and then renamed,
so that several processes may share the folder; the least recently used ones go when it has grown too large.

`LYAPHYBRID_CACHE` names another folder; "off" keeps nothing.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import platformdirs

VARIABLE = "LYAPHYBRID_CACHE"
MOST_BYTES = 256 * 2**20
LOOK_AFTER = 1 / 16  # of that, written by this process: whether the folder has grown too large
_HASH = hashlib.sha256().digest_size


def folder() -> Path | None:
    """Where entries lie; None where nothing is kept."""
    chosen = os.environ.get(VARIABLE, "")
    if chosen.lower() == "off":
        return None
    return Path(chosen) if chosen else Path(platformdirs.user_cache_dir("lyaphybrid")) / "native"


def kept(description: str, compile_: Callable[[], bytes]) -> bytes:
    """The code of that description: from the disk if it is there, else compiled and kept."""
    place, code = folder(), if_kept(description)
    if code is None:
        code = compile_()
        if place is not None:
            with contextlib.suppress(OSError):  # a full or read-only disk: compile each time
                _write(_entry(place, description), code)
    return code


def if_kept(description: str) -> bytes | None:
    """The code of that description if it is on the disk."""
    place = folder()
    return None if place is None else _read(_entry(place, description))


def _entry(place: Path, description: str) -> Path:
    return place / f"{hashlib.sha256(description.encode()).hexdigest()}.o"


def _read(entry: Path) -> bytes | None:
    try:
        content = entry.read_bytes()
        entry.touch()  # used now
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
    """How much this process has written since it last looked: to look at thousands of files takes its time."""

    unseen = MOST_BYTES  # bytes; so that the first entry is followed by a look


_written = _Written()


def _make_room(place: Path) -> None:
    """Remove the least recently used entries, and what broken writers left, until the folder is small enough."""
    entries = []
    for file in place.iterdir():
        with contextlib.suppress(OSError):  # another process was faster
            about = file.stat()
            entries.append((about.st_mtime, about.st_size, file))
    total = sum(size for _, size, _ in entries)
    for _, size, file in sorted(entries, key=lambda entry: entry[0]):
        if total <= MOST_BYTES:
            return
        with contextlib.suppress(OSError):
            file.unlink()
        total -= size
