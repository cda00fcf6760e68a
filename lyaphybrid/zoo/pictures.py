"""Pictures of hard disks: their positions, the fastest growing perturbation, and how both move.

The fastest growing perturbation of many disks is localised: most of the time half of it is on a few disks.
"""

import itertools
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._arguments import positive, whole
from ..plots.axes import axes_of as _axes
from .problem import Problem

__all__ = ["Film", "animate", "disks", "follow", "gif"]

FILL = ("#F3F3F3", "#F7C99A", "#D55E00")  # colours from no share of the perturbation to the largest
EDGE = "#7A7A7A"
ARROWS = (("δq", "#000000"), ("δp", "#0072B2"))
LEGEND = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": 2, "frameon": False, "borderaxespad": 0.1}
LONGEST_ARROW = 0.9  # length of the longest arrow, in mean diameters


class Film(NamedTuple):
    """Disks and one perturbation of them at equal times."""

    t: np.ndarray  # (frames,) time since the start
    x: np.ndarray  # (frames, 4n) states
    perturbation: np.ndarray  # (frames, 4n), each of length 1


class Box(NamedTuple):
    """The periodic box, or the one between hard walls, of a problem of disks."""

    n: int
    sides: np.ndarray  # (2,)
    diameter: np.ndarray  # (n,)
    walls: bool

    def positions(self, x) -> np.ndarray:
        """Positions (n, 2) of a state (4n,), in the box."""
        q = np.asarray(x)[: 2 * self.n].reshape(self.n, 2)
        return q if self.walls else q % self.sides

    def images(self, q) -> tuple[np.ndarray, np.ndarray]:
        """All images of disks at (n, 2) that overlap the box: indices (m,) of the disks, and centres (m, 2)."""
        shifts = np.array(list(itertools.product((0, -1, 1), repeat=2)))[: 1 if self.walls else None] * self.sides
        centres = shifts[:, None, :] + q
        beyond = np.maximum(-centres, centres - self.sides)
        shift, disk = np.nonzero(np.all(beyond < self.diameter[:, None] / 2, axis=2))
        return disk, centres[shift, disk]


def disks(problem: Problem, x=None, perturbation=None, ax=None):
    """Hard disks in their box, and a perturbation of them as arrows.

    Disks that cross the border of a periodic box are drawn on both sides. The deeper the colour of a disk, the larger
    its share of the perturbation's squared length. Black arrows are its displacements δq, blue ones its momenta δp, in
    each of the two the longest arrow about as long as a disk is wide.

    Args:
        problem: of `zoo.hard_disks`.
        x: state (4n,); None: the problem's start.
        perturbation: (4n,), as a column of a spectrum's `frame`; None: disks only.
        ax: matplotlib axes; None: those of a new figure.

    Returns:
        The axes.

    Raises:
        ValueError: on a problem of another kind, or arrays of another shape.

    Example:
        >>> from lyaphybrid import zoo
        >>> from lyaphybrid.zoo import pictures
        >>> gas = zoo.hard_disks(n=16)
        >>> run = gas.spectrum(t1=5.0, k=1)
        >>> ax = pictures.disks(gas, run.x, run.frame[:, 0])
        >>> import matplotlib.pyplot as plt; plt.close(ax.figure)
    """
    box = _box(problem)
    ax = _axes(ax, figsize=_size(box))
    _Scene(ax, box, perturbation is not None).show(
        _vector("x", problem.x0 if x is None else x, box),
        None if perturbation is None else _vector("perturbation", perturbation, box),
    )
    return ax


