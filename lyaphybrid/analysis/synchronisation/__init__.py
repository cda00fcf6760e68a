"""Synchronisation: perturbations across a motion that several systems share, or of a system that another drives."""

from .master_stability import MasterStability, master_stability
from .transverse import transverse_spectrum

__all__ = ["MasterStability", "master_stability", "transverse_spectrum"]
