"""`explore`: sliders over the parameters and the start of a system, and what it then does."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._arguments import Real, State, attempts, numbers, positive, require, require_values
from .._text import as_text
from ..analysis.spectra import lyapunov_spectrum
from ..analysis.trajectories import Trajectory
from ..integrators.base import Method
from ..plots.axes import component
from ..systems.event_driven import EventDriven
from ..systems.kinds import System, iterates
from ..systems.labels import Labels, labels_of
from ..zoo.problem import Problem
from .figures import figure_of
from .knobs import Knob, knobs_of, replaced
from .sections import section_for
from .views import Setup, View, view_of
from .widgets import panel_of

__all__ = ["Explorer", "explore"]

SHARE_OF_PROBLEM = 0.1  # of the length of a problem's spectrum that is run while exploring
WINDOW_SHARE = 0.05  # of the length of the spectrum, over which the trajectory is drawn
MOST_ATTEMPTS_SHOWN = 4_000_000  # attempts of a step for each part of a view, times n: no slider blocks a notebook
SAMPLES_SHOWN, POINTS_SHOWN = 2000, 1000
EXPONENTS_SHOWN = 8  # of a system of more components


class Explorer:
    """A system whose parameters and start can be moved, and what is then seen; in a notebook with sliders.

    Args:
        setup: what stays.
        knobs: what can be moved.
        args: the parameters at the beginning.
        x0: the start at the beginning.
        components: two that are drawn, or None.

    Attributes:
        knobs: what can be moved, each with `.name`, `.label`, `.value`, `.low`, `.high`.
        values: {name: value} of all knobs, at present.
        args, x0: parameters and start at present, as the verbs take them.
        view: what is seen: `.trajectory`, `.section`, `.spectrum` (None where it could not be computed), `.words`.

    Raises:
        ValueError: on arguments that do not fit, at the beginning; later they are words of the view.

    Example:
        >>> import lyaphybrid as lh
        >>> explorer = lh.explore(lh.zoo.logistic_map(), over={"r": (3.0, 4.2)})
        >>> bool(explorer.view.spectrum.exponents[0] > 0)
        True
        >>> explorer.move({"r": 3.2}).spectrum.exponents.round(6).tolist()  # ln|16/25|/2… of the orbit of period 2
        [-0.916291]
        >>> explorer.move({"r": 4.1}).words[0].partition(":")[0]  # these parts ended as nonfinite
        'trajectory, section, spectrum'
    """

    def __init__(self, setup: Setup, knobs: Sequence[Knob], args: Any, x0: Any, components: Any):
        self._setup, self._args, self._x0 = setup, args, np.asarray(x0)
        self.knobs, self.components = tuple(knobs), components
        self.values = {knob.name: knob.value for knob in self.knobs}
        self.view = self._seen()
        for error in self.view.refused:
            raise error

    @property
    def args(self) -> Any:
        """The parameters at present."""
        return self._at_present()[0]

    @property
    def x0(self) -> Any:
        """The start at present; of an `lh.DAE` before it is moved onto the constraints."""
        return self._at_present()[1]

    def move(self, values: Mapping[str, float]) -> View:
        """What is seen at other values; those that are not named stay. Nothing is compiled again.

        Args:
            values: {name of a knob: number}.

        Raises:
            ValueError: on a name that no knob has, and what is no number.
        """
        for name, value in values.items():
            require(name in self.values, f"There is no {name!r} to move; there is {', '.join(self.values)}.")
            numbers(name, value)
        self.values |= {name: float(value) for name, value in values.items()}
        self.view = self._seen()
        return self.view

    def reset(self) -> View:
        """What is seen at the values of the beginning."""
        return self.move({knob.name: knob.value for knob in self.knobs})

    def figure(self, phase: bool = True) -> Any:
        """The matplotlib figure of what is seen: motion, section, exponents.

        Args:
            phase: the motion as one component against another; False: against time.
        """
        return figure_of(self.view, phase, self.components)

    def widget(self) -> Any:
        """Sliders, figure and exponents as one widget of ipywidgets.

        Raises:
            ImportError: without ipywidgets (extra "notebooks").
        """
        return panel_of(self)

    def _at_present(self) -> tuple[Any, Any]:
        args, flat = replaced(self._args, self._x0.ravel(), self.knobs, self.values)
        return args, flat.reshape(self._x0.shape)

    def _seen(self) -> View:
        args, x0 = self._at_present()
        return view_of(self._setup, x0, args)

    def _ipython_display_(self) -> None:
        from IPython.display import display

        display(self.widget())

    def __repr__(self) -> str:
        rows = ", ".join(f"{name} = {value:.6g}" for name, value in self.values.items())
        return f"Explorer at {rows or 'fixed values'}\n{as_text(self.view.table())}"


def explore(
    system: System | Problem,
    x0: State | None = None,
    args: Any = None,
    *,
    t1: Real | None = None,
    transient: Real | None = None,
    t0: Real = 0.0,
    over: Sequence[str] | Mapping[str, Any] | None = None,
    section: Any = None,
    period: Any = None,
    window: Real | None = None,
    components: tuple[int, int] | None = None,
    mode: str | int | None = None,
    k: int | None = None,
    method: Method | None = None,
    max_steps: int | None = None,
) -> Explorer:
    """Sliders over parameters and start; beside them trajectory, section and exponents, computed anew at each move.

    In a notebook the last line ``lh.explore(…)`` of a cell shows it (extra "notebooks"). The first view compiles; moves
    compile nothing. A motion that fails is told in words: its `lh.STATUS`.

    Args:
        system: a system, or a problem of the zoo, which brings its start, parameters, lengths, mode and method.
        x0: (n,) start; of an `lh.DAE` a guess that is moved onto the constraints at each move.
        args: pytree of parameters. Each number in it gets a slider, and is a float then.
        t1: length of the run for the exponents, in time or iterations; of a problem a tenth of its own.
        transient: length before growth is counted; None: that of the problem, or t1/10.
        t0: time at the start.
        over: names of what gets a slider, "rho", "a.b", "rates[2]" or "x0[1]", or {name: (low, high)} with the range
            (None: chosen). None: all numbers in args and all entries of x0, at most 40. Ranges that are chosen go from
            0 to twice the value; by factors of 100 to both sides (a logarithmic slider) where a positive value is below
            0.01 or above 100; for the start as far as the motion goes.
        section: ``(t, x, args) -> h`` whose fall through zero is the section, or the index of a transition: the states
            after its events. None: iterates of a map; the states after each event of what jumps; of a flow the
            crossings of 0, or of its mean, by the first component.
        period: of a forced system, a number or ``args -> number``: the section is the states once a period.
        window: length of the trajectory; None: t1/20.
        components: two that are drawn; None: the first ones, and of the section the first that are not constant.
        mode: mode at the start, where there are several.
        k: number of exponents; None: all, at most 8.
        method: the integrator.
        max_steps: most attempts of a step for each of the three parts, so that no slider blocks the notebook; None:
            four million, divided by n.

    Returns:
        An `lh.Explorer`: a notebook shows it as sliders, and scripts use it by ``.move({"rho": 24.0})`` and ``.view``.

    Raises:
        ValueError: on arguments that do not fit.
        ImportError: where it is shown without ipywidgets (extra "notebooks").

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.stack([x[1], 0 * x[1] - args["g"]]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        ...     names=("height", "speed"),
        ... )
        >>> explorer = lh.explore(ball, [0.5, 0.0], {"g": 1.0}, t1=100.0)
        >>> [(knob.name, knob.label) for knob in explorer.knobs]
        [('g', 'g'), ('x0[0]', 'start height'), ('x0[1]', 'start speed')]
        >>> explorer.move({"g": 4.0}).trajectory.events.t[:2].round(6).tolist()
        [0.5, 1.5]
    """
    attempts(max_steps)
    require_values("explore", x0, args, t1)
    if isinstance(system, Problem):
        x0, args = system.x0 if x0 is None else x0, system.args if args is None else args
        mode, method = system.mode if mode is None else mode, system.method if method is None else method
        t1 = _tenth(system) if t1 is None else t1
        of_spectrum: dict[str, Any] = {**system.options, "clock": system.clock}
        transient, system = system.transient if transient is None else transient, system.system
    else:
        require(x0 is not None, "explore needs a start x0, unless it is given a problem of the zoo.")
        require(t1 is not None, "explore needs t1, the length for the exponents, unless it is given a problem.")
        of_spectrum = {"clock": "time"}
    positive("t1, a length of time,", t1)
    start: np.ndarray = np.asarray(numbers("x0", x0))
    require(
        start.ndim == 1 or isinstance(system, EventDriven),
        f"x0 must be one start, (n,), as sliders move it; got the shape {start.shape}.",
    )
    if components is not None:
        _check_components(components, start.size)
    if k is not None or ("frame" not in of_spectrum and start.size > EXPONENTS_SHOWN):
        of_spectrum["k"] = EXPONENTS_SHOWN if k is None else k
    transient = _part(system, t1, 0.1) if transient is None else transient
    of_spectrum |= {"t1": t1, "transient": transient}
    max_steps = max(1, MOST_ATTEMPTS_SHOWN // start.size) if max_steps is None else max_steps
    how = {"mode": mode, "method": method, "t0": t0, "max_steps": max_steps}
    labels = labels_of(system, start.shape)
    kind = section_for(system, section, period, [labels.name(i) for i in range(start.size)])
    length = (
        t1 if of_spectrum["clock"] == "time" or iterates(system) else _time_of(system, start, args, of_spectrum, how)
    )
    shown: Any = _part(system, length, WINDOW_SHARE) if window is None else window
    setup = Setup(system, how, of_spectrum, shown, _part(system, length, 0.5), kind, SAMPLES_SHOWN, POINTS_SHOWN)
    return _explorer(setup, args, start, over, labels, components)


def _tenth(problem: Problem) -> Any:
    """The length that is run of a problem."""
    return math.ceil(SHARE_OF_PROBLEM * problem.t1) if problem.clock == "jumps" else SHARE_OF_PROBLEM * problem.t1


def _part(system: System, length: Any, share: float) -> Any:
    """A share of a length, of iterations a whole number."""
    return math.ceil(share * length) if iterates(system) else share * length


def _time_of(system: System, x0: Any, args: Any, of_spectrum: dict, how: dict) -> float:
    """The time that a run takes whose jumps are counted."""
    return float(lyapunov_spectrum(system, x0, args, throw=False, **of_spectrum, **how).time)


def _check_components(components: Any, dimension: int) -> None:
    good = isinstance(components, Sequence) and len(components) == 2
    require(good, f"components must be two indices, such as (0, 1); got {components!r}.")
    for index in components:
        component("components", index, dimension)


def _explorer(setup: Setup, args: Any, x0: np.ndarray, over: Any, labels: Labels, components: Any) -> Explorer:
    """The explorer; the ranges of starts follow from its first view."""
    flat = x0.ravel()
    around = np.maximum(1.0, np.abs(flat))
    made = Explorer(setup, knobs_of(args, flat, labels, over, around), args, x0, components)
    made.knobs = knobs_of(args, flat, labels, over, _extent(made.view.trajectory, flat, around))
    return made


def _extent(run: Trajectory | None, x0: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """(n,) how far a motion goes from its start in each component."""
    if run is None:
        return otherwise
    away = np.abs(np.asarray(run.x).reshape(len(run.x), -1) - x0)
    far = np.max(np.where(np.isfinite(away), away, 0.0), axis=0)
    return np.where(far > 0, far, otherwise)
