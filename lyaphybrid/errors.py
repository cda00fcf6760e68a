"""One family of errors: all that this package raises in the middle of a computation.

What is wrong with arguments is a ValueError (or TypeError) as everywhere, before anything is computed.
"""

from typing import Any

__all__ = ["LyaphybridError", "NoPeriodicOrbitError", "RunFailedError", "StoreFailedError"]


class LyaphybridError(Exception):
    """A computation failed on its way; what was computed so far is in ``.result``.

    Attributes:
        result: as the function would have returned it, with what is missing left out or nan.
    """

    result: Any = None


class RunFailedError(LyaphybridError, RuntimeError):
    """A run ended before its time; ``.result`` holds everything computed so far, ``.status`` the `STATUS`."""

    def __init__(self, status, detail: str, result: Any):
        super().__init__(f"{status}. {detail} The result so far is in `.result` of this error; throw=False returns it.")
        self.status, self.result = status, result


class NoPeriodicOrbitError(LyaphybridError, RuntimeError):
    """Newton's method did not arrive at a periodic orbit; ``.result`` is where it stood."""

    def __init__(self, message: str, result: Any):
        super().__init__(message)
        self.result = result


class StoreFailedError(LyaphybridError, OSError):
    """A store could not be written; ``.dataset`` holds all that was computed, in the store or not."""

    dataset: Any = None

    @property
    def result(self) -> Any:
        """The dataset, under the name that all these errors share."""
        return self.dataset
