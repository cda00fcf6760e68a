"""Skew products: a system, and beside it perturbations that a linear rule of their own moves.

The state is y = (x, ξ). x moves as in the system, and

    ξ' = A(t, x) ξ   between jumps,     ξ⁺ = S(t, x) ξ   at jumps.

A start ξ = 0 stays 0: ξ is there for its derivatives alone. A frame whose columns lie in ξ grows by A and S, so the
spectrum of y with that frame is the spectrum of the linear rule (the *cocycle*), by the one loop: with its events,
errors, statuses and derivatives by parameters.

S is the saltation matrix (`events/saltations.py`) of the cocycle's vectors. It takes the field after the jump, so jumps
that follow each other at one instant have none of this form: `checking.py` refuses them.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arguments import require
from ..._jax.columns import each_column, linear_at
from ..._jax.precision import digits
from ..._linalg.frames import generic_frame
from ...events import saltations
from ...systems.daes.semi_linear import Constrained
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid, Transition
from ...systems.smooth import Flow, Map

__all__ = [
    "Cocycle",
    "Columns",
    "GuardJump",
    "frame_of",
    "guard_jumps",
    "require_flow_or_map",
    "skew_product",
    "start_of",
]

Columns = Float[Array, "n parts"]
BROUGHT_BY_FLOW = 1e-6  # relative: a state that is farther from a guard has not been brought there by a flow, …
SOON = 1e-9  # … if it is also farther than a flow comes in this time


class Cocycle(eqx.Module):
    """A linear rule for ξ (size,), given by what it does to vectors (n, parts) of the system's tangent space."""

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """The dimension of ξ."""

    @abc.abstractmethod
    def vectors(self, xi: Float[Array, " size"]) -> Columns:
        """ξ as vectors of the tangent space."""

    @abc.abstractmethod
    def components(self, vectors: Columns) -> Float[Array, " size"]:
        """The vectors as ξ."""

    def inputs(self, t, x, args, vectors: Columns) -> Float[Array, "m parts"]:
        """What the vectors change of inputs c (m,), which are 0 along the motion, of the functions of the system."""
        del t, x, args
        return jnp.zeros((0, vectors.shape[1]), vectors.dtype)

    def of_inputs(self, function: Callable, args, resets: bool) -> Callable:
        """A function of the system as (t, (x, c), …), with its parameters; `resets`: it is no field, no map."""
        del resets
        return lambda t, both, *which: function(t, both, args, *which)

    def base(self, function: Callable) -> Callable:
        """The function (t, x, args, …) by which x itself moves."""
        return function

    def with_inputs(self, t, x, args, vectors: Columns) -> tuple[Any, Any]:
        """(x, c) (n + m,), and what the vectors change of both (n + m, parts)."""
        inputs = self.inputs(t, x, args, vectors)
        return jnp.concatenate([x, jnp.zeros(inputs.shape[0], x.dtype)]), jnp.concatenate([vectors, inputs])

    def own(self, args: Any) -> Any:
        """The parameters of the system among those of the skew product."""
        return args

    def allows(self, jump: "GuardJump", t, x, new, args, *which) -> Any:
        """Whether the perturbations have a rule at this jump to the point `new`."""
        del jump, t, x, new, args, which
        return True


class _Lifted(eqx.Module):
    """A field, the rule of a map or the reset of a clock, of (x, ξ)."""

    function: Callable
    cocycle: Cocycle
    n: int = eqx.field(static=True)
    resets: bool = eqx.field(static=True, default=False)

    def __call__(self, t, y, args):
        x, cocycle = y[: self.n], self.cocycle
        both, columns = cocycle.with_inputs(t, x, args, cocycle.vectors(y[self.n :]))
        moved = linear_at(lambda both: cocycle.of_inputs(self.function, args, self.resets)(t, both), both)(columns)
        value = cocycle.base(self.function)(t, x, cocycle.own(args))
        return jnp.concatenate([value, cocycle.components(moved)])


class _OfBase(eqx.Module):
    """A function of x as a function of (x, ξ): a guard, a condition, a target, the mode of a start, a flow set."""

    function: Callable
    cocycle: Cocycle
    n: int = eqx.field(static=True)

    def __call__(self, t, y, args, *which):
        return self.function(t, y[: self.n], self.cocycle.own(args), *which)


class _OfArgs(eqx.Module):
    """The period or the phase of a clock that depends on parameters."""

    function: Callable
    cocycle: Cocycle

    def __call__(self, args):
        return self.function(self.cocycle.own(args))


