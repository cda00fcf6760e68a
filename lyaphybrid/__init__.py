"""Lyapunov exponents of systems that flow and jump, from pure JAX functions.

The names stand in the order of the data path: systems, methods, what is computed, results. Importing this package
changes no setting of JAX. For float64 call ``jax.config.update("jax_enable_x64", True)`` before the first array.
"""

from . import zoo
from ._renamed import name_of_before
from ._version import __version__ as __version__
from .analysis.basins import Basins, BasinShares, EdgeState, basin_shares, basins, edge_state
from .analysis.checking import Report, check
from .analysis.comparisons import TwoTrajectories, two_trajectories
from .analysis.continuation import Continuation, continuation
from .analysis.curves import BifurcationCurve, bifurcation_curve
from .analysis.derivatives import Jacobians, jacobians, saltation_matrix
from .analysis.diagrams.diagrams import BifurcationDiagram, bifurcation_diagram
from .analysis.diagrams.sections import PoincareSection, poincare_section
from .analysis.indicators.alignment import GALIResult, gali, sali
from .analysis.indicators.covariant import CovariantVectors, covariant_vectors
from .analysis.indicators.exponent_bounds import ExponentBounds, exponent_bounds
from .analysis.indicators.growth import IndicatorResult, fli, megno, ofli
from .analysis.indicators.intervals import SpectralIntervals, spectral_intervals
from .analysis.indicators.second_order import ofli2
from .analysis.indicators.svd_spectra import SVDSpectrum, svd_spectrum
from .analysis.multiple_solutions import solutions
from .analysis.orbits.periodic_orbits import Floquet, floquet
from .analysis.orbits.phase_responses import PhaseResponse, phase_response
from .analysis.orbits.return_maps import return_map
from .analysis.sensitivity import Design, Gradient, design, lyapunov_gradient
from .analysis.spectra import lyapunov_spectrum
from .analysis.synchronisation import MasterStability, master_stability, transverse_spectrum
from .analysis.trajectories import TangentMap, Trajectory, tangent_map, trajectory
from .engine import memberships as _memberships  # noqa: F401  answers what `contains` asks
from .errors import (
    LyaphybridError,
    NoConsistentPointError,
    NoDerivativeError,
    NoPeriodicOrbitError,
    RunFailedError,
    StoreFailedError,
)
from .explorer import Explorer, explore
from .integrators import (
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
from .results.solution_sets import Solution, Solutions
from .results.spectrum import Spectrum
from .results.time_domains import TimeDomain
from .statuses import STATUS
from .sweeps import AngleField, FTLEField, angle_field, ftle_field, refine, sweep
from .systems.consistency import consistent_start
from .systems.contacts.filippov import filippov
from .systems.contacts.rigid_contacts import impact
from .systems.daes.semi_linear import DAE
from .systems.ensembles.networks import coupled_network
from .systems.ensembles.noise import frozen_noise
from .systems.ensembles.white_noise import white_noise
from .systems.event_driven import EventDriven, Schedule
from .systems.event_queue import EventQueue
from .systems.hamiltonians import Hamiltonian, canonical_flow
from .systems.hybrid import Hybrid, Transition
from .systems.implicit_daes import implicit_dae
from .systems.smooth import Flow, Map

__all__ = [
    "Flow",
    "Map",
    "Hybrid",
    "Transition",
    "filippov",
    "EventDriven",
    "EventQueue",
    "Schedule",
    "Hamiltonian",
    "DAE",
    "canonical_flow",
    "impact",
    "coupled_network",
    "frozen_noise",
    "white_noise",
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
    "check",
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
    "transverse_spectrum",
    "master_stability",
    "exponent_bounds",
    "floquet",
    "phase_response",
    "continuation",
    "bifurcation_curve",
    "design",
    "Design",
    "lyapunov_gradient",
    "sweep",
    "refine",
    "angle_field",
    "ftle_field",
    "solutions",
    "return_map",
    "poincare_section",
    "bifurcation_diagram",
    "basins",
    "edge_state",
    "basin_shares",
    "explore",
    "Report",
    "Spectrum",
    "Trajectory",
    "TimeDomain",
    "TangentMap",
    "Jacobians",
    "TwoTrajectories",
    "GALIResult",
    "IndicatorResult",
    "CovariantVectors",
    "SpectralIntervals",
    "SVDSpectrum",
    "MasterStability",
    "ExponentBounds",
    "Floquet",
    "PhaseResponse",
    "Continuation",
    "BifurcationCurve",
    "NoPeriodicOrbitError",
    "NoConsistentPointError",
    "NoDerivativeError",
    "Gradient",
    "PoincareSection",
    "BifurcationDiagram",
    "Basins",
    "EdgeState",
    "BasinShares",
    "AngleField",
    "FTLEField",
    "Explorer",
    "Solution",
    "Solutions",
    "STATUS",
    "LyaphybridError",
    "RunFailedError",
    "StoreFailedError",
    "zoo",
]

__getattr__ = name_of_before(
    {
        "Alignment": "GALIResult",
        "Growth": "IndicatorResult",
        "NoPeriodicOrbit": "NoPeriodicOrbitError",
        "RunFailed": "RunFailedError",
        "StoreFailed": "StoreFailedError",
    },
    __name__,
    globals(),
)
