"""Follow a curve in the plane of two parameters by predictor and corrector."""

import numpy as np

from ...errors import RunFailedError
from ...statuses import STATUS
from ...systems.hybrid import Hybrid
from ..continuation.bifurcations import cycle_of_events
from ..continuation.following import Arc, BranchProgress, nodes_are_clear, shape_of, stepped, walked
from ..continuation.locating import LostError
from ..continuation.shrinking import HOPF, before_equilibrium
from ..continuation.touching import FoundTouch, found_touches
from ..orbits.motion.motions import SAMPLES_PER_PIECE, Node
from ..orbits.shooting import OrbitIterate, times_apart
from .equations import CurveEquations, CurvePoint
from .shrinking_curves import CurveBound, before_the_end
from .special_points import special_points
from .touch_conditions import TouchCondition, placed_around

__all__ = ["CurveBound", "follow_curve"]

PLAIN_ENDS = (
    "range",
    "closed",
    "max_points",
    "no convergence",
    STATUS.interrupted.name,
)  # the others are special points
ON_BOUND = 1e-12  # of the span
NOT_ITSELF = 1e-3  # of the period: a touch farther than this from that of the curve is another one
NEW_NODES = 0.01  # largest change of the scaled unknowns by new nodes
ENDS_OF_PIECE = 0.15  # of its length: a touch nearer to its ends than this gets other nodes


def follow_curve(
    equations: CurveEquations,
    kind: str,
    arc: Arc,
    bounds: list[CurveBound],
    step: float,
    most: int,
    progress: BranchProgress,
) -> Arc:
    """The curve from where an arc ends, until it leaves a range, closes or ends; or until Ctrl-C."""
    points, found = list(arc.points), list(arc.found)
    end, length = walked(
        points, found, arc.length, step,
        reason=lambda short: _reached(points[-1], bounds) or _reason_to_end(equations, points, most, short),
        onward=lambda last, length: before_equilibrium(
            equations.along(0, last.pair), last, _advanced(equations, last, length, bounds), length,
            lambda swing: before_the_end(equations, last, swing, bounds),
        ),
        between=lambda last, after, length: _between(equations, kind, last, after),
        clear=lambda after: _with_clear_nodes(equations, after),
        passed=lambda point: progress.passed(point.pair),
    )  # fmt: skip
    if end == "no convergence" and _events_end(equations, points[-1], length, bounds):
        end = "grazing"
    if end not in PLAIN_ENDS:
        found.append((end, points[-1].limit or points[-1]))
    return Arc(points, found, end, length)


def _between(
    equations: CurveEquations, kind: str, before: CurvePoint, after: CurvePoint
) -> list[tuple[str, CurvePoint]] | None:
    """Special points between two points; None if the events change, or Newton's method fails on the way."""
    if not _same_events(equations, before, after):
        return None
    try:
        return special_points(equations, kind, before, after)
    except (LostError, RunFailedError, ValueError):
        return None


def _events_end(equations: CurveEquations, last: CurvePoint, length: float, bounds: list[CurveBound]) -> bool:
    """Whether the sequence of events changes beside the last point: by the last step tried, or at another touch."""
    after = _advanced(equations, last, 2 * length, bounds)
    changes = after is not None and not _same_events(equations, last, after)
    return changes or _touches_elsewhere(equations, last)


def _reason_to_end(equations: CurveEquations, points: list[CurvePoint], most: int, short: bool) -> str | None:
    if len(points) > 3 and _back(equations, points):
        return "closed"
    if len(points) >= most:
        return "max_points"
    return "no convergence" if short else None


def _reached(point: CurvePoint, bounds: list[CurveBound]) -> str | None:
    """What the curve has reached, if it stands at the end of a range and leads out of it."""
    if point.limit is not None:
        return HOPF
    for bound in bounds:
        value, heading = float(point.u[bound.place]), float(point.tangent[bound.place])
        for side, edge, name in ((-1.0, bound.low, bound.ends[0]), (1.0, bound.high, bound.ends[1])):
            if heading * side > 0 and abs(value - edge) <= ON_BOUND * (bound.high - bound.low):
                return name
    return None


