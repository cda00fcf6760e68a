"""The unit of time in what results print, draw and store; without one all of it is as it was."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from matplotlib import pyplot

import lyaphybrid as lh
from elastic_ball import bounce, falling, height

START = [0.8, 0.3]
BOX = [[-1.0, -1.0], [1.0, 1.0]]


def cycle(t, x, a):
    return a * x * (1 - x @ x) + jnp.stack([-x[1], x[0]])


def of_named(t, x, args):
    return cycle(t, x, args["a"])


def in_wells(t, x, args):
    return jnp.stack([x[1], x[0] - x[0] ** 3 - 0.5 * x[1]])


def circle(**labels) -> lh.Flow:
    """A cycle of period 2π with the exponents 0 and −2 args."""
    return lh.Flow(cycle, **labels)


def ball(**labels) -> lh.Hybrid:
    return lh.Hybrid(falling, lh.Transition(height, bounce), **labels)


def apart(**labels) -> lh.Hybrid:
    """Two fields that point away from y = 0: there are several solutions."""
    up, down = (lambda t, x, args, away=away: jnp.stack([x[0], away + 0 * x[1]]) for away in (1.0, -1.0))
    return lh.filippov(up, down, lambda t, x, args: x[1], **labels)


def edge(**labels):
    wells = lh.Flow(in_wells, **labels)
    found = lh.basins(wells, [[-2.0, -1.0], [2.0, 1.0]], shape=(20, 10), t1=80.0)
    return lh.edge_state(wells, found, t1=60.0, settle=80.0)


# How a result is made with these labels of its system; what it says with the unit ms, and without one; what has this
# unit in its dataset, and what has 1/ms.
RESULTS = {
    "Spectrum": (
        lambda **own: lh.lyapunov_spectrum(circle(**own), START, 1.0, t1=20.0),
        ("Lyapunov spectrum per ms (t = 20 ms, 0 jumps;", "Lyapunov spectrum per unit of time (t = 20, 0 jumps;"),
        ("time",), ("exponents", "stderr", "history"),
    ),
    "TimeDomain": (
        lambda **own: lh.trajectory(ball(**own), [0.5, 0.0], t1=4.0, n=8).domain,
        ("TimeDomain(sup t = 4 ms, sup j = 2:", "TimeDomain(sup t = 4, sup j = 2:"),
        ("starts", "ends"), (),
    ),
    "Floquet": (
        lambda **own: lh.floquet(circle(**own), START, 1.0),
        ("Periodic orbit, T = 6.28318530718 ms, 0 jumps", "Periodic orbit, T = 6.28318530718, 0 jumps"),
        (), ("exponents",),
    ),
    "PhaseResponse": (
        lambda **own: lh.phase_response(circle(**own), START, 1.0, phases=8),
        ("of a cycle of period 6.28318531, in ms", "of a cycle of period 6.28318531, in units of time"),
        ("phase",), (),
    ),
    "TwoTrajectories": (
        lambda **own: lh.two_trajectories(circle(**own), START, 1.0, t1=20.0),
        (" per ms, from two trajectories", " per unit of time, from two trajectories"),
        ("time",), ("exponent", "stderr", "history"),
    ),
    "CovariantVectors": (
        lambda **own: lh.covariant_vectors(circle(**own), START, 1.0, t1=10.0, blocks=10),
        ("their growth per ms", "their growth per unit of time"),
        ("time",), ("exponents",),
    ),
    "SVDSpectrum": (
        lambda **own: lh.svd_spectrum(circle(**own), START, 1.0, t1=10.0, blocks=8),
        ("by the SVD method, per ms", "by the SVD method, per unit of time"),
        ("time",), ("exponents",),
    ),
    "SpectralIntervals": (
        lambda **own: lh.spectral_intervals(circle(**own), START, 1.0, t1=40.0, window=5.0, tau=5.0),
        ("Spectral intervals per ms, windows of 5 ms", "Spectral intervals per unit of time, windows of 5\n"),
        ("time", "start"), ("lyapunov", "running"),
    ),
    "ExponentBounds": (
        lambda **own: lh.exponent_bounds(circle(**own), START, 1.0, t1=10.0),
        ("Exponents per ms over 10 ms", "Exponents per unit of time over 10\n"),
        (), ("exponents",),
    ),
    "IndicatorResult": (
        lambda **own: lh.megno(circle(**own), START, 1.0, t1=20.0, blocks=16),
        ("\n  time (ms) ", "\n  time "),
        ("time",), (),
    ),
    "GALIResult": (
        lambda **own: lh.gali(circle(**own), START, 1.0, t1=20.0, blocks=16),
        ("\n  time (ms) ", "\n  time "),
        ("time",), (),
    ),
    "MasterStability": (
        lambda **own: lh.master_stability(circle(**own), lambda t, x, a: x, START, 1.0, at=[-1.0, 1.0], t1=20.0),
        ("Master stability function per ms", "Master stability function per unit of time"),
        (), ("exponents",),
    ),
    "Transverse": (
        lambda **own: lh.transverse_spectrum(circle(**own), START, 1.0, response=[1], t1=20.0),
        ("Lyapunov spectrum per ms (t = 20 ms,", "Lyapunov spectrum per unit of time (t = 20,"),
        ("time",), ("exponents",),
    ),
    "FTLEField": (
        lambda **own: lh.ftle_field(circle(**own), BOX, 1.0, t1=2.0, shape=(3, 2)),
        ("Finite-time exponents per ms of 6 starts (t1 = 2 ms)", "Finite-time exponents of 6 starts (t1 = 2)"),
        (), ("exponents",),
    ),
    "AngleField": (
        lambda **own: lh.angle_field(circle(**own), BOX, 1.0, shape=(2, 2), transient=5.0),
        ("Angles between covariant vectors, of 4 starts", "Angles between covariant vectors, of 4 starts"),
        ("time",), (),
    ),
    "Gradient": (
        lambda **own: lh.lyapunov_gradient(circle(**own), START, 1.0, t1=100.0),
        ("Derivatives of 2 exponents per ms by ", "Derivatives of 2 exponents by "),
        (), ("value",),
    ),
    "Design": (
        lambda **own: lh.design(
            circle(**own), START, 1.0, [0.0, -3.0], over=["args"], t1=100.0, steps=2
        ),
        ("trusted, exponents per ms\n", "trusted\n"),
        (), ("exponents",),
    ),
    "Continuation": (
        lambda **own: lh.continuation(circle(**own), START, 1.0, over={"args": (0.9, 1.1)}),
        ("Branch of periodic orbits", "Branch of periodic orbits"),
        ("period",), ("exponents",),
    ),
    "Solutions": (
        lambda **own: lh.solutions(apart(**own), [0.0, 0.0], t1=2.0),
        ("solutions from one start", "solutions from one start"),
        (), ("exponents", "lower"),
    ),
    "EdgeState": (
        edge,
        (" per ms, seen ", ", seen "),
        ("t",), (),
    ),
    "BifurcationDiagram": (
        lambda **own: lh.bifurcation_diagram(
            lh.Flow(of_named, **own), START, {"a": 1.0}, over={"a": [0.8, 1.2]}, directions=("up",),
            period=6.0, t1=20, transient=10, samples=4,
        ),
        ("Bifurcation diagram over a", "Bifurcation diagram over a"),
        ("time",), ("exponents",),
    ),
    "Report": (
        lambda **own: lh.check(circle(**own), START, 1.0),
        (" ms, 0 jumps", " units of time, 0 jumps"),
        (), (),
    ),
}  # fmt: skip
PICTURES = {
    "Spectrum": {"exponent λ$_i$ per ms"},
    "TimeDomain": {"time t (ms)"},
    "PhaseResponse": {"phase θ (ms)"},
    "TwoTrajectories": {"time t (ms)", "running exponents per ms"},
    "CovariantVectors": {"time t (ms)"},
    "SVDSpectrum": {"time t (ms)", "running exponents per ms"},
    "SpectralIntervals": {"time t (ms)", "average over [0, t]\nper ms"},
    "ExponentBounds": {"exponent λ$_i$ per ms"},
    "IndicatorResult": {"time t (ms)"},
    "GALIResult": {"time t (ms)"},
    "MasterStability": {"largest exponent per ms"},
    "FTLEField": {"finite-time exponent $\\lambda_1$ per ms, t$_1$ = 2 ms"},
    "Gradient": {"derivative of the exponent per ms"},
    "Design": {"exponent per ms"},
    "Continuation": {"exponents λ per ms"},
    "Solutions": {"exponent λ$_i$ per ms"},
    "BifurcationDiagram": {"largest exponent λ$_1$ per ms"},
}


def labels_in(figure) -> set[str]:
    return {label for ax in figure.axes for label in (ax.get_xlabel(), ax.get_ylabel())}


@pytest.mark.slow_cases(
    "Solutions",
    "EdgeState",
    "MasterStability",
    "Continuation",
    "BifurcationDiagram",
    "AngleField",
    "FTLEField",
    "Gradient",
    "Design",
    "CovariantVectors",
)
@pytest.mark.parametrize("name", RESULTS)
def test_results_say_the_unit_of_time(name):
    make, (timed, plain), times, rates = RESULTS[name]
    found, before = make(time_unit="ms"), make()
    assert timed in f"{found}\n"
    assert plain in f"{before}\n"
    assert not re.search(r"\bms\b", str(before))
    assert ("ms" in timed) == bool(re.search(r"\bms\b", found._repr_html_()))
    data, old = found.to_xarray(), before.to_xarray()
    assert {data[variable].attrs["units"] for variable in times} == ({"ms"} if times else set())
    assert {data[variable].attrs["units"] for variable in rates} == ({"1/ms"} if rates else set())
    assert not any("ms" in variable.attrs.get("units", "") for variable in old.variables.values())
    xarray.testing.assert_equal(*(one.drop_vars("text", errors="ignore") for one in (data, old)))  # but no attributes
    if name in PICTURES:
        figures = [np.ravel(np.asarray(result.plot(), object))[0].figure for result in (found, before)]
        drawn, usual = map(labels_in, figures)
        assert drawn >= PICTURES[name]
        assert not any("ms" in label for label in usual)


@pytest.mark.slow
def test_periods_along_a_branch_have_the_unit_of_time():
    """Cycles of x' = (a − x² − y²) x − y, … with T = 2π shrink to an equilibrium at a = 0."""
    growing = lh.Flow(lambda t, x, a: x * (a - x @ x) + jnp.stack([-x[1], x[0]]), names=("x", "y"), time_unit="ms")
    branch = lh.continuation(growing, START, 0.5, over={"args": (-0.5, 0.6)})
    (hopf,) = branch.of_kind("Hopf")
    assert re.fullmatch(r"Hopf at \S+, T = 6\.2831853\d ms", str(hopf))
    assert hopf.to_xarray().attrs["time_unit"] == "ms"
    assert str(branch.orbits[-1]).startswith("Periodic orbit, T = 6.28318530718 ms, ")
    assert branch.orbits[-1].to_xarray().state.values.tolist() == ["x", "y"]


