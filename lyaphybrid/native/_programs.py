"""Programs: a jaxpr, its machine code, and the programs that follow from it by differentiating or by adding lanes.

Each is made once and kept with the program that it follows from, so that a function that is differentiated, or mapped,
again and again is traced and compiled once.
"""

import ctypes
import functools
import logging
import os

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from ._compiled import Compiled
from ._unsupported import Unsupported

VARIABLE = "LYAPHYBRID_ENGINE"
_ENGINES = ("auto", "native", "xla")
_log = logging.getLogger("lyaphybrid.native")
_noted: set[str] = set()


def engine() -> str:
    """Which one is chosen: "auto" (native where the compiler takes the program), "native" (else an error), "xla"."""
    chosen = os.environ.get(VARIABLE, "").lower() or "auto"
    if chosen not in _ENGINES:
        raise ValueError(f"{VARIABLE} must be one of {', '.join(_ENGINES)}; got {chosen!r}.")
    return chosen


class Program:
    """A jaxpr that may be compiled; equal to itself only.

    Attributes:
        closed: the closed jaxpr.
        columns: of the frames that are held in vectors; 0: none.
    """

    def __init__(self, closed: ClosedJaxpr, columns: int = 0):
        self.closed, self.columns = closed, columns
        self._derived: dict = {}

    @functools.cached_property
    def compiled(self) -> Compiled | None:
        """The machine code; None where the program is XLA's to compile, which is said once for each reason."""
        if engine() == "xla":
            return None
        try:
            return Compiled(self.closed, columns=self.columns)
        except Unsupported as reason:
            if engine() == "native":
                raise
            if str(reason) not in _noted:
                _noted.add(str(reason))
                _log.warning("compiled by XLA, not natively: %s has no rule.", reason)
            return None

    @functools.cached_property
    def by_xla(self):
        """The same, compiled by XLA."""
        return jax.jit(jaxpr_as_fun(self.closed))

    @functools.cached_property
    def target(self) -> str | None:
        """The name under which XLA's programs call the machine code."""
        if self.compiled is None:
            return None
        name = f"lyaphybrid_native_{id(self):x}"
        handler = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(self.compiled.address("handler"))
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(handler), platform="cpu")
        _targets.append(self)  # XLA may call it as long as the process lives
        return name

    def pushed(self, moving: tuple[bool, ...]) -> "Program":
        """The tangents of the results, from the operands and the tangents of those that move."""

        def tangents(*given):
            operands, changes = given[: len(moving)], given[len(moving) :]

            def of_moving(*xs):
                rest = iter(xs)
                full = [next(rest) if moves else x for moves, x in zip(moving, operands, strict=True)]
                return jaxpr_as_fun(self.closed)(*full)

            primals = tuple(x for x, moves in zip(operands, moving, strict=True) if moves)
            _, found = jax.jvp(of_moving, primals, tuple(changes))
            return [tangent for tangent in found if tangent.dtype != jax.dtypes.float0]

        avals = self.closed.in_avals
        structs = [*avals, *(aval for aval, moves in zip(avals, moving, strict=True) if moves)]
        return self._made(("pushed", moving), tangents, structs)

    def mapped(self, which: tuple[bool, ...], size: int) -> "Program":
        """The same for `size` lanes, one after the other; `which` operands have a first axis for them."""

        def lanes(*xs):
            def one(mapped):
                rest = iter(mapped)
                return jaxpr_as_fun(self.closed)(*(next(rest) if w else x for w, x in zip(which, xs, strict=True)))

            return jax.lax.map(one, [x for w, x in zip(which, xs, strict=True) if w])

        structs = [
            jax.ShapeDtypeStruct((size, *aval.shape), aval.dtype) if w else aval
            for aval, w in zip(self.closed.in_avals, which, strict=True)
        ]
        return self._made(("mapped", which, size), lanes, structs)

    def _made(self, key, function, avals) -> "Program":
        if key not in self._derived:
            structs = [jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in avals]
            self._derived[key] = Program(jax.make_jaxpr(function)(*structs), self.columns)
        return self._derived[key]

    def __call__(self, *operands) -> list:
        """The results, as JAX's arrays."""
        if self.compiled is None:
            return list(self.by_xla(*operands))
        return jax.device_put(self.compiled(*operands))


_targets: list[Program] = []


def inexact(aval) -> bool:
    """Whether an array has derivatives."""
    return jnp.issubdtype(aval.dtype, np.inexact)