def _advanced(
    equations: CurveEquations, last: CurvePoint, length: float, bounds: list[CurveBound]
) -> CurvePoint | None:
    """The next point, or that on the edge of the first range which the step would leave."""
    after = stepped(equations, last, length)
    if after is None:
        return None
    share, place, edge = 1.0, None, 0.0
    for bound in bounds:
        value, before = float(after.u[bound.place]), float(last.u[bound.place])
        nearest = float(np.clip(value, bound.low, bound.high))
        if nearest != value and (nearest - before) / (value - before) < share:
            share, place, edge = (nearest - before) / (value - before), bound.place, nearest
    if place is None:
        return after
    across = np.zeros(len(after.u))
    across[place] = 1.0
    onto = equations.corrected(last.u + share * (after.u - last.u), last.orbit, across, edge)
    if onto is None:
        return None
    along = onto.tangent if onto.tangent @ last.tangent > 0 else -onto.tangent
    return onto._replace(tangent=along)


def _same_events(equations: CurveEquations, before: CurvePoint, after: CurvePoint) -> bool:
    """Whether the sequence of events is the same; at an event on an edge or a tick it may be either."""
    condition = equations.condition
    if isinstance(condition, TouchCondition) and not condition.touch.tangential:
        return True
    return cycle_of_events(before.orbit) == cycle_of_events(after.orbit)


def _touches_elsewhere(equations: CurveEquations, point: CurvePoint) -> bool:
    """Whether the orbit touches a guard, at another time than the curve says."""
    if not isinstance(equations.base.problem.system, Hybrid):
        return False
    branch = equations.along(0, point.pair)._replace(samples=SAMPLES_PER_PIECE)
    orbit = branch.shoot(branch.vector(point.orbit, point.pair[0]), point.orbit)[0]
    found, condition = found_touches(branch, orbit, point.pair[0]), equations.condition
    if isinstance(condition, TouchCondition):
        own = point.orbit.nodes[0].t + float(point.own[0]) * branch.time
        found = [one for one in found if times_apart(one.t, own, orbit.period) > NOT_ITSELF * orbit.period]
    return len(found) > 0


def _back(equations: CurveEquations, points: list[CurvePoint]) -> bool:
    """Whether the last step passed the start of the curve."""
    first, before, last = (_signature(equations, point) for point in (points[0], *points[-2:]))
    return bool(max(np.linalg.norm(first - last), np.linalg.norm(first - before)) < np.linalg.norm(last - before))


def _signature(equations: CurveEquations, point: CurvePoint) -> np.ndarray:
    """Scaled numbers of an orbit and its parameters, which do not depend on its first node."""
    pair = np.divide(point.pair, equations.spans)
    return np.concatenate([shape_of(equations.base, point.orbit), pair, point.own])


def _with_clear_nodes(equations: CurveEquations, point: CurvePoint) -> CurvePoint:
    """The same point, with new nodes if some are too near to events, or the touch leaves its piece."""
    if _are_clear(equations, point):
        return point
    try:
        orbit, own = _placed_anew(equations, point)
    except RunFailedError:
        return point
    z = equations.vector(orbit, point.pair, own)
    unknowns, across = len(own), np.zeros(len(z))
    across[len(z) - unknowns - 2 : len(z) - unknowns] = point.parameters_along(unknowns)
    again = equations.corrected(z, orbit, across, float(across @ z), reach=NEW_NODES)
    return point if again is None or not _same_events(equations, point, again) else again


def _are_clear(equations: CurveEquations, point: CurvePoint) -> bool:
    """Whether no node is near an event, and a touch not near the ends of the piece that holds it."""
    condition = equations.condition
    if isinstance(condition, TouchCondition):
        share = float(point.own[0]) * equations.base.time / point.orbit.pieces[0].length
        if not ENDS_OF_PIECE < share < 1 - ENDS_OF_PIECE:
            return False
    return nodes_are_clear(point.orbit)


def _placed_anew(equations: CurveEquations, point: CurvePoint) -> tuple[OrbitIterate, np.ndarray]:
    """The orbit of a point with other nodes, and the condition's own unknowns there."""
    branch, condition, first = equations.along(0, point.pair), equations.condition, point.orbit.nodes[0]
    if isinstance(condition, TouchCondition):
        at = first.t + float(point.own[0]) * branch.time
        found = FoundTouch(condition.touch, at, not condition.touch.tangential, 0.0)
        orbit, before = placed_around(branch, point.orbit, point.pair[0], found)
        return orbit, np.array([before / branch.time])
    node = Node(first.t, first.x, first.mode)
    return branch.orbit_from(node, point.pair[0], point.orbit.period), point.own
