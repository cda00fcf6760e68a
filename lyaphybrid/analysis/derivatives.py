"""Derivatives at a point: the saltation matrix, and the Jacobians it consists of."""

import functools
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arguments import Real, State
from .._jax.precision import GUARD_ROUNDING, digits
from .._jax.tracing import traced
from .._text import Table
from ..engine import preparation
from ..engine.evolvers.constraints import landing_of
from ..engine.evolvers.exact import Exact, integers
from ..engine.evolvers.scheduled import predicting_anew
from ..events.compiled_hybrid import by_mode, wire
from ..events.saltations import event_time_shifts, instant, pushforward, to_reference_time
from ..results.result import Data, Result
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import System
from ..systems.smooth import Flow, Map
from ..systems.validation import check_functions

__all__ = ["Jacobians", "jacobians", "saltation_matrix"]

ON_GUARD = 1e-6  # a point is on a guard if |h| is below this times the terms of h and of its rate


class Parts(NamedTuple):
    """The parts of `Jacobians`, which is a tuple."""

    Df: Array | None
    Dg: tuple[Array, ...]
    Dh: tuple[Array, ...]
    dg_dt: tuple[Array, ...]
    dh_dt: tuple[Array, ...]


class Jacobians(Result, Parts):
    """Derivatives at a point by automatic differentiation; tuples have one entry for each transition.

    Attributes:
        Df: (n, n) of the field (of a map's rule); None where there is no flow.
        Dg: (n, n) of each reset; (m, n, n) for a vector guard of m components.
        Dh: (n,) of each guard; (m, n) for a vector guard. A clock is the guard h = tick - t: zeros.
        dg_dt: (n,) or (m, n), partial derivative of each reset by time.
        dh_dt: () or (m,), partial derivative of each guard by time; -1 for a clock.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        ...     names=("height", "speed"),
        ... )
        >>> found = lh.jacobians(ball, 1.0, [0.0, -1.0])
        >>> found.Df.tolist(), found.Dg[0].tolist(), found.Dh[0].tolist()
        ([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [-0.0, -1.0]], [1.0, 0.0])
    """

    __slots__ = ()

    def _arrays(self) -> dict[str, Any]:
        """By name: "Df", "Dg_0", …; those that are there."""
        found = {} if self.Df is None else {"Df": self.Df}
        for name in ("Dg", "Dh", "dg_dt", "dh_dt"):
            found |= {f"{name}_{j}": one for j, one in enumerate(getattr(self, name))}
        return found

    def _table(self) -> Table:
        rows = [
            (f"{name} {np.shape(one)}", " ".join(np.array2string(np.asarray(one), precision=6).split()))
            for name, one in self._arrays().items()
        ]
        return Table(f"Jacobians of the field and of {len(self.Dg)} transitions", rows)

    def _data(self) -> Data:
        last = {"Df": ("state", "by"), "Dg": ("state", "by"), "Dh": ("by",), "dg_dt": ("state",), "dh_dt": ()}
        variables = {}
        for name, one in self._arrays().items():
            own = last[name.rpartition("_")[0] or name]
            several = np.ndim(one) > len(own)  # of a vector guard
            variables[name] = ((f"component_{name.rpartition('_')[2]}", *own) if several else own, one)
        return Data(variables, {}, {"transitions": len(self.Dg)})


def jacobians(
    system: System,
    t: Real,
    x: State,
    args: Any = None,
    *,
    mode: Any = None,
    which: Any = None,
) -> Jacobians:
    """The Jacobians of field, resets and guards at (t, x), by automatic differentiation.

    Df = ∂f/∂x of the mode, Dg_j = ∂g_j/∂x of every reset, Dh_j = ∂h_j/∂x of every guard, whether it is
    active in the mode or not. A saltation matrix consists of these and of ∂g_j/∂t and ∂h_j/∂t.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        t: time (the number of the iteration for a map).
        x: (n,) state.
        args: pytree of parameters.
        mode: name or index of the mode whose field is differentiated; needed where there are several.
        which: for an `lh.EventDriven`: which event; None: the next one from (t, x).

    Returns:
        `Jacobians` with `.Df` (n, n); `.Dg`, `.Dh`, `.dg_dt`, `.dh_dt`, tuples with one entry a transition.
        An `lh.EventDriven` has one transition, and its field is the velocity of the closed-form flow.

    Raises:
        ValueError: on a system, state or mode that does not fit.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.array([x[1], -1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.array([x[0], -0.8 * x[1]])),
        ... )
        >>> at_impact = lh.jacobians(ball, 1.0, [0.0, -1.0])
        >>> print(at_impact.Df)
        [[0. 1.]
         [0. 0.]]
        >>> print(at_impact.Dh[0])
        [1. 0.]
    """
    system, x, args, t, mode = _checked(system, x, args, t, mode)
    return _jacobians(system, t, x, args, mode, integers(which))


