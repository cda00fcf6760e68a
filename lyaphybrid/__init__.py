"""Lyapunov exponents of systems that flow and jump."""

from ._compiler import request_single_kernel_loops

request_single_kernel_loops()

from .comparisons import TwoTrajectories, two_trajectories  # noqa: E402
from . import zoo  # noqa: E402
from .derivatives import Jacobians, jacobians, saltation_matrix  # noqa: E402
from .methods import Diffrax, RungeKutta  # noqa: E402
from .results import RunFailed, Spectrum  # noqa: E402
from .spectra import lyapunov_spectrum  # noqa: E402
from .statuses import STATUS  # noqa: E402
from .systems import EventDriven, Flow, Hybrid, Map, Transition  # noqa: E402
from .trajectories import TangentMap, Trajectory, tangent_map, trajectory  # noqa: E402
