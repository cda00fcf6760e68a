"""Events: which guard, where in the step, and on which side of zero a guard stands after a jump.

Every transition is expanded at construction into *slots*: one falling guard each (direction +1 is negated;
direction 0 keeps both directions and is never fired by a jump), one list of slots per mode. A slot's `side` is
the sign that the guard has or is about to have. The guarantee: with at most one extremum of a guard inside an
accepted step no crossing is missed, because a step is cut at an extremum that might lie beyond zero, so that
every crossing shows as a change of sign between the ends of a step.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ._jaxprs import settled
from .daes import Constrained, is_constrained
from .eliminations import prepared
from .precision import DOUBLE, digits, nonzero
from .systems import Bound, Hybrid

__all__ = ["Wiring", "bound", "by_mode", "arm", "hermite_root", "projection", "rounding", "turning_point", "wire"]

BLUR = 64 * DOUBLE  # rounding of a guard, relative to its terms


class Wiring(NamedTuple):
    """A hybrid system's modes and slots; tables have shape (modes, slots) or (modes, clocks)."""

    fields: tuple[Callable, ...]  # per mode: (t, x) -> dx/dt
    guards: tuple[Callable, ...]  # per mode: (t, x) -> (slots,), all falling
    projections: tuple[Callable | None, ...]  # per mode: (t, x, dx) -> dx
    directed: np.ndarray  # fires only when falling
    transition: np.ndarray  # transition of a slot
    component: np.ndarray  # component of a vector guard
    clocks: tuple[int, ...]  # transitions that are clocks
    armed: np.ndarray  # (modes, clocks): is the clock armed in the mode
    resets: tuple[Callable, ...]  # per transition: (t, x, which) -> x
    targets: tuple[Callable, ...]  # per transition: (mode, t, x, which) -> mode
    whens: tuple[Callable, ...]  # per mode: (t, x) -> (slots,) bool
    shared: bool  # some transition asks `when`
    borders: np.ndarray | None  # (modes, slots): borders of flow sets, where nothing fires; None: there are none
    initial_mode: Callable | None = None  # (t, x) -> mode

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
        """Number of slots of a mode (the modes with fewer are padded with a guard that is always 1)."""
        return self.directed.shape[1]

    def of_mode(self, q: int) -> "Wiring":
        """What concerns one mode, as if there were no other."""
        of_modes = "fields", "guards", "projections", "directed", "transition", "component", "armed", "whens"
        of_modes += () if self.borders is None else ("borders",)
        return self._replace(**{name: getattr(self, name)[q : q + 1] for name in of_modes})


def by_mode(mode, functions, *operands):
    """The function of the present mode: a plain call where there is one mode, else a switch."""
    if len(functions) == 1:
        return functions[0](*operands)
    return jax.lax.switch(mode, functions, *operands)


def wire(system: Hybrid, t, x, args) -> Wiring:
    """Expand a hybrid system into slots; guards are asked for their shapes, nothing is computed."""
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
    return Wiring(
        tuple(bound(field, args, t, x) for field in fields),
        tuple(settled(_bind_guards([transitions[j] for j in own], slots, args), t, x) for own in per_mode),
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
        _bind_initial_mode(system.initial_mode, args),
    )


def _borders(system: Hybrid, transition: np.ndarray) -> np.ndarray | None:
    """The slots of the transitions that a system adds for its flow sets; padding slots belong to transition 0."""
    count = len(system.transitions)
    return transition >= count if len(system.guarded) > count else None


def _armed(transition, name) -> bool:
    return transition.source is None or name in transition.source


def _width(guard, t, x, args) -> int:
    """0 for a scalar guard or a clock, m for a vector guard."""
    if guard is None:
        return 0
    shape = jax.eval_shape(guard, t, x, args).shape
    return shape[0] if shape else 0


def bound(field, args, t, x) -> Bound:
    """A field with its parameters, and what these alone decide computed here and now."""
    field = prepared(field, t, x, args) if isinstance(field, Constrained) else field
    return Bound(field, args, settled(Bound(field, args), t, x))


def _bind_guards(transitions, slots, args):
    def guards(t, x):
        values = [jnp.atleast_1d(tr.guard(t, x, args)) * (-1.0 if tr.direction > 0 else 1.0) for tr in transitions]
        short = slots - sum(v.shape[0] for v in values)
        return jnp.concatenate([*values, jnp.ones(short, x.dtype)]) if short or len(values) > 1 else values[0]

    return guards


