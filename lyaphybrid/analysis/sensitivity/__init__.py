"""Derivatives of exponents with respect to parameters: right, or refused."""

from .design import Design, design
from .gradient import Gradient, lyapunov_gradient

__all__ = ["Design", "Gradient", "design", "lyapunov_gradient"]
