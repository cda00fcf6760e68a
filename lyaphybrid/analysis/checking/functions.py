"""The user's functions by themselves: pure, with the derivatives that differences show, finite, and smooth."""

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import for_once
from ..._jax.jaxprs import needed
from ..._jax.precision import digits, eps
from ..._jax.tracing import without_key_type
from ...systems.daes.semi_linear import Constrained
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import System
from ...systems.smooth import Flow, Map
from .report import Finding, in_short, noted, right, wrong

__all__ = ["Function", "Visited", "check_derivatives", "check_purity", "functions_of"]

AT_ONCE = 4  # states of one call of a function's program
MOST_STATES = 5  # at which the derivative of a function is looked at
STATE_DIFFERENCE = 1e-5  # of a state for a central difference, relative to its size
DERIVATIVE_ERROR = (
    1e-4  # a derivative is wrong if it differs by more than this part, and differences agree with each other
)


@dataclasses.dataclass(eq=False)
class Function:
    """One of the user's functions, of time and state."""

    name: str
    of: Callable  # (t, x) -> array
    where: str  # "mode" or "event": at which states it is evaluated
    number: int  # of the mode, or of the transition; -1: all
    modes: tuple[int, ...] | None = None  # in which it is used; None: all
    _at_once: Callable | None = dataclasses.field(default=None, init=False, repr=False)

    def at(self, t, x, dx) -> list[np.ndarray]:
        """At m states: values (m, p), derivatives along dx (m, p), and derivatives by the time (m, p).

        One program for so many states at once is used for all, as code is made faster than it is called.
        """
        t, x, dx = np.asarray(t), np.asarray(x), np.asarray(dx)
        if self._at_once is None:
            self._at_once = for_once(self._all, *(_padded(one[:1]) for one in (t, x, dx)))
        parts = [
            self._at_once(*(_padded(one[i : i + AT_ONCE]) for one in (t, x, dx))) for i in range(0, len(t), AT_ONCE)
        ]
        return [np.concatenate([np.asarray(part) for part in each])[: len(t)] for each in zip(*parts, strict=True)]

    def _all(self, *states):
        def one(state):
            t, x, dx = state
            value, along = jax.jvp(lambda x: jnp.ravel(self.of(t, x)), (x,), (dx,))
            _, by_time = jax.jvp(lambda t: jnp.ravel(self.of(t, x)), (t,), (jnp.ones_like(t),))
            return [value, along, by_time]

        return jax.lax.map(one, states)


def _padded(rows: np.ndarray) -> np.ndarray:
    """Rows (AT_ONCE, …); the last one is repeated."""
    return np.concatenate([rows, np.repeat(rows[-1:], AT_ONCE - len(rows), axis=0)])


