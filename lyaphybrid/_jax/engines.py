"""Which engine runs a large function: our own machine code on a CPU, XLA otherwise.

On a CPU a function is traced once for each structure, shape and type of its arguments, and compiled by
`lyaphybrid.native`; within other transformations (jit, vmap, jvp) it becomes a call of that machine code. XLA compiles
functions that our compiler does not support, functions that close over traced values, and everything on other devices.
"""

import contextlib
import functools
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..errors import UserFunctionError
from ..native import DURATION_PREFIX, Compiled, Program, engine, native_call, no_collector, on_device
from .forks import refuse_after_fork
from .jaxprs import explicit
from .reverse_mode import both_ways
from .tracing import enclosed, traced, transforming

CLOSED_OVER = (
    "A reverse derivative (jax.grad, jax.jacrev) of a run whose functions close over a value that is not known yet, "
    "such as a parameter that derivatives are taken by. These have forward derivatives only: let the functions take it "
    "from args, field(t, x, args), and pass args=…; or take jax.jacfwd, and jax.jacfwd(jax.jacfwd(f)) for a second one."
)
_PACKAGE = __name__.partition(".")[0]
_MOST = 256  # most cached programs of one function; the least recently used is dropped
_WORTH_A_LOOK = 0.01  # seconds; no program is optimised for a shorter run
_WORTH_A_COUNT = 0.001  # seconds; shorter runs are not counted, which would take them longer
_WIDEST = 8  # most columns of a frame whose rows are held in vector registers


class _Compilations(threading.local):
    """A counter per thread, because another thread may compile at the same time."""

    count = 0


_compilations = _Compilations()


def compilations() -> int:
    """How many programs have been compiled in this thread so far, by XLA or natively."""
    return _compilations.count


def _count_compilation(event: str, duration_secs: float, **kwargs: str | int) -> None:
    del duration_secs, kwargs
    _compilations.count += event in ("/jax/core/compile/backend_compile_duration", f"{DURATION_PREFIX}/LLVM")


jax.monitoring.register_event_duration_secs_listener(_count_compilation)


def is_native() -> bool:
    """Whether our own machine code is selected and the default device is a CPU."""
    return engine() != "xla" and jax.default_backend() == "cpu"


@contextlib.contextmanager
def debug_switches_off() -> Iterator[None]:
    """JAX's `debug_nans`, `debug_infs` and `disable_jit` off: nan marks what was not computed, inf what never happens.

    A field that gives nan ends a run with a status of its own, and without jit the loop over the steps takes hours.
    """
    if not any(getattr(jax.config, f"jax_{name}") for name in ("debug_nans", "debug_infs", "disable_jit")):
        yield  # without entering three contexts
        return
    with jax.debug_nans(False), jax.debug_infs(False), jax.disable_jit(False):
        yield


def compiled(
    columns: Callable[..., int] | None = None,
    backward: Callable | None = None,
    hands_on: bool = False,
    in_pieces: bool = False,
) -> Any:
    """Decorate a function of pytrees with array leaves (traced) and other leaves (static).

    Args:
        columns: returns the number of columns of the frame among the arguments; None: taken from inner calls.
        backward: the same function in a form with reverse derivatives; None: the function itself has them.
        hands_on: return NumPy arrays, which are cheaper to make; for results that go to other compiled functions.
        in_pieces: a long run consists of many calls.
    """

    def decorate(function: Callable) -> Any:
        natively = _Natively(function, columns, backward, hands_on, in_pieces)
        by_xla: Any = eqx.filter_jit(function)
        with_derivatives = by_xla if backward is None else both_ways(by_xla, eqx.filter_jit(backward))

        @debug_switches_off()
        def prepared(*args):
            """The function, compiled for arguments of these shapes and types."""
            if not is_native():
                return by_xla.lower(*args).compile()
            natively.prepare(*args)
            return natively

        @functools.wraps(function)
        @debug_switches_off()
        def call(*args):
            refuse_after_fork()
            try:
                if transforming() and traced(enclosed(args)):
                    return by_xla(*args) if backward is None else _forwards_only(function, args)
                if is_native():
                    return natively(*args)
                return (with_derivatives if traced(args) else by_xla)(*args)
            except ValueError as error:
                if not _is_complete(error):
                    raise
                kind, message = type(error), str(error)
            except (KeyError, NotImplementedError, TypeError) as error:
                if not any(words in str(error) for words in _NO_FORWARD_DERIVATIVE):
                    raise
                kind, message = UserFunctionError, _NO_TANGENTS.format(str(error).partition("\n")[0])
            raise kind(message)  # a new one, without the frames and the notes of JAX, which say nothing about it

        @debug_switches_off()
        def side_by_side(*args):
            """A version for many last arguments at once; None if lanes branch differently too often."""
            return natively.side_by_side(*args) if is_native() else None

        def ahead(seconds: float, *args) -> None:
            """Announce that calls with such arguments will go on for so many seconds."""
            if seconds > _WORTH_A_LOOK and is_native():
                natively.ahead(seconds, *args)

        def ended(seconds: float, *args) -> None:
            """Announce the end of a run of so many seconds, which consisted of calls with such arguments."""
            if seconds > _WORTH_A_COUNT and is_native():
                natively.ended(*args)

        call.ahead = ahead  # pyright: ignore[reportAttributeAccessIssue]
        call.ended = ended  # pyright: ignore[reportAttributeAccessIssue]
        call.prepared = prepared  # pyright: ignore[reportAttributeAccessIssue]
        call.side_by_side = side_by_side  # pyright: ignore[reportAttributeAccessIssue]
        return call

    return decorate


