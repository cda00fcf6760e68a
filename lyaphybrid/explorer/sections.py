"""Which section shows the motion of a kind of system: iterates, events, a strobe, or a plane that the flow crosses."""

import abc
import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from .._arguments import positive, require
from ..analysis.diagrams.sections import PoincareSection, poincare_section
from ..analysis.trajectories import Trajectory, trajectory
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import System, iterates

__all__ = ["AbstractSection", "AfterEvents", "Plane", "Strobe", "Surface", "section_for"]


class AbstractSection(abc.ABC):
    """A way to a section of the motion."""

    @property
    @abc.abstractmethod
    def title(self) -> str:
        """What the points are."""

    @abc.abstractmethod
    def points(self, how: dict, system: System, x0: Any, args: Any, shown: Trajectory, length: float, n: int) -> Any:
        """At most n points.

        Args:
            how: what all verbs take: mode, method, t0, max_steps.
            system: the system.
            x0: (dim,) its start.
            args: its parameters.
            shown: the beginning of the motion.
            length: of time until the motion has settled, and as long again for the points, where they are events.
            n: number of points.
        """


@dataclasses.dataclass(frozen=True)
class Strobe(AbstractSection):
    """The states once a period, or each iterate of a map."""

    period: Any
    discrete: bool = False

    @property
    def title(self) -> str:
        """What the points are."""
        return "iterates" if self.discrete and self.period == 1 else "once a period"

    def points(self, how, system, x0, args, shown, length, n) -> PoincareSection:
        """The states at multiples of the period."""
        period: Any = self.period(args) if callable(self.period) else self.period
        positive("period", period)
        transient = min(math.ceil(length / float(period)), n)
        return poincare_section(system, x0, args, period=self.period, n=n, transient=transient, throw=False, **how)


@dataclasses.dataclass(frozen=True)
class Surface(AbstractSection):
    """The states where a function falls through zero."""

    function: Callable
    direction: int = -1

    @property
    def title(self) -> str:
        """What the points are."""
        return "crossings of the section"

    def points(self, how, system, x0, args, shown, length, n) -> PoincareSection:
        """The crossings, without the first tenth of them."""
        own = {"section": self.function, "direction": self.direction, "n": n, "transient": n // 10}
        return poincare_section(system, x0, args, **own, throw=False, **how)


class _Height(eqx.Module):
    """x_i − level: a function whose level may change without a new compilation."""

    level: Array | np.ndarray
    component: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        del t, args
        return x[self.component] - self.level


@dataclasses.dataclass(frozen=True)
class Plane(AbstractSection):
    """The states where a component passes zero, or its mean where the motion does not reach zero."""

    component: int
    direction: int
    name: str

    @property
    def title(self) -> str:
        """What the points are."""
        return f"{self.name} {'falls' if self.direction < 0 else 'rises'} through 0, or its mean"

    def points(self, how, system, x0, args, shown, length, n) -> PoincareSection:
        """The crossings, without the first tenth of them."""
        heights = np.asarray(shown.x)[len(shown.x) // 2 :, self.component]
        heights = heights[np.isfinite(heights)]
        crosses = len(heights) > 0 and np.min(heights) < 0 < np.max(heights)
        level = 0.0 if crosses or not len(heights) else np.mean(heights)
        height = _Height(np.asarray(level, shown.x.dtype), self.component)
        return Surface(height, self.direction).points(how, system, x0, args, shown, length, n)


@dataclasses.dataclass(frozen=True)
class AfterEvents(AbstractSection):
    """The states after events, of one transition or of all."""

    transition: int | None = None

    @property
    def title(self) -> str:
        """What the points are."""
        return "after each event" if self.transition is None else f"after each event of transition {self.transition}"

    def points(self, how, system, x0, args, shown, length, n) -> PoincareSection:
        """The last events of a run twice as long as `length`, those after `length`."""
        run = trajectory(system, x0, args, t1=2 * length, n=2, throw=False, **how)
        events = run.events
        wanted = np.asarray(events.t) > float(np.asarray(run.begun)) + length
        if self.transition is not None:
            wanted &= np.asarray(events.transition) == self.transition
        last = np.flatnonzero(wanted)[-n:]
        chosen = tuple(np.asarray(one)[last] for one in (events.t, events.x_after, events.mode_after))
        t, x, mode = jax.device_put(chosen)  # which compiles nothing, whatever the number of events
        return PoincareSection(t, x, mode, run.status_code, run.mode_names, run.state_labels)


def section_for(system: System, section: Any, period: Any, names: list[str]) -> AbstractSection | None:
    """The section that was asked for, or one that suits this kind of system; None where there is none.

    Args:
        system: the system.
        section: None, a function ``(t, x, args) -> h``, or the index of a transition.
        period: None, a number, or ``args -> number``.
        names: of the components of a state.

    Raises:
        ValueError: on both, and on what is neither.
    """
    require(section is None or period is None, f"Give section or period, not both; got {section=} and {period=}.")
    if period is not None:
        return Strobe(period, iterates(system))
    if callable(section):
        return Surface(section)
    jumps = isinstance(system, EventDriven) or (isinstance(system, Hybrid) and system.fields is not None)
    if section is not None:
        count = len(system.transitions) if isinstance(system, Hybrid) and jumps else 0
        good = isinstance(section, int) and not isinstance(section, bool) and 0 <= section < count
        known = f"the index of one of its {count} transitions" if count else "of this system, which has no transitions"
        require(good, f"section must be a function (t, x, args) -> h, or {known}; got {section!r}.")
        return AfterEvents(section)
    if iterates(system):
        return Strobe(1, True)
    if jumps:
        return AfterEvents()
    if len(names) == 1:
        return None
    return Plane(0, 1 if getattr(system, "canonical", False) else -1, names[0])
