"""The family of results: each prints, shows itself in notebooks, becomes a dataset and, where it can, a picture."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot

import lyaphybrid as lh
from docstring_examples import made_by_example
from lyaphybrid._text import Table, as_html, as_text, with_error
from lyaphybrid.results.result import Result, RunResult

HENON = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]), names=("position", "memory"))
START = [0.1, 0.2]
SLOW = (
    "Spectrum",
    "TwoTrajectories",
    "CovariantVectors",
    "AngleField",
    "Continuation",
    "BifurcationCurve",
    "CurveSpecial",
    "BifurcationDiagram",
    "Solution",
    "Solutions",
    "CollisionStatistics",
    "Report",
)

# Of each: a variable, its dimensions, and the attribute that holds the same numbers. For a class that is not here all
# variables that are named like an attribute are compared, as for those that are.
HELD = {
    "Spectrum": ("exponents", ("exponent",), lambda r: r.exponents),
    "Trajectory": ("x", ("sample", "state"), lambda r: r.x),
    "TimeDomain": ("starts", ("interval",), lambda r: r.starts),
    "TangentMap": ("matrix", ("state", "start"), lambda r: r.matrix),
    "Jacobians": ("Dg_0", ("state", "by"), lambda r: r.Dg[0]),
    "TwoTrajectories": ("history", ("block",), lambda r: r.history.exponents),
    "GALIResult": ("log_values", ("sample", "order"), lambda r: r.log_values),
    "IndicatorResult": ("mean", ("sample",), lambda r: r.mean),
    "CovariantVectors": ("vectors", ("sample", "state", "exponent"), lambda r: r.vectors),
    "AngleField": ("angles", ("x0", "x1"), lambda r: r.angles),
    "SpectralIntervals": ("sacker_sell", ("exponent", "bound"), lambda r: r.sacker_sell),
    "SVDSpectrum": ("directions", ("sample", "state", "exponent"), lambda r: r.directions),
    "ExponentBounds": ("bound", ("exponent",), lambda r: r.bound),
    "Floquet": ("monodromy", ("state", "start"), lambda r: r.monodromy),
    "Continuation": ("multipliers", ("point", "exponent"), lambda r: r.multipliers),
    "Design": ("tried_exponents", ("point", "exponent"), lambda r: r.history[:, 1:]),
    "Gradient": ("gradient", ("exponent", "parameter"), lambda r: np.reshape(r.gradient["r"], (1, 1))),
    "PoincareSection": ("x", ("sample", "state"), lambda r: r.x),
    "BifurcationDiagram": ("points", ("value", "start", "sample", "state"), lambda r: r.points),
    "Special": ("multipliers", ("exponent",), lambda r: r.multipliers),
    "CollisionStatistics": ("rate", (), lambda r: r.rate.value),
    "Solution": ("exponents", ("exponent",), lambda r: r.exponents),
    "Solutions": ("exponents", ("solution", "exponent"), lambda r: r.exponents),
    "Report": ("topic", ("finding",), lambda r: np.array([one.topic for one in r.findings])),
}


def kinds_of(base):
    """All classes of results: those that can be made."""
    for kind in base.__subclasses__():
        yield from kinds_of(kind)
        if not kind.__abstractmethods__ and kind.__module__.startswith("lyaphybrid."):
            yield kind


KINDS = {kind.__name__: kind for kind in kinds_of(Result)}


def test_all_public_results_are_in_the_family():
    assert set(KINDS) >= {name for name in lh.__all__ if hasattr(getattr(lh, name), "to_xarray")}
    assert set(KINDS) >= set(HELD)


@pytest.fixture(scope="module")
def made():
    """One of each kind, from the example of its docstring."""
    return functools.cache(lambda name: made_by_example(KINDS[name]))


@pytest.mark.slow_cases(*SLOW)
@pytest.mark.parametrize("name", KINDS)
def test_a_result_prints_shows_itself_and_becomes_a_dataset(name, made):
    result = made(name)
    text, page, data = str(result), result._repr_html_(), result.to_xarray()
    assert type(result).__name__ == name
    assert repr(result) == text
    title = text.splitlines()[0]
    assert len(text.splitlines()) > 1 or name in ("Special", "CurveSpecial")  # one line, of the table of its branch
    assert page.startswith("<table>")
    assert title.replace("<", "&lt;").replace("'", "&#x27;") in page
    same = {str(variable): getattr(result, str(variable), None) for variable in data.data_vars}
    same = {variable: held for variable, held in same.items() if isinstance(held, np.ndarray | jax.Array)}
    if name in HELD:
        variable, dimensions, attribute = HELD[name]
        assert data[variable].dims == dimensions
        same[variable] = attribute(result)
    assert same, "a dataset holds something under the name of an attribute"
    for variable, held in same.items():
        np.testing.assert_array_equal(data[variable].values, np.asarray(held))
    assert not any("dim_" in dimension for dimension in data.dims)
    assert data.attrs["result"] == name
    if isinstance(result, RunResult | lh.Solution):
        assert isinstance(result.status, lh.STATUS)
        assert data.attrs["status"] == str(result.status)
        assert f"status {result.status}" in text


@pytest.mark.slow_cases(*(name for name in SLOW if hasattr(KINDS[name], "plot")))
@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if hasattr(kind, "plot")])
def test_a_result_has_a_picture(name, made):
    found = made(name).plot()
    for ax in np.ravel(np.asarray(found, object)):
        assert isinstance(ax, pyplot.Axes)
        assert ax.has_data()
        ax.figure.canvas.draw()
    pyplot.close("all")
    if isinstance(found, pyplot.Axes):
        ax = pyplot.subplots()[1]
        assert made(name).plot(ax) is ax


@pytest.mark.slow
def test_datasets_can_be_written_to_files(made, tmp_path):
    for name in KINDS:
        data = made(name).to_xarray()
        if any(np.iscomplexobj(values) for values in data.data_vars.values()):
            continue  # zarr holds them, but not each version
        data.to_zarr(tmp_path / f"{name}.zarr", zarr_format=2)


@pytest.mark.slow
def test_under_a_transformation_a_result_says_so(made):
    said = []

    def look(x):
        run = lh.lyapunov_spectrum(HENON, x, 1.4, t1=10)
        said.append(str(run))
        with pytest.raises(ValueError, match="not under jit"):
            run.to_xarray()
        return run.exponents

    jax.jit(look)(jnp.array(START))
    assert said == ["Spectrum(under a transformation)"]


def test_decimal_points_stand_below_each_other():
    table = Table(
        "title", [("λ1", "0.92(11)"), ("λ10", "-14.577(67)"), ("λ2", "-inf"), ("λ3", "3"), ("λ4", "1e-10")], ["a < b"]
    )
    lines = as_text(table).splitlines()
    assert lines == [
        "title",
        "  λ1      0.92(11)",
        "  λ10   -14.577(67)",
        "  λ2   -inf",
        "  λ3      3",
        "  λ4      1e-10",
        "  a < b",
    ]
    assert "a &lt; b" in as_html(table)


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.905872, 0.00153, "0.9059(15)"),
        (-14.57254, 3.1, "-14.6(31)"),
        (-1.2039728043259, 1e-17, "-1.203972804326"),  # the error is rounding
        (2.2e-16, 1.8e-16, "2.2(18)e-16"),
        (-7.8e-14, 1.2e-15, "-7.80(12)e-14"),
        (3e-18, 4e-15, "0.0(40)e-15"),
        (0.0, 2e-17, "0"),
    ],
)
def test_errors_stand_behind_values(value, error, shown):
    assert with_error(value, error) == shown


@pytest.mark.slow
def test_lengths_of_runs_are_written_in_full():
    doubling = lh.Map(lambda n, x, r: r * x * (1 - x))
    long = lh.lyapunov_spectrum(doubling, [0.3], 4.0, t1=1_000_000)
    assert "(1000000 iterations;" in str(long)
    disks = lh.zoo.hard_disks(n=2, aspect=1)
    x0 = np.asarray(disks.x0)
    both = np.stack([x0, x0[[0, 1, 2, 3, 5, 4, 7, 6]]])
    runs = disks.spectrum(x0=both, t1=3.5, transient=0.0)
    assert f"(t = 3.5, {np.mean(runs.jumps):.0f} jumps, 2 runs;" in str(runs)


def test_long_tables_are_shortened():
    lines = as_text(Table("title", [(str(i), "x") for i in range(1000)])).splitlines()
    assert len(lines) == 42
    assert lines[21].split() == ["…", "…"]


@pytest.mark.slow
@pytest.mark.parametrize(("replicates", "averaging"), [(None, "uniform"), (None, "birkhoff"), (4, "uniform")])
def test_errors_of_sums_are_those_of_the_exponents_with_their_correlation(replicates, averaging):
    """The sum of Hénon's exponents is ln 0.3 at each step: the errors of both cancel, though each is large."""
    key = None if replicates is None else jax.random.key(1)
    s = lh.lyapunov_spectrum(HENON, START, 1.4, t1=2000, replicates=replicates, key=key, averaging=averaging)
    for weights, known in (((1.0, 0.0), s.stderr[0]), ((0.0, 1.0), s.stderr[1]), ((1.0, 1.0), 0.0)):
        assert s._stderr_of(np.array(weights)) == pytest.approx(float(known), rel=1e-9, abs=1e-12)
    assert s.ks_entropy_stderr() == pytest.approx(float(s.stderr[0]), rel=1e-9)
    # D = 1 − λ₁/λ₂ with λ₁ + λ₂ = ln 0.3: dD/dλ₁ = −ln 0.3/λ₂²
    wanted = -np.log(0.3) / float(s.exponents[1]) ** 2 * float(s.stderr[0])
    assert s.kaplan_yorke_stderr() == pytest.approx(wanted, rel=1e-6)
    assert f"Kaplan–Yorke dimension {float(s.kaplan_yorke_dimension()):.4f}(" in str(s)


