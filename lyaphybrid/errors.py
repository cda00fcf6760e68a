"""The errors that this package raises during a computation; all derive from `LyaphybridError`.

Wrong arguments raise a ValueError or TypeError before anything is computed.
"""

from typing import Any

__all__ = ["LyaphybridError", "NoPeriodicOrbitError", "RunFailedError", "StoreFailedError"]


class LyaphybridError(Exception):
    """A computation failed; what was computed so far is in ``.result``.

    Attributes:
        result: what the function would have returned; missing values are left out or nan.
    """

    result: Any = None


class RunFailedError(LyaphybridError, RuntimeError):
    """A run failed before its end; ``.result`` holds everything computed so far, ``.status`` the `STATUS`."""

    def __init__(self, status, detail: str, result: Any):
        super().__init__(f"{status}. {detail} The result so far is in `.result` of this error; throw=False returns it.")
        self.status, self.result = status, result


class NoPeriodicOrbitError(LyaphybridError, RuntimeError):
    """Newton's method did not converge to a periodic orbit; ``.result`` is its last iterate."""

    def __init__(self, message: str, result: Any):
        super().__init__(message)
        self.result = result


class StoreFailedError(LyaphybridError, OSError):
    """A store could not be written; ``.dataset`` holds all that was computed, whether it was stored or not."""

    dataset: Any = None

    @property
    def result(self) -> Any:
        """The dataset; every error of this family calls it `result`."""
        return self.dataset
