"""Pictures: what is drawn is what was computed."""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.colors import to_hex

import lyaphybrid as lh
from lyaphybrid import plots
from lyaphybrid.analysis.trajectories import Trajectory
from lyaphybrid.plots.axes import varying
from lyaphybrid.results.events import Events
from lyaphybrid.results.spectrum import History, Spectrum


def a_spectrum(exponents, stderr=None, times=None, clock="time") -> Spectrum:
    values = jnp.asarray(exponents, float)
    k = len(exponents)
    stderr = jnp.full(k, 0.1) if stderr is None else jnp.asarray(stderr, float)
    times = jnp.arange(1.0, 11.0) if times is None else jnp.asarray(times, float)
    finite = jnp.where(jnp.isfinite(values), values, -5.0)
    running = finite[None, :] + 1.0 / times[:, None]
    zero = jnp.zeros(())
    return Spectrum(
        exponents=values,
        stderr=stderr,
        finite_exponents=finite,
        time=times[-1],
        jumps=zero,
        upper=values,
        lower=values,
        losses=jnp.isneginf(values).astype(jnp.int32),
        first_loss=jnp.full(k, jnp.nan),
        history=History(times, running, running),
        x=jnp.zeros(k),
        t=times[-1],
        mode=jnp.zeros((), jnp.int32),
        frame=jnp.eye(k),
        replicates=None,
        min_transversality=zero,
        accumulation_time=zero,
        status_code=jnp.zeros((), jnp.int32),
        flags=jnp.zeros(4),
        spread=zero,
        residual=None,
        error_kind="blocks",
        clock=clock,
        mode_names=("flow",),
    )


