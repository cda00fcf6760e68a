"""How a tangent is carried over one step: each method knows its step, and nothing of systems or exponents."""

from .diffrax_solver import Diffrax
from .runge_kutta import RungeKutta
from .symplectic import Splitting, Symplectic
from .tangent_hamiltonians import TangentHamiltonian

__all__ = ["Diffrax", "RungeKutta", "Splitting", "Symplectic", "TangentHamiltonian"]