def follow(problem: Problem, x, perturbation, *, t1: float, frames: int = 100) -> Film:
    """The motion of disks and of one perturbation, at the start and at equal times up to t1.

    Args:
        problem: of `zoo.hard_disks`.
        x: state (4n,) at the start: `spectrum.x` after a long run.
        perturbation: (4n,) at the start: `spectrum.frame[:, 0]` then is the most unstable one.
        t1: length of time.
        frames: number of times.

    Returns:
        A `Film`.

    Raises:
        ValueError: on a problem of another kind, or arguments that do not fit.

    Example:
        >>> from lyaphybrid import zoo
        >>> from lyaphybrid.zoo import pictures
        >>> gas = zoo.hard_disks(n=4)
        >>> run = gas.spectrum(t1=5.0, k=1)
        >>> pictures.follow(gas, run.x, run.frame[:, 0], t1=0.5, frames=3).x.shape
        (3, 16)
    """
    box = _box(problem)
    positive("t1, a length of time,", t1)
    whole("frames", frames, least=2)
    x, column = _vector("x", x, box), _vector("perturbation", perturbation, box)[:, None]
    states, columns = [x], [column / np.linalg.norm(column)]
    for _ in range(frames - 1):
        # Each run starts at the state and frame in which the one before ended.
        piece = problem.spectrum(x0=x, frame=column, t1=t1 / (frames - 1), transient=0.0, blocks=2)
        x, column = np.asarray(piece.x), np.asarray(piece.frame)
        states.append(x)
        columns.append(column)
    return Film(np.linspace(0.0, t1, frames), np.stack(states), np.stack(columns)[:, :, 0])


def animate(problem: Problem, followed: Film, ax=None, *, interval: float = 60.0):
    """A film of the disks and their perturbation: `disks`, frame by frame.

    Args:
        problem: of `zoo.hard_disks`.
        followed: from `follow`.
        ax: matplotlib axes; None: those of a new figure.
        interval: between two frames, ms.

    Returns:
        A `matplotlib.animation.FuncAnimation`: `.to_jshtml()` for a notebook, or `gif`.

    Example:
        >>> from lyaphybrid import zoo
        >>> from lyaphybrid.zoo import pictures
        >>> gas = zoo.hard_disks(n=4)
        >>> run = gas.spectrum(t1=5.0, k=1)
        >>> film = pictures.animate(gas, pictures.follow(gas, run.x, run.frame[:, 0], t1=0.1, frames=2))
        >>> pictures.gif(film)[:6]
        b'GIF89a'
    """
    from matplotlib.animation import FuncAnimation

    box = _box(problem)
    ax = _axes(ax, figsize=_size(box))
    scene = _Scene(ax, box, True)
    title = ax.set_title("t = 0.00", fontsize="medium", loc="left")
    figure: Any = ax.figure
    # No ticks and a fixed layout: drawing them again would make every frame slow.
    ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
    figure.draw_without_rendering()
    figure.set_layout_engine("none")

    def show(frame: int) -> list:
        title.set_text(f"t = {followed.t[frame]:.2f}")
        return [title, *scene.show(followed.x[frame], followed.perturbation[frame])]

    return FuncAnimation(figure, show, frames=len(followed.t), init_func=lambda: show(0), interval=interval)


def gif(animation, *, fps: int = 15, dpi: float = 72.0) -> bytes:
    """An animation as a GIF of few colours, small enough for a notebook; closes its figure.

    Args:
        animation: from `animate`.
        fps: frames per second.
        dpi: points per inch of the figure.

    Returns:
        The bytes of the file: `IPython.display.Image(data=…, format="gif")` shows them.
    """
    from matplotlib import pyplot
    from matplotlib.animation import PillowWriter
    from PIL import Image

    # One palette for all frames and no dithering: then most pixels equal those of the frame before.
    palette = Image.new("P", (1, 1))
    palette.putpalette(_palette())

    class Writer(PillowWriter):
        """Frames in the colours of the palette."""

        def finish(self):
            self._frames = [
                frame.convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE) for frame in self._frames
            ]
            super().finish()

    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder, "film.gif")
        animation.save(film, writer=Writer(fps=fps), dpi=dpi)
        pyplot.close(animation._fig)
        return film.read_bytes()