class _Projection(eqx.Module):
    """The projection onto the tangent space of a mode: nothing along x, so that no column ever gets a part there."""

    project: Callable | None
    cocycle: Cocycle
    n: int = eqx.field(static=True)

    def __call__(self, t, y, args, dy):
        x, vectors, project = y[: self.n], self.cocycle.vectors(dy[self.n :]), self.project
        if project is not None:
            own = self.cocycle.own(args)
            vectors = each_column(lambda dx: project(t, x, own, dx), vectors)
        return jnp.concatenate([0 * dy[: self.n], self.cocycle.components(vectors)])


class GuardJump(eqx.Module):
    """A jump at a guard out of one mode, with the fields before and after it."""

    transition: Transition
    before: Callable
    fields: tuple[Callable, ...]
    target: Any  # index of the mode after the jump, or a function (t, x, args, …) of it

    def reset(self, t, x, args, *which):
        """x⁺."""
        return x if self.transition.reset is None else self.transition.reset(t, x, args, *which)

    def guard(self, t, x, args, *which):
        """The one guard that fires."""
        assert self.transition.guard is not None, "clocks have none"
        value = self.transition.guard(t, x, args)
        return value[which[0]] if which else jnp.reshape(value, ())

    def is_reached(self, t, x, args, *which):
        """Whether x is on the guard, where a flow ends, and not beyond it, where another jump has put it."""

        def guard(t, x):
            return self.guard(t, x, args, *which)

        value, (by_time, by_state) = jax.value_and_grad(guard, argnums=(0, 1))(t, x)
        rate = by_time + by_state @ self.before(t, x, args)
        size = jnp.max(jnp.abs(by_state)) * jnp.max(jnp.abs(x)) + jnp.abs(by_time * t)
        return jnp.abs(value) <= digits(BROUGHT_BY_FLOW, x) * size + digits(SOON, x) * jnp.abs(rate)

    def after(self, t, x, new, args, *which):
        """The field at x⁺ in the new mode."""
        if not callable(self.target):
            return self.fields[self.target](t, new, args)
        mode = jnp.asarray(self.target(t, x, args, *which), jnp.int32)
        return jax.lax.switch(mode, [lambda t, x, field=field: field(t, x, args) for field in self.fields], t, new)

    def cross(self, cocycle: Cocycle, t, x, args, vectors: Columns, *which) -> Columns:
        """The saltation matrix times the vectors; the instant and the reset of a jump may depend on inputs."""
        own = cocycle.own(args)
        both, columns = cocycle.with_inputs(t, x, args, vectors)
        before = self.before(t, x, own)
        onwards = jnp.concatenate([before, jnp.zeros(both.shape[0] - x.shape[0], x.dtype)])
        guard, reset = (cocycle.of_inputs(one, args, True) for one in (self.guard, self.reset))
        gradient, _, rate = saltations.instant(lambda t, both: guard(t, both, *which), t, both, onwards)
        shift = saltations.event_time_shifts(gradient @ columns, rate)
        new, moved, direction = saltations.pushforward(
            lambda t, both: reset(t, both, *which), t, both, columns, onwards
        )
        return saltations.to_reference_time(moved, direction, self.after(t, x, new, own, *which), shift)


class _LiftedJump(eqx.Module):
    """The reset of a guard's jump, of (x, ξ).

    `watched`: ξ becomes nan where it has no rule, at jumps that another one has brought about among them.
    """

    jump: GuardJump
    cocycle: Cocycle
    n: int = eqx.field(static=True)
    watched: bool = eqx.field(static=True)

    def __call__(self, t, y, args, *which):
        x, cocycle = y[: self.n], self.cocycle
        crossed = self.jump.cross(cocycle, t, x, args, cocycle.vectors(y[self.n :]), *which)
        own = cocycle.own(args)
        new, xi = cocycle.base(self.jump.reset)(t, x, own, *which), cocycle.components(crossed)
        if self.watched:
            after = self.jump.reset(t, x, own, *which)
            has_rule = self.jump.is_reached(t, x, own, *which) & cocycle.allows(self.jump, t, x, after, own, *which)
            xi = jnp.where(has_rule, xi, jnp.nan)
        return jnp.concatenate([new, xi])


