"""The public names: a docstring with its sections, an example that runs, a source where there is one."""

import importlib
import inspect
import re

import jax
import numpy as np
import pytest

import lyaphybrid as lh
from docstring_examples import MODULES, examples, run
from lyaphybrid.results.result import Result

PUBLIC = {name: getattr(lh, name) for name in lh.__all__ if name not in ("zoo", "STATUS")}
HOLDING = (Result, BaseException)  # made by a computation, not by a user


@pytest.mark.slow_cases(
    "analysis.comparisons.two_trajectories",
    "analysis.checking.report.Report",
    "analysis.comparisons.TwoTrajectories",
    "analysis.continuation.continuing.continuation",
    "analysis.curves.bifurcation_curves.BifurcationCurve",
    "analysis.curves.bifurcation_curves.CurveSpecial",
    "analysis.curves.curves.bifurcation_curve",
    "plots.continuations.curves",
    "analysis.diagrams.diagrams.bifurcation_diagram",
    "analysis.indicators.alignment.gali",
    "analysis.indicators.alignment.sali",
    "analysis.indicators.covariant.covariant_vectors",
    "analysis.indicators.covariant.CovariantVectors",
    "analysis.indicators.second_order.ofli2",
    "analysis.multiple_solutions.solutions",
    "analysis.orbits.periodic_orbits.floquet",
    "explorer.exploring.Explorer",
    "explorer.exploring.explore",
    "integrators.diffrax_events.DiffraxEvents",
    "papers.fu.transfer_matrices.transfer_matrix",
    "plots.results.solutions",
    "plots.results.spectra",
    "plots.sweeps.sweep_lines",
    "plots.sweeps.sweep_map",
    "results.solution_sets.Solutions",
    "results.solution_sets.Solution",
    "results.spectrum.Spectrum",
    "sweeps.angles.AngleField",
    "sweeps.angles.angle_field",
    "sweeps.refining.refine",
    "sweeps.sweeping.sweep",
    "systems.contacts.filippov.filippov",
    "systems.daes.semi_linear.DAE",
    "systems.implicit_daes.implicit_dae",
    "zoo.bodies.statistics.collision_statistics",
    "zoo.pictures.animate",
    "zoo.pictures.disks",
    "zoo.problem.Problem.floquet",
    "zoo.problem.Problem.sweep",
    "plots.indicators.angles",
    "plots.diagrams.angle_field",
    "zoo.pictures.follow",
    "analysis.basins.shares.basin_shares",
    "systems.ensembles.noise.frozen_noise",
    "analysis.checking.checks.check",
    "analysis.diagrams.sections.PoincareSection",
    "analysis.diagrams.diagrams.BifurcationDiagram",
    "plots.diagrams.basins",
    "systems.ensembles.white_noise.white_noise",
    "analysis.continuation.branches.OrbitsAlong.resume",
    "analysis.basins.basins.Basins",
    "analysis.orbits.phase_responses.PhaseResponse",
    "plots.orbits.matrix",
    "plots.results.against_density",
    "analysis.orbits.phase_responses.phase_response",
    "plots.diagrams.basin_shares",
    "analysis.continuation.branches.Special",
    "results.spectrum.Spectrum.resume",
    "analysis.basins.edges.EdgeState",
    "analysis.synchronisation.master_stability.master_stability",
    "plots.continuations.continuation",
    "analysis.basins.shares.BasinShares",
    "analysis.continuation.branches.Continuation",
    "plots.results.master_stability",
    "plots.orbits.phase_responses",
    "sweeps.fields.FTLEField.ridges",
    "plots.trajectories.trajectory",
    "plots.trajectories.animation",
    "plots.diagrams.ftle_field",
    "plots.results.spectrum",
    "integrators.implicit.radau.RadauIIA",
    "plots.trajectories.raster",
    "analysis.basins.edges.EdgeState.resume",
    "analysis.diagrams.sections.poincare_section",
    "plots.results.convergence",
    "analysis.trajectories.trajectory",
    "analysis.synchronisation.transverse.transverse_spectrum",
    "plots.results.bounds",
    "analysis.basins.basins.basins",
    "zoo.switched.sparse_networks.sparse_network",
    "analysis.trajectories.Trajectory",
    "analysis.indicators.exponent_bounds.ExponentBounds",
    "analysis.trajectories.TangentMap",
    "plots.indicators.intervals",
    "systems.consistency.consistent_start",
    "results.events.Events",
    "systems.event_queue.EventQueue",
    "systems.contacts.rigid_contacts.impact",
    "plots.orbits.time_domain",
    "analysis.indicators.intervals.SpectralIntervals",
    "plots.trajectories.phase",
    "results.time_domains.TimeDomain",
    "zoo.bodies.statistics.CollisionStatistics",
    "analysis.orbits.return_maps.return_map",
)
@pytest.mark.parametrize("test", [pytest.param(one, id=one.name.removeprefix("lyaphybrid.")) for one in examples()])
def test_the_examples_print_what_they_say(test, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(test)[0] == 0


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_is_documented(name):
    """What a result has; of everything else what goes in, what can go wrong, and an example."""
    described = inspect.getdoc(PUBLIC[name])
    assert described
    first = described.splitlines()[0]
    assert first.endswith(".")
    if inspect.isclass(PUBLIC[name]) and issubclass(PUBLIC[name], HOLDING):
        return
    assert "Args:" in described
    assert "Example:" in described
    assert ">>>" in described
    for parameter in inspect.signature(PUBLIC[name]).parameters:
        assert f"{parameter}" in described


@pytest.mark.parametrize(
    "name",
    [
        "lyapunov_spectrum",
        "trajectory",
        "tangent_map",
        "saltation_matrix",
        "jacobians",
        "two_trajectories",
        "floquet",
        "continuation",
        "bifurcation_curve",
        "design",
        "return_map",
        "filippov",
        "poincare_section",
        "bifurcation_diagram",
        "svd_spectrum",
        "angle_field",
        "implicit_dae",
        "exponent_bounds",
        "solutions",
    ],
)
def test_every_verb_says_what_comes_back_and_what_can_go_wrong(name):
    described = inspect.getdoc(PUBLIC[name])
    assert "Returns:" in described
    assert "Raises:" in described


def unannotated(name: str) -> list[str]:
    """The parameters of a public callable, and what it returns, that say no type."""
    signature = inspect.signature(PUBLIC[name])
    missing = [p.name for p in signature.parameters.values() if p.annotation is inspect.Parameter.empty]
    returns = inspect.isclass(PUBLIC[name]) or signature.return_annotation is not inspect.Signature.empty
    return missing if returns else [*missing, "return"]


@pytest.mark.parametrize("name", sorted(PUBLIC.keys() - {"LyaphybridError", "StoreFailedError"}))
def test_every_public_name_says_its_types(name):
    """The two that are left out take what every exception takes."""
    assert unannotated(name) == []


def test_the_modules_name_their_public_names_and_nothing_else():
    for module in map(importlib.import_module, MODULES):
        for name in getattr(module, "__all__", ()):
            assert hasattr(module, name)


def test_importing_again_changes_nothing():
    before = dict(jax.config.values)
    importlib.reload(lh)
    assert dict(jax.config.values) == before


OLD = {
    "Alignment": lh.GALIResult,
    "Growth": lh.IndicatorResult,
    "NoPeriodicOrbit": lh.NoPeriodicOrbitError,
    "RunFailed": lh.RunFailedError,
    "StoreFailed": lh.StoreFailedError,
}


@pytest.mark.parametrize("name", OLD)
def test_old_names_work_and_say_the_new_ones(name):
    with pytest.warns(DeprecationWarning, match=OLD[name].__name__) as said:
        assert getattr(lh, name) is OLD[name]
    assert len(said) == 1


@pytest.mark.slow
def test_old_keywords_work_and_say_the_new_ones():
    logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
    with pytest.warns(DeprecationWarning, match="target_stderr=") as said:
        old = lh.lyapunov_spectrum(logistic, [0.3], 3.7, t1=200, until=0.05)
    assert len(said) == 1
    assert old.exponents == lh.lyapunov_spectrum(logistic, [0.3], 3.7, t1=200, target_stderr=0.05).exponents
    with pytest.raises(TypeError, match="give one of them"):
        lh.lyapunov_spectrum(logistic, [0.3], 3.7, t1=200, until=0.05, target_stderr=0.05)


LOGISTIC = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
BOX = [[0.1], [0.9]]
SHORT = {"t1": 40, "transient": 20, "samples": 8, "starts": 1}
OLD_CALLS = {
    "over=": (
        lambda: lh.lyapunov_gradient(LOGISTIC, [0.3], {"r": 2.9}, t1=100, free=["r"]),
        lambda: lh.lyapunov_gradient(LOGISTIC, [0.3], {"r": 2.9}, t1=100, over=["r"]),
        lambda found: found.gradient["r"],
    ),
    "algorithm=": (
        lambda: lh.lyapunov_gradient(LOGISTIC, [0.3], {"r": 2.9}, t1=100, method="implicit"),
        lambda: lh.lyapunov_gradient(LOGISTIC, [0.3], {"r": 2.9}, t1=100, algorithm="implicit"),
        lambda found: found.gradient["r"],
    ),
    "over={name": (
        lambda: lh.design(LOGISTIC, [0.3], {"r": 2.8}, -0.5, t1=100, free="r", bounds={"r": (2.5, 2.9)}),
        lambda: lh.design(LOGISTIC, [0.3], {"r": 2.8}, -0.5, t1=100, over={"r": (2.5, 2.9)}),
        lambda found: found.parameters["r"],
    ),
    "over={'r': ": (
        lambda: lh.continuation(LOGISTIC, [0.6], {"r": 2.5}, "r", over=(2.4, 2.6), period=1),
        lambda: lh.continuation(LOGISTIC, [0.6], {"r": 2.5}, over={"r": (2.4, 2.6)}, period=1),
        lambda found: found.values,
    ),
    "system, x0, args, over": (
        lambda: lh.bifurcation_diagram(LOGISTIC, {"r": [2.8]}, BOX, {"r": 0.0}, **SHORT),
        lambda: lh.bifurcation_diagram(LOGISTIC, BOX, {"r": 0.0}, over={"r": [2.8]}, **SHORT),
        lambda found: found.exponents,
    ),
}


@pytest.mark.slow_cases("over={'r': ", "system, x0, args, over")
@pytest.mark.parametrize("said", OLD_CALLS)
def test_old_calls_work_and_say_the_new_ones(said):
    old, new, value = OLD_CALLS[said]
    with pytest.warns(DeprecationWarning, match=re.escape(said)) as warned:
        before = old()
    assert len(warned) == 1
    assert warned[0].filename == __file__
    np.testing.assert_array_equal(value(before), value(new()))


@pytest.mark.slow
def test_the_integrator_is_called_method_everywhere():
    decay = lh.Flow(lambda t, x, args: args["a"] * x)
    coarse = lh.RungeKutta("rk4", dt=0.1)
    with pytest.warns(DeprecationWarning, match="method=") as warned:
        old = lh.lyapunov_gradient(decay, [0.5], {"a": -1.0}, t1=5.0, integrator=coarse)
    assert len(warned) == 1
    new = lh.lyapunov_gradient(decay, [0.5], {"a": -1.0}, t1=5.0, method=coarse)
    assert old.gradient["a"] == new.gradient["a"]


def test_a_name_that_never_was_is_an_error():
    with pytest.raises(AttributeError, match="no attribute 'Spektrum'"):
        _ = lh.Spektrum


def test_errors_of_a_computation_are_one_family():
    family = [lh.RunFailedError, lh.NoPeriodicOrbitError, lh.NoConsistentPointError, lh.NoDerivativeError]
    assert not any(issubclass(one, ValueError) for one in family)
    family = [*family, lh.StoreFailedError]
    assert all(issubclass(one, lh.LyaphybridError) for one in family)
    assert issubclass(lh.StoreFailedError, OSError)
    assert issubclass(lh.RunFailedError, RuntimeError)
