"""The motion itself: its derivative against differences and along the flow, finer tolerances, and stiffness."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from ...engine.host.driver import rates_at
from ...engine.host.paces import Rates, at_stability_limit, may_be_stiff
from ...engine.preparation import RELATIVE_ATOL, SMALL_UNITS
from ...engine.problems import RunProblem
from ...integrators.base import Method
from ...statuses import STIFF_REMEDY
from ..trajectories import TangentMap, Trajectory
from .report import Finding, in_short, noted, right, wrong

__all__ = ["check_along_flow", "check_differences", "check_stiffness", "check_tolerance", "is_resolved", "moderate"]

LARGEST = 1e4  # growth, and decay, of perturbations up to which differences of trajectories tell something
SHORTENED = 6  # so often a stretch is made shorter
DIRECTIONS = 3  # random ones
SHIFT = 1e-5  # of a start, relative to its size
MATRIX_ERROR = 1e-3  # a matrix is wrong if it differs from differences by more than this part
STRETCHES, ATTEMPTS_PER_STRETCH = 8, 4000  # of a run that goes on to where a flow may be stiff
FEW_COMPONENTS, LEAST_ATTEMPTS = 4, 400  # dimension up to which a stretch is so long; of more it shrinks
ATTEMPTS_FOR_STEP = 100  # whose mean is the length of a step at a place
COARSE = 1e-5  # an absolute tolerance is coarse above this part of a component
FINER = 1e-2  # the tolerances of the run that is compared with


def moderate(tangent: Callable[..., TangentMap], x0, length: float) -> tuple[float, TangentMap] | None:
    """A length over which perturbations grow and decay little, and the tangent map over it; None: they always grow."""
    decayed = None
    for _ in range(SHORTENED):
        found = tangent(x0, length)
        largest = np.inf if found.status.failed else np.max(np.abs(found.matrix))
        if 1 / LARGEST <= largest <= LARGEST:
            return length, found
        decayed = (length, found) if decayed is None and largest < 1 else decayed
        length /= 4
    return decayed


def check_differences(tangent: Callable[..., TangentMap], x0, length: float, exact: TangentMap) -> list[Finding]:
    """The tangent map, with its saltation matrices, against central differences of the motion."""
    draw, compared = np.random.default_rng(0), 0
    size = np.maximum(np.abs(x0), 1e-2 * np.max(np.abs(x0), initial=1e-2))
    how = f"over {_lasting(length, exact)} with {int(exact.jumps)} jumps"
    for _ in range(DIRECTIONS):
        direction = draw.normal(size=len(x0)) * size
        wide, narrow = (_difference(tangent, x0, part * SHIFT * direction, length, exact) for part in (1.0, 0.25))
        moved = np.asarray(exact.matrix) @ direction * SHIFT
        largest = np.max(np.abs(moved))
        if wide is None or narrow is None or np.max(np.abs(wide - 4 * narrow)) > 1e-4 * largest:
            continue  # another order of events, or too curved
        compared += 1
        if np.max(np.abs(4 * narrow - moved)) > MATRIX_ERROR * largest:
            return [
                wrong("saltation", f"A perturbation along {in_short(direction)} becomes {in_short(moved / SHIFT)} by "
                      f"the tangent map, and {in_short(4 * narrow / SHIFT)} by differences of the motion, {how}. Is "
                      "a derivative, a reset or the `tangent` of a mode wrong?")
            ]  # fmt: skip
    if not compared:
        return []
    return [right("saltation", f"the tangent map agrees with differences of the motion {how}, {compared} directions")]


def _lasting(length: float, exact: TangentMap) -> str:
    """A length of time in words."""
    return f"{length:.4g} {exact.state_labels.time_unit or 'units of time'}"


def _difference(tangent, x0, step, length: float, exact: TangentMap) -> np.ndarray | None:
    """Half the difference of the ends of two runs; None where they have other events, or fail."""
    up, down = (tangent(x0 + sign * step, length) for sign in (1.0, -1.0))
    if {int(up.jumps), int(down.jumps)} != {int(exact.jumps)} or up.status.failed or down.status.failed:
        return None
    return 0.5 * np.ravel(np.asarray(up.x) - np.asarray(down.x))


def check_along_flow(slope: Callable, t0, x0, mode: int, exact: TangentMap, length: float) -> list[Finding]:
    """In a system that does not depend on the time, a perturbation along the flow stays along the flow.

    `slope` is the field (t, x, mode) -> dx/dt.
    """
    before = slope(t0, x0, mode)
    after = slope(t0 + length, exact.x, exact.mode)
    moved = np.asarray(exact.matrix) @ before
    size = np.max(np.abs(exact.matrix)) * np.max(np.abs(before))
    if size == 0:
        return [noted("flow direction", "the run starts at an equilibrium: the field is zero there")]
    if np.max(np.abs(moved - after)) > MATRIX_ERROR * size:
        return [
            wrong("flow direction", f"A perturbation along the flow, {in_short(before)}, becomes {in_short(moved)} "
                  f"over {_lasting(length, exact)}, and the flow is {in_short(after)} there: they must be equal where "
                  "nothing depends on the time. So the exponent that must be 0 is not. Is a derivative wrong?")
        ]  # fmt: skip
    said = "a perturbation along the flow stays along it: one exponent is 0, unless the motion ends at rest"
    return [right("flow direction", said)]


def check_tolerance(tangent: Callable[..., TangentMap], x0, length: float, exact: TangentMap, method) -> list[Finding]:
    """The end of a run at tolerances a hundred times finer."""
    if not isinstance(method, Method) or not method.adaptive or not hasattr(method, "atol"):
        return []
    try:
        finer = dataclasses.replace(method, rtol=FINER * method.rtol, atol=FINER * method.atol)
    except (TypeError, ValueError):  # a method of another kind
        return []
    end = tangent(x0, length, finer)
    moved = float(np.max(np.abs(np.asarray(end.x) - np.asarray(exact.x))))
    size = float(np.max(np.abs(exact.x))) + float(np.max(np.abs(x0)))
    allowed = 1e4 * (float(method.rtol) * size + float(method.atol)) * (1 + float(np.max(np.abs(exact.matrix))))
    said = f"x after {_lasting(length, exact)} moves by {moved:.1e} when the tolerances are 100 times finer"
    if moved > allowed or int(end.jumps) != int(exact.jumps):
        return [wrong("tolerance", f"{said}, which is far more than they say ({int(exact.jumps)} and {int(end.jumps)} "
                      "jumps). Is a function not smooth, or too noisy?")]  # fmt: skip
    return [right("tolerance", said)]


def is_resolved(run: Trajectory, method) -> bool:
    """Whether the absolute tolerance of a method is less than some component, so that differences tell something."""
    sizes, allowed = _sizes_and_tolerances(run, method)
    return not np.any(sizes > 0) or bool(np.any(sizes > SMALL_UNITS * allowed))


def _sizes_and_tolerances(run: Trajectory, method) -> tuple[np.ndarray, np.ndarray]:
    """(n,) the largest values of the components, and the absolute errors that a method allows them; 0: any."""
    x = np.reshape(np.asarray(run.x), (len(run.t), -1))
    sizes = np.max(np.abs(x[np.all(np.isfinite(x), axis=1)]), axis=0, initial=0.0)
    limited = isinstance(method, Method) and method.adaptive and hasattr(method, "atol")
    return sizes, np.broadcast_to(np.asarray(method.atol if limited else 0.0, float), sizes.shape)


def check_absolute_tolerance(run: Trajectory, method) -> list[Finding]:
    """Whether components are so small that the absolute tolerance of a method is no small part of them."""
    sizes, allowed = _sizes_and_tolerances(run, method)
    coarse = np.flatnonzero((sizes > 0) & (allowed > COARSE * sizes))
    if not len(coarse):
        return []
    names = " and ".join(run.state_labels.name(int(i)) for i in coarse[:3]) + (" and more" if len(coarse) > 3 else "")
    size, error, wanted = np.max(sizes[coarse]), np.max(allowed[coarse]), np.min(sizes[coarse]) * RELATIVE_ATOL
    said = f"{names}: at most {size:.1e} large, and atol allows errors of {error:.0e} in each step of a trajectory"
    return [noted("tolerance", f"{said}. Take larger units, or give method=lh.RungeKutta(atol={wanted:.0e}).")]


def check_stiffness(problem: RunProblem, run: Trajectory, step: float, onward: Callable) -> list[Finding]:
    """Whether steps are as long as stability allows, and not as the motion would.

    Args:
        problem: the system, its parameters and its method.
        run: the trial run.
        step: the mean length of its steps.
        onward: (t, x, mode, attempts) -> t, x, mode after so many attempts; None where the motion has ended before.
    """
    if not may_be_stiff(problem.method):
        return []
    samples = np.unique(np.linspace(0, len(run.t) - 1, 9).astype(int))
    met = _known((rates_at(problem, *_place(run, i)), step) for i in samples)
    if not _mostly_stiff(met):  # an explicit method may not have come to where the flow is stiff
        met = _met_onward(problem, _place(run, -1), onward)
    if _mostly_stiff(met):
        _, change, decay = np.median([one for one, _ in met], axis=0)
        length = np.median([length for _, length in met])
        return [
            noted("stiffness", f"The flow is stiff: perturbations decay at the rate {decay:.3g}, the motion changes at "
                  f"{change:.3g}, and steps of {length:.2g} are as long as an explicit method stays stable. Take an "
                  f"implicit one: {STIFF_REMEDY}.")
        ]  # fmt: skip
    return [right("stiffness", f"steps of {step:.2g} follow the motion, not the stability of the method")]


def _place(run: Trajectory, i: int) -> tuple[Any, Any, Any]:
    """Time, state and mode of a sample."""
    return run.t[i], run.x[i], run.mode[i]


def _met_onward(problem: RunProblem, state, onward: Callable) -> list[tuple[Rates, float]]:
    """Rates, and lengths of steps, after each of `STRETCHES` further stretches of the motion."""
    met = []
    attempts = max(LEAST_ATTEMPTS, ATTEMPTS_PER_STRETCH * FEW_COMPONENTS // max(FEW_COMPONENTS, np.size(state[1])))
    for _ in range(STRETCHES):
        state = onward(*state, attempts)
        after = None if state is None else onward(*state, ATTEMPTS_FOR_STEP)
        if state is None or after is None:
            break
        met.append((rates_at(problem, *state), float(after[0] - state[0]) / ATTEMPTS_FOR_STEP))
        state = after
    return _known(met)


def _known(met) -> list[tuple[Rates, float]]:
    """Without states at rest, where every step is longer than the motion needs."""
    return [(rates, length) for rates, length in met if rates is not None and rates.motion > 0]


def _mostly_stiff(met: list[tuple[Rates, float]]) -> bool:
    return 2 * sum(at_stability_limit(one, step) for one, step in met) > len(met)
