"""Pictures of results: result, ax -> ax.

Every function draws into the axes it is given, or makes a figure of its own, and touches nothing else.
Colours are those of Okabe and Ito, which colour-blind readers can tell apart.
"""

from .axes import COLOURS
from .continuations import continuation
from .diagrams import bifurcations, diagram, largest_exponent, section
from .indicators import alignment, growth, intervals
from .results import against_density, convergence, phase, spectra, spectrum, trajectory
from .sweeps import sweep_lines, sweep_map

__all__ = [
    "COLOURS",
    "against_density",
    "alignment",
    "bifurcations",
    "continuation",
    "convergence",
    "diagram",
    "growth",
    "intervals",
    "largest_exponent",
    "phase",
    "section",
    "spectra",
    "spectrum",
    "sweep_lines",
    "sweep_map",
    "trajectory",
]
