"""Flow set and jump set: in which of them a state lies."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from . import events
from ._tracing import array, traced
from .precision import digits
from .systems import EventDriven, Hybrid, iterates

__all__ = ["Membership", "membership"]


class Membership(NamedTuple):
    """Whether a state lies in the flow set C, and in the jump set D, up to rounding.

    Attributes:
        flow: in C: where the motion may flow.
        jump: in D: where a transition may fire, a guard being at zero or on its fired side, or a clock ticking.
    """

    flow: Any
    jump: Any

    @property
    def where(self) -> str:
        """The word: C, D, both or neither; not under a transformation."""
        if traced(self):
            raise ValueError("Membership.where is for values on the host; under jit, vmap or grad use .flow and .jump.")
        return {(True, True): "both", (True, False): "C", (False, True): "D", (False, False): "neither"}[
            bool(self.flow), bool(self.jump)
        ]

    def __repr__(self) -> str:
        return f"Membership({self.where if not traced(self) else 'under a transformation'})"


def membership(system, x, args: Any, t, mode) -> Membership:
    """Where the state x (n,) lies at the time t, in the mode of this name or index."""
    from .runs import as_arrays, mode_index, number

    x = jnp.asarray(x, float) if not hasattr(x, "dtype") else jnp.asarray(x)
    yes, no = jnp.asarray(True), jnp.asarray(False)
    if iterates(system):
        return Membership(no, yes)
    t, args = array(t, x.dtype), as_arrays(args, x.dtype)
    if isinstance(system, EventDriven):
        return Membership(yes, _is_due(system, x, args, t))
    if not isinstance(system, Hybrid):
        return Membership(yes, no)
    q = mode_index(system, mode)
    if q is None:
        raise ValueError(f"In which mode? The modes are {list(system.mode_names)}: say mode=….")
    name, jump = system.mode_names[q], no
    for transition in system.transitions:
        if transition.source is not None and name not in transition.source:
            continue
        if transition.is_clock:
            turns = (t - number(transition.phase, args)) / number(transition.every, args)
            at = jnp.abs(turns - jnp.round(turns)) <= digits(1e-9, x)
        else:
            side = 1.0 if transition.direction > 0 else -1.0
            assert transition.guard is not None, "what is no clock has a guard"
            at = _reached(
                lambda t, x, guard=transition.guard, side=side: side * jnp.atleast_1d(guard(t, x, args)), t, x
            )
            at = at[0] if transition.direction else at[1]
            at = jnp.any(at)
        jump = jump | (at if transition.when is None else at & transition.when(t, x, args))
    inside = system.flow_sets[q]
    if inside is None:
        return Membership(yes, jump)
    return Membership(jnp.all(_reached(lambda t, x: jnp.atleast_1d(inside(t, x, args)), t, x)[0]), jump)


def _is_due(system: EventDriven, x, args: Any, t):
    """Whether the next event is now: no later than rounding of its guard tells."""
    from .methods.accumulations import hidden_below
    from .methods.exact import integers, is_event
    from .methods.scheduled import predicting_anew

    flat, state = predicting_anew(system, x.shape), x.ravel()
    dt, which = flat.next_event(t, state, args)
    which = integers(which)
    hidden = hidden_below(lambda t, x: flat.guard(t, x, args, which), t, state, flat.velocity(t, state, args))
    return is_event(which) & (dt <= hidden)


def _reached(function, t, x):
    """Where the functions are at zero or above it, and where at zero, up to rounding."""
    value, rounding = function(t, x), events.rounding(function, t, x)
    return value >= -rounding, jnp.abs(value) <= rounding
