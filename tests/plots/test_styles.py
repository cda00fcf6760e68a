"""Figures in light, on dark pages and as a deuteranope sees them: measured in pixels and distances of colours."""

import io
import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot, rcParams
from matplotlib.colors import to_rgb
from PIL import Image
from test_plots import a_spectrum, a_trajectory

import lyaphybrid as lh
from lyaphybrid import plots
from lyaphybrid.plots.axes import colours
from lyaphybrid.plots.styles import STYLES

# Linear sRGB as a deuteranope sees it, and from linear sRGB to CIE XYZ (D65):
# G. M. Machado, M. M. Oliveira & L. A. F. Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291–1298, Table 1,
# severity 1.0, doi:10.1109/TVCG.2009.113; IEC 61966-2-1:1999.
DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = TO_XYZ @ np.ones(3)
APART = 15.0  # of CIELAB: colours that lie so far apart are told apart at a glance
VISIBLE = 25.0  # from the background
SEEN = {"normal": np.eye(3), "deuteranopia": DEUTERANOPIA}


@pytest.fixture(autouse=True)
def _settings_kept():
    before = dict(rcParams)
    yield
    assert dict(rcParams) == before


def lab(colour, eye="normal") -> np.ndarray:
    """CIELAB of sRGB colours (…, 3) in [0, 1], as an eye sees them."""
    colour = np.asarray(colour, float)
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ SEEN[eye].T, 0.0, 1.0)
    ratio = linear @ TO_XYZ.T / WHITE
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def distance(one, other, eye="normal"):
    return np.linalg.norm(lab(one, eye) - lab(other, eye), axis=-1)


def pixels(figure) -> np.ndarray:
    file = io.BytesIO()
    figure.savefig(file, dpi=80)
    with Image.open(file) as image:
        return np.asarray(image.convert("RGB")).reshape(-1, 3) / 255


def test_the_eye_is_one():
    """White and black stay; red and green come much closer, blue and yellow do not."""
    np.testing.assert_allclose(lab([1.0, 1.0, 1.0], "deuteranopia"), [100, 0, 0], atol=0.01)
    np.testing.assert_allclose(lab([0.0, 0.0, 0.0], "deuteranopia"), 0, atol=1e-9)
    np.testing.assert_allclose(lab([1.0, 0.0, 0.0]), [53.24, 80.09, 67.20], atol=0.1)  # tabulated
    red, green = (0.7, 0.3, 0.1), (0.35, 0.5, 0.1)
    assert distance(red, green, "deuteranopia") < 0.25 * distance(red, green)
    assert distance((0, 0, 1), (1, 1, 0), "deuteranopia") > 100


@pytest.mark.parametrize("eye", SEEN)
@pytest.mark.parametrize("name", [None, "dark"])
def test_colours_are_told_apart(name, eye):
    with plots.style(name or "print"):
        ax = pyplot.figure().subplots()
    own = [to_rgb(colour) for colour in colours(7, ax)]
    assert min(distance(one, other, eye) for one, other in itertools.combinations(own, 2)) > APART
    assert min(distance(one, to_rgb(ax.get_facecolor()), eye) for one in own) > VISIBLE


def test_the_colours_that_matplotlib_takes_are_not():
    """What the measure is for: two of the usual seven nearly coincide for a deuteranope."""
    usual = [to_rgb(f"C{number}") for number in range(7)]
    pairs = list(itertools.combinations(usual, 2))
    assert min(distance(*pair) for pair in pairs) > APART
    assert min(distance(*pair, "deuteranopia") for pair in pairs) < APART / 2


def figures():
    spectrum = a_spectrum([0.9, 0.1, 0.0, -0.3, -1.0, -2.0, -14.5], [0.1] * 7)
    yield plots.spectrum(spectrum)
    yield plots.convergence(spectrum, linewidth=3)
    yield plots.trajectory(a_trajectory(), linewidth=3)
    yield plots.phase(a_trajectory(), linewidth=3)
    yield plots.time_domain(a_domain())


def a_domain():
    ball = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
    )
    return lh.trajectory(ball, [0.5, 0.0], t1=4.0, n=8).domain


@pytest.mark.slow
@pytest.mark.parametrize("name", STYLES)
def test_what_is_drawn_is_seen(name):
    """Every curve in the picture itself: its colour is there, and apart from the background for both eyes."""
    with plots.style(name):
        for ax in figures():
            picture, behind = pixels(ax.figure), to_rgb(ax.get_facecolor())
            drawn = {to_rgb(line.get_color()) for line in ax.lines if line.get_visible() and len(line.get_xdata())}
            for colour in drawn:
                assert np.min(np.abs(picture - colour).max(axis=1)) < 0.06, (ax.get_ylabel(), colour)
                assert all(distance(colour, behind, eye) > VISIBLE for eye in SEEN), (ax.get_ylabel(), colour)
            for text in [ax.xaxis.label, ax.yaxis.label, *ax.get_xticklabels(), *ax.texts]:
                if text.get_text():
                    assert distance(to_rgb(text.get_color()), behind) > 50


