"""The reference by task: which public name stands on which page, and the pages."""

from pathlib import Path
from typing import NamedTuple

from lyaphybrid import plots, zoo

PROBLEMS = tuple(zoo.names())


class Task(NamedTuple):
    """A page of the reference: title, what is there, its names, and the module that they are in."""

    title: str
    about: str
    names: tuple[str, ...]
    module: str = "lyaphybrid"


TASKS = {
    "systems": Task(
        "Systems",
        "Mathematics only: what flows, what jumps, and when. User functions are pure, take ``(t, x, args)`` and return "
        "arrays of JAX.",
        (
            *("Flow", "Map", "Hybrid", "Transition", "filippov", "impact", "EventDriven", "Schedule", "EventQueue"),
            *("Hamiltonian", "canonical_flow", "DAE", "implicit_dae", "consistent_start", "check", "Report"),
            *("frozen_noise", "white_noise"),
        ),
    ),
    "methods": Task(
        "Methods of integration",
        "What ``method=`` takes. Without it a flow is integrated by an adaptive `lh.RungeKutta`, a DAE by "
        "`lh.HalfExplicit`.",
        (
            *("RungeKutta", "RadauIIA", "ESDIRK", "HalfExplicit", "ContinuousQR", "Symplectic", "Splitting"),
            *("TangentHamiltonian", "Diffrax", "DiffraxEvents"),
        ),
    ),
    "motion": Task(
        "Motion and its derivatives",
        "What a run does, and what it does to small perturbations.",
        (
            *("trajectory", "Trajectory", "TimeDomain", "tangent_map", "TangentMap", "saltation_matrix"),
            *("jacobians", "Jacobians", "solutions", "Solution", "Solutions"),
        ),
    ),
    "exponents": Task(
        "Exponents, vectors, bounds",
        "The spectrum of exponents with its errors, other ways to it, and what it rests on.",
        (
            *("lyapunov_spectrum", "Spectrum", "two_trajectories", "TwoTrajectories", "covariant_vectors"),
            *("CovariantVectors", "svd_spectrum", "SVDSpectrum", "spectral_intervals", "SpectralIntervals"),
            *("exponent_bounds", "ExponentBounds"),
        ),
    ),
    "indicators": Task(
        "Regular or chaotic",
        "Indicators of chaos from deviation vectors, sooner than exponents converge.",
        ("sali", "gali", "GALIResult", "megno", "fli", "ofli", "ofli2", "IndicatorResult"),
    ),
    "synchronisation": Task(
        "Synchronisation",
        "Perturbations across a motion that coupled systems share, or of a system that another one drives; see "
        ":doc:`how to tell whether systems synchronise </howto/kinds/synchronisation>`.",
        ("transverse_spectrum", "master_stability", "MasterStability", "coupled_network"),
    ),
    "exploring": Task(
        "Exploring in a notebook",
        "Sliders over parameters and start; see :doc:`how to explore </howto/results/explore>`.",
        ("explore", "Explorer"),
    ),
    "orbits": Task(
        "Sections, periodic orbits, bifurcations",
        "What repeats, and how it changes with a parameter.",
        (
            *("poincare_section", "PoincareSection", "return_map", "floquet", "Floquet", "continuation"),
            *("phase_response", "PhaseResponse", "basins", "Basins", "edge_state", "EdgeState"),
            *("basin_shares", "BasinShares"),
            *("Continuation", "bifurcation_curve", "BifurcationCurve", "bifurcation_diagram", "BifurcationDiagram"),
        ),
    ),
    "derivatives": Task(
        "Derivatives of exponents, design",
        "How exponents change with parameters, and which parameters give the exponents that are wanted.",
        ("lyapunov_gradient", "Gradient", "design", "Design"),
    ),
    "sweeps": Task(
        "Sweeps",
        "Many parameters, many starts, on all cores or a cluster; fields of exponents and of angles over starts.",
        ("sweep", "refine", "ftle_field", "FTLEField", "angle_field", "AngleField"),
    ),
    "errors": Task(
        "Status and errors",
        "How a run ended is data, an `lh.STATUS`; the verbs raise where ``throw=True``. The meanings of all statuses "
        "and notes are on :doc:`their own page <statuses>`.",
        (
            *("STATUS", "LyaphybridError", "RunFailedError", "NoPeriodicOrbitError", "NoConsistentPointError"),
            *("NoDerivativeError", "StoreFailedError"),
        ),
    ),
    "plotting": Task(
        "Figures",
        "``lyaphybrid.plots``: functions (result, ax) -> ax. Most results call the right one by ``.plot()``.",
        tuple(plots.__all__),
        "lyaphybrid.plots",
    ),
    "zoo": Task(
        "The zoo: named problems",
        "``lh.zoo.lorenz63(rho=30)`` is a problem: a system, a start, parameters, lengths of runs and a reference "
        "value. Their references are listed on :doc:`a page of their own <problems>`.",
        tuple(zoo.__all__),
        "lyaphybrid.zoo",
    ),
}


def page(task: Task) -> str:
    """The page of a task: a table with one line for each name, which leads to the name's own page."""
    names = "\n".join(f"   {name}" for name in task.names)
    about = linked(task.about)
    head = f"{task.title}\n{'=' * len(task.title)}\n\n{about}\n\n.. currentmodule:: {task.module}\n"
    return f"{head}\n.. autosummary::\n   :toctree: api\n   :nosignatures:\n\n{names}\n"


def linked(text: str) -> str:
    """Names of the package in single backticks lead to their pages."""
    for task in TASKS.values():
        if task.module == "lyaphybrid":
            for name in task.names:
                text = text.replace(f"`lh.{name}`", f":obj:`lh.{name} <lyaphybrid.{name}>`")
    return text


def pages(root: Path) -> dict[str, str]:
    """The pages of all tasks."""
    return {f"reference/{name}.rst": page(task) for name, task in TASKS.items()}
