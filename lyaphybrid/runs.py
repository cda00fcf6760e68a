"""Runs: from a system and its arguments to the one compiled loop, and the host that drives it.

Eager, the host calls the compiled `advance` again and again with a budget of attempts that takes about a third
of a second: between two calls there is room for progress, Ctrl-C and checks, and nothing computed is lost.
Traced (under jit, vmap, grad) it is called once.
"""

import contextlib
import contextvars
import dataclasses
import functools
import math
import time
import warnings
from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from . import propagation
from ._engines import compilations, compiled
from ._tracing import array, traced
from .checkpoints import Part
from .checks import check_clocks, check_functions, real, require
from .consistency import check_constraints
from .daes import Constrained, fields_of
from .events import Wiring, bound, by_mode, projection, wire
from .methods import DiffraxEvents, HalfExplicit, RungeKutta
from .methods.base import Method
from .methods.exact import Exact
from .methods.flights import Flights
from .methods.iterate import Iterating
from .methods.scheduled import Scheduled
from .methods.stepping import Stepping, are_curved, are_timeless
from .paces import Pace, Rates, given_up, rates_of
from .precision import CURE, LEAST, eps, is_short, require_double
from .propagation import Cadence, Journey, Settings, Watch
from .statuses import RUNNING, STATUS
from .systems import Bound, EventDriven, Flow, Hybrid, Map

__all__ = [
    "Plan",
    "Noticed",
    "Problem",
    "as_arrays",
    "drive",
    "mode_index",
    "mode_names",
    "noticing",
    "number",
    "prepare",
    "start",
    "time_of",
]

FOREVER = 2**31 - 1
SECONDS_PER_CALL = 0.3
FIRST, FEWEST, MOST = 2000, 100, 10**8  # attempts in a call …
MOST_FASTER = 64.0  # … and how many times as many the next call may have
SHORT = np.int32(STATUS.max_steps)  # the verdict on a run whose attempts are spent


class Problem(NamedTuple):
    """What is computed: traced where it is an array, static where it is a function."""

    system: Any
    method: Any
    args: Any
    shape: tuple[int, ...]  # of a state, which is flat within a run


class Plan(NamedTuple):
    """How it is computed: all static."""

    cadence: Cadence
    kind: str
    sum_rule: bool
    log: int
    count_jumps: bool
    batched: bool
    collect: Callable
    watch: Watch | None = None


def nothing(t, carry):
    """Collect nothing at the ends of blocks."""
    del t, carry


def first_losses(t, carry):
    """Collect when each column was first lost; None where nothing can be."""
    del t
    return carry.first_loss


def point(t, carry):
    """Collect the time, the state, the mode and the number of jumps at the ends of blocks."""
    return t, carry.x, mode_of(carry), carry.jumps


def mode_of(carry, xp: ModuleType = jnp):
    """The index of the present mode."""
    mode = getattr(carry.own, "mode", None)
    return xp.zeros((), np.int32) if mode is None else mode


def time_of(journey: Journey):
    """The time where a journey stands."""
    return journey.base[..., 0] + (journey.base[..., 1] + journey.carry.s)


def mode_names(system) -> tuple[str, ...]:
    """The names of a system's modes."""
    return system.mode_names if isinstance(system, Hybrid) else ("flow",)


class Noticed(NamedTuple):
    """A run that was prepared."""

    system: Any
    method: Any


_noticed: contextvars.ContextVar[list | None] = contextvars.ContextVar("noticed", default=None)


@contextlib.contextmanager
def noticing():
    """A list of all runs that are prepared meanwhile."""
    found: list[Noticed] = []
    token = _noticed.set(found)
    try:
        yield found
    finally:
        _noticed.reset(token)


