"""Where an orbit touches a guard, or has an event on the edge of another guard or at the tick of a clock."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...engine import problems
from ...engine.binding import number
from ...systems.hybrid import Hybrid, Transition
from ..orbits.motion.motions import Motion, MotionPiece, Node
from ..orbits.shooting import OrbitIterate
from .equations import BranchEquations, BranchPoint

__all__ = ["FoundTouch", "Touch", "ending_touch", "found_touches", "tick_time"]

GRAZED = 1e-5  # largest value at a touch at which a branch ends, relative to the guard's range over the orbit
TOUCHES = 1e-4  # the same where a touch is looked for
STAYS = 1e-4  # change in a period, relative to the range, of a guard on whose surface the motion stays
SAME_SURFACE = 1e-6  # of 1 − cos of the angle between the gradients of two guards that are the same surface


class Touch(NamedTuple):
    """A guard that is touched, or whose event falls on the edge of another guard, or on the tick of a clock."""

    guard: tuple[int, int]  # transition, entry
    mode: int  # before the event
    edge: tuple[int, int] | None = None  # transition, entry
    tick: tuple[int, int] | None = None  # transition, number of the tick

    @property
    def tangential(self) -> bool:
        """Whether the guard's own rate is zero, too."""
        return self.edge is None and self.tick is None


class FoundTouch(NamedTuple):
    """A touch of an orbit."""

    touch: Touch
    t: float
    fired: bool  # the touched guard fires at this time
    off: float  # relative value: 0 for an exact touch


def ending_touch(equations: BranchEquations, point: BranchPoint) -> Touch | None:
    """The touch at which a branch ends; None if it does not end at one."""
    found = found_touches(equations, point.orbit, point.parameter)
    return found[0].touch if found and found[0].off < GRAZED else None


def found_touches(equations: BranchEquations, orbit: OrbitIterate, p: float) -> list[FoundTouch]:
    """The touches that an orbit is near to, the nearest first."""
    flow = equations.motion(p)
    if not isinstance(flow.problem.system, Hybrid):
        return []
    seen = [
        found
        for j in _guarded(flow)
        for piece in orbit.pieces
        for found in (
            *_tangencies(flow, piece, j),
            *_edges(flow, orbit, piece, j),
            *_events_at_ticks(flow, orbit, piece, j),
            *_values_at_ticks(flow, orbit, piece, j),
        )
    ]
    return sorted((found for found in seen if found.off < TOUCHES), key=lambda found: found.off)


def _guarded(flow: Motion) -> list[int]:
    """The transitions that have a guard."""
    return [j for j, transition in enumerate(flow.problem.system.transitions) if transition.guard is not None]


def _sources(flow: Motion, j: int) -> list[int]:
    names, source = problems.mode_names(flow.problem.system), flow.problem.system.transitions[j].source
    return list(range(len(names))) if source is None else [names.index(name) for name in source]


def _tangencies(flow: Motion, piece: MotionPiece, j: int) -> Iterator[FoundTouch]:
    """Extrema of a guard next to zero, and events at which it hardly moves."""
    ranges, fastest = _scales(flow, piece, j)
    for mode in _sources(flow, j):
        inside = np.flatnonzero(piece.modes == mode)
        fired = np.flatnonzero((piece.events.transition == j) & (piece.events.mode_before == mode))
        if len(inside) > 2:
            values = _along(flow, j, mode, piece.start.t + piece.times[inside], piece.points[inside])[0]
            for entry, range_of in enumerate(ranges):
                for at, value in _extrema(piece.times[inside], values[:, entry], inside):
                    yield FoundTouch(Touch((j, entry), mode), piece.start.t + at, False, abs(value) / range_of)
        if len(fired):
            times = piece.start.t + piece.events.t[fired]
            rates = _along(flow, j, mode, times, piece.events.x_before[fired])[1]
            for t, rate, which in zip(times, rates, piece.events.which[fired], strict=True):
                entry = max(int(which), 0)
                # Beside a touch the rate at the event is the root of the distance.
                off = float(rate[entry] / fastest[entry]) ** 2
                yield FoundTouch(Touch((j, entry), mode), float(t), True, off)


def _scales(flow: Motion, piece: MotionPiece, j: int) -> tuple[np.ndarray, np.ndarray]:
    """The range (m,) of a guard on a piece of motion, and its largest rate (m,), in whatever mode; 1 for 0."""
    parts = []
    for mode in np.unique(piece.modes):
        here = piece.modes == mode
        parts.append(_along(flow, j, int(mode), piece.start.t + piece.times[here], piece.points[here]))
    values, rates = (np.concatenate(part) for part in zip(*parts, strict=True))
    ranges, fastest = np.ptp(values, axis=0), np.max(np.abs(rates), axis=0)
    return np.where(ranges > 0, ranges, 1.0), np.where(fastest > 0, fastest, 1.0)


def _extrema(times: np.ndarray, values: np.ndarray, places: np.ndarray) -> Iterator[tuple[float, float]]:
    """Times and values of extrema, from the parabola through three consecutive samples."""
    a, b, c = values[:-2], values[1:-1], values[2:]
    curvature = a - 2 * b + c
    turning = (places[2:] - places[:-2] == 2) & ((b - a) * (c - b) <= 0) & (curvature != 0)
    for i in np.flatnonzero(turning):
        shift = (a[i] - c[i]) / (2 * curvature[i])
        yield (
            float(times[i + 1] + shift * (times[i + 2] - times[i + 1])),
            float(b[i] - (c[i] - a[i]) ** 2 / (8 * curvature[i])),
        )


