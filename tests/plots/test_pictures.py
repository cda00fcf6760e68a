"""Pictures of hard disks: disks where the state has them, arrows as long as the perturbation says, films that run."""

import dataclasses
import io

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.animation import FuncAnimation
from matplotlib.collections import EllipseCollection
from matplotlib.quiver import Quiver
from PIL import Image

import lyaphybrid as lh
from lyaphybrid.zoo import pictures


@pytest.fixture(scope="module")
def gas():
    """Four disks after a while, in a box 2.2 × 2.6."""
    problem = lh.zoo.hard_disks(n=4)
    frame = np.random.default_rng(0).normal(size=(16, 1))
    return problem, problem.spectrum(t1=5.0, transient=0.0, frame=frame, blocks=2)  # as `follow` compiles it


def bodies(ax) -> EllipseCollection:
    (found,) = (artist for artist in ax.collections if isinstance(artist, EllipseCollection))
    return found


def arrows(ax) -> list[Quiver]:
    return [artist for artist in ax.collections if isinstance(artist, Quiver)]


def at(positions, **parameters):
    """A problem of disks at these positions, at rest."""
    positions = np.asarray(positions, float)
    problem = lh.zoo.hard_disks(n=len(positions), density=len(positions) / 16, aspect=1.0, **parameters)
    return dataclasses.replace(problem, x0=jnp.concatenate([positions.ravel(), jnp.zeros(positions.size)]))


def test_a_disk_across_the_border_is_drawn_on_both_sides():
    """One inside, one across a side, one across a corner, given outside the box: 1 + 2 + 4."""
    ax = pictures.disks(at([[2.0, 2.0], [0.1, 2.0], [7.9, -4.2]]))
    centres = [tuple(np.round(centre, 9)) for centre in np.asarray(bodies(ax).get_offsets())]
    expected = {(2.0, 2.0), (0.1, 2.0), (4.1, 2.0), (3.9, 3.8), (-0.1, 3.8), (3.9, -0.2), (-0.1, -0.2)}
    assert len(centres) == 7
    assert set(centres) == expected
    assert (ax.get_xlim(), ax.get_ylim(), ax.get_aspect()) == ((0, 4), (0, 4), 1)
    assert arrows(ax) == []


def test_disks_between_walls_stay_where_they_are():
    problem = at([[2.0, 2.0], [0.6, 2.0]], walls="hard", diameter=[0.8, 1.2])
    drawn = bodies(pictures.disks(problem))
    np.testing.assert_allclose(drawn.get_offsets(), [[2.0, 2.0], [0.6, 2.0]])
    np.testing.assert_allclose(drawn.get_widths(), [0.8, 1.2])


def test_disks_are_as_wide_as_they_are():
    """In pixels: grey from the centre to the radius, white beyond."""
    ax = pictures.disks(at([[2.0, 2.0], [2.0, 3.5]]))
    ax.figure.canvas.draw()
    pixels = np.asarray(ax.figure.canvas.buffer_rgba())[:, :, :3].min(axis=2)

    def shade(x, y):
        column, row = ax.transData.transform((x, y))
        return pixels[pixels.shape[0] - 1 - int(row), int(column)]

    assert shade(2.0, 2.0) == shade(2.45, 2.0) == shade(2.0, 1.55) == shade(2.0, 3.95) == 0xF3
    assert shade(2.55, 2.0) == shade(2.0, 1.45) == 255


