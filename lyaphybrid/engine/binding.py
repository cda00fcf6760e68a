"""Bind a problem to its evolver and its plan; this runs while JAX traces."""

import dataclasses
import functools

import jax
import numpy as np

from .._jax.calls import Calls
from .._jax.tracing import is_typed_key
from ..errors import UserFunctionError
from ..events.compiled_hybrid import CompiledHybrid, bound, projection, wire
from ..integrators import DiffraxEvents
from ..systems.bound import Bound
from ..systems.daes.semi_linear import Constrained
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.smooth import Flow, Map
from ..systems.validation import check_functions
from .evolvers.exact import Exact
from .evolvers.flights import Flights
from .evolvers.iterate import Iterating
from .evolvers.scheduled import Scheduled
from .evolvers.stepping import Stepping, are_nonlinear, are_timeless
from .problems import RunPlan, RunProblem
from .states import Settings

__all__ = ["evolver_of", "number", "settings_of"]

SHORT_CASCADE = 16  # jumps at one instant that are allowed where there are fewer guards


def evolver_of(problem: RunProblem, t, x):
    """The evolver of a problem, made while tracing; the user's functions are checked and get their `args`."""
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
        hybrid = CompiledHybrid(fields, (), onto, empty, empty, empty, (), empty, (), (), (), False, None, Calls())
        return _moving(hybrid, method, (), (), 0, t, x)
    if system.fields is None:
        reset = system.transitions[0].reset
        return Iterating(lambda n, x: reset(n, x, args))
    hybrid = wire(system, t, x, args)
    for field in hybrid.fields:
        method.require(field, t, x)
    clocks = tuple(
        (number(system.transitions[j].every, args), number(system.transitions[j].phase, args)) for j in hybrid.clocks
    )
    terminal = tuple(tr.terminal for tr in system.guarded)
    most = system.max_cascade or max(SHORT_CASCADE, hybrid.slots)
    return _moving(hybrid, method, clocks, terminal, most, t, x)


def _moving(hybrid, method, clocks, terminal, max_cascade, t, x) -> Stepping:
    """The evolver of a flow: `Flights` if the method locates events itself, else `Stepping`."""
    kind = Flights if isinstance(method, DiffraxEvents) else Stepping
    # Worked out when it is first asked for: it takes a derivative of each field, and many programs do not ask.
    nonlinear = functools.cache(lambda: are_nonlinear(hybrid.fields, t, x))
    return kind(hybrid, method, clocks, terminal, max_cascade, nonlinear)


def number(value, args):
    """The value of a clock's period or phase, which may be a function of `args`."""
    return value(args) if callable(value) else value


def settings_of(problem: RunProblem, plan: RunPlan, t, x, reverse: bool = False) -> Settings:
    """Bind a plan to a problem, while tracing."""
    own = plan._asdict()
    del own["batched"]
    if reverse and isinstance(problem.system, EventDriven | Hybrid):
        _refuse_typed_keys(problem.args)
    evolver = evolver_of(problem, t, x)
    if plan.count_jumps and isinstance(evolver, Stepping) and evolver.has_events:
        evolver = dataclasses.replace(evolver, per_jump=True, timeless=are_timeless(evolver.hybrid, t, x))
    if plan.count_jumps and isinstance(evolver, Scheduled):
        evolver = dataclasses.replace(evolver, per_jump=True)
    return Settings(evolver, **own, reverse=reverse)


def _refuse_typed_keys(args) -> None:
    """JAX cannot transpose conditionals over them (0.10 and 0.12)."""
    if any(is_typed_key(leaf) for leaf in jax.tree.leaves(args)):
        raise UserFunctionError(
            "args hold a typed key, jax.random.key(…), and JAX takes no reverse derivatives of a run with events over "
            "one: give jax.random.key_data(key) in args, which jax.random takes as well, or use jax.jacfwd."
        )