@eqx.filter_jit
def _jacobians(system, t, x, args, mode, which) -> Jacobians:
    if isinstance(system, Flow | Map):
        function = system.field if isinstance(system, Flow) else system.rule
        return Jacobians(jax.jacfwd(function, argnums=1)(t, x, args), (), (), (), ())
    if isinstance(system, EventDriven):
        which = integers(system.next_event(t, x, args)[1]) if which is None else which
        widths = (0,)
    else:
        widths = _widths(system, t, x, args)
    parts = []
    for j, width in enumerate(widths):

        def component(i, j=j):
            crossing = _crossing(system, t, x, args, (j,), (i,))
            return _of_event(crossing.guard, crossing.jumps[0].reset, t, x)

        event = which if isinstance(system, EventDriven) else jnp.asarray(0)
        parts.append(jax.vmap(component)(jnp.arange(width)) if width else component(event))
    velocity = _crossing(system, t, x, args, (0,), (0,)).velocity
    flow = None if velocity is None else jax.jacfwd(lambda x: velocity(mode, t, x))(x)
    return Jacobians(flow, *zip(*parts, strict=True))


def _of_event(guard, reset, t, x):
    """Dg, Dh, ∂ₜg and ∂ₜh."""
    dg_dt, dg = jax.jacfwd(reset, argnums=(0, 1))(t, x)
    dh_dt, dh = jax.grad(guard, argnums=(0, 1))(t, x)
    return dg, dh, dg_dt, dh_dt


def saltation_matrix(
    system: System,
    t: Real,
    x: State,
    args: Any = None,
    *,
    transition: Any = 0,
    mode: Any = None,
    which: Any = None,
) -> Array:
    """How a perturbation crosses an event: dx⁺ = S dx at a point (t, x) on a guard, x before the jump.

    S = Dg + (f⁺ - Dg f⁻ - ∂ₜg) ∇h / (∂ₜh + ∇h·f⁻)

    with the field f⁻ of the mode before and f⁺ of the mode after the jump. At the tick of a clock, and where
    there is no flow, S = Dg. In a cascade the first guard h₁ alone sets the event time:
    S ← Dg₂ S + (f⁺⁺ - Dg₂ f⁺ - ∂ₜg₂) ∇h₁ / (∂ₜh₁ + ∇h₁·f⁻) for each further reset.

    Args:
        system: an `lh.Hybrid` or `lh.EventDriven`.
        t: time of the event.
        x: (n,) state just before the jump, on the guard.
        args: pytree of parameters.
        transition: index of the transition; or several, in order, for a cascade at one instant.
        mode: name or index of the mode before the jump; None: the only one, or the transition's only source.
        which: for a vector guard the component that fires (one each, where `transition` is several); for an
            `lh.EventDriven` the event, as its `next_event` calls it.

    Returns:
        S (n, n). Under a transformation nothing is checked, and S is nan where the rate of the guard is 0.

    Raises:
        ValueError: if the point is not on the guard, |h| > 1e-6 (|∇h| (|x| + |f⁻|) + |∂ₜh|); if the contact
            is tangential, ∂ₜh + ∇h·f⁻ = 0; on a transition, mode or component that does not exist or fit; on
            a missing `which`.

    Source:
        M. di Bernardo, C. Budd, A. Champneys & P. Kowalczyk, Piecewise-smooth Dynamical Systems (Springer
        2008), section 2.5, doi:10.1007/978-1-84628-708-4.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.array([x[1], -1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.array([x[0], -0.5 * x[1]])),
        ... )
        >>> print(lh.saltation_matrix(ball, 1.0, [0.0, -2.0]))
        [[-0.5   0.  ]
         [ 0.75 -0.5 ]]
    """
    if not isinstance(system, Hybrid | EventDriven):
        raise ValueError(
            f"saltation_matrix needs a system that jumps, an lh.Hybrid or lh.EventDriven; got {type(system).__name__}."
        )
    if isinstance(system, EventDriven):
        if which is None:
            raise ValueError(
                "An EventDriven needs which=…, the event as next_event(t, x, args) -> (dt, which) calls it."
            )
        system, x, args, t, mode = _checked(system, x, args, t, mode)
        sequence, components = (0,), (integers(which),)
    else:
        sequence = _sequence(system, transition)
        source = _only_source(system, sequence[0]) if mode is None else mode
        _, x, args, t, mode = _checked(system, x, args, t, source)
        _require_armed(system, sequence[0], mode)
        components = _components(system, t, x, args, sequence, which)
    matrix, contact = _saltation(system, t, x, args, mode, sequence, components)
    if contact is not None and not traced(matrix):
        _require_on_guard(x, *map(float, contact))
    return matrix


