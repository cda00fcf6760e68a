"""The errors that this package raises during a computation; all derive from `LyaphybridError`.

Wrong arguments raise a ValueError or TypeError before anything is computed.
"""

from typing import Any

__all__ = [
    "LyaphybridError",
    "NoConsistentPointError",
    "NoDerivativeError",
    "NoPeriodicOrbitError",
    "RunFailedError",
    "StoreFailedError",
    "UserFunctionError",
]


class LyaphybridError(Exception):
    """A computation failed; what was computed so far is in ``.result``.

    Attributes:
        result: what the function would have returned; missing values are left out or nan.
    """

    result: Any = None


class UserFunctionError(ValueError):
    """A function that was given cannot be used; the message is complete, with the place in the user's own file."""


class RunFailedError(LyaphybridError, RuntimeError):
    """A run failed before its end; ``.result`` holds everything computed so far, ``.status`` the `STATUS`."""

    def __init__(self, status: Any, detail: str, result: Any):
        self.told = f"{status}. {detail}"  # without what to do with the error
        super().__init__(f"{self.told} The result so far is in `.result` of this error; throw=False returns it.")
        self.status, self.result = status, result


class _NotFoundError(LyaphybridError, RuntimeError):
    """A search did not converge, or found nothing; ``.result`` is what it found instead."""

    def __init__(self, message: str, result: Any):
        super().__init__(message)
        self.result = result


class NoPeriodicOrbitError(_NotFoundError):
    """Newton's method did not converge to a periodic orbit; ``.result`` is its last iterate."""


class NoConsistentPointError(_NotFoundError):
    """Newton's method did not converge to a consistent point; ``.result`` (n,) is its last iterate."""


class NoDerivativeError(_NotFoundError):
    """No method gives the derivative of the exponents; ``.result`` is an `lh.Gradient` of nan that is not trusted."""


class StoreFailedError(LyaphybridError, OSError):
    """A store could not be written; ``.dataset`` holds all that was computed, whether it was stored or not."""

    dataset: Any = None

    @property
    def result(self) -> Any:
        """The dataset; every error of this family calls it `result`."""
        return self.dataset
