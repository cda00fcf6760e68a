"""Hybrid systems: they flow in modes, and jump at guards or at the ticks of clocks."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._arguments import flag, positive, real, require
from .bound import require_callable
from .labels import check_labels, time_word, words
from .membership import Membership, membership
from .smooth import Flow

__all__ = ["Hybrid", "Transition", "disarmed"]


class Transition(eqx.Module):
    """A jump x⁺ = reset(t, x, args), where a guard crosses zero or a clock ticks.

    ``Transition(guard, reset)`` fires where ``guard`` crosses zero; ``Transition(every=T, reset=…)`` fires at
    t = phase + kT for every integer k with t later than the start.

    Args:
        guard: ``(t, x, args) -> scalar``, continuously differentiable within its source modes; or ``-> (m,)``
            for m contacts, pairs or neurons at once.
        reset: ``(t, x, args) -> x⁺``; for a vector guard ``(t, x, args, which) -> x⁺``. None: x stays.
        every: period of a clock: a number, or ``args -> number``. Excludes ``guard``.
        phase: time of one of the clock's ticks: a number, or ``args -> number``.
        source: mode (or tuple of modes) in which the transition is armed. None: every mode.
        target: mode after the jump: None (stays), a name, or ``(t, x, args) -> index`` (with ``which`` last for
            a vector guard), evaluated at the state before the jump.
        direction: -1 the guard falls through 0, +1 it rises, 0 both.
        when: ``(t, x, args) -> bool``, or ``-> (m,)`` for a vector guard, evaluated at the root (before the jump). It
            can choose between several transitions with the same guard; where it is false, no other jump of that
            instant makes this one fire. If it is true for none of them the run ends as ``deadlock``.
        terminal: whether the run ends here, after the reset, with status ``terminated``.

    Raises:
        ValueError: on anything but exactly one of ``guard`` and ``every``; on a direction outside {-1, 0, 1}; on
            a period that is not positive.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> bounce = lh.Transition(lambda t, x, r: x[0], lambda t, x, r: jnp.array([x[0], -r * x[1]]))
        >>> sample = lh.Transition(every=0.5, reset=lambda t, x, r: x)
    """

    guard: Callable | None
    reset: Callable | None
    source: tuple[str, ...] | None = eqx.field(static=True)
    target: str | Callable | None
    direction: int = eqx.field(static=True)
    when: Callable | None
    terminal: bool = eqx.field(static=True)
    every: Any
    phase: Any

    def __init__(
        self,
        guard: Callable | None = None,
        reset: Callable | None = None,
        *,
        every: Any = None,
        phase: Any = 0.0,
        source: str | Sequence[str] | None = None,
        target: str | Callable | None = None,
        direction: int = -1,
        when: Callable | None = None,
        terminal: bool = False,
    ):
        if (guard is None) == (every is None):
            raise ValueError(
                "Transition needs exactly one of guard (a function that crosses zero) and every (a clock's "
                f"period); got guard={guard!r}, every={every!r}."
            )
        if guard is not None:
            require_callable("guard", guard, "(t, x, args) -> scalar or (m,)")
        for name, function in (("reset", reset), ("when", when)):
            if function is not None:
                require_callable(name, function, "(t, x, args) -> …")
        if not isinstance(direction, int | np.integer) or direction not in (-1, 0, 1):
            raise ValueError(f"direction must be -1 (falls), +1 (rises) or 0 (both); got {direction!r}.")
        if guard is None and not callable(every):
            positive("every, the clock's period,", every)
        if not callable(phase):
            real("phase", phase)
        flag("terminal", terminal)
        if target is not None and not isinstance(target, str) and not callable(target):
            raise ValueError(f"target must be None, a mode name or (t, x, args) -> index; got {target!r}.")
        self.guard, self.reset, self.target, self.when = guard, reset, target, when
        self.source = _sources(source)
        self.direction, self.terminal, self.every, self.phase = int(direction), bool(terminal), every, phase

    @property
    def is_clock(self) -> bool:
        """Whether the event times of this transition come from a clock rather than from a guard."""
        return self.every is not None

    @property
    def changes_nothing(self) -> bool:
        """Whether all that this transition does is to record where the flow crosses its guard."""
        acts = self.reset is not None or self.target is not None or self.terminal
        return not (self.is_clock or acts or self.when is not None)


def _sources(source: Any) -> tuple[str, ...] | None:
    """The modes in which a transition is armed."""
    given = (source,) if isinstance(source, str) else source
    good = given is None or (isinstance(given, Sequence) and len(given) > 0 and all(isinstance(x, str) for x in given))
    require(good, f"source must be None (every mode), the name of a mode or several names; got {source!r}.")
    return None if given is None else tuple(given)


class Hybrid(eqx.Module):
    """A hybrid system: one or several modes that flow, and transitions between them.

    Args:
        fields: one field (a callable ``(t, x, args) -> dx/dt``, a ``Flow`` or a ``DAE``), or ``{"mode": field, …}``;
            the order of the dictionary is the order of the mode indices. None: jumps only, the flow set is empty
            and the first transition's reset is iterated. After a jump into a mode that is a DAE the state is moved onto
            its constraints with the same E₁ x.
        transitions: one ``Transition`` or a sequence of them.
        tangent: ``{"mode": (t, x, args, dx) -> dx}``, the projection onto the tangent space of a mode in which
            the motion is constrained.
        initial_mode: ``(t, x, args) -> index`` of the mode to which a state belongs, for runs without `mode`; negative
            if no mode can continue from the state (``deadlock``). None: the only mode.
        max_cascade: largest number of jumps at one time; one more ends the run as ``zeno``. None: 16, or as many as
            there are guards in a mode, for units that are alike may fire together. A run that counts jumps
            (``clock="jumps"`` or ``"hybrid"``) continues such a cascade without limit, and ends if the cascade does.
        flow_set: ``(t, x, args) -> c``, continuously differentiable, or ``{"mode": function, …}``: the flow set C is
            where c ≥ 0. A flow that leaves C where no transition fires ends as ``deadlock``, and so does a jump or a
            start outside C and D; a start outside C but in D jumps at once. None: C is the whole space.
        names: what the components of x are called, as for `lh.Flow`.
        units: in which they are measured, likewise.
        time_unit: in which time is measured, as for `lh.Flow`.

    The jump set D is where a guard is at zero or on its fired side. If a reset ends in D, beyond any guard, its own
    included, the next jump follows at once; if it ends on its own guard, within rounding, the flow continues.
    A transition that changes nothing (a guard alone) never follows a jump: it records where the flow crosses it.
    Several guards that the flow brings to zero at one instant fire in turn, unless a jump takes the state back from
    one; one that has fired fires again where another's jump turns the state back to it. Clocks that tick at one time
    do so in the order of the list; but of equal ones in different modes only that of the mode before, so that modes can
    take turns.

    Raises:
        ValueError: without a transition, on an unknown mode name, on a field that is no function.

    Source:
        R. Goebel, R. Sanfelice & A. Teel, Hybrid Dynamical Systems, IEEE Control Systems 29 (2009) 28,
        doi:10.1109/MCS.2008.931718.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.array([x[1], -1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.array([x[0], -0.8 * x[1]])),
        ... )
        >>> ball.mode_names
        ('flow',)
    """

    fields: tuple[Callable, ...] | None
    transitions: tuple[Transition, ...]
    tangent: tuple[Callable | None, ...]
    initial_mode: Callable | None
    flow_sets: tuple[Callable | None, ...]
    mode_names: tuple[str, ...] = eqx.field(static=True)
    max_cascade: int | None = eqx.field(static=True)
    names: tuple[str, ...] | None = eqx.field(static=True)
    units: tuple[str, ...] | None = eqx.field(static=True)
    time_unit: str | None = eqx.field(static=True, default=None)

    def __init__(
        self,
        fields: Any,
        transitions: Transition | Sequence[Transition],
        tangent: Mapping[str, Callable] | None = None,
        max_cascade: int | None = None,
        *,
        initial_mode: Callable | None = None,
        flow_set: Callable | Mapping[str, Callable] | None = None,
        names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        time_unit: str | None = None,
    ):
        self.names, self.units, self.time_unit = words(names), words(units), time_word(time_unit)
        check_labels(self.names, self.units)
        named = fields if isinstance(fields, Mapping) else {"jump" if fields is None else "flow": fields}
        self.mode_names = tuple(named)
        self.fields = None if fields is None else tuple(_as_field(k, v) for k, v in named.items())
        self.transitions = _listed(transitions)
        require(
            tangent is None or isinstance(tangent, Mapping),
            f'tangent must be {{"mode": (t, x, args, dx) -> dx}}; got {tangent!r}.',
        )
        self.tangent = tuple((tangent or {}).get(name) for name in self.mode_names)
        self.initial_mode, self.max_cascade = initial_mode, max_cascade
        if initial_mode is not None:
            require_callable("initial_mode", initial_mode, "(t, x, args) -> index of a mode")
        whole_number = isinstance(max_cascade, int) and not isinstance(max_cascade, bool)
        if max_cascade is not None and (not whole_number or max_cascade < 1):
            raise ValueError(f"max_cascade must be a positive integer; got {max_cascade!r}.")
        for transition in self.transitions:
            target = (transition.target,) if isinstance(transition.target, str) else ()
            self._require_modes("source or target", (*(transition.source or ()), *target))
        self._require_modes("tangent", tuple(tangent or ()))
        one_each = flow_set if isinstance(flow_set, Mapping) else dict.fromkeys(self.mode_names, flow_set)
        self._require_modes("flow_set", tuple(one_each))
        self.flow_sets = tuple(one_each.get(name) for name in self.mode_names)
        for function in self.tangent:
            if function is not None:
                require_callable("tangent", function, "(t, x, args, dx) -> dx")
        for function in self.flow_sets:
            if function is not None:
                require_callable("flow_set", function, "(t, x, args) -> scalar, or {mode: function}")
        if not self.transitions:
            raise ValueError("Hybrid needs at least one Transition; a system without jumps is an lh.Flow.")
        if self.fields is None and (len(self.transitions) != 1 or self.transitions[0].reset is None):
            raise ValueError(
                f"fields=None (jumps only) needs exactly one Transition, with a reset; got {self.transitions!r}."
            )
        if self.fields is None and flow_set is not None:
            raise ValueError(f"fields=None (jumps only) has an empty flow set; got flow_set={flow_set!r}.")
        if self.fields is None and time_unit is not None:
            raise ValueError(f"fields=None (jumps only) counts jumps: no time passes; got time_unit={time_unit!r}.")

    @property
    def guarded(self) -> tuple[Transition, ...]:
        """The transitions, and one for the boundary of each flow set, whose `when` is never true: ``deadlock``."""
        sets = zip(self.mode_names, self.flow_sets, strict=True)
        return self.transitions + tuple(
            Transition(inside, when=never, source=name) for name, inside in sets if inside is not None
        )

    def contains(self, x: Any, args: Any = None, *, t: Any = 0.0, mode: str | int | None = None) -> Membership:
        """Whether the state x (n,) is in the flow set C, the jump set D, both or neither, up to rounding.

        Args:
            x: state, (n,).
            args: pytree of parameters.
            t: the time.
            mode: the mode, where there are several.

        Returns:
            A named tuple of truth values, `flow` and `jump`; `.where` is "C", "D", "both" or "neither".

        Raises:
            ValueError: if there are several modes and `mode` is not given.

        Example:
            >>> import jax.numpy as jnp, lyaphybrid as lh
            >>> ball = lh.Hybrid(
            ...     lambda t, x, args: jnp.array([x[1], -1.0]),
            ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.array([x[0], -x[1]])),
            ...     flow_set=lambda t, x, args: x[0],
            ... )
            >>> [ball.contains([height, 0.0]).where for height in (1.0, 0.0, -1.0)]
            ['C', 'both', 'D']
        """
        return membership(self, x, args, t, mode)

    def _require_modes(self, role: str, names: tuple[str, ...]) -> None:
        unknown = [name for name in names if name not in self.mode_names]
        if unknown:
            raise ValueError(f"Unknown mode {unknown[0]!r} as {role}; the modes are {list(self.mode_names)}.")


def _listed(transitions: Any) -> tuple[Transition, ...]:
    """One transition, or a sequence of them, as a tuple."""
    given = (transitions,) if isinstance(transitions, Transition) else transitions
    good = isinstance(given, Sequence) and all(isinstance(one, Transition) for one in given)
    require(good, f"transitions must be lh.Transition objects; got {transitions!r}.")
    return tuple(given)


def never(t, x, args):
    """The `when` of a transition that never fires."""
    del t, x, args
    return False


def _as_field(name: str, field: Any) -> Callable:
    field = field.field if isinstance(field, Flow) else field
    require_callable(f"The field of mode {name!r}", field, "(t, x, args) -> dx/dt, or an lh.Flow")
    return field


class DisarmedGuard(eqx.Module):
    """A guard of which one entry never falls to zero."""

    guard: Callable
    entry: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        """The values, 1 for that entry."""
        values = jnp.asarray(self.guard(t, x, args))
        return jnp.where(np.arange(values.size).reshape(values.shape) == self.entry, 1.0, values)


def disarmed(system: Hybrid, transition: int, entry: int) -> Hybrid:
    """The system in which one entry of a transition's guard never fires."""
    guard = system.transitions[transition].guard
    assert guard is not None, "a clock is no guard"
    guard = DisarmedGuard(guard, entry)
    return eqx.tree_at(lambda system: system.transitions[transition].guard, system, guard)
