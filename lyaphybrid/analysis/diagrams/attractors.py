"""The kind of attractor of a run, from its last stroboscopic points and its largest exponent."""

import numpy as np

from ...statuses import OK, STATUS

__all__ = ["at_rest", "labels", "lifetime", "period", "turns_of"]

LONGEST_PERIOD = 24  # longest period that is recognised
REPEATS = 1e-5  # points this near, relative to the range of each component, are equal
PERIODIC_CONVERGING = 1e-3  # the same for a motion that still converges to its cycle …
NEAR_CYCLE = 0.05  # … whose lifetime ends when it comes this near to the cycle
LEAST_RANGE = 0.01  # least range of a component, relative to its size
LARGEST_DRIFT = 0.01  # largest relative change, from first to second half, of the misfit of a divisor of the period
GROWTH_ERRORS = 5.0  # motions part if λ₁ is larger than so many standard errors …
NEUTRAL_GROWTH = 0.1  # … and the growth over the run exceeds this, ln: more than errors of a neutral direction
CHAOS_GROWTH = 25.0  # chaos: it even exceeds e²⁵, which a power of the time, as of slow motions, does not reach
EXACT_REPEATS = 1e-12  # a cycle from which motions part repeats to this, if the run is on it


def turns_of(n: int, angles) -> np.ndarray:
    """(n,) period of each component: 2π of an angle, infinite of any other."""
    turns = np.full(n, np.inf)
    turns[list(angles)] = 2 * np.pi
    return turns


def apart(xp, a, b, turns):
    """|a − b| of states (…, n); for angles along the shorter arc."""
    difference = a - b
    finite = np.isfinite(turns)
    whole = np.broadcast_to(np.where(finite, turns, 1.0), difference.shape)
    ways = xp.round(difference / whole) * np.broadcast_to(np.where(finite, turns, 0.0), difference.shape)
    return xp.abs(difference - ways)


def _ranges(xp, points, turns):
    """(n,) the range of each component, at least a small part of its size and of the largest range."""
    low, high = xp.min(points, axis=0), xp.max(points, axis=0)
    scale = xp.maximum(high - low, LEAST_RANGE * xp.maximum(xp.abs(low), xp.abs(high)))
    scale = xp.where(np.isfinite(turns), np.where(np.isfinite(turns), turns, 0.0), scale)
    return xp.maximum(scale, LEAST_RANGE**2 * xp.max(scale) + 1e-300)


def period(xp, points, turns, scale, tolerance: float):
    """The least p with x_{j+p} = x_j for all points (…, samples, n); 0 where there is none up to LONGEST_PERIOD.

    Args:
        xp: NumPy or jax.numpy.
        points: (…, samples, n), one point for each period of the forcing.
        turns: (n,) from `turns_of`.
        scale: (n,) range of each component, to which the tolerance is relative.
        tolerance: of the repetition.
    """
    samples = points.shape[-2]
    found = xp.zeros(points.shape[:-2], np.int32)
    for p in reversed(range(1, min(LONGEST_PERIOD, samples // 2) + 1)):
        gap = apart(xp, points[..., p:, :], points[..., :-p, :], turns)
        same = xp.all(gap <= tolerance * xp.broadcast_to(scale, gap.shape), axis=(-2, -1))
        found = xp.where(same, np.int32(p), found)
    return found


def lifetime(xp, points, ends: np.ndarray, turns, samples: int):
    """() number of periods until the motion came near the cycle on which it ends; nan if it ends on none.

    Args:
        xp: NumPy or jax.numpy.
        points: (m, n), stroboscopic points of a run.
        ends: (m,) number of periods before each point; the last `samples` points are one period apart.
        turns: (n,) from `turns_of`.
        samples: number of last points that must repeat.
    """
    m = points.shape[0]
    scale = _ranges(xp, points, turns)
    p = period(xp, points[m - samples :], turns, scale, PERIODIC_CONVERGING)
    # Compare each point with the point of the last cycle that has the same phase.
    beside = m - 1 - xp.mod((ends[-1] - ends).astype(np.int32), xp.maximum(p, 1))
    gap = apart(xp, points, points[beside], turns)
    away = xp.any(gap > NEAR_CYCLE * xp.broadcast_to(scale, gap.shape), axis=1)
    settled = xp.max(xp.where(away, ends.astype(points.dtype), 0.0))
    return xp.where(p > 0, settled, np.nan)


def labels(points, angles, status, exponents, stderr, lengths) -> np.ndarray:
    """The attractor of each lane: "P{p}w{q}", "chaos", "aperiodic/slow", or the name of its status.

    "P": the points repeat, and motions beside it do not part; or it repeats to rounding, for a run may start on a cycle
    that repels. Else "chaos", if they part by more than e²⁵ over the run. "aperiodic/slow" is all that is left.

    Args:
        points: (…, samples, n) stroboscopic points, angles not wrapped.
        angles: components that are angles.
        status: (…) codes.
        exponents: (…) the largest.
        stderr: (…) its standard error.
        lengths: (…) of the runs, in the exponent's unit.
    """
    turns = turns_of(points.shape[-1], angles)
    rows = points.reshape(-1, points.shape[-1])
    rows = rows[np.all(np.isfinite(rows), axis=1)]
    scale = _ranges(np, rows, turns) if len(rows) else np.ones_like(turns)
    p = at_rest(points, turns, scale, period(np, points, turns, scale, REPEATS))
    growth = np.where(exponents > GROWTH_ERRORS * stderr, exponents * lengths, 0.0)
    exact = period(np, points, turns, scale, EXACT_REPEATS) > 0
    p, chaotic = np.where((growth > NEUTRAL_GROWTH) & ~exact, 0, p), growth > CHAOS_GROWTH
    found = np.where(chaotic, "chaos", "aperiodic/slow").astype(object)
    for i in np.argwhere(p > 0):
        found[tuple(i)] = f"P{p[tuple(i)]}w{_winding(points[tuple(i)], int(p[tuple(i)]), angles)}"
    for code in STATUS:
        if code != OK:
            found[status == code] = code.name
    found[status < 0] = "interrupted"
    return found


def at_rest(points, turns, scale, p):
    """The period; 0 if the motion may still converge to a cycle of a shorter period with a multiplier near −1.

    Then x_{j+2q} = x_j holds nearly, long before x_{j+q} = x_j does.
    """
    p, half = p.copy(), points.shape[-2] // 2
    for q in range(1, LONGEST_PERIOD // 2 + 1):
        several = (p > q) & (p % q == 0)
        if not np.any(several):
            continue
        gap = np.max(apart(np, points[several][:, q:], points[several][:, :-q], turns) / scale, axis=-1)
        early, late = np.max(gap[:, :half], axis=1), np.max(gap[:, -half:], axis=1)
        p[several] = np.where(np.abs(early - late) > LARGEST_DRIFT * early, 0, p[several])
    return p


def _winding(points, p: int, angles) -> str:
    """Turns of each angle in p periods; 0 where there are no angles."""
    turned = points[-1, list(angles)] - points[-1 - p, list(angles)]
    return ",".join(f"{abs(round(turn / (2 * np.pi)))}" for turn in turned) or "0"