def test_modes_stay_behind_what_is_drawn():
    for name in STYLES:
        with plots.style(name):
            ax = plots.trajectory(a_trajectory())
        shades = [to_rgb(one.get_facecolor()[0]) for one in ax.collections[:2]]
        assert shades[0] != shades[1]
        for line in ax.lines[:2]:
            assert all(distance(to_rgb(line.get_color()), shade, eye) > VISIBLE for shade in shades for eye in SEEN)


def test_an_exponent_keeps_its_colour():
    spectrum = a_spectrum([0.9, 0.1, -1.0])
    every = {line.get_color() for line in spectrum.plot.convergence().lines[1:]}
    (second,) = spectrum.plot.convergence(exponents=[2]).lines[1:]
    assert second.get_color() == plots.COLOURS[1] in every
    found = a_spectrum([0.9, np.nan, -1.0])  # what is missing takes no colour from the others
    assert [line.get_color() for line in plots.convergence(found).lines[1:]] == [plots.COLOURS[0], plots.COLOURS[2]]
    with pytest.raises(ValueError, match=r"from 1 to 3; got \[0\]"):
        spectrum.plot.convergence(exponents=[0])


@pytest.mark.slow
def test_keywords_go_to_what_is_drawn():
    """By their long and their short names."""
    spectrum, trajectory = a_spectrum([0.9, -1.0]), a_trajectory()
    assert {line.get_linewidth() for line in spectrum.plot.convergence(lw=3).lines[1:]} == {3}
    points = spectrum.plot(marker="s", ms=9).containers[0].lines[0]
    assert (points.get_marker(), points.get_markersize()) == ("s", 9)
    assert spectrum.plot(kind="convergence", alpha=0.5).lines[1].get_alpha() == 0.5
    assert trajectory.plot(linestyle="--").lines[0].get_linestyle() == "--"
    assert trajectory.plot.phase(c="red").lines[0].get_color() == "red"
    logistic = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
    options = {"over": {"r": [2.8, 3.2]}, "t1": 40, "transient": 20, "samples": 8}
    diagram = lh.bifurcation_diagram(logistic, [[0.1], [0.9]], {"r": 0.0}, **options)
    assert diagram.plot.bifurcations(markersize=7).lines[0].get_markersize() == 7
    assert diagram.plot(alpha=0.25)[0].lines[0].get_alpha() == 0.25
    assert diagram.plot.largest_exponent(ms=5).containers[0].lines[0].get_markersize() == 5


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: a_trajectory().plot(components=[5]), "components must be the index of a component, 0 to 1; got 5"),
        (lambda: a_trajectory().plot.phase(j=7), "j must be the index of a component, 0 to 1; got 7"),
        (lambda: a_trajectory().plot(pyplot.figure()), r"ax must be axes of matplotlib.*pyplot\.subplots"),
        (lambda: a_trajectory().animate(frames=1), "frames must be an integer of at least 2; got 1"),
        (lambda: plots.style("ggplot"), "styles are print, notebook, dark; got 'ggplot'"),
    ],
)
def test_what_cannot_be_drawn_is_refused(call, said):
    with pytest.raises(ValueError, match=said):
        call()


def test_a_film_ends_where_the_motion_does():
    figure, ax = pyplot.subplots()
    trajectory = a_trajectory()
    film = trajectory.animate(ax=ax, i=1, j=0, frames=5)
    path, point = film._func(0)
    assert point.get_xydata().tolist() == [[1.0, 0.0]]
    assert ax.get_title(loc="left") == "t = 0.5"
    path, point = film._func(4)
    assert point.get_xydata().tolist() == [[-1.0, 3.0]]
    assert point.get_color() == colours(2)[1]  # of the mode that it is in
    assert ax.get_title(loc="left") == "t = 3"
    assert np.all(np.isin(path.get_ydata()[np.isfinite(path.get_ydata())], [30, 31, 3]))  # the tail: a quarter
    assert film.to_jshtml().count("data:image/png") == 5
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$x_{1}$", "$x_{0}$")


def test_names_and_units_are_on_the_axes():
    swing = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0]]), names=("angle", "rate"), units=("rad", "rad/s"))
    found = lh.trajectory(swing, [1.0, 0.0], t1=1.0, n=8)
    ax = found.plot.phase()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("angle (rad)", "rate (rad/s)")
    assert found.plot(components=[1]).get_ylabel() == "rate (rad/s)"
    ticks = [text.get_text() for text in lh.tangent_map(swing, [1.0, 0.0], t1=1.0).plot().get_xticklabels()]
    assert ticks == ["angle", "rate"]
