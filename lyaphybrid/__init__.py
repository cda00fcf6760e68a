"""Lyapunov exponents of systems that flow and jump, from pure JAX functions.

The names stand in the order of the data path: systems, methods, what is computed, results. Importing this package
asks XLA, where it is still possible, to compile whole loops into single CPU kernels (see the README); nothing else
is set behind your back. For float64 say so yourself: ``jax.config.update("jax_enable_x64", True)``.
"""

from ._compiler import request_single_kernel_loops

request_single_kernel_loops()

# Only now: importing these may make arrays, and with the first array it is too late for the switch.
from . import zoo  # noqa: E402
from .comparisons import TwoTrajectories, two_trajectories  # noqa: E402
from .consistency import consistent_start  # noqa: E402
from .continuations import Continuation, continuation  # noqa: E402
from .daes import DAE  # noqa: E402
from .derivatives import Jacobians, jacobians, saltation_matrix  # noqa: E402
from .diagrams import BifurcationDiagram, bifurcation_diagram  # noqa: E402
from .filippov import filippov  # noqa: E402
from .gradients import Design, Gradient, design, lyapunov_gradient  # noqa: E402
from .hamiltonians import Hamiltonian, canonical_flow  # noqa: E402
from .indicators import (  # noqa: E402
    Alignment,
    CovariantVectors,
    Growth,
    SpectralIntervals,
    covariant_vectors,
    fli,
    gali,
    megno,
    ofli,
    sali,
    spectral_intervals,
)
from .methods import ESDIRK, ContinuousQR, Diffrax, HalfExplicit, RungeKutta, Splitting, Symplectic, TangentHamiltonian  # noqa: E402
from .periodic_orbits import Floquet, floquet  # noqa: E402
from .results import RunFailed, Spectrum  # noqa: E402
from .return_maps import return_map  # noqa: E402
from .rigid_contacts import impact  # noqa: E402
from .sections import PoincareSection, poincare_section  # noqa: E402
from .shooting import NoPeriodicOrbit  # noqa: E402
from .spectra import lyapunov_spectrum  # noqa: E402
from .statuses import STATUS  # noqa: E402
from .sweeps import StoreFailed, refine, sweep  # noqa: E402
from .systems import EventDriven, Flow, Hybrid, Map, Schedule, Transition  # noqa: E402
from .trajectories import TangentMap, Trajectory, tangent_map, trajectory  # noqa: E402

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
    "Symplectic",
    "Splitting",
    "TangentHamiltonian",
    "HalfExplicit",
    "ESDIRK",
    "ContinuousQR",
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
    "covariant_vectors",
    "spectral_intervals",
    "floquet",
    "continuation",
    "design",
    "Design",
    "lyapunov_gradient",
    "sweep",
    "refine",
    "return_map",
    "poincare_section",
    "bifurcation_diagram",
    "Spectrum",
    "Trajectory",
    "TangentMap",
    "Jacobians",
    "TwoTrajectories",
    "Alignment",
    "Growth",
    "CovariantVectors",
    "SpectralIntervals",
    "Floquet",
    "Continuation",
    "NoPeriodicOrbit",
    "Gradient",
    "PoincareSection",
    "BifurcationDiagram",
    "STATUS",
    "RunFailed",
    "StoreFailed",
    "zoo",
]
