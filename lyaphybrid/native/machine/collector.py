"""Pauses Python's cyclic garbage collector: tracing and lowering create many small objects and few cycles."""

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def no_collector() -> Iterator[None]:
    """A context without garbage collection, which would take a noticeable part of a first call."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
