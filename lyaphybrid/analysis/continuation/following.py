"""Follow a branch of periodic orbits by predictor and corrector, and detect its special points.

E. L. Allgower & K. Georg, Introduction to Numerical Continuation Methods (SIAM 2003), doi:10.1137/1.9780898719154.
"""

import warnings
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..._arguments import Progress
from ..._keywords import user_level
from ...engine.host.reporting import reporter
from ...errors import RunFailedError
from ...statuses import STATUS
from ..orbits.motion.motions import Node, states_of
from ..orbits.shooting import OrbitIterate
from ..orbits.sides import guards_passed
from .bifurcations import cycle_of_events
from .equations import BranchEquations, BranchPoint, tangent
from .locating import BORDER, LocatedPoint, OrbitChange, change_of, crossings, is_kink
from .shrinking import BOUNDARY_EQUILIBRIUM, HOPF, at_a_point, before_equilibrium, in_front_of_hopf, is_smooth
from .touching import ending_touch

__all__ = [
    "Arc",
    "advanced",
    "follow",
    "followed",
    "nodes_are_clear",
    "point_of_orbit",
    "resumed",
    "shape_of",
    "stepped",
    "walked",
]

LEAST_COSINE = 0.9  # least cosine of the angle between the tangents of two consecutive points
ASTRAY = 0.5  # of the step length: a longer correction is rejected, it may lead to another branch
GROWTH = 1.4  # factor of the step length where Newton's method converges quickly
QUICK_ITERATIONS = 3  # at most so many Newton iterations lengthen the step …
SLOW_ITERATIONS = 5  # … and at least so many shorten it
SHORTEST_STEP = 1e-7  # of the largest step
CRAWLS = 50, 1.0  # so many steps that together are shorter than this many of the largest one end a branch
NEXT = 1e-12  # step length at which the approach to a change of the events ends
LEAST_CLEARANCE = 0.005  # of the period: nodes nearer to an event than this are moved
BEHIND_A_CORNER = 1e-3  # of the largest step: where the branch is looked for behind a corner


GOES_ON = ("range", "max_points", STATUS.interrupted.name)  # ends from which a branch or curve can be followed on


class Arc(NamedTuple):
    """The part of a branch or curve to one side of its start."""

    points: list[Any]
    found: list[Any]  # what is special on the way
    end: str
    length: float  # of the next step

    @classmethod
    def begun(cls, start: Any, step: float) -> "Arc":
        """An arc of which nothing is followed, in steps of at most this length."""
        return cls([start], [], STATUS.interrupted.name, step / 4)


class BranchProgress:
    """Reports how far arcs to both sides of a start have come in the ranges of their parameters."""

    def __init__(self, progress: Progress, start, ranges):
        """`progress` as for `lh.lyapunov_spectrum`; the parameters (d,) at the start, and their ranges (d, 2)."""
        self._report, self._ended, self._most = reporter(progress), 0, 0.0
        self._start, (self._low, self._high) = np.atleast_1d(start), np.reshape(ranges, (-1, 2)).T

    def passed(self, values) -> None:
        """An arc has come to these parameters: the share is the largest of all, for branches may turn back."""
        off = np.atleast_1d(values) - self._start
        room = np.where(off > 0, self._high - self._start, self._start - self._low)
        shares = np.abs(off) / np.where(room > 0, room, np.inf)
        self._most = min(1.0, max(self._most, float(np.max(shares))))
        self._report((self._ended + self._most) / 2)

    def arc_ended(self) -> None:
        """One of the two arcs has ended."""
        self._ended, self._most = self._ended + 1, 0.0
        self._report(min(1.0, self._ended / 2))

    def ended(self) -> None:
        """Nothing is to come."""
        self._report(None)


def followed(arcs: list[Arc], on: Callable[[Arc], Arc], progress: BranchProgress) -> list[Arc]:
    """The arcs to both sides, each followed on; one alone where it closes. After Ctrl-C the others stay as they are."""
    try:
        return _each_followed(arcs, on, progress)
    finally:
        progress.ended()


