"""Programs: a jaxpr, its machine code, and the programs derived from it by differentiation or by adding lanes.

Each derived program is cached in the program that it comes from, so that a function that is differentiated or mapped
repeatedly is traced and compiled once.
"""

import ctypes
import functools
import logging
import os
from collections.abc import Callable, Sequence

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from ..lowering.costs import apart
from ..lowering.jax_versions import Jaxpr, subprograms
from ..lowering.unsupported import UnsupportedError
from ..machine.code import doubles_in_a_vector
from .compiled import Compiled

ENGINE_VARIABLE = "LYAPHYBRID_ENGINE"
_ENGINES = ("auto", "native", "xla")
_MOST_APART = 0.2  # largest part of the code in branches that lanes do not share: beyond, lanes wait too often
ONE_WAY = (
    "A second derivative of a run is a forward derivative of a forward one; a reverse derivative is among those asked "
    "for. In place of jax.hessian(f), jax.grad(jax.grad(f)) or the like take jax.jacfwd(jax.jacfwd(f))."
)
_log = logging.getLogger("lyaphybrid.native")
_noted: set[str] = set()


def engine() -> str:
    """The chosen engine: "auto" (XLA for programs that native does not support), "native" (an error there), "xla"."""
    chosen = os.environ.get(ENGINE_VARIABLE, "").lower() or "auto"
    if chosen not in _ENGINES:
        raise ValueError(f"{ENGINE_VARIABLE} must be one of {', '.join(_ENGINES)}; got {chosen!r}.")
    return chosen


