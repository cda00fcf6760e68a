"""A small compiler from jaxprs to machine code, by LLVM. It is independent of dynamical systems."""

from .bridge.compiled import DURATION_PREFIX, Compiled, compile
from .bridge.placing import on_device
from .bridge.primitive import native, native_call
from .bridge.programs import ONE_WAY, Program, engine
from .lowering.costs import instructions
from .lowering.unsupported import UnsupportedError
from .machine.collector import no_collector
from .rules.calls import seldom

__all__ = [
    "DURATION_PREFIX",
    "ONE_WAY",
    "Compiled",
    "Program",
    "UnsupportedError",
    "compile",
    "engine",
    "instructions",
    "native",
    "native_call",
    "no_collector",
    "on_device",
    "seldom",
]
