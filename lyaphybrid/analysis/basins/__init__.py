"""Basins: which attractor each start leads to, how intricate the boundaries are, and motions on them."""

from .basins import Basins, basins
from .edges import EdgeState, edge_state
from .shares import BasinShares, basin_shares

__all__ = ["BasinShares", "Basins", "EdgeState", "basin_shares", "basins", "edge_state"]
