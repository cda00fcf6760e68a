"""Derivatives of exponents with respect to parameters: right, or refused."""

from .gradient import Gradient, lyapunov_gradient

__all__ = ["Gradient", "lyapunov_gradient"]