def a_trajectory() -> Trajectory:
    """Two modes; one event at t = 1, where a sample lies too, and a cascade of two at t = 2.5."""
    points = jnp.array([[0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [3.0, -1.0]])
    events = Events(
        t=jnp.array([1.0, 2.5, 2.5]),
        transition=jnp.zeros(3, jnp.int32),
        which=jnp.zeros(3, jnp.int32),
        mode_before=jnp.array([0, 1, 0], jnp.int32),
        mode_after=jnp.array([1, 0, 1], jnp.int32),
        x_before=jnp.array([[10.0, 0.0], [20.0, 0.0], [30.0, 0.0]]),
        x_after=jnp.array([[11.0, 0.0], [21.0, 0.0], [31.0, 0.0]]),
    )
    mode, jumps = jnp.array([0, 1, 1, 1], jnp.int32), jnp.array([0, 1, 1, 3], jnp.int32)
    times, status = jnp.array([0.5, 1.0, 2.0, 3.0]), jnp.zeros((), jnp.int32)
    return Trajectory(times, points, mode, jumps, events, status, ("free", "held"))


def texts(ax) -> list[str]:
    return [text.get_text() for text in ax.texts if text.get_text()]


def test_the_spectrum_shows_values_errors_and_zero():
    ax = plots.spectrum(a_spectrum([0.9, 0.0, -14.5], [0.1, 0.2, 0.3]))
    points, _, (bars,) = ax.containers[0].lines
    np.testing.assert_allclose(points.get_xydata(), [[1, 0.9], [2, 0.0], [3, -14.5]])
    spans = [np.ptp(segment[:, 1]) for segment in bars.get_segments()]
    np.testing.assert_allclose(spans, [0.2, 0.4, 0.6])
    assert ax.lines[0].get_ydata()[0] == 0.0
    assert "time" in ax.get_ylabel()
    assert texts(ax) == []


@pytest.mark.parametrize("exponents", [[0.5, -np.inf, -np.inf], [-np.inf]])
def test_minus_infinity_is_a_labelled_arrow_at_the_foot(exponents):
    ax = plots.spectrum(a_spectrum(exponents))
    lost = [i + 1 for i, value in enumerate(exponents) if value == -np.inf]
    labels = [text for text in ax.texts if text.get_text() == "−∞"]
    assert [label.xy[0] for label in labels] == lost
    arrows = [text for text in ax.texts if text.arrow_patch is not None]
    assert [arrow.xy[0] for arrow in arrows] == lost
    assert all(arrow.xy[1] < 0.05 < arrow.xyann[1] < 0.2 for arrow in arrows)
    drawn = ax.containers[0].lines[0].get_ydata()
    low, high = ax.get_ylim()
    above = low + 0.15 * (high - low)  # the arrow's own room
    assert np.all(np.asarray(drawn) > above)


def test_what_was_not_computed_is_not_drawn():
    ax = plots.spectrum(a_spectrum([0.5, np.nan], [0.1, np.nan]))
    assert len(ax.containers[0].lines[0].get_xydata()) == 1
    assert texts(ax) == []


def test_errors_that_are_unknown_leave_the_points():
    ax = plots.spectrum(a_spectrum([0.5, 0.1], [np.nan, np.nan]))
    assert len(ax.containers[0].lines[0].get_xydata()) == 2


def test_convergence_draws_the_history_and_the_final_band():
    spectrum = a_spectrum([0.9, 0.0, -np.inf], [0.1, 0.2, np.nan])
    ax = plots.convergence(spectrum)
    curves = [line for line in ax.lines if len(line.get_xdata()) == 10]
    assert len(curves) == 2
    for i, curve in enumerate(curves):
        np.testing.assert_allclose(curve.get_ydata(), spectrum.history.exponents[:, i])
    bands = [(patch.get_y(), patch.get_height()) for patch in ax.patches]
    np.testing.assert_allclose(bands, [(0.8, 0.2), (-0.2, 0.4)])
    assert any("3" in text and "−∞" in text for text in texts(ax))
    assert any("0.90(10)" in text for text in texts(ax))
    assert ax.get_xscale() == "linear"


def test_convergence_in_logarithmic_time():
    ax = plots.convergence(a_spectrum([1.0, 0.0], times=np.geomspace(1, 1000, 32)))
    assert ax.get_xscale() == "log"


def test_many_exponents_share_labels_where_they_are_close():
    values = [5.0, 3.0, 0.0, 0.0, 0.0, 0.0, -3.0, -5.0]
    ax = plots.convergence(a_spectrum(values))
    assert texts(ax) == ["λ$_{1}$", "λ$_{2}$", "λ$_{3–6}$", "λ$_{7}$", "λ$_{8}$"]
    colours = {to_hex(line.get_color()) for line in ax.lines[1:]}
    assert len(colours) == len(values)


def test_the_clock_is_on_the_axes():
    assert plots.convergence(a_spectrum([1.0], clock="jumps")).get_xlabel() == "jumps j"
    assert "jump" in plots.spectrum(a_spectrum([1.0], clock="jumps")).get_ylabel()


def test_a_trajectory_breaks_at_its_events_in_their_order():
    ax = plots.trajectory(a_trajectory())
    times, first = ax.lines[0].get_data()
    # At t = 1 the sample has the jump behind it; at 2.5 two jumps happen one after the other.
    expected = [(0.5, 0), (1, 10), (1, np.nan), (1, 11), (1, 1), (2, 2)]
    expected += [(2.5, 20), (2.5, np.nan), (2.5, 21), (2.5, 30), (2.5, np.nan), (2.5, 31), (3, 3)]
    np.testing.assert_allclose(np.stack([times, first], axis=1), expected)


@pytest.mark.slow
def test_components_with_several_units_have_a_panel_for_each():
    ball = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0, x[0]]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: x.at[1].multiply(-1)),
        names=("height", "speed", "distance"), units=("m", "m/s", "m"),
    )  # fmt: skip
    run = lh.trajectory(ball, [0.5, 0.0, 0.0], t1=4.0, n=50)
    first = run.plot()
    upper, lower = first.figure.axes
    assert first is upper
    assert [line.get_label() for line in upper.get_lines()] == ["height (m)", "distance (m)"]
    assert lower.get_ylabel() == "speed (m/s)"
    assert (upper.get_xlabel(), lower.get_xlabel()) == ("", "time t")
    assert len({line.get_color() for ax in (upper, lower) for line in ax.get_lines()}) == 3
    assert len(run.plot(components=[0, 2]).figure.axes) == 1
    own = pyplot.subplots()[1]
    assert run.plot(own) is own
    assert len(own.get_lines()) == 3


def test_a_component_that_does_not_vary_is_not_chosen():
    values = np.stack([np.full(5, 0.7), np.linspace(1.0, 2.0, 5)], axis=1)
    assert varying(values) == 1
    assert varying(values[:, :1]) == 0
    assert varying(np.array([[1.0, np.nan], [1.0, 2.0], [1.0, 3.0]])) == 1
    assert varying(np.full((3, 2), np.nan)) == 0


