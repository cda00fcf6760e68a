"""Ctrl-C at a chosen moment, and what it leaves."""

import numpy as np

from lyaphybrid.sweeps import starts


def interrupted_at(monkeypatch, owner, name, call):
    """Let a method of a class raise KeyboardInterrupt at its call of this number, from 0."""
    original, numbers = getattr(owner, name), iter(range(1_000_000))

    def wrapped(*arguments, **more):
        if next(numbers) == call:
            raise KeyboardInterrupt
        return original(*arguments, **more)

    monkeypatch.setattr(owner, name, wrapped)


def only_computed(monkeypatch, count):
    """Let a field be what it is after Ctrl-C, with so many starts computed."""
    run = starts.sweep

    def some(*given, **how):
        found = run(*given, **how)
        return found.assign(status_code=found["status_code"].where(np.arange(found.sizes["point"]) < count, -1))

    monkeypatch.setattr(starts, "sweep", some)
