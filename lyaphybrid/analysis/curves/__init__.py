"""Bifurcations of periodic orbits, followed in two parameters."""

from .bifurcation_curves import BifurcationCurve, CurveSpecial
from .curves import bifurcation_curve

__all__ = ["BifurcationCurve", "CurveSpecial", "bifurcation_curve"]
