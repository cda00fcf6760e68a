"""Checks of a system before it is used."""

from .checks import check
from .report import Report

__all__ = ["Report", "check"]