class Program:
    """A jaxpr and its machine code, compiled on first use; compared by identity.

    Attributes:
        closed: the closed jaxpr, or a function that traces it when it is needed.
        columns: number of columns of the frames that are held in vectors; 0: none; None: as in the programs it calls.
        backward: the same function of its operands in a form that has reverse derivatives, but no second ones; None:
            that is `closed`.
        in_pieces: whether a long run consists of many calls.
        origin: for a program of tangents, the program it is derived from, and which of its operands have tangents.
    """

    def __init__(
        self,
        closed: ClosedJaxpr | Callable[[], ClosedJaxpr],
        columns: int | None = None,
        backward: Callable | None = None,
        in_pieces: bool = False,
    ):
        self.in_pieces = in_pieces
        self._trace, self.backward = closed if callable(closed) else lambda: closed, backward
        self.columns = _columns_within(self.closed.jaxpr) if columns is None else columns
        self.origin: tuple[Program, tuple[bool, ...]] | None = None
        self._derived: dict = {}

    @functools.cached_property
    def closed(self) -> ClosedJaxpr:
        """The closed jaxpr, traced now if a function was given that does it."""
        return self._trace()

    @functools.cached_property
    def out_avals(self) -> Sequence:
        """The shapes and types of the results."""
        return self.closed.out_avals

    @functools.cached_property
    def compiled(self) -> Compiled | None:
        """The machine code; None if XLA must compile the program, which is logged once for each reason."""
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
        """The same function, compiled by XLA."""
        return jax.jit(jaxpr_as_fun(self.closed))

    @functools.cached_property
    def target(self) -> str | None:
        """The FFI target name under which XLA's programs call the machine code."""
        if self.compiled is None:
            return None
        name = f"lyaphybrid_native_{id(self):x}"
        handler = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(self.compiled.address("handler"))
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(handler), platform="cpu")
        _targets.append(self)  # XLA may call it as long as the process lives
        return name

    def pushed(self, moving: tuple[bool, ...]) -> "Program":
        """The program of the tangents of the results, a function of the operands and of the tangents that are given.

        `moving`: for each operand, whether it has a tangent. It is traced when it is needed: a reverse derivative asks
        for its transpose alone, and tracing the tangents of a long loop takes a second.
        """

        def tangents(*given):
            operands, changes = given[: len(moving)], given[len(moving) :]
            function, primals = self._of_moving(jaxpr_as_fun(self.closed), operands, moving)
            return jax.jvp(function, primals, tuple(changes))[1]

        def refused(*given):
            raise RuntimeError(ONE_WAY)

        made = self._made(("pushed", moving), tangents, [*self.closed.in_avals, *self._moving(moving)])
        made.backward = self.backward and refused
        made.origin = self, moving
        made.out_avals = [aval.to_tangent_aval() for aval in self.out_avals if inexact(aval)]
        return made

    def pulled(self, moving: tuple[bool, ...], asked: tuple[bool, ...]) -> "Program":
        """The program of the cotangents of the `moving` operands, a function of the operands and of given cotangents.

        `asked`: for each result that has derivatives, whether its cotangent is given. The others are left out rather
        than set to zero, because zero times an infinite derivative would be nan.
        """

        def cotangents(*given):
            given = eqxi.nondifferentiable(given, msg=ONE_WAY) if self.backward else given
            operands, back = given[: len(moving)], given[len(moving) :]
            function, primals = self._of_moving(self.backward or jaxpr_as_fun(self.closed), operands, moving)

            def wanted(*xs):
                return [x for x, wants in zip(function(*xs), asked, strict=True) if wants]

            return jax.vjp(wanted, *primals)[1](list(back))

        results = [aval for aval in self.closed.out_avals if inexact(aval)]
        given = [aval for aval, wants in zip(results, asked, strict=True) if wants]
        return self._made(("pulled", moving, asked), cotangents, [*self.closed.in_avals, *given])

    def _moving(self, moving: Sequence[bool]) -> list:
        return [aval for aval, moves in zip(self.closed.in_avals, moving, strict=True) if moves]

    def _of_moving(self, of_all: Callable, operands: Sequence, moving: Sequence[bool]) -> tuple[Callable, tuple]:
        """The differentiable results as a function of the `moving` operands, and the values of these operands."""

        def function(*xs):
            rest = iter(xs)
            full = [next(rest) if moves else x for moves, x in zip(moving, operands, strict=True)]
            found = of_all(*full)
            return [x for x, aval in zip(found, self.closed.out_avals, strict=True) if inexact(aval)]

        return function, tuple(x for x, moves in zip(operands, moving, strict=True) if moves)

    def mapped(self, which: tuple[bool, ...], size: int) -> "Program":
        """The program for `size` lanes, one after the other; operands with `which` true have a first axis (size,)."""

        def side_by_side(function):
            def lanes(*xs):
                def one(mapped):
                    rest = iter(mapped)
                    return function(*(next(rest) if w else x for w, x in zip(which, xs, strict=True)))

                return jax.lax.map(one, [x for w, x in zip(which, xs, strict=True) if w])

            return lanes

        structs = [
            jax.ShapeDtypeStruct((size, *aval.shape), aval.dtype) if w else aval
            for aval, w in zip(self.closed.in_avals, which, strict=True)
        ]
        made = self._made(("mapped", which, size), side_by_side(jaxpr_as_fun(self.closed)), structs)
        made.backward = self.backward and side_by_side(self.backward)
        return made

    def in_lanes(self, last: int) -> Compiled | None:
        """Machine code for as many lanes as a vector register holds; lanes differ only in the `last` operands.

        None if lanes take different branches so often that one after the other is faster, or a primitive has no rule
        for lanes.
        """
        if ("in lanes", last) not in self._derived:
            wide = [place >= len(self.closed.in_avals) - last for place in range(len(self.closed.in_avals))]
            try:
                if apart(self.closed.jaxpr) > _MOST_APART:  # decided without lowering, which takes long
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
            self._derived[key] = Program(lambda: jax.make_jaxpr(function)(*structs), self.columns)
        return self._derived[key]

    def __call__(self, *operands) -> list:
        """The results: NumPy arrays from machine code, otherwise JAX arrays."""
        return list(self.by_xla(*operands)) if self.compiled is None else self.compiled(*operands)


def _columns_within(jaxpr: Jaxpr) -> int:
    programs = [eqn.params["program"].columns for eqn in jaxpr.eqns if eqn.primitive.name == "native_call"]
    inner = [_columns_within(each) for eqn in jaxpr.eqns for each in subprograms(eqn)]
    return max([*programs, *inner], default=0)


_targets: list[Program] = []


def inexact(aval) -> bool:
    """Whether an array has derivatives."""
    return jnp.issubdtype(aval.dtype, np.inexact)
