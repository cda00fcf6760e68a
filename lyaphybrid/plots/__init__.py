"""Figures of results: functions (result, ax) -> ax.

Every function draws into the given axes, or into those of a new figure, and changes nothing else; what it does not know
goes to what it draws (``linewidth=2``). Colours are those of Okabe and Ito, which colour-blind readers can tell apart;
the i-th exponent has the same one in every figure. `style` gives figures for print, notebooks and dark pages.
"""

from .axes import COLOURS, Axes
from .continuations import continuation, curves
from .diagrams import (
    DiagramPlots,
    angle_field,
    basin_shares,
    basins,
    bifurcations,
    diagram,
    ftle_field,
    largest_exponent,
    section,
)
from .indicators import alignment, angles, growth, intervals
from .orbits import matrix, multipliers, phase_responses, time_domain
from .reports import report
from .results import (
    SpectrumPlots,
    against_density,
    bounds,
    convergence,
    master_stability,
    running,
    solutions,
    spectra,
    spectrum,
)
from .sensitivities import design, gradient
from .styles import style
from .sweeps import sweep_lines, sweep_map
from .trajectories import TrajectoryPlots, animation, phase, raster, trajectory

__all__ = [
    "COLOURS",
    "Axes",
    "DiagramPlots",
    "SpectrumPlots",
    "TrajectoryPlots",
    "against_density",
    "alignment",
    "angle_field",
    "angles",
    "animation",
    "basin_shares",
    "basins",
    "bifurcations",
    "bounds",
    "continuation",
    "convergence",
    "curves",
    "design",
    "diagram",
    "ftle_field",
    "gradient",
    "growth",
    "intervals",
    "largest_exponent",
    "master_stability",
    "matrix",
    "multipliers",
    "phase",
    "phase_responses",
    "raster",
    "report",
    "running",
    "section",
    "solutions",
    "spectra",
    "spectrum",
    "style",
    "sweep_lines",
    "sweep_map",
    "time_domain",
    "trajectory",
]
