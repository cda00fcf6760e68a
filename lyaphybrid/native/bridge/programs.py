"""Programs: a jaxpr, its machine code, and the programs that follow from it by differentiating or by adding lanes.

Each is made once and kept with the program that it follows from, so that a function that is differentiated, or mapped,
again and again is traced and compiled once.
"""

import ctypes
import functools
import logging
import os
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from ..lowering.costs import apart
from ..lowering.jax_versions import Jaxpr, subprograms
from ..lowering.unsupported import UnsupportedError
from ..machine.code import doubles_in_a_vector
from .compiled import Compiled

VARIABLE = "LYAPHYBRID_ENGINE"
_ENGINES = ("auto", "native", "xla")
_MOST_APART = 0.2  # of the code: beyond that lanes wait for each other too often
_SURELY = 2  # times as much is beyond by any means, though it is an estimate
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
        columns: of the frames that are held in vectors; 0: none; None: as in the programs within.
        backward: the same function of its operands, written so that it has reverse derivatives.
        in_pieces: whether a long run is many calls of it.
        origin: of a program of tangents: of which program, and which of its operands move.
    """

    def __init__(
        self,
        closed: ClosedJaxpr,
        columns: int | None = None,
        backward: Callable | None = None,
        in_pieces: bool = False,
    ):
        self.in_pieces = in_pieces
        self.closed, self.backward = closed, backward or jaxpr_as_fun(closed)
        self.columns = _columns_within(closed.jaxpr) if columns is None else columns
        self.origin: tuple[Program, tuple[bool, ...]] | None = None
        self._derived: dict = {}

    @functools.cached_property
    def compiled(self) -> Compiled | None:
        """The machine code; None where the program is XLA's to compile, which is said once for each reason."""
        if engine() == "xla":
            return None
        try:
            return Compiled(self.closed, columns=self.columns, in_pieces=self.in_pieces)
        except UnsupportedError as reason:
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
            function, primals = self._of_moving(jaxpr_as_fun(self.closed), operands, moving)
            return jax.jvp(function, primals, tuple(changes))[1]

        made = self._made(("pushed", moving), tangents, [*self.closed.in_avals, *self._moving(moving)])
        made.origin = self, moving
        return made

    def pulled(self, moving: tuple[bool, ...], asked: tuple[bool, ...]) -> "Program":
        """The transposed: the cotangents of the operands that move, from the operands and those of the results.

        `asked`: of each result that has derivatives, whether its cotangent is given. The others do not count: a
        cotangent of zero would make nan of a derivative that is infinite.
        """

        def cotangents(*given):
            operands, back = given[: len(moving)], given[len(moving) :]
            function, primals = self._of_moving(self.backward, operands, moving)

            def wanted(*xs):
                return [x for x, wants in zip(function(*xs), asked, strict=True) if wants]

            return jax.vjp(wanted, *primals)[1](list(back))

        results = [aval for aval in self.closed.out_avals if inexact(aval)]
        given = [aval for aval, wants in zip(results, asked, strict=True) if wants]
        return self._made(("pulled", moving, asked), cotangents, [*self.closed.in_avals, *given])

    def _moving(self, moving: Sequence[bool]) -> list:
        return [aval for aval, moves in zip(self.closed.in_avals, moving, strict=True) if moves]

    def _of_moving(self, of_all: Callable, operands: Sequence, moving: Sequence[bool]) -> tuple[Callable, tuple]:
        """The results that have derivatives, as a function of the operands that move, and these."""

        def function(*xs):
            rest = iter(xs)
            full = [next(rest) if moves else x for moves, x in zip(moving, operands, strict=True)]
            found = of_all(*full)
            return [x for x, aval in zip(found, self.closed.out_avals, strict=True) if inexact(aval)]

        return function, tuple(x for x, moves in zip(operands, moving, strict=True) if moves)

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

    def in_lanes(self, last: int) -> Compiled | None:
        """Machine code for as many lanes as vectors hold, which differ in the `last` operands.

        None where lanes part so often that one after the other is faster, or a primitive has no rule for lanes.
        """
        if ("in lanes", last) not in self._derived:
            wide = [place >= len(self.closed.in_avals) - last for place in range(len(self.closed.in_avals))]
            try:
                if apart(self.closed.jaxpr) > _SURELY * _MOST_APART:  # to lower it first takes seconds
                    raise UnsupportedError("lanes that part often")
                lanes = doubles_in_a_vector()
                code = Compiled(self.closed, lanes=lanes, wide=wide, most_apart=_MOST_APART, in_pieces=True)
            except UnsupportedError:
                code = None
            self._derived["in lanes", last] = code
        return self._derived["in lanes", last]

    def _made(self, key, function, avals) -> "Program":
        if key not in self._derived:
            structs = [jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in avals]
            self._derived[key] = Program(jax.make_jaxpr(function)(*structs), self.columns)
        return self._derived[key]

    def __call__(self, *operands) -> list:
        """The results, as NumPy's arrays where they come from machine code."""
        return list(self.by_xla(*operands)) if self.compiled is None else self.compiled(*operands)


def _columns_within(jaxpr: Jaxpr) -> int:
    programs = [eqn.params["program"].columns for eqn in jaxpr.eqns if eqn.primitive.name == "native_call"]
    inner = [_columns_within(each) for eqn in jaxpr.eqns for each in subprograms(eqn)]
    return max([*programs, *inner], default=0)


_targets: list[Program] = []


def inexact(aval) -> bool:
    """Whether an array has derivatives."""
    return jnp.issubdtype(aval.dtype, np.inexact)
