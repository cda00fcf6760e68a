"""Whether a state lies in the flow set and in the jump set of a system."""

from typing import Any

import jax.numpy as jnp

from .._jax.precision import digits
from .._jax.tracing import array, as_arrays
from ..events import roots
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import iterates
from ..systems.membership import Membership, membership
from ..systems.smooth import Map
from .binding import number
from .evolvers.accumulations import hidden_below
from .evolvers.exact import integers, is_event
from .evolvers.scheduled import predicting_anew
from .preparation import mode_index

__all__: list[str] = []


def _yes_and_no():
    return jnp.asarray(True), jnp.asarray(False)


def _as_arrays(x, args: Any, t):
    """The state, the parameters and the time as arrays of one floating type."""
    x = jnp.asarray(x, float) if not hasattr(x, "dtype") else jnp.asarray(x)
    return x, as_arrays(args, x.dtype), array(t, x.dtype)


@membership.register
def _of_a_map(system: Map, x, args: Any, t, mode) -> Membership:
    del system, x, args, t, mode
    yes, no = _yes_and_no()
    return Membership(no, yes)


@membership.register
def _of_an_event_driven_system(system: EventDriven, x, args: Any, t, mode) -> Membership:
    del mode
    x, args, t = _as_arrays(x, args, t)
    return Membership(_yes_and_no()[0], _is_due(system, x, args, t))


@membership.register
def _of_a_hybrid_system(system: Hybrid, x, args: Any, t, mode) -> Membership:
    yes, no = _yes_and_no()
    if iterates(system):
        return Membership(no, yes)
    x, args, t = _as_arrays(x, args, t)
    q = mode_index(system, mode)
    if q is None:
        raise ValueError(f"mode is missing, and the system has the modes {list(system.mode_names)}: give mode=….")
    name, jump = system.mode_names[q], no
    for transition in system.transitions:
        if transition.source is not None and name not in transition.source:
            continue
        if transition.is_clock:
            turns = (t - number(transition.phase, args)) / number(transition.every, args)
            at = jnp.abs(turns - jnp.round(turns)) <= digits(1e-9, x)
        else:
            guard_sign = 1.0 if transition.direction > 0 else -1.0
            assert transition.guard is not None, "what is no clock has a guard"
            at = _reached(
                lambda t, x, guard=transition.guard, guard_sign=guard_sign: (
                    guard_sign * jnp.atleast_1d(guard(t, x, args))
                ),
                t,
                x,
            )
            at = at[0] if transition.direction else at[1]
        jump = jump | jnp.any(at if transition.when is None else at & transition.when(t, x, args))
    inside = system.flow_sets[q]
    if inside is None:
        return Membership(yes, jump)
    return Membership(jnp.all(_reached(lambda t, x: jnp.atleast_1d(inside(t, x, args)), t, x)[0]), jump)


def _is_due(system: EventDriven, x, args: Any, t):
    """Whether the next event is now, up to the rounding of its guard."""
    flat, state = predicting_anew(system, x.shape), x.ravel()
    dt, which = flat.next_event(t, state, args)
    which = integers(which)
    hidden = hidden_below(lambda t, x: flat.guard(t, x, args, which), t, state, flat.velocity(t, state, args))
    return is_event(which) & (dt <= hidden)


def _reached(function, t, x):
    """Where the functions are >= 0, and where they are 0, both up to rounding."""
    value, rounding = function(t, x), roots.rounding(function, t, x)
    return value >= -rounding, jnp.abs(value) <= rounding
