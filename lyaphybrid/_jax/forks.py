"""Forked processes: once JAX has begun to compute it has threads, which a fork does not copy, and waits for ever."""

import os

from jax._src.xla_bridge import backends_are_initialized  # there is no public name for it

__all__ = ["refuse_after_fork"]

_FORKED = (
    "This process was forked after JAX had begun to compute. Its threads were not copied, so that it would wait for "
    'ever. Begin processes with multiprocessing.get_context("spawn"), or fork before anything is computed.'
)


class _Threads:
    """Whether JAX's threads were lost in a fork."""

    lost = False


def _note_a_fork() -> None:
    _Threads.lost = backends_are_initialized()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_note_a_fork)


def refuse_after_fork() -> None:
    """Raise an error in a process that JAX cannot compute in.

    Raises:
        RuntimeError: if the process was forked after JAX had begun to compute.
    """
    if _Threads.lost:
        raise RuntimeError(_FORKED)
