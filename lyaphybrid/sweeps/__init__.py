"""Sweeps over parameters, starts and keys; fields of finite-time exponents over starts."""

from ..errors import StoreFailedError
from .fields import FTLEField, ftle_field
from .refining import refine
from .sweeping import sweep

__all__ = ["FTLEField", "StoreFailedError", "ftle_field", "refine", "sweep"]
