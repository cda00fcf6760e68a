"""Where a motion first comes back to itself: a guess of the period of an orbit. Nothing depends on units."""

from typing import NamedTuple

import numpy as np

from ...._jax.precision import digits
from ....errors import NoPeriodicOrbitError, RunFailedError
from .motions import Motion, MotionPiece, Node, states_of
from .sizes import LEAST_SCALE, extents_of, sizes_of

__all__ = ["CLOSE_RETURN", "close_return", "least_period"]

CLOSE_RETURN = 0.1  # of the motion's size: largest distance of a close return
AS_NEAR_RETURN = 3.0  # of the nearest return: so far away an earlier one may be
NEAR_RETURN = 0.02  # of the motion's size: after a return that is not so near a nearer one is looked for …
MUCH_LATER = 4.0  # … over a time that is longer by this factor
WENT_AWAY = 0.1  # of the motion's size: from a return the motion must have been farther away
MOVES = 1e-10  # extents below this part of the state are rounding
ROUNDING_OF_SPEED = 1e-14  # of the terms of the velocity: less is rounding
DOUBLINGS = 14  # doublings of the time of the motion up to which a return is searched …
LONG = 100.0  # the typical time is no more than this times the first one
PARTS_OF_PERIOD = (2, 3, 5, 7, 11, 13)  # after which an orbit may have closed already
HAS_CLOSED = 1e-8  # of the motion's extents: distance within which it has
MORE_DOUBLINGS = 50  # … with so many more where it begins much shorter, at a zero of a component


class Return(NamedTuple):
    """A close return."""

    start: Node
    time: float
    distance: float  # relative to the motion in between


def close_return(flow: Motion, start: Node) -> tuple[Node, float]:
    """A point and the time after which the motion returns close to it.

    Each piece is twice as long as the one before and starts at its end, so that a motion towards an orbit gets closer.
    A motion away from an orbit comes back only in those components that are large there.
    """
    horizon, natural = _first_times(flow, start)
    longest, roughly, units, begun = 2.0**DOUBLINGS * natural, None, np.zeros(len(start.x)), True
    for _ in range(DOUBLINGS + MORE_DOUBLINGS):
        try:
            stretch = flow.piece(start, float(horizon))
        except RunFailedError:
            if roughly is None:
                raise
            break
        # What decays never comes back to a part of itself: components count by their largest extents until now.
        units = np.maximum(units, _units_along(flow, stretch))
        found = _return_in(flow, stretch, units)
        if found is not None:
            found = _nearest_return(flow, found, horizon, units)
            return found.start, found.time
        roughly = roughly or _return_in(flow, stretch, np.full(len(units), np.max(_units_along(flow, stretch))))
        start, horizon = Node(start.t, stretch.x, stretch.mode), 2 * horizon
        if horizon > longest and begun:  # it may have begun at an exceptional point, as beside an event
            longest, begun = max(longest, 2.0**DOUBLINGS * _later_time(flow, start)), False
        if horizon > longest:
            break
    if roughly is not None:
        return roughly.start, roughly.time
    raise NoPeriodicOrbitError(
        f"The motion from x0 did not come back to itself, looked for over a time of {horizon / 2:.6g}: (a) it is far "
        "from a periodic orbit, give a transient; (b) it moves towards a fixed point; (c) give the period.",
        None,
    )


def _later_time(flow: Motion, start: Node) -> float:
    """A typical time of the motion where it has come to; 0 where it rests."""
    try:
        return _first_times(flow, start)[1]
    except NoPeriodicOrbitError:
        return 0.0


def _nearest_return(flow: Motion, found: Return, horizon: float, units: np.ndarray) -> Return:
    """A return that is much nearer than a rough one, some time later; or this one."""
    if found.distance < NEAR_RETURN:
        return found
    try:
        longer = flow.piece(found.start, MUCH_LATER * float(horizon))
        return _return_in(flow, longer, np.maximum(units, _units_along(flow, longer))) or found
    except RunFailedError:
        return found


def _units_along(flow: Motion, stretch: MotionPiece) -> np.ndarray:
    """The extents (n,) of the components on a piece."""
    points = states_of(stretch)[1]
    return extents_of(
        points, sizes_of(points, flow.mixing(stretch.start, stretch.matrix, stretch.length)), digits(MOVES, points)
    )


