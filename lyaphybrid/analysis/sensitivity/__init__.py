"""Derivatives of exponents with respect to parameters, with checks of whether they can be trusted."""

from .design import Design, design
from .gradient import Gradient, lyapunov_gradient

__all__ = ["Design", "Gradient", "design", "lyapunov_gradient"]
