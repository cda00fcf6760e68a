"""The union type of all systems, the form of their states, and what their times are counted in."""

from .._text import UNIT
from .event_driven import EventDriven
from .hybrid import Hybrid
from .smooth import Flow, Map

__all__ = ["System", "has_rows", "iterates", "unit_of"]

System = Flow | Map | Hybrid | EventDriven


def iterates(system: System) -> bool:
    """Whether time is the number of iterations: a map, or a hybrid system without a flow."""
    return isinstance(system, Map) or (isinstance(system, Hybrid) and system.fields is None)


def has_rows(system: System) -> bool:
    """Whether a state is (N, d), with a row for each body."""
    return isinstance(system, EventDriven) and system.has_rows


def unit_of(system: System) -> str:
    """What the times of a system are counted in."""
    return "iteration" if iterates(system) else system.time_unit or UNIT["time"]