def prepare(system, x0, args, t0, method, mode, name: str = "x0") -> tuple[Problem, Any, Any, Any]:
    """Check what the user gave, before any computing; -> problem, x0, t0, index of the mode.

    `name` is what the caller's user calls the state. The mode is None where each start says in which it begins.
    """
    if not isinstance(system, Flow | Map | Hybrid | EventDriven):
        raise ValueError(
            f"system must be an lh.Flow, lh.Map, lh.Hybrid or lh.EventDriven; got {type(system).__name__}. "
            "Wrap a function: lh.Flow(field)."
        )
    x0, shape = _state(system, x0, name)
    real("t0" if name == "x0" else "t", t0)
    # Python floats would be compiled in as constants: as arrays they may change without compiling again.
    method, listener = _method_for(system, method), _noticed.get()
    _check_precision(name, x0, system, method)
    if listener is not None:
        listener.append(Noticed(system, method))
    args, method = as_arrays(args, x0.dtype), at_precision(method, x0)
    check_clocks(system, args)
    t0 = array(t0, x0.dtype)
    check_constraints(system, x0 if x0.ndim == 1 else x0[0], t0, args)
    return Problem(system, method, args, shape), x0, t0, mode_index(system, mode)


def as_arrays(tree, dtype):
    """The tree with arrays for Python's floats, which would be compiled in as constants."""
    return jax.tree.map(lambda leaf: array(leaf, dtype) if isinstance(leaf, float) else leaf, tree)


def at_precision(method, x):
    """The method, with arrays for numbers, and with tolerances that can be kept in the precision of x."""
    if method is not None and is_short(x):
        method = method.loosened(LEAST * eps(x))
    return as_arrays(method, x.dtype)


def _check_precision(name: str, x, system, method) -> None:
    """Refuse what float32 cannot do, and say what it does to the rest."""
    if not is_short(x):
        return
    if any(isinstance(field, Constrained) for field in fields_of(system)):
        require_double(name, x, "an lh.DAE")
    require(x.dtype == jnp.float32, f"{name} is {x.dtype}: it must be float64, or float32. {CURE}")
    steps, kept = "", at_precision(method, x)
    if method is not None and method.adaptive and not traced(method) and kept.rtol > method.rtol:
        steps = f" Steps are controlled to rtol = {kept.rtol:.2g} and not {method.rtol:.2g}."
    warnings.warn(
        f"{name} is float32: exponents will carry three to four digits, and events may be missed.{steps} {CURE}",
        stacklevel=4,
    )


def in_rows(problem: Problem, x):
    """States of a run, flat there, in the shape in which the user gave them."""
    return x.reshape(*x.shape[:-1], *problem.shape)


def _state(system, x0, name):
    """The states (n,) or (m, n), and the shape of one as the user gives it: (N, d) for many bodies."""
    numbers = all(np.asarray(leaf).dtype.kind in "biufc" for leaf in jax.tree.leaves(x0) if not traced(leaf))
    if not numbers or not jax.tree.leaves(x0):
        raise ValueError(f"{name} must be an array of numbers; got {x0!r}.")
    if any(np.iscomplexobj(leaf) for leaf in jax.tree.leaves(x0)):
        raise ValueError(f"{name} must be real; write a complex state as its real and imaginary parts.")
    x0 = jnp.asarray(x0)
    x0 = x0 if jnp.issubdtype(x0.dtype, jnp.floating) else x0.astype(float)
    rows = isinstance(system, EventDriven) and system.schedule is not None and not system.schedule.flat
    one = 2 if rows else 1
    if x0.ndim not in (one, one + 1) or 0 in x0.shape:
        several, single = ("(m, N, d)", "(N, d), one row a body") if rows else ("(m, n)", "(n,)")
        raise ValueError(f"{name} must have shape {single}, or {several} for m runs at once; got {x0.shape}.")
    if not traced(x0) and not np.all(np.isfinite(x0)):
        raise ValueError(f"{name} must be finite; got {x0}.")
    shape = x0.shape[-one:]
    return x0.reshape(*x0.shape[:-one], math.prod(shape)), shape


def _method_for(system, method):
    if isinstance(system, Flow) or (isinstance(system, Hybrid) and system.fields is not None):
        if method is None:
            constrained = any(isinstance(field, Constrained) for field in fields_of(system))
            return HalfExplicit() if constrained else RungeKutta()
        if not isinstance(method, Method):
            raise ValueError(f"A system that flows needs a method such as lh.RungeKutta(); got {method!r}.")
        return method
    if method is not None:
        kind = "A map is iterated" if isinstance(system, Map | Hybrid) else "An lh.EventDriven flow is exact"
        raise ValueError(f"{kind}: it takes no method; got {method!r}. Leave method=None.")
    return None


