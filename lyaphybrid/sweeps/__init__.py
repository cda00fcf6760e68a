"""Sweeps over parameters, starts and keys."""

from .stores import StoreFailed
from .sweeping import sweep

__all__ = ["StoreFailed", "sweep"]