def test_a_trajectory_names_its_modes_and_marks_its_events():
    ax = plots.trajectory(a_trajectory(), components=[1])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["free", "held", "$x_{1}$"]
    marks = ax.collections[-1].get_segments()
    np.testing.assert_allclose([mark[0, 0] for mark in marks], [1.0, 2.5, 2.5])
    assert marks[0][:, 1].tolist() == [0.0, 1.0]
    shades = [collection.get_paths() for collection in ax.collections[:2]]
    held = np.concatenate([path.vertices[:, 0] for path in shades[1]])
    assert {held.min(), held.max()} == {1.0, 3.0}


def test_many_events_are_ticks_at_the_foot():
    ball = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], -jnp.ones_like(x[1])]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
    )
    trajectory = lh.trajectory(ball, [0.5, 0.0], t1=200.0, n=300)
    assert len(trajectory.events) == 100
    ax = trajectory.plot()
    assert ax.collections[-1].get_segments()[0][1, 1] < 0.1
    plots.phase(trajectory)


def test_phase_shows_one_path_for_each_mode_and_the_jumps():
    ax = plots.phase(a_trajectory(), i=1, j=0)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["free", "held"]
    rings, dots = ax.lines[-2:]
    np.testing.assert_allclose(rings.get_xydata(), [[0, 10], [0, 20], [0, 30]])
    np.testing.assert_allclose(dots.get_xydata(), [[0, 11], [0, 21], [0, 31]])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$x_{1}$", "$x_{0}$")


@pytest.mark.slow
def test_a_raster_has_a_mark_for_each_event_of_a_transition():
    """Three guards that fall at 1, 2, 3 and a clock: the marks are those of the guards."""
    guards = lh.Transition(lambda t, x, args: jnp.arange(1.0, 4.0) - t, lambda t, x, args, which: x)
    run = lh.trajectory(lh.Hybrid(lambda t, x, args: -x, [guards, lh.Transition(every=0.7)]), [1.0], t1=4.0)
    ax = run.plot.raster()
    np.testing.assert_allclose(ax.lines[0].get_xydata(), [[1.0, 0.0], [2.0, 1.0], [3.0, 2.0]], atol=1e-12)
    assert ax.get_xlim() == (0.0, 4.0)
    assert len(run.plot.raster(transition=1).lines[0].get_xdata()) == 5


def test_iterates_of_a_map_are_points():
    trajectory = lh.trajectory(lh.Map(lambda n, x, r: r * x * (1 - x)), [0.3], 4.0, t1=20, n=20)
    ax = plots.trajectory(trajectory)
    assert ax.lines[0].get_linestyle() == "None"
    assert ax.get_xlabel() == "iteration"


def test_axes_that_are_given_are_used_and_nothing_else():
    figure, axes = pyplot.subplots(2, 2)
    spectrum, trajectory = a_spectrum([1.0, -1.0]), a_trajectory()
    current = pyplot.gca()
    assert plots.spectrum(spectrum, axes[0, 0]) is axes[0, 0]
    assert spectrum.plot(axes[0, 1], kind="convergence") is axes[0, 1]
    assert trajectory.plot(axes[1, 0]) is axes[1, 0]
    assert plots.phase(trajectory, axes[1, 1]) is axes[1, 1]
    assert pyplot.get_fignums() == [figure.number]
    assert pyplot.gca() is current


def test_without_axes_there_is_one_new_figure():
    ax = a_spectrum([1.0, -1.0]).plot()
    assert pyplot.get_fignums() == [ax.figure.number]


def of_bodies(n, per_n, replicates=None) -> Spectrum:
    """A paired spectrum of n bodies in the plane, exponents per_n(i/n)."""
    up = [per_n(i / n) for i in range(1, 2 * n + 1)]
    found = a_spectrum([*up, *(-value for value in reversed(up))])
    return eqx.tree_at(lambda s: s.replicates, found, replicates, is_leaf=lambda leaf: leaf is None)


def test_spectra_of_several_sizes_lie_on_one_curve():
    ax = plots.spectra({n: of_bodies(n, lambda s: 4.0 - 2.0 * s) for n in (2, 8)})
    small, large = (container.lines[0].get_xydata() for container in ax.containers)
    np.testing.assert_allclose(small, [[0.5, 3.0], [1.0, 2.0], [1.5, 1.0], [2.0, 0.0]])
    assert len(large) == 16
    np.testing.assert_allclose(large[:, 1], 4.0 - 2.0 * large[:, 0], atol=1e-12)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["N = 2", "N = 8"]


