"""Continuation of periodic orbits: branches, and where they fold, branch, double, leave circles behind or graze."""

from .branches import Continuation, Special
from .continuing import continuation

__all__ = ["Continuation", "Special", "continuation"]