class Jump(NamedTuple):
    """One of the resets at an event time."""

    reset: Any  # (t, x) -> x
    move: Any  # (mode, t, x) -> mode


class Crossing(NamedTuple):
    """The guard and the resets of one event time, with the parameters bound."""

    guard: Any  # (t, x) -> scalar, of the first transition
    ticks: bool  # a clock: the event time does not depend on the state
    jumps: tuple[Jump, ...]
    velocity: Any  # (mode, t, x) -> dx/dt; None where there is no flow
    land: Any = None  # (mode, t, x) -> x projected onto the mode's constraints; None: no constraints


def _crossing(system, t, x, args, sequence, which) -> Crossing:
    """Bind the parameters to a sequence of transitions; `which` has one component or event for each."""
    if isinstance(system, EventDriven):
        return _crossing_of_event(system, args, which[0])
    first = system.transitions[sequence[0]]

    def guard(t, x):
        if first.is_clock:
            return -t + 0 * jnp.sum(x)  # h = tick − t without the constant tick; only its derivatives matter
        return jnp.atleast_1d(first.guard(t, x, args))[which[0]]

    if system.fields is None:
        jump = Jump(lambda t, x: first.reset(t, x, args), lambda mode, t, x: mode)
        return Crossing(guard, True, (jump,), None)
    hybrid = wire(system, t, x, args)

    def jump_of(j, i):
        return Jump(lambda t, x: hybrid.resets[j](t, x, i), lambda mode, t, x: hybrid.targets[j](mode, t, x, i))

    def land(mode, t, x):
        return by_mode(mode, [landing_of(field) for field in hybrid.fields], t, x)

    def velocity(mode, t, x):
        return by_mode(mode, hybrid.fields, t, x)

    jumps = tuple(map(jump_of, sequence, which))
    return Crossing(guard, first.is_clock, jumps, velocity, land if hybrid.constrained else None)


def _crossing_of_event(system: EventDriven, args, event) -> Crossing:
    exact = Exact(system, args)
    jump = Jump(lambda t, x: system.jump(t, x, args, event), lambda mode, t, x: mode)

    def velocity(mode, t, x):
        del mode
        return exact.velocity(t, x)

    return Crossing(lambda t, x: system.guard(t, x, args, event), False, (jump,), velocity)


@eqx.filter_jit
def _saltation(system, t, x, args, mode, sequence, which):
    """S; and, to check that the point is on the guard, h, ḣ and the sizes of their terms."""
    crossing = _crossing(system, t, x, args, sequence, which)
    columns, contact = jnp.eye(x.shape[0], dtype=x.dtype), None
    direction = delay = jnp.zeros_like(x)
    if not crossing.ticks:
        f = crossing.velocity(mode, t, x)
        gradient, moving, rate = instant(crossing.guard, t, x, f)
        direction, delay = f, jnp.where(rate == 0, jnp.nan, event_time_shifts(gradient @ columns, rate))
        slope, moving = jnp.sqrt(jnp.sum(gradient**2)), jnp.abs(moving)
        speed, size = jnp.sqrt(jnp.sum(f**2)), jnp.sqrt(jnp.sum(x**2))
        contact = (crossing.guard(t, x), rate, slope * (size + speed) + moving, slope * speed + moving)
    for reset, move in crossing.jumps:
        after = move(mode, t, x)
        x, columns, direction = pushforward(reset, t, x, columns, direction)
        if crossing.land is not None:
            x, columns, direction = pushforward(functools.partial(crossing.land, after), t, x, columns, direction)
        mode = after
    if crossing.velocity is not None:
        columns = to_reference_time(columns, direction, crossing.velocity(mode, t, x), delay)
    return columns, contact


