"""A small compiler: from a jaxpr to machine code by LLVM. It knows nothing of dynamics."""

from ._bridge import native, native_call
from ._calls import seldom
from ._collector import no_collector
from ._compiled import EVENTS, Compiled, compile
from ._costs import instructions
from ._programs import Program, engine
from ._unsupported import Unsupported

__all__ = [
    "EVENTS",
    "Compiled",
    "Program",
    "Unsupported",
    "compile",
    "engine",
    "instructions",
    "native",
    "native_call",
    "no_collector",
    "seldom",
]
