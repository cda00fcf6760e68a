"""Basins: which attractor each start leads to, and how intricate the boundaries between them are."""

from .basins import Basins, basins

__all__ = ["Basins", "basins"]