def _edges(flow: Motion, orbit: OrbitIterate, piece: MotionPiece, j: int) -> Iterator[FoundTouch]:
    """Events of a guard at which another guard is next to zero, but not all the time, as on its surface."""
    events = np.flatnonzero(piece.events.transition == j)
    ranges = {other: _range_along(flow, other, orbit) for other in _guarded(flow)} if len(events) else {}
    for event in events:
        mode, t, x = int(piece.events.mode_before[event]), piece.events.t[event], piece.events.x_before[event]
        entry, time = max(int(piece.events.which[event]), 0), piece.start.t + float(t)
        normal = _gradients(flow, j, time, x)[1][entry]
        velocity = np.append(1.0, flow.velocity(Node(time, jnp.asarray(x), mode)))
        for other in ranges:
            values, gradients = _gradients(flow, other, time, x)
            for k, (value, gradient) in enumerate(zip(values, gradients, strict=True)):
                lengths, range_of = (
                    float(np.linalg.norm(gradient) * np.linalg.norm(normal)),
                    float(ranges[other][k]) or 1.0,
                )
                same = lengths == 0 or abs(gradient @ normal) > (1 - SAME_SURFACE) * lengths
                stays = abs(gradient @ velocity) * orbit.period < STAYS * range_of
                if not same and not stays:
                    yield FoundTouch(Touch((j, entry), mode, edge=(other, k)), time, True, float(abs(value)) / range_of)


def _events_at_ticks(flow: Motion, orbit: OrbitIterate, piece: MotionPiece, j: int) -> Iterator[FoundTouch]:
    """Events of a guard next to a tick, by how far the guard moves between both."""
    events = np.flatnonzero(piece.events.transition == j)
    ranges = _range_along(flow, j, orbit) if len(events) and _clocks(flow) else ()
    for event in events if len(ranges) else ():
        mode, entry = int(piece.events.mode_before[event]), max(int(piece.events.which[event]), 0)
        t, x = piece.start.t + float(piece.events.t[event]), piece.events.x_before[event]
        rate = _along(flow, j, mode, [t], x[None])[1][0, entry]
        for clock in _clocks(flow):
            tick, at = _nearest_tick(flow, clock, t)
            off = abs(rate * (t - at)) / (float(ranges[entry]) or 1.0)
            yield FoundTouch(Touch((j, entry), mode, tick=(clock, tick)), at, True, float(off))


def _values_at_ticks(flow: Motion, orbit: OrbitIterate, piece: MotionPiece, j: int) -> Iterator[FoundTouch]:
    """Ticks at which a guard that waits is next to zero, but not all the time."""
    for clock in _clocks(flow):
        ticks = np.flatnonzero(
            (piece.events.transition == clock) & np.isin(piece.events.mode_before, _sources(flow, j))
        )
        ranges = _range_along(flow, j, orbit) if len(ticks) else ()
        for event in ticks:
            mode, t = int(piece.events.mode_before[event]), piece.start.t + float(piece.events.t[event])
            values, rates = _along(flow, j, mode, [t], piece.events.x_before[event][None])
            for entry, (value, rate) in enumerate(zip(values[0], rates[0], strict=True)):
                range_of = float(ranges[entry]) or 1.0
                if abs(rate) * orbit.period >= STAYS * range_of:
                    tick, at = _nearest_tick(flow, clock, t)
                    touch = Touch((j, entry), mode, tick=(clock, tick))
                    yield FoundTouch(touch, at, True, float(abs(value)) / range_of)


def _clocks(flow: Motion) -> list[int]:
    """The transitions that are clocks."""
    return [j for j, transition in enumerate(flow.problem.system.transitions) if transition.is_clock]


def _nearest_tick(flow: Motion, clock: int, t: float) -> tuple[int, float]:
    """The number and the time of the tick that is nearest to a time."""
    transition, args = flow.problem.system.transitions[clock], flow.problem.args
    first, second = (float(tick_time(transition, tick, args)) for tick in (0, 1))
    nearest = round((t - first) / (second - first))
    return nearest, float(tick_time(transition, nearest, args))


def tick_time(transition: Transition, tick: int, args: Any) -> Any:
    """The time of a tick of a clock."""
    phase, every = (jnp.asarray(number(value, args)) for value in (transition.phase, transition.every))
    return phase + tick * every


def _guard(flow: Motion, j: int):
    guard, args = flow.problem.system.transitions[j].guard, flow.problem.args
    return lambda t, x: jnp.ravel(jnp.asarray(guard(t, x, args)))


def _along(flow: Motion, j: int, mode: int, times, states) -> list[np.ndarray]:
    """Values and rates (samples, m) of a guard along the motion in a mode."""
    field, args, guard = flow.problem.system.fields[mode], flow.problem.args, _guard(flow, j)

    def one(t, x):
        return jax.jvp(guard, (t, x), (jnp.ones_like(t), field(t, x, args)))

    return [np.asarray(found) for found in jax.vmap(one)(jnp.asarray(times), jnp.asarray(states))]


def _range_along(flow: Motion, j: int, orbit: OrbitIterate) -> np.ndarray:
    """The range (m,) of a guard over an orbit."""
    times = np.concatenate([piece.start.t + piece.times for piece in orbit.pieces])
    points = np.concatenate([piece.points for piece in orbit.pieces])
    return np.ptp(np.asarray(jax.vmap(_guard(flow, j))(jnp.asarray(times), jnp.asarray(points))), axis=0)


def _gradients(flow: Motion, j: int, t: float, x) -> tuple[np.ndarray, np.ndarray]:
    """Values (m,) of a guard, and gradients (m, 1 + n) by time and state."""
    guard, at = _guard(flow, j), (jnp.asarray(t, float), jnp.asarray(x))
    by_time, by_state = jax.jacfwd(guard, argnums=(0, 1))(*at)
    return np.asarray(guard(*at)), np.column_stack([by_time, by_state])
