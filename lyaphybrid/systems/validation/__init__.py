"""Checks of the user's functions and numbers before a run; an error says what was given, what is wanted, what to do."""

from .calling import check_signature
from .explanations import Call, explained
from .functions import check_clocks, check_functions, has_identity_reset

__all__ = ["Call", "check_clocks", "check_functions", "check_signature", "explained", "has_identity_reset"]
