"""The user's functions by themselves: pure, with the derivatives that differences show, finite, and smooth."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.jaxprs import needed
from ..._jax.precision import digits, eps
from ...systems.daes.semi_linear import Constrained
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import System
from ...systems.smooth import Flow, Map
from .report import Finding, in_short, noted, right, wrong

__all__ = ["Function", "Visited", "check_derivatives", "check_purity", "functions_of"]

STATE_DIFFERENCE = 1e-5  # of a state for a central difference, relative to its size
DERIVATIVE_ERROR = (
    1e-4  # a derivative is wrong if it differs by more than this part, and differences agree with each other
)


class Function(NamedTuple):
    """One of the user's functions, of time and state."""

    name: str
    of: Callable  # (t, x) -> array
    where: str  # "mode" or "event": at which states it is evaluated
    number: int  # of the mode, or of the transition; -1: all
    modes: tuple[int, ...] | None = None  # in which it is used; None: all


class Visited(NamedTuple):
    """States that a trial run has met."""

    t: np.ndarray  # (m,)
    x: np.ndarray  # (m, n)
    number: np.ndarray  # (m,) of the mode, or of the transition

    def of(self, number: int, most: int) -> Iterator[tuple[Any, Any]]:
        """Up to so many of them, spread evenly."""
        own = np.flatnonzero((self.number == number) | (number < 0))
        for i in own[np.unique(np.linspace(0, len(own) - 1, most).astype(int))] if len(own) else ():
            yield self.t[i], self.x[i]


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
    for one in functions:
        first, second = np.asarray(one.of(t, x)), np.asarray(one.of(t, x))
        traced = [jax.make_jaxpr(lambda t, x, of=one.of: of(t, x))(t, x) for _ in range(2)]
        constants = [[np.asarray(const) for const in closed.consts] for closed in traced]
        same = np.array_equal(first, second, equal_nan=True) and str(traced[0]) == str(traced[1])
        same = same and all(np.array_equal(*pair, equal_nan=True) for pair in zip(*constants, strict=False))
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
        met = along if one.where == "mode" else at_events
        for t, x in met.of(one.number, 5):
            verdict = _compare(one, jnp.asarray(t), jnp.asarray(x), draw)
            compared += verdict is not None
            if verdict:
                found.append(wrong("derivatives", f"The derivative of the {one.name} {verdict}"))
                break
    if found:
        return found
    return [right("derivatives", f"those of the functions agree with differences, at {compared} states")]


def _compare(one: Function, t, x, draw) -> str | None:
    """What is wrong with a derivative; empty: nothing; None: differences do not tell."""
    scale = np.maximum(np.abs(x), 1e-3 * np.max(np.abs(x), initial=1e-3))
    direction = jnp.asarray(draw.normal(size=x.shape) * scale, x.dtype)

    wide_step = digits(STATE_DIFFERENCE, x)

    @jax.jit
    def both(x, dx):
        value, slope = jax.jvp(lambda x: one.of(t, x), (x,), (dx,))
        steps = jnp.asarray([wide_step, wide_step / 4], x.dtype)
        ends = jax.vmap(lambda s: (one.of(t, x + s * dx) - one.of(t, x - s * dx)) / (2 * s))(steps)
        return value, slope, ends

    value, slope, (wide, narrow) = jax.device_get(both(x, direction))
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