def mode_index(system, mode):
    """The index of a mode, given by name or index; None: the state tells."""
    names = mode_names(system)
    if mode is None:
        if isinstance(system, Hybrid) and system.initial_mode is not None:
            return None
        if len(names) > 1:
            raise ValueError(f"This system has the modes {list(names)}: say which one it starts in, mode=….")
        return 0
    if isinstance(mode, str):
        if mode not in names:
            raise ValueError(f"Unknown mode {mode!r}; the modes are {list(names)}.")
        return names.index(mode)
    if isinstance(mode, int) and not 0 <= mode < len(names):
        raise ValueError(f"mode {mode} is out of range; the modes are {list(names)}.")
    return mode


def mover_of(problem: Problem, t, x):
    """The mover of a problem, made while tracing: its functions are checked and have `args` bound."""
    system, method, args, _ = problem
    check_functions(system, jax.ShapeDtypeStruct(problem.shape, x.dtype), args)
    if isinstance(system, Map):
        return Iterating(lambda n, x: system.rule(n, x, args))
    if isinstance(system, EventDriven):
        return Exact(system, args) if system.schedule is None else Scheduled(system, args, problem.shape)
    if isinstance(system, Flow):
        empty = np.zeros((1, 0), np.int32)
        of_dae = isinstance(system.field, Constrained)
        fields = (bound(system.field, args, t, x) if of_dae else Bound(system.field, args),)
        method.require(fields[0], t, x)
        onto = (projection(fields[0], None, args),)
        wiring = Wiring(fields, (), onto, empty, empty, empty, (), empty, (), (), (), False, None)
        return _moving(wiring, method, (), (), 0, are_curved(fields, t, x))
    if system.fields is None:
        reset = system.transitions[0].reset
        return Iterating(lambda n, x: reset(n, x, args))
    wiring = wire(system, t, x, args)
    for field in wiring.fields:
        method.require(field, t, x)
    clocks = tuple(
        (number(system.transitions[j].every, args), number(system.transitions[j].phase, args)) for j in wiring.clocks
    )
    terminal = tuple(tr.terminal for tr in system.guarded)
    return _moving(wiring, method, clocks, terminal, system.max_cascade, are_curved(wiring.fields, t, x))


def _moving(wiring, method, *rest) -> Stepping:
    """The mover of what flows by a method: it finds the events, where the method does not do it itself."""
    return (Flights if isinstance(method, DiffraxEvents) else Stepping)(wiring, method, *rest)


def number(value, args):
    """The period or the phase of a clock."""
    return value(args) if callable(value) else value


def settings_of(problem: Problem, plan: Plan, t, x, reverse: bool = False) -> Settings:
    """Bind a plan to a problem, while tracing."""
    own = plan._asdict()
    del own["batched"]
    mover = mover_of(problem, t, x)
    if plan.count_jumps and isinstance(mover, Stepping) and mover.has_events:
        mover = dataclasses.replace(mover, per_jump=True, timeless=are_timeless(mover.wiring, t, x))
    if plan.count_jumps and isinstance(mover, Scheduled):
        mover = dataclasses.replace(mover, per_jump=True)
    return Settings(mover, **own, reverse=reverse)


@compiled(lambda problem, plan, t0, x0, frame, mode, interval: frame.shape[-1], hands_on=True)
def start(problem: Problem, plan: Plan, t0, x0, frame, mode, interval) -> Journey:
    """The journey at its start; x0 (n,), or (m, n) where the plan is batched."""

    def one(x, frame):
        settings = settings_of(problem, plan, t0, x)
        return propagation.begin(settings, t0, x, frame, mode, None, jnp.asarray(interval, x.dtype))

    if not plan.batched:
        return one(x0, frame)
    frames = jnp.broadcast_to(frame, (x0.shape[0], *frame.shape)) if frame.ndim == 2 else frame
    return jax.vmap(one)(x0, frames)