def skew_product(system: Flow | Map | Hybrid, cocycle: Cocycle, n: int, watched: bool = False) -> Flow | Map | Hybrid:
    """The system of (x, ξ), x (n,), in the same unit of time; `watched`: where jumps could not be looked at before."""
    if isinstance(system, Map):
        return Map(_Lifted(system.rule, cocycle, n))
    if isinstance(system, Flow):
        return Flow(_Lifted(system.field, cocycle, n), time_unit=system.time_unit)
    fields, names = system.fields or (), system.mode_names
    transitions = [
        one for transition in system.transitions for one in _lifted_transitions(system, transition, cocycle, n, watched)
    ]
    projections = zip(names, system.tangent, strict=True)
    sets = zip(names, system.flow_sets, strict=True)
    initial = system.initial_mode
    return Hybrid(
        {name: _Lifted(field, cocycle, n) for name, field in zip(names, fields, strict=True)},
        transitions,
        tangent={name: _Projection(project, cocycle, n) for name, project in projections},
        max_cascade=system.max_cascade,
        initial_mode=None if initial is None else _OfBase(initial, cocycle, n),
        flow_set={name: _OfBase(inside, cocycle, n) for name, inside in sets if inside is not None},
        time_unit=system.time_unit,
    )


def _lifted_transitions(
    system: Hybrid, transition: Transition, cocycle: Cocycle, n: int, watched: bool
) -> list[Transition]:
    """The transition of (x, ξ): of a guard one for each mode that it leaves, since S takes the field there."""

    def of(function):
        return _OfBase(function, cocycle, n) if callable(function) else function

    def timed(value):
        return _OfArgs(value, cocycle) if callable(value) else value

    shared: dict[str, Any] = {
        "target": of(transition.target), "when": of(transition.when), "direction": transition.direction,
        "terminal": transition.terminal,
    }  # fmt: skip
    if transition.is_clock:
        reset = transition.reset and _Lifted(transition.reset, cocycle, n, resets=True)
        clock = {"every": timed(transition.every), "phase": timed(transition.phase)}
        return [Transition(None, reset, source=transition.source, **clock, **shared)]
    if transition.changes_nothing:
        return [Transition(of(transition.guard), source=transition.source, **shared)]
    return [
        Transition(of(transition.guard), _LiftedJump(jump, cocycle, n, watched), source=name, **shared)
        for name, jump in guard_jumps(system, transition)
    ]


def guard_jumps(system: Hybrid, transition: Transition) -> list[tuple[str, GuardJump]]:
    """The jumps at a guard, with the names of the modes that they leave."""
    fields, names = system.fields or (), system.mode_names
    found = []
    for name in transition.source or names:
        here = names.index(name)
        target = here if transition.target is None else transition.target
        target = names.index(target) if isinstance(target, str) else target
        found.append((name, GuardJump(transition, fields[here], fields, target)))
    return found


def require_flow_or_map(verb: str, system: Any) -> None:
    """Raise a ValueError unless perturbations across the system can be written beside it."""
    fits = isinstance(system, Flow | Map | Hybrid) and not isinstance(system, EventDriven)
    require(fits, f"{verb} takes an lh.Flow, lh.Map or lh.Hybrid; got {type(system).__name__}.")
    fields = system.fields if isinstance(system, Hybrid) else (getattr(system, "field", None),)
    require(fields is not None, f"{verb} needs a system that flows; this lh.Hybrid has fields=None: write an lh.Map.")
    constrained = any(isinstance(field, Constrained) for field in fields or ())
    require(not constrained, f"{verb} takes no lh.DAE: its perturbations lie on constraints. Eliminate them.")


def start_of(x0, size: int):
    """The start y = (x, 0)."""
    return jnp.concatenate([x0, jnp.zeros(size, x0.dtype)])


def frame_of(n: int, size: int, k: int, dtype, parts: int = 1) -> np.ndarray:
    """(n + size, parts k) directions along ξ: all unit vectors, or k generic ones where there are fewer.

    Unit vectors may all lie in a part of ξ that never acts on the rest, and then miss the largest exponents. With two
    parts, the real and the imaginary one of complex ξ, each direction v is the pair of v and i v, as real columns.
    """
    count = size // parts
    directions: np.ndarray
    if k == count:
        directions = np.eye(count, dtype=complex if parts == 2 else dtype)
    elif parts == 1:
        directions = generic_frame(count, k, dtype)
    else:
        real, imaginary = generic_frame(2 * count, k, dtype).reshape(2, count, k)
        directions = np.linalg.qr(real + 1j * imaginary)[0]
    if parts == 2:
        pairs = np.stack([directions, 1j * directions], axis=2).reshape(count, 2 * k)
        directions = np.concatenate([np.real(pairs), np.imag(pairs)])
    frame = np.zeros((n + size, parts * k), dtype)
    frame[n:] = directions
    return frame