def for_once(function: Callable, *likes: Any) -> Callable[..., list]:
    """A function that returns a list of arrays, compiled for arguments like these.

    Nobody but the caller keeps it, for functions that are made anew for each use: the programs of `compiled` stay.
    """
    with debug_switches_off():
        program = Program(jax.make_jaxpr(function)(*likes), columns=0)

    @debug_switches_off()
    def call(*operands: Any) -> list:
        return program(*operands) if is_native() else list(program.by_xla(*operands))

    return call


# What JAX says of functions that have none, and what this package says of it.
_NO_FORWARD_DERIVATIVE = ("custom_vjp function", "custom_lin", "Forward-mode differentiation rule", "JVP rule")
_NO_TANGENTS = (
    "A function of the system has no forward derivative, of which the motion of perturbations and the times of events "
    "are made: give jax.custom_jvp in place of jax.custom_vjp, and write what has no rule in other terms. JAX says: {}"
)


def _is_complete(error: ValueError) -> bool:
    """Whether an error comes from a check of this package, whose message says everything."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    ours = trace is not None and trace.tb_frame.f_globals.get("__name__", "").startswith(_PACKAGE)
    return ours and type(error) in (ValueError, UserFunctionError)


def _forwards_only(function: Callable, args: tuple) -> Any:
    """The results of a function that closes over tracers, with derivatives by them that go forwards."""
    arrays, static = eqx.partition(args, eqx.is_array)
    leaves, tree = jax.tree.flatten(arrays)

    def flat(*leaves):
        return function(*eqx.combine(jax.tree.unflatten(tree, leaves), static))

    def backwards(*operands):
        raise RuntimeError(CLOSED_OVER)

    of_all, numbers = explicit(flat, *leaves)
    return both_ways(jax.jit(of_all), backwards)(numbers, *leaves)


class SideBySide:
    """A function whose last argument are lanes; as many run at once as a vector register holds.

    Attributes:
        lanes: number of lanes that run at once.
    """

    def __init__(self, code: Compiled, shared: list, result: Any):
        self.code, self.shared, self.result, self.lanes = code, shared, result, code.lanes

    def ahead(self, seconds: float) -> None:
        """Calls will go on for so many seconds: optimised code may be worth its compilation."""
        self.code.code.ahead(seconds)

    def ended(self) -> None:
        """A run of many calls has ended, and may be repeated."""
        self.code.code.ended()

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
    """Drop all cached programs and their machine code; the next call traces again."""
    for one in _all:
        with one.lock:
            one.known.clear()


class _Natively:
    """A function, traced once for each structure, shape and type of its arguments."""

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
        self.lock = threading.RLock()  # re-entrant, because a function may call itself with other arguments
        _all.append(self)

    def __call__(self, *args):
        leaves, program, result = self._program(args)
        if transforming() or traced(leaves):  # within jit, even if the arguments are concrete
            return jax.tree.unflatten(result, native_call.bind(*leaves, program=program))
        found = program(*leaves)
        return jax.tree.unflatten(result, found if self.hands_on else on_device(found))

    def prepare(self, *args) -> None:
        """Trace and compile for arguments of these shapes and types."""
        _, program, _ = self._program(args)
        _ = program.compiled

    def ahead(self, seconds: float, *args) -> None:
        """Calls with such arguments will go on for so many seconds: optimised code may be worth its compilation."""
        _, program, _ = self._program(args)
        if program.compiled is not None:
            program.compiled.code.ahead(seconds)

    def ended(self, *args) -> None:
        """A run has ended, and may be repeated: optimised code may be worth its compilation."""
        _, program, _ = self._program(args)
        if program.compiled is not None:
            program.compiled.code.ended()

    def side_by_side(self, *args) -> SideBySide | None:
        """A version for many last arguments at once; None if lanes branch differently too often, e.g. at events."""
        leaves, program, result = self._program(args)
        lanes = len(jax.tree.leaves(eqx.filter(args[-1], eqx.is_array)))
        code = program.in_lanes(lanes)
        return code and SideBySide(code, leaves[: len(leaves) - lanes], result)

    def _program(self, args) -> tuple[list, Program, Any]:
        """The arrays among the arguments, the program for their shapes and types, and the structure of its result."""
        everything, tree = jax.tree.flatten(args)
        which = tuple(map(eqx.is_array, everything))
        leaves = [x for x, is_array in zip(everything, which, strict=True) if is_array]
        others = tuple(x for x, is_array in zip(everything, which, strict=True) if not is_array)
        shapes = tuple((x.shape, x.dtype) for x in leaves)
        kinds = tuple(map(type, others))  # True == 1, but functions may tell them apart
        key = tree, which, others, kinds, shapes, jax.config.read("jax_enable_x64")
        with self.lock:
            if key not in self.known:
                with no_collector():
                    self.known[key] = self._traced(args)
                if len(self.known) > _MOST:
                    self.known.popitem(last=False)
            self.known.move_to_end(key)
            return leaves, *self.known[key]

    def _traced(self, args) -> tuple[Program, Any]:
        arrays, static = eqx.partition(args, eqx.is_array)
        tree = jax.tree.structure(arrays)

        def flat(function):
            return lambda *leaves: function(*eqx.combine(jax.tree.unflatten(tree, leaves), static))

        columns = None if self.columns is None else self.columns(*args)
        if columns is not None and not 2 <= columns <= _WIDEST:
            columns = 0
        closed, shapes = jax.make_jaxpr(flat(self.function), return_shape=True)(*jax.tree.leaves(arrays))
        backward = self.backward and (lambda *leaves: jax.tree.leaves(flat(self.backward)(*leaves)))
        return Program(closed, columns, backward, self.in_pieces), jax.tree.structure(shapes)
