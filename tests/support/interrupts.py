"""Ctrl-C at a chosen moment."""


def interrupted_at(monkeypatch, owner, name, call):
    """Let a method of a class raise KeyboardInterrupt at its call of this number, from 0."""
    original, numbers = getattr(owner, name), iter(range(1_000_000))

    def wrapped(*arguments, **more):
        if next(numbers) == call:
            raise KeyboardInterrupt
        return original(*arguments, **more)

    monkeypatch.setattr(owner, name, wrapped)
