"""The union type of all systems."""

from .event_driven import EventDriven
from .hybrid import Hybrid
from .smooth import Flow, Map

__all__ = ["System", "iterates"]

System = Flow | Map | Hybrid | EventDriven


def iterates(system: System) -> bool:
    """Whether time is the number of iterations: a map, or a hybrid system without a flow."""
    return isinstance(system, Map) or (isinstance(system, Hybrid) and system.fields is None)