class Visited(NamedTuple):
    """States that a trial run has met."""

    t: Any  # (m,)
    x: Any  # (m, n)
    number: Any  # (m,) of the mode, or of the transition

    def of(self, number: int, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Times and states of up to so many of them, spread evenly."""
        own = np.flatnonzero((self.number == number) | (number < 0))
        own = own[np.unique(np.linspace(0, len(own) - 1, most).astype(int))] if len(own) else own
        return self.t[own], self.x[own]


def functions_of(system: System, args: Any, t, x) -> list[Function]:
    """The user's functions of time and state, with `args` bound."""
    if isinstance(system, Map):
        return [Function("rule", lambda n, x: system.rule(n, x, args), "mode", -1)]
    if isinstance(system, Flow):
        return _of_field("field", system.field, args, 0)
    if isinstance(system, EventDriven):
        if system.schedule is not None:
            return []
        return [Function("flow", lambda t, x: system.flow(jnp.full_like(t, 0.1), t, x, args), "mode", -1)]
    found = []
    for q, (name, field) in enumerate(zip(system.mode_names, system.fields or (), strict=False)):
        found += _of_field(f"field of mode {name!r}", field, args, q)
    return found + [one for j in range(len(system.transitions)) for one in _of_transition(system, j, args, t, x)]


def _of_field(name: str, field: Any, args: Any, mode: int) -> list[Function]:
    if isinstance(field, Constrained):
        return [Function(f"residual of the {name}", lambda t, x: field.residual(t, x, args), "mode", mode, (mode,))]
    return [Function(name, lambda t, x: field(t, x, args), "mode", mode, (mode,))]


def _of_transition(system: Hybrid, j: int, args: Any, t, x) -> list[Function]:
    own, found = system.transitions[j], []
    guard, reset, which = own.guard, own.reset, ()
    if guard is not None:
        which = (jnp.asarray(0, jnp.int32),) if jax.eval_shape(guard, t, x, args).shape else ()
        armed = None if own.source is None else tuple(system.mode_names.index(name) for name in own.source)
        found.append(Function(f"guard of transition {j}", lambda t, x: guard(t, x, args), "event", j, armed))
    # Derivatives of resets into modes with a projection mean something only after it.
    if reset is not None and not any(system.tangent):
        found.append(Function(f"reset of transition {j}", lambda t, x: reset(t, x, args, *which), "event", j))
    return found


def check_purity(functions: Iterable[Function], t, x) -> list[Finding]:
    """Whether each function returns the same for the same arguments, at once and when it is traced again."""
    found = []
    here = [np.asarray(each)[None] for each in (t, x, x)]
    for one in functions:
        traced = [jax.make_jaxpr(lambda t, x, of=one.of: of(t, x))(t, x) for _ in range(2)]
        constants = [[without_key_type(const) for const in closed.consts] for closed in traced]
        same = str(traced[0]) == str(traced[1])
        same = same and all(np.array_equal(*pair, equal_nan=True) for pair in zip(*constants, strict=False))
        same = same and np.array_equal(one.at(*here)[0], one.at(*here)[0], equal_nan=True)
        if not same:
            found.append(
                wrong("functions", f"The {one.name} is not pure: two calls with the same arguments differ. A random "
                      "number or a counter must be part of the state or of args.")
            )  # fmt: skip
    return found or [right("functions", "pure: the same arguments give the same results")]


def check_derivatives(functions: Iterable[Function], along: Visited, at_events: Visited) -> list[Finding]:
    """Derivatives along random directions against central differences, at states that the run has met."""
    draw, found, compared = np.random.default_rng(0), [], 0
    for one in functions:
        met = (along if one.where == "mode" else at_events).of(one.number, MOST_STATES)
        verdicts = _compare(one, *met, draw) if len(met[0]) else []
        compared += sum(verdict is not None for verdict in verdicts)
        found += [wrong("derivatives", f"The derivative of the {one.name} {said}") for said in verdicts if said][:1]
    if found:
        return found
    return [right("derivatives", f"those of the functions agree with differences, at {compared} states")]


def _compare(one: Function, t, x, draw) -> list[str | None]:
    """What is wrong with a derivative at each state (m, n); empty: nothing; None: differences do not tell."""
    sizes = np.max(np.abs(x), axis=tuple(range(1, x.ndim)), initial=1e-3, keepdims=True)
    direction = np.asarray(draw.normal(size=x.shape) * np.maximum(np.abs(x), 1e-3 * sizes), x.dtype)

    def difference(step):
        step = np.asarray(step, x.dtype)
        after, before = (one.at(t, x + side * step * direction, direction)[0] for side in (1, -1))
        return (after - before) / (2 * step)

    step = digits(STATE_DIFFERENCE, x)
    value, slope, _ = one.at(t, x, direction)
    found = zip(t, x, value, slope, difference(step), difference(step / 4), strict=True)
    return [_difference_from_slope(*each) for each in found]


def _difference_from_slope(t, x, value, slope, wide, narrow) -> str | None:
    """What `_compare` says at one state: `wide` and `narrow` are central differences, (p,) each."""
    place = f"at t = {float(t):.6g}, x = {in_short(x)}"
    if np.all(np.isfinite(value)) and not np.all(np.isfinite(slope)):
        return (
            f"is not finite {place}: a root or a norm at zero, or a division? Write it so that its derivative exists."
        )
    size = np.max(np.abs(narrow)) + np.max(np.abs(slope))
    rounding = 1e6 * eps(x) * np.max(np.abs(value), initial=0.0)
    if np.max(np.abs(wide - narrow)) > 1e-5 * size + rounding:
        return None  # a kink nearby, or noise
    if np.max(np.abs(slope - narrow)) > DERIVATIVE_ERROR * size + rounding:
        ours, theirs = in_short(slope), in_short(narrow)
        return (
            f"is {ours} along a direction in which differences give {theirs}, {place}: a custom derivative rule, "
            "stop_gradient, or a rounded number?"
        )
    return ""


def depends_on_state(one: Function, t, x) -> bool:
    """Whether a function may depend on the state, by its jaxpr."""
    closed = jax.make_jaxpr(one.of)(t, x)
    return closed.jaxpr.invars[1] in needed(closed)


def check_clocks(functions: Iterable[Function], t, x) -> list[Finding]:
    """Guards of the time alone, for which there are clocks."""
    guards = [one for one in functions if one.name.startswith("guard")]
    found = [
        noted("clocks", f"The {one.name} depends on the time alone. If its zeros are periodic, "
              "lh.Transition(every=period, phase=…) meets them exactly and at less cost.")
        for one in guards if not depends_on_state(one, t, x)
    ]  # fmt: skip
    return found or ([right("clocks", "no guard is a function of the time alone")] if guards else [])