def _require_on_guard(x, h: float, rate: float, near: float, terms: float) -> None:
    on = digits(ON_GUARD, x) * near
    if not abs(h) <= on:
        raise ValueError(
            f"(t, x) is not on the guard: its value is {h:.6g}, and zero is what is below "
            f"{on:.2g}. Give t and x_before of an event, as lh.trajectory lists them."
        )
    if abs(rate) <= digits(GUARD_ROUNDING, x) * terms:
        raise ValueError(
            f"The contact is tangential: the guard's rate along the flow, ∂ₜh + ∇h·f⁻, is {rate:.2g}, and "
            "the saltation matrix grows like 1/rate."
        )


def _sequence(system: Hybrid, transition) -> tuple[int, ...]:
    """The transitions at one event time as indices, checked to exist."""
    several = transition if isinstance(transition, Sequence) else (transition,)
    count = len(system.transitions)
    for index in several:
        if not _is_index(index) or not 0 <= operator.index(index) < count:
            raise ValueError(
                f"transition must be an index from 0 to {count - 1}, or several in order; got {transition!r}."
            )
    if not several:
        raise ValueError("transition must name at least one transition; got none.")
    return tuple(map(operator.index, several))


def _is_index(value: Any) -> bool:
    """Whether it is an integer, or an array of one."""
    if isinstance(value, Array):
        return value.ndim == 0 and jnp.issubdtype(value.dtype, jnp.integer)
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _only_source(system: Hybrid, index: int) -> str | None:
    source = system.transitions[index].source
    return source[0] if source is not None and len(source) == 1 else None


def _require_armed(system: Hybrid, index: int, mode) -> None:
    source = system.transitions[index].source
    if source is None or traced(mode):
        return
    name = system.mode_names[int(mode)]
    if name not in source:
        raise ValueError(f"Transition {index} leaves the modes {list(source)}, not {name!r}.")


def _widths(system: Hybrid, t, x, args) -> list[int]:
    """0 for a scalar guard, a clock or a system of jumps only; m for a vector guard."""
    if system.fields is None:
        return [0]
    shapes = [() if tr.guard is None else jax.eval_shape(tr.guard, t, x, args).shape for tr in system.transitions]
    return [shape[0] if shape else 0 for shape in shapes]


def _components(system: Hybrid, t, x, args, sequence, which) -> tuple:
    """One guard component for each transition: as given for a vector guard, 0 for a scalar one."""
    given = which if len(sequence) > 1 and isinstance(which, Sequence) else (which,) * len(sequence)
    if len(given) != len(sequence):
        raise ValueError(f"which must have one entry for each of the transitions {sequence}; got {which!r}.")
    widths = _widths(system, t, x, args)
    for index, component in zip(sequence, given, strict=True):
        most = max(widths[index], 1) - 1
        if component is None and widths[index]:
            raise ValueError(
                f"The guard of transition {index} has {most + 1} components: say which one fires, which=0 to {most}."
            )
        if component is None or traced(component):
            continue
        if not _is_index(component) or not 0 <= operator.index(component) <= most:
            raise ValueError(f"The components of transition {index}'s guard are 0 to {most}; got which={component!r}.")
    return tuple(integers(0 if component is None else component) for component in given)


def _checked(system, x, args, t, mode):
    """The system as functions of a flat state; the state, the parameters, the time, the mode's index: as arrays."""
    problem, x, t, mode = preparation.prepare(system, x, args, t, None, mode, "x")
    if x.ndim != 1:
        raise ValueError(f"x must have shape (n,) here; got {x.shape}. Use jax.vmap for several points.")
    args = problem.args
    check_functions(system, jax.ShapeDtypeStruct(problem.shape, x.dtype), args)
    if mode is None:
        mode = system.initial_mode(t, x, args)
    flat = predicting_anew(system, problem.shape) if isinstance(system, EventDriven) else system
    return flat, x, args, t, jnp.asarray(mode, jnp.int32)