def _each_followed(arcs: list[Arc], on: Callable[[Arc], Arc], progress: BranchProgress) -> list[Arc]:
    after: list[Arc] = []
    for i, arc in enumerate(arcs):
        after.append(on(arc) if arc.end in GOES_ON else arc)
        progress.arc_ended()
        if after[-1].end == "closed":
            return after[-1:]
        if after[-1].end == STATUS.interrupted.name:
            return [*after, *arcs[i + 1 :]]
    return after


def follow(
    equations: BranchEquations, arc: Arc, over: tuple[float, float], step: float, most: int, progress: BranchProgress
) -> Arc:
    """The branch from where an arc ends, until it leaves the range, closes or ends; or until Ctrl-C."""
    points, found, length = list(arc.points), list(arc.found), arc.length
    behind = None  # the point behind the last corner: without a step from there the branch ends
    while True:
        end, length = walked(
            points, found, length, step,
            reason=lambda short: _reason_to_stop(equations, points, over, most, short),
            onward=lambda last, length: before_equilibrium(
                equations, last, advanced(equations, last, length, over), length,
                lambda swing: in_front_of_hopf(equations, last, swing, over),
            ),
            between=lambda last, after, length: _between(equations, last, after, length, step),
            clear=lambda after: _with_clear_nodes(equations, after),
            passed=lambda point: progress.passed(point.parameter),
        )  # fmt: skip
        if end != "no convergence" or points[-1] is behind:
            return Arc(points, found, end, length)
        shrunk = at_a_point(equations, points)
        if shrunk is not None:
            kind = HOPF if is_smooth(shrunk.orbit) else BOUNDARY_EQUILIBRIUM
            return Arc(points, [*found, LocatedPoint(kind, shrunk, None, 1)], kind, length)
        try:
            nearest = _approached(equations, points[-1], length)
            touch = ending_touch(equations, nearest)
            behind = _behind_a_corner(equations, nearest, step, over) if touch or equations.discrete else None
        except KeyboardInterrupt:
            return Arc(points, found, _interrupted(), length)
        if touch is None and behind is None:
            return Arc(points, found, end, length)
        if touch is not None or not _is_met(found, nearest, step):
            found.append(LocatedPoint("grazing" if touch else BORDER, nearest, None, 1))
        if behind is None:
            return Arc(points, found, "grazing", length)
        points.append(behind)
        length = step / 4


def _is_met(found: list[LocatedPoint], nearest: BranchPoint, step: float) -> bool:
    """Whether the border that a branch has come to is the one that its last step crossed."""
    last = found[-1] if found and found[-1].kind == BORDER else None
    return last is not None and bool(np.linalg.norm(last.point.u - nearest.u) < BEHIND_A_CORNER * step)


def _behind_a_corner(equations: BranchEquations, edge: BranchPoint, step: float, over) -> BranchPoint | None:
    """A point behind a corner of the branch: other events, or another piece of a map; None if none is found.

    The equations are linearised on the other side of the corner. Of both directions along their tangent the branch goes
    on in the one that has the other events: the parameter may go on, or turn back.
    """
    ahead = BEHIND_A_CORNER * step
    try:
        orbit, p = equations.shoot(edge.u + ahead * edge.tangent, edge.orbit)
    except (RunFailedError, ValueError):
        return None
    along = tangent(equations.linearised(orbit, p)[0], edge.tangent)
    for heading in (along, -along):
        guess = edge.u + ahead * heading
        after = equations.corrected(guess, edge.orbit, heading, float(heading @ guess), reach=ahead)
        if after is None or not over[0] <= after.parameter <= over[1]:
            continue
        other_piece = equations.discrete and is_kink(edge.jacobian, after.jacobian)
        if other_piece or cycle_of_events(after.orbit) != cycle_of_events(edge.orbit):
            return after
    return None


