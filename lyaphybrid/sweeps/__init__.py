"""Sweeps over parameters, starts and keys."""

from .refining import refine
from .stores import StoreFailed
from .sweeping import sweep

__all__ = ["StoreFailed", "refine", "sweep"]
