"""Lyapunov exponents of systems that flow and jump, from pure JAX functions.

The names stand in the order of the data path: systems, methods, what is computed, results. Importing this package
sets nothing behind your back. For float64 say so yourself: ``jax.config.update("jax_enable_x64", True)``.
"""

from . import zoo
from .comparisons import TwoTrajectories, two_trajectories
from .consistency import consistent_start
from .continuations import Continuation, continuation
from .daes import DAE
from .derivatives import Jacobians, jacobians, saltation_matrix
from .diagrams import BifurcationDiagram, bifurcation_diagram
from .filippov import filippov
from .gradients import Design, Gradient, design, lyapunov_gradient
from .hamiltonians import Hamiltonian, canonical_flow
from .implicit_daes import implicit_dae
from .indicators import (
    Alignment,
    CovariantVectors,
    ExponentBounds,
    Growth,
    SpectralIntervals,
    SVDSpectrum,
    covariant_vectors,
    exponent_bounds,
    fli,
    gali,
    megno,
    ofli,
    ofli2,
    sali,
    spectral_intervals,
    svd_spectrum,
)
from .methods import (
    ESDIRK,
    ContinuousQR,
    Diffrax,
    DiffraxEvents,
    HalfExplicit,
    RadauIIA,
    RungeKutta,
    Splitting,
    Symplectic,
    TangentHamiltonian,
)
from .multiple_solutions import solutions
from .periodic_orbits import Floquet, floquet
from .results import RunFailed, Spectrum
from .return_maps import return_map
from .rigid_contacts import impact
from .sections import PoincareSection, poincare_section
from .shooting import NoPeriodicOrbit
from .solution_sets import Solution, Solutions
from .spectra import lyapunov_spectrum
from .statuses import STATUS
from .sweeps import StoreFailed, refine, sweep
from .systems import EventDriven, Flow, Hybrid, Map, Schedule, Transition
from .time_domains import TimeDomain
from .trajectories import TangentMap, Trajectory, tangent_map, trajectory

__version__ = "0.2.0.dev0"

__all__ = [
    "Flow",
    "Map",
    "Hybrid",
    "Transition",
    "filippov",
    "EventDriven",
    "Schedule",
    "Hamiltonian",
    "DAE",
    "canonical_flow",
    "impact",
    "RungeKutta",
    "Diffrax",
    "DiffraxEvents",
    "Symplectic",
    "Splitting",
    "TangentHamiltonian",
    "HalfExplicit",
    "ESDIRK",
    "RadauIIA",
    "ContinuousQR",
    "implicit_dae",
    "consistent_start",
    "lyapunov_spectrum",
    "trajectory",
    "tangent_map",
    "saltation_matrix",
    "jacobians",
    "two_trajectories",
    "gali",
    "sali",
    "megno",
    "fli",
    "ofli",
    "ofli2",
    "covariant_vectors",
    "spectral_intervals",
    "svd_spectrum",
    "exponent_bounds",
    "floquet",
    "continuation",
    "design",
    "Design",
    "lyapunov_gradient",
    "sweep",
    "refine",
    "solutions",
    "return_map",
    "poincare_section",
    "bifurcation_diagram",
    "Spectrum",
    "Trajectory",
    "TimeDomain",
    "TangentMap",
    "Jacobians",
    "TwoTrajectories",
    "Alignment",
    "Growth",
    "CovariantVectors",
    "SpectralIntervals",
    "SVDSpectrum",
    "ExponentBounds",
    "Floquet",
    "Continuation",
    "NoPeriodicOrbit",
    "Gradient",
    "PoincareSection",
    "BifurcationDiagram",
    "Solution",
    "Solutions",
    "STATUS",
    "RunFailed",
    "StoreFailed",
    "zoo",
]
