"""Formatting of numbers and units, shared by all tables, axes and messages."""

import numpy as np

__all__ = ["UNIT", "with_error"]

UNIT = {"time": "unit of time", "jumps": "jump", "hybrid": "unit of max(t, j)"}


def with_error(value: float, error: float) -> str:
    """0.90587(15): two digits of the error, in units of the last digits shown."""
    if not np.isfinite(value):
        return "-inf" if value < 0 else str(value)
    if not np.isfinite(error) or error <= 0:
        return f"{value:.12g}"
    digits = max(0, 1 - int(np.floor(np.log10(error))))
    if digits > 12:
        return f"{value:.12f}" if abs(value) >= 1e-12 else f"{value:.0e}"
    return f"{value:.{digits}f}({error * 10**digits:.0f})" if digits else f"{value:.0f}({error:.0f})"