def test_the_error_of_the_dimension_is_that_of_independent_runs():
    runs = [
        lh.lyapunov_spectrum(HENON, [0.1, 0.01 * i], 1.4, t1=2000, transient=100).kaplan_yorke_dimension()
        for i in range(24)
    ]
    one = lh.lyapunov_spectrum(HENON, [0.1, 0.0], 1.4, t1=2000, transient=100).kaplan_yorke_stderr()
    assert 0.6 < one / np.std(runs, ddof=1) < 1.7  # of 24 runs it is known to 15 %, of 64 blocks to 9 %


@pytest.mark.slow
def test_notes_are_explained(made):
    idle = lh.Hybrid(lambda t, x, args: -x, lh.Transition(lambda t, x, args: x[0] + 10.0, lambda t, x, args: -x))
    found = lh.lyapunov_spectrum(idle, [1.0], t1=5.0)
    assert "guard_unreached: the system has guards, and the flow reached none of them" in str(found)


@pytest.mark.slow
def test_old_spellings_of_results_work(made):
    orbit = made("Floquet")
    with pytest.warns(DeprecationWarning, match=r"\.jumps") as said:
        assert orbit.events == orbit.jumps
    assert len(said) == 1
    axes = pyplot.subplots(2)[1]
    with pytest.warns(DeprecationWarning, match="ax=") as said:
        made("Continuation").plot(axes=axes)
    assert len(said) == 1
