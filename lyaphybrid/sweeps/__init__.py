"""Sweeps over parameters, starts and keys."""

from ..errors import StoreFailedError
from .refining import refine
from .sweeping import sweep

__all__ = ["StoreFailedError", "refine", "sweep"]