def test_arrows_and_colours_are_the_perturbation():
    """δq of one disk twice that of another; δp of a third."""
    problem = at([[1.0, 1.0], [2.0, 3.0], [3.0, 1.0]])
    perturbation = np.zeros(12)
    perturbation[0], perturbation[3], perturbation[10] = 0.2, -0.1, 0.7
    ax = pictures.disks(problem, problem.x0, perturbation)
    displacement, momentum = arrows(ax)
    np.testing.assert_allclose(np.stack([displacement.U, displacement.V], axis=1), [[0.9, 0], [0, -0.45], [0, 0]])
    np.testing.assert_allclose(np.stack([momentum.U, momentum.V], axis=1), [[0, 0], [0, 0], [0.9, 0]])
    np.testing.assert_allclose(displacement.get_offsets(), [[1, 1], [2, 3], [3, 1]])
    np.testing.assert_allclose(bodies(ax).get_array(), np.array([0.04, 0.01, 0.49]) / 0.49)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["δq", "δp"]


@pytest.mark.slow
def test_axes_that_are_given_are_used_and_nothing_else(gas):
    problem, run = gas
    figure, axes = pyplot.subplots(1, 2)
    assert pictures.disks(problem, run.x, run.frame[:, 0], axes[0]) is axes[0]
    assert pyplot.get_fignums() == [figure.number]
    assert len(axes[1].collections) == 0


@pytest.mark.slow
def test_following_is_the_run_itself(gas):
    """The end of ten pieces is that of one: the same state, and the perturbation that the tangent map makes."""
    problem, run = gas
    followed = pictures.follow(problem, run.x, run.frame[:, 0], t1=0.5, frames=11)
    np.testing.assert_allclose(followed.t, np.linspace(0, 0.5, 11))
    assert followed.x.shape == followed.perturbation.shape == (11, 16)
    np.testing.assert_array_equal(followed.x[0], run.x)
    whole = lh.tangent_map(problem.system, run.x, problem.args, t1=0.5)
    assert whole.jumps >= 3
    np.testing.assert_allclose(followed.x[-1], whole.x, atol=1e-9)
    moved = np.asarray(whole.matrix @ run.frame[:, 0])
    np.testing.assert_allclose(followed.perturbation[-1], moved / np.linalg.norm(moved), atol=1e-9)


def test_a_film_shows_what_was_followed(gas):
    problem, run = gas
    followed = pictures.follow(problem, run.x, run.frame[:, 0], t1=0.3, frames=4)
    film = pictures.animate(problem, followed)
    assert isinstance(film, FuncAnimation)
    figure = film._fig
    (ax,) = figure.axes
    for frame in (0, 3):
        film._func(frame)
        assert ax.get_title(loc="left") == f"t = {followed.t[frame]:.2f}"
        np.testing.assert_allclose(
            arrows(ax)[0].get_offsets(),
            followed.x[frame, :8].reshape(4, 2) % [float(problem.args["width"]), float(problem.args["height"])],
        )
    data = pictures.gif(film, fps=20, dpi=50)
    assert figure.number not in pyplot.get_fignums()
    with Image.open(io.BytesIO(data)) as image:
        assert image.n_frames == 4
        assert image.info["duration"] == 50
        shown = np.asarray(image.convert("RGB")).reshape(-1, 3)
    # The colour of the disk that carries most
    assert np.any(np.all(shown == [0xD5, 0x5E, 0x00], axis=1))


def test_a_film_for_a_notebook(gas):
    problem, run = gas
    film = pictures.animate(problem, pictures.follow(problem, run.x, run.frame[:, 0], t1=0.1, frames=2))
    page = film.to_jshtml()
    assert page.count("data:image/png") == 2


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: pictures.disks(lh.zoo.hard_spheres()), "hard_disks; got 'hard_spheres'"),
        (lambda p: pictures.disks(p, np.zeros(8)), r"x must have shape \(16,\) for n = 4 disks; got \(8,\)"),
        (lambda p: pictures.disks(p, p.x0, np.zeros((16, 2))), "perturbation must have shape"),
        (lambda p: pictures.follow(p, p.x0, p.x0, t1=-1.0), "t1"),
        (lambda p: pictures.follow(p, p.x0, p.x0, t1=1.0, frames=1), "frames"),
    ],
)
def test_bad_arguments(call, message, gas):
    with pytest.raises(ValueError, match=message):
        call(gas[0])