def _return_in(flow: Motion, stretch: MotionPiece, units: np.ndarray) -> Return | None:
    """The first close return to the start of a piece, in units (n,); None: none."""
    times, points, modes = states_of(stretch)
    distance = flow.apart(stretch.start.x, points, units)[0]
    size = np.maximum.accumulate(distance)
    if flow.symmetry is not None and flow.symmetry.freedom and size[-1] < digits(LEAST_SCALE, points):
        return Return(stretch.start, stretch.length, 0.0)  # it moves along the group alone
    distance = np.where(modes == flow.mode(stretch.start), distance, np.inf)
    away = distance / np.where(size > 0, size, 1.0)
    inner = np.flatnonzero((distance[1:-1] <= distance[:-2]) & (distance[1:-1] <= distance[2:])) + 1
    close = inner[(away[inner] < CLOSE_RETURN) & (size[inner] > WENT_AWAY)]
    if not len(close):
        return None
    # The best one, but the first of several turns: on an orbit they are equally near.
    first = close[away[close] <= AS_NEAR_RETURN * np.min(away[close])][0]
    return Return(stretch.start, float(times[first]), float(away[first]))


def _first_times(flow: Motion, start: Node) -> tuple[float, float]:
    """A time to begin with and a typical time of the motion, from the state, its velocity and its acceleration.

    Each component that moves gives the time in which it would change by its own size: of those that begin at zero
    there is none.
    """
    x, speed = np.abs(np.asarray(start.x, float)), np.abs(flow.velocity(start))
    underflows = np.max([x, speed]) < np.sqrt(np.finfo(speed.dtype).tiny)
    if underflows or np.all(speed <= digits(ROUNDING_OF_SPEED, speed) * np.abs(flow.slope(start)) @ x):
        raise NoPeriodicOrbitError(
            "The motion is at rest: its velocity is 0 up to rounding, and so it has no period. Start beside this "
            "equilibrium, and give a transient, if there is an orbit beside it; what perturbations of an equilibrium "
            "do is in the eigenvalues of the field's derivative there.",
            None,
        )
    change = np.abs(flow.acceleration(start))
    with np.errstate(divide="ignore", invalid="ignore"):
        # The root of change τ² + speed τ = x; and for what begins at zero, when its velocity is another.
        each = np.where(x > 0, 2 * x / (speed + np.sqrt(speed**2 + 4 * change * x)), speed / change)
    each = np.sort(each[np.isfinite(each) & (each > 0)])
    if not len(each):
        return 1e-3 / float(np.max(speed)), 1e-3 / float(np.max(speed))
    first, typical = float(each[(len(each) - 1) // 2]), float(each[len(each) // 2])
    return first, min(typical, LONG * first)


def least_period(flow: Motion, pieces: list[MotionPiece], period: float, units: np.ndarray) -> float:
    """The least period of an orbit of which a multiple was found, as the nearest one of many returns.

    Args:
        flow: the motion.
        pieces: those of the orbit, in order.
        period: the one that was found.
        units: (n,) extents of the components.
    """
    start, samples = pieces[0].start, [states_of(piece) for piece in pieces]
    begun = np.cumsum([0.0, *(piece.length for piece in pieces[:-1])])
    times = np.concatenate([own + offset for (own, _, _), offset in zip(samples, begun, strict=True)])
    away = flow.apart(start.x, np.concatenate([points for _, points, _ in samples]), units)[0]

    if not np.max(away) > WENT_AWAY:  # it rests
        return period

    def closes(part: float) -> bool:
        beside = np.searchsorted(times, part) + np.arange(-2, 2)
        if np.min(away[np.clip(beside, 0, len(times) - 1)]) > CLOSE_RETURN:  # a look at samples costs nothing
            return False
        end = flow.piece(start, part)
        return end.mode == flow.mode(start) and flow.apart(start.x, np.asarray(end.x)[None], units)[0][0] < HAS_CLOSED

    for number in PARTS_OF_PERIOD:
        while closes(period / number):
            period = period / number
    return period