def walked(
    points: list,
    found: list,
    length: float,
    step: float,
    *,
    reason: Callable,
    onward: Callable,
    between: Callable,
    clear: Callable,
    passed: Callable,
) -> tuple[str, float]:
    """Append the points of a branch or curve and what is special on the way; why it ends, and the next step length.

    Args:
        points: those that are known, one at least.
        found: what is special between them.
        length: of the first step.
        step: the largest step.
        reason: (whether the step is too short) -> why to end here, or None.
        onward: (last point, length) -> the next point, or None for a shorter step.
        between: (last point, next one, length) -> what is special between them, or None for a shorter step.
        clear: (point) -> the same with nodes that are clear of events.
        passed: told each point, for a report.
    """
    lately: deque[float] = deque(maxlen=CRAWLS[0])
    try:
        while (end := reason(length < SHORTEST_STEP * step or _crawls(lately, step))) is None:
            last = points[-1]
            after = onward(last, length)
            met = None if after is None else between(last, after, length)
            if after is None or met is None:
                length /= 2
                continue
            cleared = clear(after)  # before anything is noted, for Ctrl-C may come on the way
            found += met
            points.append(cleared)
            passed(cleared)
            lately.append(length)
            length = _next_length(length, after.iterations, step)
    except KeyboardInterrupt:
        return _interrupted(), length
    return end, length


def _crawls(lately: deque[float], step: float) -> bool:
    """Whether the last steps were so short that the branch gets nowhere, as where the period grows without bound."""
    return len(lately) == lately.maxlen and sum(lately) < CRAWLS[1] * step


def _interrupted() -> str:
    """Say that Ctrl-C ended it; how such a branch or curve ends."""
    warnings.warn("interrupted: what was computed until then is returned.", stacklevel=user_level())
    return STATUS.interrupted.name


def _reason_to_stop(equations: BranchEquations, points: list[BranchPoint], over, most: int, short: bool) -> str | None:
    """The reason to stop following the branch; None: go on."""
    last = points[-1]
    if last.limit is not None:
        return HOPF
    bound = over[1] if last.tangent[-1] > 0 else over[0]
    if abs(last.parameter - bound) <= 1e-12 * equations.span:
        return "range"
    if len(points) > 3 and _closed(equations, points):
        return "closed"
    if len(points) >= most:
        return "max_points"
    return "no convergence" if short else None


def _closed(equations: BranchEquations, points: list[BranchPoint]) -> bool:
    """Whether the last step passed the start of the branch, in the same direction."""
    first, before, last = (_signature(equations, point) for point in (points[0], *points[-2:]))
    along = points[0].tangent[-1] * points[-1].tangent[-1] > 0
    return bool(
        along and max(np.linalg.norm(first - last), np.linalg.norm(first - before)) < np.linalg.norm(last - before)
    )


def _signature(equations: BranchEquations, point: BranchPoint) -> np.ndarray:
    """Scaled numbers of an orbit that do not depend on its first node."""
    return np.append(shape_of(equations, point.orbit), point.parameter / equations.span)


def shape_of(equations: BranchEquations, orbit: OrbitIterate) -> np.ndarray:
    """Largest and smallest value of each component, and the period, all scaled."""
    states = np.concatenate([states_of(piece)[1] for piece in orbit.pieces])
    ends = np.concatenate([states.max(axis=0), states.min(axis=0)]) / np.tile(equations.sizes, 2)
    return np.append(ends, orbit.period / equations.time)


def stepped(equations: Any, last: Any, length: float) -> Any:
    """The point a step further along the tangent; None where it is not found, or is too far from the tangent."""
    guess = last.u + length * last.tangent
    after = equations.corrected(guess, last.orbit, last.tangent, float(last.tangent @ guess), reach=length)
    if (
        after is None
        or after.tangent @ last.tangent < LEAST_COSINE
        or np.linalg.norm(after.u - guess) > ASTRAY * length
    ):
        return None
    return after


def _next_length(length: float, iterations: int, largest: float) -> float:
    """The length of the next step, from the number of Newton iterations of the last one."""
    length = min(largest, length * GROWTH) if iterations <= QUICK_ITERATIONS else length
    return length / GROWTH if iterations >= SLOW_ITERATIONS else length