def projection(field: Any, project: Callable | None, args: Any) -> Callable | None:
    """Onto the tangent space of a mode: that of the algebraic equations, and what the user says of it."""
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


def rates(guards, t, x, f):
    """The guards (slots,) and their rates along the flow f."""
    return jax.jvp(guards, (t, x), (jnp.ones_like(t), f))


def rounding(guards, t, x):
    """The rounding of the guards (slots,): of the time and of the state, as the guards feel them."""
    moving, gradient = jax.jacfwd(guards, argnums=(0, 1))(t, x)
    return digits(BLUR, x) * (jnp.abs(moving * t) + jnp.sum(jnp.abs(gradient * x[None, :]), axis=1))


def jets(guards, field, t, x):
    """The guards, their first and second time derivatives along the field: (slots,) each."""

    def first(t, x):
        return rates(guards, t, x, field(t, x))

    (g, rate), (_, second) = jax.jvp(first, (t, x), (jnp.ones_like(t), field(t, x)))
    return g, rate, second


def arm(g, rate, second, blur, h, t, fired) -> tuple[Any, Any, Any, Any]:
    """The side (slots,) where each guard stands or is about to, guards and rates with zeros made exact, which are flat.

    A guard that is zero up to rounding takes its side from its rate, and where that is zero too from its
    second derivative: the exit from a stick has v = v̇ = 0. A rate that is rounding must not be kept: late, when an
    instant is blurred, it would show a guard that first turns back through zero.

    Args:
        g: the guards.
        rate: their first derivatives in time.
        second: their second derivatives.
        blur: their rounding.
        h: the step of the controller, the local scale of time.
        t: the time, whose rounding enters the rates.
        fired: which slot has just fired here (its own root was only found to the accuracy of the flow).
    """
    loose = jnp.where(fired, digits(1e-9, g), digits(1e-12, g))
    curve = 0.5 * jnp.abs(second) * h * h
    zero = jnp.abs(g) <= loose * jnp.maximum(jnp.abs(rate) * h, curve) + blur
    flat = zero & (jnp.abs(rate) * h <= digits(1e-8, g) * curve + digits(BLUR, g) * jnp.abs(t * second) * h)
    side = jnp.where(flat, jnp.sign(second), jnp.where(zero, jnp.sign(rate), jnp.sign(g)))
    return side, jnp.where(zero, 0.0, g), jnp.where(flat, 0.0, rate), flat


def cubic(theta, g0, d0, g1, d1):
    """Value and slope at theta of the cubic with values g0, g1 and slopes d0, d1 at theta = 0 and 1."""
    a = d0 + d1 - 2 * (g1 - g0)
    b = g1 - g0 - d0 - a
    return g0 + theta * (d0 + theta * (b + theta * a)), d0 + theta * (2 * b + theta * 3 * a)


def turning_point(g0, d0, g1, d1):
    """The extremum theta in (0, 1) of the cubic whose end slopes differ in sign."""
    a = 3 * (d0 + d1 - 2 * (g1 - g0))
    b = 2 * (3 * (g1 - g0) - 2 * d0 - d1)
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * d0, nonzero(1e-300, a)))
    q = -0.5 * (b + jnp.where(b >= 0, root, -root))
    # d0 / q and q / a are the two roots of a θ² + b θ + d0; the slopes' signs say which one lies inside.
    first = d0 / jnp.where(q == 0, nonzero(1e-300, q), q)
    second = q / jnp.where(a == 0, nonzero(1e-300, a), a)
    inside = (first >= 0) & (first <= 1)
    return jnp.clip(jnp.where(inside, first, second), 0.0, 1.0)


def hermite_root(lo, g0, d0, g1, d1):
    """The root in (lo, 1) of the cubic, by Newton steps kept inside a shrinking bracket."""
    falling = jnp.sign(g1)  # the sign beyond the root

    def narrow(_, state):
        left, right, theta = state
        value, slope = cubic(theta, g0, d0, g1, d1)
        beyond = value * falling >= 0
        left, right = jnp.where(beyond, left, theta), jnp.where(beyond, theta, right)
        newton = theta - value / jnp.where(slope == 0, nonzero(1e-300, slope), slope)
        good = (newton > left) & (newton < right)
        return left, right, jnp.where(good, newton, 0.5 * (left + right))

    chord = g0 / jnp.where(g0 == g1, 1.0, g0 - g1)
    start = jnp.where((chord > lo) & (chord < 1), chord, 0.5 * (lo + 1))
    return jax.lax.fori_loop(0, 12, narrow, (lo, jnp.ones_like(lo), start))[2]