def _loop(problem: Problem, plan: Plan, journey: Journey, ends, last_jumps, budget, reverse: bool = False):
    def one(journey):
        settings = settings_of(problem, plan, journey.base[0], journey.carry.x, reverse)
        return propagation.advance(settings, journey, ends, last_jumps, budget)

    if not plan.batched:
        return one(journey)
    # On a CPU one lane after the other keeps real branches; a vmap of them would compute every case for all.
    if jax.default_backend() == "cpu":
        return jax.lax.map(one, journey)
    return jax.vmap(one)(journey)


_advance = compiled(
    lambda problem, plan, journey, *rest: journey.carry.frame.shape[-1],
    functools.partial(_loop, reverse=True),
    hands_on=True,
    in_pieces=True,
)(_loop)


@compiled(hands_on=True)
def restart(journey: Journey, watch: Watch | None = None, batched: bool = False) -> Journey:
    """`propagation.restart`, of one journey or of several."""
    one = functools.partial(propagation.restart, watch=watch)
    return jax.vmap(one)(journey) if batched else one(journey)


def summary_of(journey: Journey, xp: ModuleType = jnp):
    """(transversality, grazing, simultaneous, accumulation, doubtful) of a journey, whatever its mover."""
    memory = getattr(journey.carry.own, "memory", None)
    if memory is None:
        zero = xp.zeros_like(journey.carry.s)
        return zero + np.inf, zero, zero, zero + np.nan, zero
    return tuple(memory[..., i] for i in (4, 5, 6, 7, 9))


class Outcome(NamedTuple):
    """Where a run ended, and its records."""

    journey: Journey
    records: Any  # propagation.Record with leading axes ([m,] blocks)
    status: Any
    interrupted: bool
    logs: tuple = ()  # of events, to be joined
    why: str = ""  # a run has stalled, in words


def drive(
    problem: Problem,
    plan: Plan,
    journey: Journey,
    ends,
    last_jumps,
    max_steps=None,
    progress=None,
    interrupted: bool = False,
    part: Part | None = None,
) -> Outcome:
    """Run all blocks: in one call where traced, else call by call.

    Args:
        problem: what.
        plan: how.
        journey: from `start`, or `restart` of an earlier outcome's.
        ends: (blocks,) of the blocks, in time since the run began.
        last_jumps: (blocks,) number of jumps that ends each block; ignored unless plan.count_jumps.
        max_steps: most attempts; None: no limit, but a run that gets nowhere ends as stalled.
        progress: None, True for a bar, or a function of the fraction done.
        interrupted: before it began: nothing is computed.
        part: where it is kept on disk; of a run that has no log of events.
    """
    limit = 0 if interrupted else FOREVER if max_steps is None else max_steps
    leaves = jax.tree.leaves((journey, problem, ends, last_jumps))
    if traced(leaves):
        journey, records = _advance(problem, plan, journey, ends, last_jumps, limit)
        kept = () if journey.carry.log is None else (journey.carry.log,)
        return Outcome(journey, records, _verdict(journey, ends, SHORT), False, kept)
    blocks, records, budget, given, done = ends.shape[0], None, FIRST, 0, 0.0
    logs: list[propagation.Events] = []
    report = reporter(progress)
    if part is not None:
        journey, records, given = part.begun(
            journey, lambda: eqx.filter_eval_shape(once, problem, plan, journey, ends, last_jumps, np.int32(0))[1]
        )
    pace, why = Pace(journey, given, ends[-1], last_jumps[-1], plan.count_jumps), ""
    try:
        while records is None or (not _finished(journey, blocks) and (limit == FOREVER or given < limit)):
            allowed = budget if limit == FOREVER else min(budget, limit - given)
            clock, compiled = time.perf_counter(), compilations()
            journey, fresh = jax.block_until_ready(
                _advance(problem, plan, journey, ends, last_jumps, np.int32(allowed))
            )
            records = fresh if records is None else _merge(records, fresh)
            journey = _drain(journey, logs)
            given += allowed
            if part is not None:
                part.keep(journey, records, given)
            before, done = done, float(np.mean(np.asarray(journey.block))) / blocks
            if compilations() == compiled:  # the time of a call that compiled says nothing about the loop's speed
                seconds = time.perf_counter() - clock
                budget = int(np.clip(budget * min(SECONDS_PER_CALL / seconds, MOST_FASTER), FEWEST, MOST))
                if done > before:
                    left = (1 - done) / (done - before) * seconds
                    _advance.ahead(left, problem, plan, journey, ends, last_jumps, np.int32(allowed))
            if max_steps is None:
                stalled = pace.look(journey, given, functools.partial(_rates, problem, journey))
                journey, said = given_up(journey, stalled)
                why = why or said
            report(done)
    except KeyboardInterrupt:
        if records is None:
            raise
        warnings.warn("interrupted: the result holds what was computed until then.", stacklevel=3)
        interrupted = True
    report(None)
    if part is not None:
        part.keep(journey, records, given, now=True)
    status = _verdict(journey, ends, np.int32(STATUS.interrupted) if interrupted else SHORT)
    return Outcome(journey, records, status, interrupted, tuple(logs), why)


