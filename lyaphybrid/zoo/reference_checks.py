"""Every problem of the zoo against its reference, by two methods and at two tolerances."""

import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from .. import integrators
from ..systems.daes.semi_linear import Constrained, fields_of
from ..systems.event_driven import EventDriven
from ..systems.kinds import iterates
from .problem import Problem, get

__all__ = ["Comparison", "Way", "comparisons", "ways_of"]

SECOND_TOLERANCE = 1e-7  # the second relative tolerance
WITHIN = 5.0  # standard errors
FINITE_TIME = 5.0  # a run of length T knows an exponent to this over T, whatever its statistics say
UNTIL_LOST = 10  # times as long a run goes that has lost no direction yet, where the reference says that one is lost
SHORT = 2000.0  # longer runs, and those without a reference, are cut to a tenth in quick mode


class Way(NamedTuple):
    """One way to compute the exponents of a problem."""

    name: str
    options: dict[str, Any]  # of `Problem.spectrum`


class Comparison(NamedTuple):
    """The exponents of a problem by one way, beside what is known of them.

    Attributes:
        problem: the name of the problem.
        way: how they were computed.
        exponents: what was found.
        stderr: one standard error each.
        known: the reference; where there is none, what the first way found.
        has_reference: whether `known` is the reference.
        deviation: the largest deviation, in standard errors; inf where -inf was not found as -inf.
        status: how the run ended.
        seconds: how long it took, compilation included.
    """

    problem: str
    way: str
    exponents: tuple[float, ...]
    stderr: tuple[float, ...]
    known: tuple[float, ...]
    has_reference: bool
    deviation: float
    status: str
    seconds: float

    @property
    def agrees(self) -> bool:
        """Whether the run ended well and all exponents are within five standard errors."""
        return self.status in ("ok", "terminated") and self.deviation <= WITHIN


def ways_of(problem: Problem, quick: bool = False) -> list[Way]:
    """Two methods at two tolerances; in quick mode each method at one of them.

    Where nothing is integrated (maps, closed-form flows) two algorithms of orthonormalisation at two intervals.
    """
    if iterates(problem.system) or isinstance(problem.system, EventDriven):
        every = 4 if isinstance(problem.system, EventDriven) else 2
        found = [
            Way(f"{algorithm}, QR every {count}", {"orthonormalise": algorithm, "every": count})
            for algorithm in ("mgs", "lapack") for count in (every // 2, every)
        ]  # fmt: skip
    else:
        found = [way for method in _methods_of(problem) for way in _of_method(*method)]
    return [found[0], found[3]] if quick else found


def _methods_of(problem: Problem) -> list[tuple[str, Any]]:
    if problem.method is not None:
        return [(type(problem.method).__name__, problem.method), ("dopri8", integrators.RungeKutta("dopri8"))]
    if any(isinstance(field, Constrained) for field in fields_of(problem.system)):
        return [("HalfExplicit", integrators.HalfExplicit()), ("ESDIRK", integrators.ESDIRK())]
    return [(name, integrators.RungeKutta(name)) for name in ("dopri8", "dopri5")]


def _of_method(name: str, method: Any) -> list[Way]:
    if not method.adaptive:
        half = eqx.tree_at(lambda method: method.dt, method, method.dt / 2)
        return [Way(f"{name}, dt = {one.dt:g}", {"method": one}) for one in (half, method)]
    return [Way(f"{name}, rtol = {one.rtol:g}", {"method": one}) for one in (method, method.loosened(SECOND_TOLERANCE))]


def comparisons(names: Sequence[str], quick: bool = False) -> Iterator[Comparison]:
    """Run the problems, one after the other, and compare; each comparison comes as soon as it is made."""
    for name in names:
        problem, first = get(name)(), None
        for way in ways_of(problem, quick):
            found = _compare(problem, way, first, quick)
            first = first or found
            yield found


def _compare(problem: Problem, way: Way, first: Comparison | None, quick: bool) -> Comparison:
    start, length = time.perf_counter(), problem.t1
    options = dict(way.options)
    reference = problem.reference
    rarely_lost = reference is not None and not np.all(np.isfinite(reference.exponents))  # a short run may lose nothing
    if quick and (length >= SHORT or reference is None) and not rarely_lost:
        options["t1"] = length = type(length)(length / 10)
    spectrum = problem.spectrum(throw=False, **options)
    if rarely_lost and not np.any(np.isneginf(spectrum.exponents)):
        options["t1"] = length = UNTIL_LOST * length
        spectrum = problem.spectrum(throw=False, **options)
    values, errors = np.asarray(spectrum.exponents, float), np.nan_to_num(np.asarray(spectrum.stderr, float))
    own = (problem.name, way.name, tuple(map(float, values)), tuple(map(float, errors)))
    if problem.reference is not None:
        known, known_errors = problem.reference.exponents, problem.reference.stderr
    else:
        known, known_errors = (first.exponents, first.stderr) if first else own[2:]
    deviation = _deviation(values, errors, np.array(known), np.array(known_errors), FINITE_TIME / float(length))
    took = time.perf_counter() - start
    return Comparison(*own, tuple(known), problem.reference is not None, deviation, spectrum.status.name, took)


def _deviation(values, errors, known, known_errors, settling: float) -> float:
    """The largest deviation in standard errors; inf where there are more or fewer exponents, or other infinite ones."""
    if values.shape != known.shape or not np.array_equal(np.isneginf(values), np.isneginf(known)):
        return float("inf")
    finite = np.isfinite(known)
    if not np.all(np.isfinite(values[finite])):
        return float("inf")
    sizes = np.sqrt(errors[finite] ** 2 + known_errors[finite] ** 2 + (settling / WITHIN) ** 2)
    return float(np.max(np.abs(values[finite] - known[finite]) / sizes, initial=0.0))