def _palette() -> bytes:
    """The palette of a film as RGB bytes: fills, lines, and lines at half strength on some fills."""
    from matplotlib.colors import LinearSegmentedColormap, to_rgb

    fills = [(1.0, 1.0, 1.0), *LinearSegmentedColormap.from_list("share", FILL)(np.linspace(0, 1, 13))[:, :3]]
    lines = [to_rgb(colour) for colour in (EDGE, *(colour for _, colour in ARROWS))]
    mixed = [np.add(fill, line) / 2 for fill in fills[::3] for line in lines]
    return np.uint8(np.round(255 * np.array([*fills, *lines, *mixed]))).tobytes()


class _Scene:
    """The artists of one box of disks; `show` moves them."""

    def __init__(self, ax, box: Box, perturbed: bool):
        from matplotlib.collections import EllipseCollection
        from matplotlib.colors import LinearSegmentedColormap

        self.box = box
        self.bodies = EllipseCollection(
            [],
            [],
            [0.0],
            units="xy",
            offset_transform=ax.transData,
            cmap=LinearSegmentedColormap.from_list("share", FILL),
            edgecolors=EDGE,
            linewidths=0.8,
        )
        self.bodies.set_clim(0.0, 1.0)
        ax.add_collection(self.bodies)
        self.arrows = [_arrows(ax, box.n, *style) for style in ARROWS] if perturbed else []
        if perturbed:
            ax.legend(handles=[_key(*style) for style in ARROWS], **LEGEND)
        ax.set(aspect="equal", xlim=(0, box.sides[0]), ylim=(0, box.sides[1]), xlabel="$q_x$", ylabel="$q_y$")
        for spine in ax.spines.values():
            spine.set(linestyle="-" if box.walls else (0, (4, 3)), linewidth=2.0 if box.walls else 0.8)

    def show(self, x, perturbation=None) -> list[Any]:
        """Move everything; returns what moved."""
        q, n = self.box.positions(x), self.box.n
        disk, centres = self.box.images(q)
        widths = self.box.diameter[disk]
        self.bodies.set(offsets=centres, widths=widths, heights=widths)
        parts = np.zeros((2, n, 2)) if perturbation is None else np.asarray(perturbation).reshape(2, n, 2)
        share = np.sum(parts**2, axis=(0, 2))
        self.bodies.set_array(share[disk] / max(np.max(share), np.finfo(float).tiny))
        for arrows, part in zip(self.arrows, parts, strict=False):
            longest = max(np.max(np.linalg.norm(part, axis=1)), np.finfo(float).tiny)
            arrows.set_offsets(q)
            arrows.set_UVC(*(LONGEST_ARROW * np.mean(self.box.diameter) / longest * part.T))
        return [self.bodies, *self.arrows]


def _arrows(ax, n: int, name: str, colour: str):
    style = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "units": "xy", "minlength": 0.0, "clip_on": False}
    return ax.quiver(*np.zeros((4, n)), color=colour, label=name, width=0.045, zorder=3, **style)


def _key(name: str, colour: str):
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, linewidth=2.0, label=name)


def _box(problem: Problem) -> Box:
    if problem.name != "hard_disks":
        raise ValueError(f"problem must be one of zoo.hard_disks; got {problem.name!r}.")
    n, args = problem.parameters["n"], problem.args
    sides = np.array([float(args["width"]), float(args["height"])])
    diameter = np.broadcast_to(np.asarray(args["diameter"], float), n)
    return Box(n, sides, diameter, problem.parameters["walls"] == "hard")


def _vector(name: str, value, box: Box) -> np.ndarray:
    value = np.asarray(value, float)
    if value.shape != (4 * box.n,):
        raise ValueError(f"{name} must have shape ({4 * box.n},) for n = {box.n} disks; got {value.shape}.")
    return value


def _size(box: Box) -> tuple[float, float]:
    """Size of a figure in inches: the box at equal scale in both directions, and space for the axes."""
    width, height = 4.6 * box.sides / np.max(box.sides)
    return width + 0.6, height + 0.6
