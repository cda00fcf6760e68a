"""Old names, which still work for one release; each use warns and gives the new name."""

import functools
import warnings
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from ._keywords import user_level

__all__ = ["arguments", "attribute", "keywords", "name_of_before", "warn"]

P = ParamSpec("P")
T = TypeVar("T")


def warn(old: str, new: str) -> None:
    """Warn that `old` is now `new`, at the line outside of this package that uses it."""
    said = f"{old} is now called {new}; the old name goes with the next release."
    warnings.warn(said, DeprecationWarning, user_level())


def keywords(**renamed: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function whose keywords were renamed, each given as old="new"."""

    def translate(name: str, args: tuple, given: dict[str, Any]) -> tuple:
        for old, new in renamed.items():
            if old in given:
                if new in given:
                    raise TypeError(f"{name}: {old} is the old name of {new}: give one of them.")
                warn(f"{name}(…, {old}=…)", f"{new}=")
                given[new] = given.pop(old)
        return args

    return arguments(translate)


def arguments(translate: Callable[[str, tuple, dict[str, Any]], tuple]) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function whose arguments were others before.

    Args:
        translate: (name, positional, keywords) -> positional; it changes the keywords in place, and warns.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def call(*args: P.args, **given: P.kwargs) -> T:
            positional: Any = translate(function.__name__, args, given)
            return function(*positional, **given)

        return call

    return decorate


def attribute(old: str, new: str) -> property:
    """An attribute that has a new name."""

    def read(self):
        warn(f"{type(self).__name__}.{old}", f".{new}")
        return getattr(self, new)

    return property(read, doc=f"The old name of `{new}`.")


def name_of_before(renamed: dict[str, str], module: str, namespace: dict[str, Any]) -> Callable:
    """A module's `__getattr__` that accepts its old names; `renamed` is {old: new}."""

    def find(name: str):
        if name not in renamed:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warn(f"{module}.{name}", f"{module}.{renamed[name]}")
        return namespace[renamed[name]]

    return find