def test_exponent_and_entropy_against_density():
    """Errors of the entropy: of four runs, or of the blocks of one."""
    runs = jnp.array([[3.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0, -3.0]]) * jnp.array([[0.9], [1.1], [0.9], [1.1]])
    several = of_bodies(2, lambda s: [3.0, 1.0, 0.0, 0.0][round(2 * s) - 1], runs)
    one = of_bodies(2, lambda s: [6.0, 2.0, 0.0, 0.0][round(2 * s) - 1])
    ax = plots.against_density([0.1, 0.5], [several, one], 2)
    first, entropy = ax.containers
    np.testing.assert_allclose(first.lines[0].get_xydata(), [[0.1, 3.0], [0.5, 6.0]])
    np.testing.assert_allclose(entropy.lines[0].get_xydata(), [[0.1, 2.0], [0.5, 4.0]])
    spans = [np.ptp(segment[:, 1]) / 2 for segment in entropy.lines[2][0].get_segments()]
    np.testing.assert_allclose(spans[0], np.std([3.6, 4.4, 3.6, 4.4], ddof=1) / 2 / 2)
    growth = np.asarray(one.history.growth)[:, :2].sum(axis=1)
    np.testing.assert_allclose(spans[1], np.std(growth, ddof=1) / 10**0.5 / 2)
    assert "density" in ax.get_xlabel()


HENON = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
LINEAR = lh.Flow(lambda t, x, a: jnp.stack([x[1], -a * x[0]]))


@pytest.mark.slow_cases(
    "system0-iteration-covariant_vectors",
    "system1-time t-covariant_vectors",
    "system0-iteration-megno",
    "system0-iteration-spectral_intervals",
    "system0-iteration-gali",
)
@pytest.mark.parametrize("verb", ["gali", "sali", "megno", "fli", "covariant_vectors", "spectral_intervals"])
@pytest.mark.parametrize(("system", "label"), [(HENON, "iteration"), (LINEAR, "time t")])
def test_times_have_the_name_of_what_is_counted(verb, system, label):
    length = {"window": 10, "tau": 10} if verb == "spectral_intervals" else {"blocks": 10}
    axes = getattr(lh, verb)(system, [0.1, 0.2], 1.4, t1=40, **length).plot()
    assert np.ravel(axes)[-1].get_xlabel() == label


def test_exponents_of_minus_infinity_are_marked_in_a_diagram():
    """They had no mark, as if nothing had been computed there."""
    forgets = lh.Map(lambda n, x, a: jnp.where(x > a, 0.4 + 0 * x, 1.7 * x))
    found = lh.bifurcation_diagram(
        forgets, [[0.1], [0.9]], 0.5, over={"args": [0.5, 0.6]}, t1=100, transient=50, samples=8, directions=("up",)
    )
    ax = plots.largest_exponent(found)
    (marks,) = [line for line in ax.get_lines() if line.get_marker() == "v"]
    assert marks.get_xdata().tolist() == [0.5, 0.6]
    assert [text.get_text() for text in ax.texts] == ["−∞"]


def test_marks_of_short_times_do_not_run_into_each_other():
    run = lh.trajectory(lh.Flow(lambda t, x, a: -1e4 * x), [1.0], t1=4e-4, n=8)
    ax = run.plot()
    ax.figure.canvas.draw()
    boxes = [label.get_window_extent() for label in ax.get_xticklabels()]
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))
    assert "10" in ax.xaxis.get_offset_text().get_text()


def test_what_cannot_be_drawn_leaves_no_empty_figure():
    motion = lh.trajectory(lh.Flow(lambda t, x, args: -x), [1.0, 2.0], t1=1.0)
    ax = pyplot.subplots()[1]
    for draw in (motion.plot, motion.plot.phase):
        with pytest.raises(TypeError, match="draw into axes of your own"):
            draw(figsize=(3, 3))
        with pytest.raises(TypeError, match="draw into axes of your own"):
            draw(ax=ax, figsize=(3, 3))
    assert pyplot.get_fignums() == [ax.figure.number]