def advanced(equations: BranchEquations, last: BranchPoint, length: float, over) -> BranchPoint | None:
    """The next point of the branch, or the point on the border of the range if the step would leave it.

    None, too, where it is no motion of the system: beyond a guard that an event has left by a node, and never fires.
    """
    after = stepped(equations, last, length)
    if after is None or _has_left_an_event(equations, last, after):
        return None
    bound = float(np.clip(after.parameter, *over))
    if bound == after.parameter:
        return after
    share = (bound - last.parameter) / (after.parameter - last.parameter)
    across = np.zeros(len(after.u))
    across[-1] = 1.0
    onto = equations.corrected(last.u + share * (after.u - last.u), last.orbit, across, bound / equations.span)
    return None if onto is None else onto._replace(tangent=tangent(onto.jacobian, last.tangent), parameter=bound)


def _has_left_an_event(equations: BranchEquations, last: BranchPoint, after: BranchPoint) -> bool:
    """Whether an event has left by a node, so that the motion is beyond a guard that never fires."""
    if cycle_of_events(last.orbit) == cycle_of_events(after.orbit):
        return False
    passed, before = (guards_passed(equations.motion(one.parameter), one.orbit.pieces) for one in (after, last))
    return bool(passed - before)


def _between(
    equations: BranchEquations, before: BranchPoint, after: BranchPoint, length: float, step: float
) -> list[LocatedPoint] | None:
    """Special points between two points; None if they cannot be located, and the step must be shorter."""
    if cycle_of_events(before.orbit) == cycle_of_events(after.orbit):
        met = crossings(equations, before, after)
        return met if met is None or after.limit is None else [*met, LocatedPoint(HOPF, after.limit, None, 1)]
    if length < BEHIND_A_CORNER * step:
        touch = ending_touch(equations, after)
        if touch is not None and not touch.tangential:
            return None  # so near to a corner the events, and the tangent, are those of neither side
    edge = _approached(equations, before, length)
    first = [] if edge is before else crossings(equations, before, edge)
    return None if first is None else [*first, LocatedPoint("grazing", edge, None, 1)]


def _approached(equations: BranchEquations, last: BranchPoint, length: float) -> BranchPoint:
    """The last point before the branch ends or the sequence of its events changes."""
    cycle, everywhere = cycle_of_events(last.orbit), (-np.inf, np.inf)
    while length > NEXT:
        length /= 2
        after = advanced(equations, last, length, everywhere)
        if after is not None and cycle_of_events(after.orbit) == cycle:
            last = after
    return last


def resumed(
    equations: BranchEquations, node: Node, p: float, period: float, change: OrbitChange
) -> tuple[OrbitIterate, np.ndarray]:
    """The orbit through a node with new nodes, and the direction `change` in its unknowns (N + 1,)."""
    orbit = equations.orbit_from(node, p, period)
    moved = [
        change.x
        if at.t == node.t
        else equations.carried(node, at.t - node.t, p, (change.parameter, 0.0, change.x, 0.0))
        for at in orbit.nodes
    ]
    rest = [change.period] * equations.autonomous, change.shift, np.zeros(equations.fixed), [change.parameter]
    values = np.concatenate([*moved, *rest])
    return orbit, values / equations.scales(orbit)


def point_of_orbit(equations: BranchEquations, orbit: OrbitIterate, p: float, along: np.ndarray) -> BranchPoint | None:
    """The point of the branch next to an orbit, in that orbit's nodes, its tangent oriented like `along`."""
    u = equations.vector(orbit, p)
    return equations.corrected(u, orbit, along, float(along @ u))


def nodes_are_clear(orbit: OrbitIterate) -> bool:
    """Whether no node is too near to an event."""
    near = LEAST_CLEARANCE * orbit.period
    times = [(piece.events.t, piece.length) for piece in orbit.pieces if piece.events is not None]
    return not any(np.any((t < near) | (length - t < near)) for t, length in times)


def _with_clear_nodes(equations: BranchEquations, point: BranchPoint) -> BranchPoint:
    """The same point, with new nodes if some are too near to events."""
    if nodes_are_clear(point.orbit):
        return point
    change = change_of(equations, point, point.tangent)
    try:
        orbit, along = resumed(equations, point.orbit.nodes[0], point.parameter, point.orbit.period, change)
    except RunFailedError:
        return point
    return point_of_orbit(equations, orbit, point.parameter, along) or point
