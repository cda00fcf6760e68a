"""Sweeps over parameters, starts and keys; fields of finite-time exponents and of angles over starts."""

from ..errors import StoreFailedError
from .angles import AngleField, angle_field
from .fields import FTLEField, ftle_field
from .refining import refine
from .sweeping import sweep

__all__ = ["AngleField", "FTLEField", "StoreFailedError", "angle_field", "ftle_field", "refine", "sweep"]
