"""The table of published flows: what an entry is, how a row is written, how an entry becomes a `Problem`."""

import dataclasses
import functools
import importlib
import inspect
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from ...integrators.base import Method
from ...systems.smooth import Flow
from ..problem import Problem, Reference, get, nearest, number, state
from .spectra import Known, recorded

__all__ = ["FAMILIES", "Entry", "entry_of", "flow", "flow_names", "published"]

FAMILIES = (
    "sprott",
    "convection",
    "polynomial",
    "hyperchaos",
    "circuits",
    "life",
    "chemistry",
    "mechanics",
    "mixing",
)
IN_ZOO = ("lorenz63", "rossler", "henon_heiles", "double_pendulum", "chua")  # problems of the zoo with a spectrum
RUN, TRANSIENT = 2000.0, 200.0  # lengths of a run and of its transient in turns

_TABLE: dict[str, "Entry"] = {}


@dataclasses.dataclass(frozen=True)
class Entry:
    """A row of the table.

    Attributes:
        name: of the row.
        field: (*state, **parameters) -> the derivatives; its first argument is named t if the flow is driven.
        start: on the attractor, or where the flow conserves volume in its chaotic sea.
        turn: rough time of a turn; lengths of runs are multiples of it.
        source: of the equations and the parameters. All are those of the dysts collection too, but for those
            of burke_shaw and forced_van_der_pol; where a text with others was found, this says so.
        known: exponents that were published, with their source; None if none were found.
        conservative: whether volume is conserved on average, so that there is a chaotic sea and no attractor.
        note: what a reader must know: stiff, piecewise, transient.
        method: for stiff flows; None: the default of `lh.lyapunov_spectrum`.
    """

    name: str
    field: Callable[..., Any]
    start: tuple[float, ...]
    turn: float
    source: str
    known: Known | None = None
    conservative: bool = False
    note: str = ""
    method: Callable[[], Method] | None = None

    @functools.cached_property
    def driven(self) -> bool:
        """Whether the field depends on time."""
        return next(iter(inspect.signature(self.field).parameters)) == "t"

    @functools.cached_property
    def parameters(self) -> dict[str, float]:
        """The published parameters by name."""
        signature = inspect.signature(self.field).parameters.values()
        return {one.name: float(one.default) for one in signature if one.kind is one.KEYWORD_ONLY}

    @functools.cached_property
    def components(self) -> tuple[str, ...]:
        """Names of the components of the state."""
        named = [
            one.name
            for one in inspect.signature(self.field).parameters.values()
            if one.kind is one.POSITIONAL_OR_KEYWORD and one.name != "t"
        ]
        return tuple(named) or tuple(f"x{i + 1}" for i in range(len(self.start)))

    @functools.cached_property
    def system(self) -> Flow:
        """The flow; the same object for all parameters, so that other values compile nothing."""

        def field(t, x, args):
            values = [x[i] for i in range(len(self.start))]
            slopes = self.field(*([t] if self.driven else []), *values, **args)
            return jnp.stack(slopes) if isinstance(slopes, tuple) else slopes

        field.__name__ = self.name
        return Flow(field, names=self.components)

    def problem(self, **parameters: Any) -> Problem:
        """The entry as a `Problem`; the recorded spectrum is its reference at the published parameters."""
        for name in parameters:
            if name not in self.parameters:
                valid = ", ".join(f"{k}={v:.10g}" for k, v in self.parameters.items()) or "none"
                raise ValueError(f"{self.name} has no parameter {name!r}; it has: {valid}.")
        args = {**self.parameters, **{name: number(name, value) for name, value in parameters.items()}}
        return Problem(
            system=self.system,
            x0=state(*self.start),
            args=args,
            t1=RUN * self.turn,
            transient=TRANSIENT * self.turn,
            method=self.method() if self.method else None,
            source=self.source,
            reference=self.reference() if not parameters else None,
            parameters=dict(args),
            name=self.name,
        )

    def reference(self) -> Reference | None:
        """The recorded spectrum; None before it is computed, or where the flow has none."""
        found = recorded().get(self.name)
        return None if found is None else found.reference()


def published(
    *,
    start: tuple[float, ...],
    turn: float,
    source: str,
    known: Known | None = None,
    conservative: bool = False,
    note: str = "",
    method: Callable[[], Method] | None = None,
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Put a field, written by components, into the table under its own name; `Entry` says what the arguments are."""

    def enter(field: Callable[..., Any]) -> Callable[..., Any]:
        name = field.__name__
        _TABLE[name] = Entry(name, field, start, turn, source, known, conservative, note, method)
        return field

    return enter


@functools.cache
def _table() -> dict[str, Entry]:
    """The whole table; its modules are loaded when a flow is first asked for."""
    for family in FAMILIES:
        importlib.import_module(f".families.{family}", __package__)
    return dict(_TABLE)


def entry_of(name: str) -> Entry:
    """The row of this name.

    Raises:
        ValueError: on an unknown name; the valid ones are listed, the nearest first.
    """
    table = _table()
    if name not in table:
        raise ValueError(
            f"No published flow {name!r}. The flows, the nearest first: {', '.join(nearest(name, table))}."
        )
    return table[name]


def flow_names() -> list[str]:
    """The names of the published flows, those of `zoo.names()` that have a recorded spectrum last.

    Example:
        >>> from lyaphybrid import zoo
        >>> "halvorsen" in zoo.flow_names()
        True
    """
    return [*_table(), *IN_ZOO]


def flow(name: str, **parameters: Any) -> Problem:
    """A published chaotic flow.

    Args:
        name: one of `zoo.flow_names()`.
        parameters: by name, instead of the published values.

    Returns:
        A `Problem`; at the published parameters with the recorded spectrum as its reference.

    Raises:
        ValueError: on an unknown name or parameter.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.flow("thomas", b=9.0).args
        {'a': 1.85, 'b': 9.0}
    """
    return get(name)(**parameters) if name in IN_ZOO else entry_of(name).problem(**parameters)
