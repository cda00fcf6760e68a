"""Which engine runs a large function: our own machine code on a CPU, XLA for all else.

On a CPU a function is traced once for each structure, shape and type of its arguments, and compiled by
`lyaphybrid.native`; within other transformations (jit, vmap, jvp) it becomes a call of that machine code. XLA compiles
what the compiler does not take, what closes over traced values, and all that runs on other devices.
"""

import functools
import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..native import EVENTS, Compiled, Program, engine, native_call, no_collector
from .reverse_mode import both_ways
from .tracing import enclosed, traced

_MOST = 256  # programs of one function that are kept: the least recently used one goes
_WIDEST = 8  # columns of a frame that is held in the vectors of a CPU


class _Compilations(threading.local):
    """A count for each thread: another thread may compile meanwhile."""

    count = 0


_compilations = _Compilations()


def compilations() -> int:
    """How many programs have been compiled in this thread so far, by XLA or natively."""
    return _compilations.count


def _listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
    del duration_secs, kwargs
    _compilations.count += event in ("/jax/core/compile/backend_compile_duration", f"{EVENTS}/LLVM")


jax.monitoring.register_event_duration_secs_listener(_listen)


def is_native() -> bool:
    """Whether our own machine code is asked for, and there is a CPU to run it."""
    return engine() != "xla" and jax.default_backend() == "cpu"


def compiled(
    columns: Callable[..., int] | None = None,
    backward: Callable | None = None,
    hands_on: bool = False,
    in_pieces: bool = False,
) -> Any:
    """Decorate a function of trees of arrays and of what is static.

    Args:
        columns: gives the columns of the frame that is among the arguments; None: as in what is called within.
        backward: the same function, written so that it has reverse derivatives; None: it has them as it is.
        hands_on: the results are not a user's but go to functions like this one: NumPy's arrays take less time to make.
        in_pieces: a long run is many calls.
    """

    def decorate(function: Callable) -> Any:
        natively = _Natively(function, columns, backward, hands_on, in_pieces)
        by_xla: Any = eqx.filter_jit(function)
        with_derivatives = by_xla if backward is None else both_ways(by_xla, eqx.filter_jit(backward))

        def prepared(*args):
            """The function for arguments like these, compiled."""
            if not is_native():
                return by_xla.lower(*args).compile()
            natively.prepare(*args)
            return natively

        @functools.wraps(function)
        def call(*args):
            if traced(enclosed(args)):  # what functions close over has forward derivatives only
                return by_xla(*args)
            if is_native():
                return natively(*args)
            return (with_derivatives if traced(args) else by_xla)(*args)

        def side_by_side(*args):
            """The function for arguments like these, for many last ones at once; None where that is of no use."""
            return natively.side_by_side(*args) if is_native() else None

        def ahead(seconds: float, *args) -> None:
            """Calls like this one will go on for so long."""
            if is_native():
                natively.ahead(seconds, *args)

        call.ahead = ahead  # pyright: ignore[reportAttributeAccessIssue]
        call.prepared = prepared  # pyright: ignore[reportAttributeAccessIssue]
        call.side_by_side = side_by_side  # pyright: ignore[reportAttributeAccessIssue]
        return call

    return decorate


class SideBySide:
    """A function of lanes for its last argument, as many at once as the vectors of the CPU hold.

    Attributes:
        lanes: how many these are.
    """

    def __init__(self, code: Compiled, shared: list, result: Any):
        self.code, self.shared, self.result, self.lanes = code, shared, result, code.lanes

    def __call__(self, lanes: Any) -> Any:
        """The results for these lanes (m, …), m a multiple of `lanes`: NumPy arrays (m, …)."""
        rows = jax.tree.leaves(lanes)
        parts = [[np.empty((0, *aval.shape), aval.dtype) for aval in self.code.program.out_avals]]
        for first in range(0, len(rows[0]), self.lanes):
            mine = [np.moveaxis(np.asarray(row[first : first + self.lanes]), 0, -1) for row in rows]
            parts.append([np.moveaxis(found, -1, 0) for found in self.code(*self.shared, *mine)])
        return jax.tree.unflatten(self.result, [np.concatenate(each) for each in zip(*parts, strict=True)])


_all: list["_Natively"] = []


def forget_programs() -> None:
    """Forget all programs, and their machine code: what is called next is traced anew."""
    for one in _all:
        with one.lock:
            one.known.clear()


class _Natively:
    """A function, traced once for arguments of one kind."""

    def __init__(
        self,
        function: Callable,
        columns: Callable[..., int] | None,
        backward: Callable | None,
        hands_on: bool,
        in_pieces: bool,
    ):
        self.function, self.columns, self.backward, self.hands_on = function, columns, backward, hands_on
        self.in_pieces = in_pieces
        self.known: OrderedDict = OrderedDict()
        self.lock = threading.RLock()  # a function may call itself with other arguments
        _all.append(self)

    def __call__(self, *args):
        leaves, program, result = self._program(args)
        # Within a jit new arrays are traced, whatever the arguments are.
        within = traced(leaves, jnp.zeros(()))
        if within:
            return jax.tree.unflatten(result, native_call.bind(*leaves, program=program))
        found = program(*leaves)
        return jax.tree.unflatten(result, found if self.hands_on else jax.device_put(found))

    def prepare(self, *args) -> None:
        """Trace and compile for arguments like these."""
        _, program, _ = self._program(args)
        _ = program.compiled

    def ahead(self, seconds: float, *args) -> None:
        """Calls with arguments like these will go on for so long: better code may be worth its time."""
        _, program, _ = self._program(args)
        if program.compiled is not None:
            program.compiled.code.ahead(seconds)

    def side_by_side(self, *args) -> SideBySide | None:
        """The same for many last arguments like this one; None where lanes part too often, at events for example."""
        leaves, program, result = self._program(args)
        lanes = len(jax.tree.leaves(eqx.filter(args[-1], eqx.is_array)))
        code = program.in_lanes(lanes)
        return code and SideBySide(code, leaves[: len(leaves) - lanes], result)

    def _program(self, args) -> tuple[list, Program, Any]:
        """The arrays among the arguments, the program for such ones, and the structure of its result."""
        arrays, static = eqx.partition(args, eqx.is_array)
        leaves, tree = jax.tree.flatten(arrays)
        others, other_tree = jax.tree.flatten(static)
        shapes = tuple((x.shape, x.dtype) for x in leaves)
        key = tree, other_tree, tuple(others), shapes, jax.config.read("jax_enable_x64")
        with self.lock:
            if key not in self.known:
                with no_collector():
                    self.known[key] = self._traced(arrays, static)
                if len(self.known) > _MOST:
                    self.known.popitem(last=False)
            self.known.move_to_end(key)
            return leaves, *self.known[key]

    def _traced(self, arrays, static) -> tuple[Program, Any]:
        tree = jax.tree.structure(arrays)

        def flat(function):
            return lambda *leaves: function(*eqx.combine(jax.tree.unflatten(tree, leaves), static))

        columns = None if self.columns is None else self.columns(*eqx.combine(arrays, static))
        if columns is not None and not 2 <= columns <= _WIDEST:
            columns = 0
        closed, shapes = jax.make_jaxpr(flat(self.function), return_shape=True)(*jax.tree.leaves(arrays))
        backward = self.backward and (lambda *leaves: jax.tree.leaves(flat(self.backward)(*leaves)))
        return Program(closed, columns, backward, self.in_pieces), jax.tree.structure(shapes)
