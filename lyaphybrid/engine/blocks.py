"""How a run is divided into blocks, and when its frame is orthonormalised."""

from typing import Any

import numpy as np

from .._arguments import numbers, positive, real, require
from .._jax.tracing import array, numpy_for, traced
from ..integrators.base import Method
from ..systems.event_driven import EventDriven
from ..systems.kinds import iterates
from . import problems
from .states import QRSchedule

__all__ = ["qr_schedule_for", "check_counts", "each_step_of", "ends_of_blocks", "is_zero", "part_of", "targets_for"]


COUNTED = 2.0**53  # beyond it the next whole number is not a float


def is_zero(value) -> bool:
    """Whether a length is the number 0, so that nothing has to be run."""
    return isinstance(value, int | float) and value == 0


def qr_schedule_for(problem: problems.RunProblem, every) -> tuple[QRSchedule, Any]:
    """The schedule of orthonormalisations, with the unit of `every` for this kind of system, and the first interval."""
    system, method, *_ = problem
    by_time = isinstance(every, tuple | list)
    if isinstance(system, EventDriven):
        unit = "time" if by_time else "jumps"
    elif method is None or not method.adaptive:
        unit = "steps"
    else:
        unit = "steps" if every is None else "time"
    if by_time:
        good = len(every) == 2 and isinstance(every[0], str) and every[0] == "time" and unit == "time"
        where = "" if unit == "time" else f" for a system whose {unit} are counted"
        known = 'every must be a number; of an lh.EventDriven, or with adaptive steps, also ("time", length)'
        require(good, f"{known}; got {every!r}{where}.")
        every = every[1]
    if every is None:
        each = isinstance(method, Method) and method.each_step
        return QRSchedule(unit, not each, each), 1.0
    positive("every", every)
    return QRSchedule(unit, False, each=unit == "steps" and not traced(every) and bool(every == 1)), every


def each_step_of(problem: problems.RunProblem) -> tuple[QRSchedule, Any]:
    """Orthonormalise after every step; for event-driven systems after every flight."""
    method = problem.method
    unit = "jumps" if isinstance(problem.system, EventDriven) else "steps"
    return QRSchedule(unit, False, each=unit == "steps" and (method is None or not method.adaptive)), 1.0


def ends_of_blocks(length, blocks, times, name):
    """(blocks,) the ends of the blocks, measured from the start of the run."""
    if isinstance(length, tuple | list):
        raise ValueError(f"{name} is one number, a length; got {length!r}. From a to b: t0=a, {name}=b − a.")
    positive(f"{name}, a length,", length)
    if times is None:
        return length * (np.arange(1, blocks + 1) / blocks)
    if isinstance(times, str):
        require(times == "log", f"times must be an increasing array or 'log'; got {times!r}.")
        return length * np.geomspace(1e-3, 1.0, blocks)
    times = numbers("times", times, float)
    rising = times.ndim == 1 and len(times) > 1 and times[0] > 0 and bool(np.all(np.diff(times) > 0))
    require(rising, f"times must be a positive, increasing array of at least two; got {times!r}.")
    matches = traced(length) or bool(np.isclose(times[-1], float(length)))
    require(matches, f"times must end at t1 = {length}; the last is {times[-1]}.")
    return times


def check_counts(system, clock: str = "time", **lengths) -> None:
    """Check that lengths that count iterations or jumps are whole numbers, where the values are known."""
    if not (iterates(system) or clock == "jumps"):
        return
    unit = "iterations" if iterates(system) else "jumps"
    for name, length in lengths.items():
        if length is None or traced(length):
            continue
        real(name, length)
        require(
            float(length) <= COUNTED, f"{name} must be at most 2**53 {unit}, as far as floats count; got {length!r}."
        )
        require(float(length).is_integer(), f"{name} counts {unit} here: it must be a whole number; got {length!r}.")


def part_of(system, clock: str, t1, fraction: float):
    """A fraction of the length of a run, rounded up to a whole number where iterations or jumps are counted."""
    part = fraction * t1
    return numpy_for(part).ceil(part) if iterates(system) or clock == "jumps" else part


def targets_for(ends, clock, discrete, dtype):
    """(blocks,) the end of each block in time, and in jumps."""
    xp = numpy_for(ends)
    whole = xp.ceil(ends - 1e-9)
    times = whole if discrete else xp.full_like(ends, np.inf) if clock == "jumps" else ends
    return array(times, dtype), array(whole, dtype)
