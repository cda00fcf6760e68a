"""A small compiler: from a jaxpr to machine code by LLVM. It knows nothing of dynamics."""

from .bridge.compiled import EVENTS, Compiled, compile
from .bridge.primitive import native, native_call
from .bridge.programs import Program, engine
from .lowering.costs import instructions
from .lowering.unsupported import UnsupportedError
from .machine.collector import no_collector
from .rules.calls import seldom

__all__ = [
    "EVENTS",
    "Compiled",
    "Program",
    "UnsupportedError",
    "compile",
    "engine",
    "instructions",
    "native",
    "native_call",
    "no_collector",
    "seldom",
]
