"""Integration methods: one step of the state and the tangent of that step. They know no systems and no exponents."""

from .continuous_qr import ContinuousQR
from .diffrax_events import DiffraxEvents
from .diffrax_solver import Diffrax
from .hamiltonian.symplectic import Splitting, Symplectic
from .hamiltonian.tangent_hamiltonians import TangentHamiltonian
from .implicit.half_explicit import ESDIRK, HalfExplicit
from .implicit.radau import RadauIIA
from .runge_kutta import RungeKutta

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