def _rates(problem: Problem, journey: Journey, run: int) -> Rates | None:
    """How fast things change where a run stands; None where no field says it."""
    carry, several = journey.carry, journey.carry.x.ndim == 2
    if problem.method is None:
        return None
    t, x, mode = (
        np.asarray(leaf)[run] if several and np.ndim(leaf) else np.asarray(leaf)
        for leaf in (journey.base[..., 0] + carry.s, carry.x, mode_of(carry, np))
    )
    try:
        return Rates(*map(float, _rates_at(problem, t, x, mode)))
    except Exception:  # a callback has no derivative: then nothing is known
        return None


@compiled()
def _rates_at(problem: Problem, t, x, mode):
    mover = mover_of(problem, t, x)
    assert isinstance(mover, Stepping), "what has a method has fields"
    return rates_of(lambda t, x: by_mode(mode, mover.wiring.fields, t, x), t, x)


def once(
    problem: Problem, plan: Plan, journey: Journey, ends, last_jumps, budget
) -> tuple[Journey, propagation.Record]:
    """So many attempts: the compiled loop."""
    return _advance(problem, plan, journey, ends, last_jumps, budget)


def sealed(outcome: Outcome) -> Journey:
    """The journey of an outcome that did not reach its end stays where it is, with its verdict."""
    journey = outcome.journey
    return journey._replace(carry=journey.carry._replace(status=outcome.status))


def _drain(journey: Journey, logs: list) -> Journey:
    """Take the events out of the log: a run pauses where it is full."""
    log = journey.carry.log
    if log is None:
        return journey
    # NumPy's, for JAX would compile a slice for every number of events.
    logs.append(jax.tree.map(lambda leaf, upto=int(log.count): np.array(leaf)[:upto], log._replace(count=None)))
    emptied = log._replace(count=jnp.zeros_like(log.count))
    return journey._replace(carry=journey.carry._replace(log=emptied))


def _finished(journey: Journey, blocks: int) -> bool:
    running = np.asarray(journey.carry.status) == 0
    return not bool(np.any(running & (np.asarray(journey.block) < blocks)))


@compiled()
def _verdict(journey: Journey, ends, otherwise):
    """The status; where a run goes on still, though blocks are left, that of what has ended it."""
    short = (journey.carry.status == RUNNING) & (journey.block < ends.shape[0])
    return jnp.where(short, otherwise, journey.carry.status)


def _merge(old, new):
    """Records of an earlier call, overwritten where a later call finished a block; on the host: nothing to compile."""
    finished = np.asarray(new.valid)

    def leaf(a, b):
        return np.where(finished.reshape(finished.shape + (1,) * (b.ndim - finished.ndim)), b, a)

    return jax.tree.map(leaf, old, new)


def reporter(progress, total: int = 100, unit: str = "%"):
    """A function of the fraction done, None at the end, as `progress` says: None, True for a bar, or a function."""
    if progress is None or progress is False:
        return lambda fraction: None
    if callable(progress):
        return lambda fraction: None if fraction is None else progress(fraction)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # in a notebook without ipywidgets the bar is text
        from tqdm.auto import tqdm

    rate = "" if unit == "%" else ", {rate_fmt}"
    bar = tqdm(total=total, unit=unit, bar_format=f"{{l_bar}}{{bar}}| {{elapsed}}<{{remaining}}{rate}")

    def report(fraction):
        if fraction is None:
            bar.close()
        else:
            bar.update(round(total * fraction) - bar.n)

    return report
