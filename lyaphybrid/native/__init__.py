"""A small compiler: from a jaxpr to machine code by LLVM. It knows nothing of dynamics."""

from ._compiled import Compiled, compile
from ._unsupported import Unsupported

__all__ = ["Compiled", "Unsupported", "compile"]