@pytest.mark.slow_cases("jumps")
@pytest.mark.parametrize("clock", ["jumps", "hybrid"])
def test_exponents_by_other_clocks_stay_as_they_are(clock):
    """But the length of the run is a time with every clock."""
    found, before = (
        lh.lyapunov_spectrum(ball(**own), [0.5, 0.1], t1=40, clock=clock) for own in ({"time_unit": "ms"}, {})
    )
    length = f"(t = {float(before.time):.6g}"
    assert length in str(before)
    assert str(found) == str(before).replace(length, f"{length} ms")
    assert found.unit == before.unit
    drawn, usual = (labels_in(run.plot.convergence().figure) for run in (found, before))
    assert drawn == usual


@pytest.mark.slow
def test_the_course_of_a_spectrum_is_drawn_over_time_with_its_unit():
    found = lh.lyapunov_spectrum(ball(time_unit="ms"), [0.5, 0.1], t1=40.0)
    ax = found.plot.convergence()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time t (ms)", "running exponents per ms")
    run = lh.trajectory(ball(time_unit="ms"), [0.5, 0.0], t1=4.0, n=8)
    assert run.plot.raster().get_xlabel() == "time t (ms)"
    film = run.animate(frames=2)
    film._func(1)
    assert pyplot.gca().get_title(loc="left") == "t = 4 ms"
    film.to_jshtml()


@pytest.mark.slow
def test_a_sweep_knows_the_unit_of_its_exponents():
    def largest(args):
        return lh.lyapunov_spectrum(circle(time_unit="ms"), START, args, t1=20.0)

    found = lh.sweep(largest, {"args": np.linspace(0.5, 1.0, 3)}, args=1.0, progress=False)
    assert found.attrs["unit"] == "ms"
    assert lh.plots.sweep_lines(found).get_ylabel() == "exponents λ$_i$ per ms"


@pytest.mark.parametrize("unit", ["ms", "s", "µs", "2π/ω", "hours of 3600 s"])
def test_files_keep_the_times_as_they_are(unit, tmp_path):
    run = lh.trajectory(circle(time_unit=unit), START, 1.0, t1=2.0, n=4)
    run.to_netcdf(tmp_path / "run.nc")
    with xarray.open_dataset(tmp_path / "run.nc") as data:
        np.testing.assert_array_equal(data.t, run.t)
        assert data.t.attrs["units"] == data.attrs["time_unit"] == unit
