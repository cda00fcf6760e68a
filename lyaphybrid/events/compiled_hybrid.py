"""A hybrid system's modes, guards, resets and targets, expanded once into tables.

Each mode gets one vector (slots,) of scalar guards; `slots` is the largest number of guards of a mode. Guards fire when
they fall through zero: one of direction +1 is negated; one of direction 0 fires in both directions, but a reset never
makes it fire. A vector guard takes one entry per component.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._jax.calls import Calls
from .._jax.jaxprs import partially_evaluated
from ..systems.bound import Bound
from ..systems.daes.eliminations import with_eliminations
from ..systems.daes.semi_linear import Constrained, is_constrained
from ..systems.hybrid import Hybrid

__all__ = ["CompiledHybrid", "bound", "by_mode", "projection", "wire"]


class CompiledHybrid(NamedTuple):
    """A hybrid system with `args` bound; tables have shape (modes, slots) or (modes, clocks)."""

    fields: tuple[Callable, ...]  # per mode: (t, x) -> dx/dt
    guards: tuple[Callable, ...]  # per mode: (t, x) -> (slots,), firing when they fall
    projections: tuple[Callable | None, ...]  # per mode: (t, x, dx) -> dx
    directed: np.ndarray  # (modes, slots): fires only when falling
    transition: np.ndarray  # (modes, slots): index of the guard's transition
    component: np.ndarray  # (modes, slots): component of a vector guard
    clocks: tuple[int, ...]  # indices of the transitions that are clocks
    armed: np.ndarray  # (modes, clocks): whether the clock is armed in the mode
    resets: tuple[Callable, ...]  # per transition: (t, x, which) -> x
    targets: tuple[Callable, ...]  # per transition: (mode, t, x, which) -> mode
    whens: tuple[Callable, ...]  # per mode: (t, x) -> (slots,) bool
    shared: bool  # whether some transition has a condition `when`
    borders: np.ndarray | None  # (modes, slots): guards that are borders of flow sets; None: there are none
    calls: Calls  # the functions of one step in each mode, each traced once
    initial_mode: Callable | None = None  # (t, x) -> mode
    recording: np.ndarray | None = (
        None  # (modes, slots): guards of transitions that change nothing; None: there are none
    )

    @property
    def constrained(self) -> bool:
        """Whether there are algebraic equations in some mode."""
        return any(is_constrained(field) for field in self.fields)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.fields)

    @property
    def slots(self) -> int:
        """Number of guards in every mode; modes with fewer guards are padded with guards that are always 1."""
        return self.directed.shape[1]

    def of_mode(self, q: int) -> "CompiledHybrid":
        """The same system restricted to mode q."""
        of_modes = "fields", "guards", "projections", "directed", "transition", "component", "armed", "whens"
        of_modes += tuple(name for name in ("borders", "recording") if getattr(self, name) is not None)
        return self._replace(**{name: getattr(self, name)[q : q + 1] for name in of_modes})


def by_mode(mode, functions, *operands):
    """Call the function of the present mode: directly if there is one mode, else by `lax.switch`."""
    if len(functions) == 1:
        return functions[0](*operands)
    return jax.lax.switch(mode, functions, *operands)


def wire(system: Hybrid, t, x, args) -> CompiledHybrid:
    """Expand a hybrid system into tables; only the shapes of guards are evaluated."""
    names, transitions, fields = system.mode_names, system.guarded, system.fields or ()
    widths = [_width(tr.guard, t, x, args) for tr in transitions]
    per_mode = [[j for j, tr in enumerate(transitions) if not tr.is_clock and _armed(tr, name)] for name in names]
    slots = max(1, *(sum(max(1, widths[j]) for j in own) for own in per_mode))
    directed = np.ones((len(names), slots), bool)
    transition, component = np.zeros((len(names), slots), np.int32), np.zeros((len(names), slots), np.int32)
    for q, own in enumerate(per_mode):
        expanded = [(j, c) for j in own for c in range(max(1, widths[j]))]
        for i, (j, c) in enumerate(expanded):
            directed[q, i], transition[q, i], component[q, i] = transitions[j].direction != 0, j, c
    clocks = tuple(j for j, tr in enumerate(transitions) if tr.is_clock)
    return CompiledHybrid(
        tuple(bound(field, args, t, x) for field in fields),
        tuple(partially_evaluated(_bind_guards([transitions[j] for j in own], slots, args), t, x) for own in per_mode),
        tuple(projection(field, project, args) for field, project in zip(fields, system.tangent, strict=False)),
        directed,
        transition,
        component,
        clocks,
        np.array([[_armed(transitions[j], name) for j in clocks] for name in names], bool).reshape(len(names), -1),
        tuple(_bind_reset(tr, width, args) for tr, width in zip(transitions, widths, strict=True)),
        tuple(_bind_target(tr, width, names, args) for tr, width in zip(transitions, widths, strict=True)),
        tuple(_bind_when([(transitions[j], max(1, widths[j])) for j in own], slots, args) for own in per_mode),
        any(tr.when is not None for tr in transitions),
        _borders(system, transition),
        Calls(),
        _bind_initial_mode(system.initial_mode, args),
        _recording(system, per_mode, widths, slots),
    )


def _borders(system: Hybrid, transition: np.ndarray) -> np.ndarray | None:
    """(modes, slots) which guards belong to transitions added for flow sets; padding belongs to transition 0."""
    count = len(system.transitions)
    return transition >= count if len(system.guarded) > count else None


def _recording(system: Hybrid, per_mode, widths, slots) -> np.ndarray | None:
    """(modes, slots) which guards belong to transitions that change nothing; the padding does not."""
    table = np.zeros((len(per_mode), slots), bool)
    for q, own in enumerate(per_mode):
        of_slot = [system.guarded[j].changes_nothing for j in own for _ in range(max(1, widths[j]))]
        table[q, : len(of_slot)] = of_slot
    return table if table.any() else None


def _armed(transition, name) -> bool:
    return transition.source is None or name in transition.source


def _width(guard, t, x, args) -> int:
    """0 for a scalar guard or a clock, m for a vector guard."""
    if guard is None:
        return 0
    shape = jax.eval_shape(guard, t, x, args).shape
    return shape[0] if shape else 0


def bound(field, args, t, x) -> Bound:
    """A vector field with its parameters; subexpressions of the parameters alone are computed now."""
    field = with_eliminations(field, t, x, args) if isinstance(field, Constrained) else field
    return Bound(field, args, partially_evaluated(Bound(field, args), t, x))


def _bind_guards(transitions, slots, args):
    def guards(t, x):
        values = [jnp.atleast_1d(tr.guard(t, x, args)) * (-1.0 if tr.direction > 0 else 1.0) for tr in transitions]
        short = slots - sum(v.shape[0] for v in values)
        return jnp.concatenate([*values, jnp.ones(short, x.dtype)]) if short or len(values) > 1 else values[0]

    return guards


def projection(field: Any, project: Callable | None, args: Any) -> Callable | None:
    """(t, x, dx) -> dx onto the tangent space of a mode: the user's projection, then that of algebraic equations."""
    field = field.field if isinstance(field, Bound) else field
    if isinstance(field, Constrained):
        if project is None:
            return lambda t, x, dx: field.onto(t, x, args, dx)
        return lambda t, x, dx: field.onto(t, x, args, project(t, x, args, dx))
    return None if project is None else (lambda t, x, dx: project(t, x, args, dx))


def _bind_reset(transition, width, args):
    if transition.reset is None:
        return lambda t, x, which: x
    if width:
        return lambda t, x, which: transition.reset(t, x, args, which)
    return lambda t, x, which: transition.reset(t, x, args)


def _bind_target(transition, width, names, args):
    target = transition.target
    if target is None:
        return lambda mode, t, x, which: mode
    if isinstance(target, str):
        return lambda mode, t, x, which: jnp.full_like(mode, names.index(target))
    if width:
        return lambda mode, t, x, which: jnp.asarray(target(t, x, args, which)).astype(mode.dtype)
    return lambda mode, t, x, which: jnp.asarray(target(t, x, args)).astype(mode.dtype)


def _bind_initial_mode(initial_mode, args):
    return None if initial_mode is None else (lambda t, x: initial_mode(t, x, args))


def _bind_when(transitions, slots, args):
    def when(t, x):
        values = [
            jnp.full(width, True) if tr.when is None else jnp.full(width, tr.when(t, x, args))
            for tr, width in transitions
        ]
        short = slots - sum(v.shape[0] for v in values)
        return jnp.concatenate([*values, jnp.full(short, True)])

    return when
