"""Figures of results: functions (result, ax) -> ax.

Every function draws into the given axes, or into those of a new figure, and changes nothing else.
Colours are those of Okabe and Ito, which colour-blind readers can tell apart.
"""

from .axes import COLOURS, Axes
from .continuations import continuation
from .diagrams import bifurcations, diagram, largest_exponent, section
from .indicators import alignment, angles, growth, intervals
from .orbits import matrix, multipliers, time_domain
from .reports import report
from .results import against_density, bounds, convergence, running, solutions, spectra, spectrum
from .sensitivities import design, gradient
from .sweeps import sweep_lines, sweep_map
from .trajectories import phase, trajectory

__all__ = [
    "COLOURS",
    "Axes",
    "against_density",
    "alignment",
    "angles",
    "bifurcations",
    "bounds",
    "continuation",
    "convergence",
    "design",
    "diagram",
    "gradient",
    "growth",
    "intervals",
    "largest_exponent",
    "matrix",
    "multipliers",
    "phase",
    "report",
    "running",
    "section",
    "solutions",
    "spectra",
    "spectrum",
    "sweep_lines",
    "sweep_map",
    "time_domain",
    "trajectory",
]
