"""How a tangent is carried over one step: each method knows its step, and nothing of systems or exponents."""

from .continuous_qr import ContinuousQR
from .diffrax_events import DiffraxEvents
from .diffrax_solver import Diffrax
from .half_explicit import ESDIRK, HalfExplicit
from .radau import RadauIIA
from .runge_kutta import RungeKutta
from .symplectic import Splitting, Symplectic
from .tangent_hamiltonians import TangentHamiltonian

__all__ = [
    "ESDIRK",
    "ContinuousQR",
    "Diffrax",
    "DiffraxEvents",
    "HalfExplicit",
    "RadauIIA",
    "RungeKutta",
    "Splitting",
    "Symplectic",
    "TangentHamiltonian",
]
