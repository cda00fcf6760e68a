"""Continuation of periodic orbits: branches and their bifurcations."""

from .branches import Continuation, Special
from .continuing import continuation

__all__ = ["Continuation", "Special", "continuation"]
