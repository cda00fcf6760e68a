"""Basins: which attractor each start leads to, how intricate the boundaries are, and motions on them."""

from .basins import Basins, basins
from .edges import EdgeState, edge_state

__all__ = ["Basins", "EdgeState", "basins", "edge_state"]
