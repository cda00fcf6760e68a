"""Which kinds of systems there are."""

from .event_driven import EventDriven
from .hybrid import Hybrid
from .smooth import Flow, Map

__all__ = ["System", "iterates"]

System = Flow | Map | Hybrid | EventDriven


def iterates(system: System) -> bool:
    """Whether time counts iterations: a map, or a hybrid system that only jumps."""
    return isinstance(system, Map) or (isinstance(system, Hybrid) and system.fields is None)
