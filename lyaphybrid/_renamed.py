"""Old names, which still work for one release; each use warns and gives the new name."""

import functools
import warnings
from collections.abc import Callable
from typing import Any

__all__ = ["keywords", "name_of_before"]


def _warn(old: str, new: str) -> None:
    warnings.warn(f"{old} is now called {new}; the old name goes with the next release.", DeprecationWarning, 3)


def keywords(**renamed: str) -> Callable:
    """Decorate a function whose keywords were renamed, each given as old="new"."""

    def decorate(function: Callable) -> Callable:
        @functools.wraps(function)
        def call(*args, **given):
            for old, new in renamed.items():
                if old in given:
                    if new in given:
                        raise TypeError(f"{function.__name__}: {old} is the old name of {new}: give one of them.")
                    _warn(f"{function.__name__}(…, {old}=…)", f"{new}=")
                    given[new] = given.pop(old)
            return function(*args, **given)

        return call

    return decorate


def name_of_before(renamed: dict[str, str], module: str, namespace: dict[str, Any]) -> Callable:
    """A module's `__getattr__` that accepts its old names; `renamed` is {old: new}."""

    def find(name: str):
        if name not in renamed:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        _warn(f"{module}.{name}", f"{module}.{renamed[name]}")
        return namespace[renamed[name]]

    return find
