"""`lh.check`: does a system do what its author means? Looked at before a long run is made."""

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from ..._arguments import Real, State, positive, require, require_values
from ..._jax.engines import for_once
from ..._jax.precision import cure, is_short
from ..._jax.tracing import as_jax
from ...engine import preparation
from ...engine.binding import evolver_of
from ...engine.evolvers.stepping import Stepping, are_timeless
from ...errors import RunFailedError
from ...events.compiled_hybrid import CompiledHybrid, by_mode
from ...integrators import ContinuousQR
from ...integrators.base import Method
from ...statuses import STATUS
from ...systems.daes.semi_linear import Constrained, fields_of
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import System, iterates
from ...systems.validation import check_functions
from ..trajectories import Trajectory, place_after, tangent_map, trajectory
from . import functions, jumps, motion
from .constraints import check_what_is_fixed
from .predictions import check_instants, check_predictions
from .promises import check_promises
from .report import Finding, Report, noted, right, wrong
from .smoothness import check_smoothness

__all__ = ["check"]

ATTEMPTS = 1000  # steps of the run that finds a length of time
SAMPLES = 400
ITERATIONS = 300  # of a map
FARTHEST_TIME = 1e9  # no run of `ATTEMPTS` steps gets so far but one at rest


def check(
    system: System,
    x0: State,
    args: Any = None,
    *,
    t1: Real | None = None,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
) -> Report:
    """Check a system before it is used: its functions, its jumps, a trial run and the derivative of the motion.

    Looked at are: whether functions are pure, with results of the right kind; their derivatives against differences;
    jumps and kinks of fields and guards within a mode; guards that are clocks; whether resets leave their guards, and
    whether the motion goes on from there; guards that are passed the other way; how the trial run ended; the tangent
    map, saltation matrices included, against differences of the motion; the direction of the flow, whose exponent must
    be 0 where nothing depends on the time; the end of the run at finer tolerances; stiffness; whether couplings of
    an `lh.DAE` stay inside its `bandwidth`, and the kernel of ∂F/∂x' of an `lh.implicit_dae` what it was; and whether
    the `next_event` of an `lh.EventDriven` gives the same event from midway, and each event once.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: start, (n,); or (N, d) for many bodies.
        args: pytree of parameters.
        t1: length of the trial run, in time (iterations for a map). None: as long as 1000 steps last, or 300
            iterations.
        t0: time at the start.
        mode: mode at the start, where there are several.
        method: the integrator; None: the default of the system.

    Returns:
        A `Report`: `print` it; `.ok` is False if something is wrong, `.findings` holds everything that was looked at.

    Raises:
        ValueError: on something that is no system, and on t1 that is not positive. What is wrong with functions or with
            a run is in the report.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.array([x[1], -1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.array([x[0], 0.8 * x[1]])),
        ... )
        >>> report = lh.check(ball, [1.0, 0.0], t1=2.0)
        >>> report.ok, report.notes[0].topic  # the reset does not turn the velocity around
        (False, 'jumps')
    """
    require_values("check", x0, args, t1, t0)
    if t1 is not None:
        positive("t1, a length of time,", t1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem, start, begin, index = preparation.prepare(system, x0, args, t0, method, mode)
            require(start.ndim == 1, f"check looks at one start: x0 must have shape (n,); got {start.shape}.")
            check_functions(system, jax.ShapeDtypeStruct(problem.shape, start.dtype), problem.args)
        except ValueError as error:
            if not isinstance(system, System):
                raise
            return Report([wrong("functions", str(error))])
        found = _of_precision(start)
        state = start.reshape(problem.shape)
        problem = problem._replace(args=as_jax(problem.args))  # as in a run: the user may index them by a state
        own = functions.functions_of(system, problem.args, begin, state)
        found += functions.check_purity(own, begin, state)
        if any(one.verdict == "wrong" for one in found):  # nothing else would mean anything
            return Report(found)
        run, step, ended = _trial(system, state, problem.args, begin, t1, mode, method)
        run = _with_start(run, begin, state, index)
        found += functions.check_derivatives(own, *_visited(run))
        found += check_what_is_fixed(system, problem.args, _visited(run)[0])
        found += functions.check_clocks(own, begin, state)
        found += check_predictions(system, problem.args, run, (begin, state))
        found += check_instants(system, problem.args, run, (begin, state))
        found += check_promises(system, problem.args, run, (begin, state))
        flowing = None if iterates(system) or isinstance(system, EventDriven) else _flowing(problem, begin, start)
        found += _of_run(system, run, problem, own, flowing, step)
        found += ended
        if not any(one.topic == "jumps" and one.verdict == "wrong" for one in found):
            found += _of_motion(system, problem, run, begin, start, index, mode, flowing)
    return Report(found)


def _of_precision(x0) -> list[Finding]:
    if is_short(x0):
        return [noted("precision", f"The state is {x0.dtype}: exponents carry three to four digits. {cure('x0')}")]
    return [right("precision", "float64")]


def _trial(system, x0, args, t0, t1, mode, method) -> tuple[Trajectory, float, list[Finding]]:
    """The trial run, the mean length of its steps, and how it ended."""
    options = {"t0": t0, "mode": mode, "method": method, "n": SAMPLES}
    if iterates(system):
        length, step = t1 or ITERATIONS, 1.0
    else:
        probe = trajectory(system, x0, args, t1=FARTHEST_TIME, max_steps=ATTEMPTS, throw=False, **options)
        passed = float(probe.ended) - float(t0)
        step = passed / ATTEMPTS
        # A run that ended by itself is repeated to beyond its end, so that the end is seen again.
        length = t1 or (1.5 if probe.status is not STATUS.max_steps else 1.0) * passed or 1.0
    try:
        run = trajectory(system, x0, args, t1=length, max_steps=None if t1 else 3 * ATTEMPTS, **options)
        jumps = int(np.asarray(run.j)[-1])
        unit = run.state_labels.time_unit or "units of time"
        return run, step, [right("run", f"{run.status}: {length:.6g} {unit}, {jumps} jumps")]
    except RunFailedError as failure:
        run, reached = failure.result, float(failure.result.ended) - float(t0)
        if not iterates(system) and 0 < reached < length:  # again, with all samples before the end
            again = trajectory(
                system, x0, args, t1=reached * (1 - 1e-9), max_steps=4 * ATTEMPTS, throw=False, **options
            )
            run = dataclasses.replace(again, events=run.events)
        if failure.status is not STATUS.max_steps:
            verdict = noted if _accumulates(failure.status, run) else wrong
            return run, step, [verdict("run", f"The trial run ended early: {failure.told}")]
        return run, step, [
            wrong("run", f"Steps become ever shorter: {3 * ATTEMPTS} led to t = {float(t0) + reached:.6g} only, where "
                  f"{ATTEMPTS} had led to {float(t0) + ATTEMPTS * step:.6g}. Does the state escape, or is a function "
                  "not smooth?")
        ]  # fmt: skip


def _accumulates(status, run: Trajectory) -> bool:
    """Whether a run ended at the rest of a motion: jumps in ever shorter intervals, and no cascade without end."""
    return status is STATUS.zeno and len(run.events.t) > 1 and float(run.events.t[-1]) > float(run.events.t[-2])


def _onward(system, problem):
    """The function (t, x, mode, attempts) -> t, x, mode after so many attempts; None where the motion ends before."""

    def onward(t, x, mode, attempts: int):
        options = {"t1": FARTHEST_TIME, "n": SAMPLES, "t0": float(t), "method": problem.method}
        options["mode"] = int(mode) if isinstance(system, Hybrid) else None
        return place_after(system, x, problem.args, attempts=attempts, **options)

    return onward


def _with_start(run: Trajectory, t0, x0, mode) -> Trajectory:
    """The samples of a run that it has reached, after its start; all arrays are NumPy's."""
    run = jax.tree.map(lambda one: np.asarray(one) if isinstance(one, jax.Array) else one, run)
    seen, first = np.isfinite(run.t), int(run.mode[0]) if mode is None or np.ndim(mode) else int(mode)
    start = {"t": t0, "x": x0, "mode": first, "j": 0}
    samples = {
        name: np.concatenate([np.asarray(one, getattr(run, name).dtype)[None], getattr(run, name)[seen]])
        for name, one in start.items()
    }
    return dataclasses.replace(run, **samples)


def _with_end(run: Trajectory, slope: Callable) -> list:
    """Times, states, modes and jumps of the samples, and of one step on along the flow: a run may end before a jump."""
    t, x, mode, jumps_done = (np.asarray(one) for one in (run.t, run.x, run.mode, run.j))
    if len(t) < 2 or not np.all(np.isfinite(x[-1])):
        return [t, x, mode, jumps_done]
    dt = t[-1] - t[-2]
    ahead = x[-1] + dt * slope(t[-1], x[-1], mode[-1])
    ends = (t[-1] + dt, ahead, mode[-1], jumps_done[-1])
    return [
        np.append(one, np.asarray(end)[None], axis=0) for one, end in zip((t, x, mode, jumps_done), ends, strict=True)
    ]


def _visited(run: Trajectory) -> tuple[functions.Visited, functions.Visited]:
    """The states along the run, and those before its jumps."""
    e = run.events
    return functions.Visited(run.t, run.x, run.mode), functions.Visited(e.t, e.x_before, e.transition)


class Flowing(NamedTuple):
    """A system that flows, with its parameters."""

    hybrid: CompiledHybrid
    slope: Callable  # (t, x, mode) -> dx/dt, NumPy's array (n,)


def _flowing(problem, t0, x0) -> Flowing:
    evolver = evolver_of(problem, t0, x0)
    assert isinstance(evolver, Stepping), "the caller sorts out maps and closed-form flows"
    fields, mode = evolver.hybrid.fields, np.zeros((), np.int32)
    slope = for_once(lambda t, x, mode: [by_mode(mode, fields, t, x)], t0, x0, mode)
    return Flowing(evolver.hybrid, lambda *place: np.asarray(slope(*place)[0]))


def _of_run(system, run: Trajectory, problem, own, flowing: Flowing | None, step: float) -> list[Finding]:
    """What the states and the jumps of the run show."""
    if flowing is None:
        return []
    if isinstance(system, Hybrid):
        mistaken = jumps.check_targets(system, problem.args, run)
        if mistaken:  # the states after are of no mode
            return mistaken
    found = check_smoothness(own, *_with_end(run, flowing.slope))
    found += motion.check_absolute_tolerance(run, problem.method)
    found += motion.check_stiffness(problem, run, step, _onward(system, problem))
    if isinstance(system, Hybrid):
        found += jumps.check_jumps(system, problem.args, flowing.slope, run)
    return found


def _of_motion(system, problem, run: Trajectory, t0, x0, index, mode, flowing) -> list[Finding]:
    """The tangent map over a stretch with some jumps, where neighbouring states are states, too."""
    if (
        iterates(system)
        or x0.ndim != 1
        or is_short(x0)
        or any(isinstance(field, Constrained) for field in fields_of(system))
        or not motion.is_resolved(run, problem.method)
    ):
        return []

    method = problem.method
    of_columns = method.method if isinstance(method, ContinuousQR) else method

    def tangent(x, length, method=of_columns):
        options = {"t0": t0, "mode": mode, "method": method, "throw": False}
        return tangent_map(system, np.reshape(x, problem.shape), problem.args, t1=np.asarray(length), **options)

    reached = _stretch(run, float(t0))
    found = motion.moderate(tangent, x0, reached) if reached > 0 else None
    if found is None:
        return []
    length, exact = found
    checks = motion.check_differences(tangent, np.asarray(x0), length, exact)
    if flowing is not None and index is not None and are_timeless(flowing.hybrid, t0, x0):
        checks += motion.check_along_flow(flowing.slope, t0, x0, index, exact, length)
    return checks + motion.check_tolerance(tangent, x0, length, exact, of_columns)


def _stretch(run: Trajectory, t0: float) -> float:
    """A length of time with up to three jumps, that ends between two."""
    reached = float(run.t[-1]) - t0
    times = np.unique(run.events.t) - t0
    times = times[times < reached]
    if len(times) > 3:
        return float(0.5 * (times[2] + times[3]))
    return float(0.5 * (times[-1] + reached)) if len(times) else reached / 10
