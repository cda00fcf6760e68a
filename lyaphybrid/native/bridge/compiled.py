"""A compiled program, called with NumPy arrays."""

import ctypes
import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr

from .. import rules  # noqa: F401  registers how each primitive is lowered
from ..lowering.costs import Options, plan, runs_long
from ..lowering.lowering import lower
from ..lowering.types import as_numpy, numpy_type, of_numpy
from ..machine.collector import no_collector
from ..machine.tiers import LONGEST_OPTIMISATION, Tiers
from .handler import filled, handler

DURATION_PREFIX = "/lyaphybrid/native"  # prefix of the durations reported to `jax.monitoring`: …/lowering, …/LLVM


class Compiled:
    """A program as machine code: a function of a flat list of arrays.

    Attributes:
        program: the closed jaxpr.
        plan: the compiler options.
        seconds: durations of lowering, and of LLVM with linking.
        code: its machine code, replaced by optimised code if it runs for long.
    """

    def __init__(
        self,
        program: ClosedJaxpr,
        *,
        columns: int = 0,
        lanes: int = 1,
        wide: Sequence[bool] = (),
        checked: bool = False,
        most_apart: float = 1.0,
        plan: Options | None = None,
        in_pieces: bool = False,
    ):
        """`in_pieces`: a long run consists of many calls, between which optimised code can replace the first one."""
        self.program, self.lanes, self._wide = program, lanes, tuple(wide)
        self._given, self._found = map(_forms, (program.in_avals, program.out_avals))
        self.plan = _plan_of(program) if plan is None else plan
        self._how = columns, lanes, self._wide, checked, most_apart
        clock = time.perf_counter()
        with no_collector():
            text = self.text
        lowered = time.perf_counter()
        # Without a long loop optimised code gains little, so LLVM gets less time for it.
        long = runs_long(program.jaxpr)
        self._patience = LONGEST_OPTIMISATION if long else LONGEST_OPTIMISATION / 20
        at_once = 0.0 if in_pieces or not long else LONGEST_OPTIMISATION
        patience = at_once if plan is None else math.inf
        self.code = Tiers(text, self.plan.level, self.plan.scattered, patience, filled())
        compiled = time.perf_counter()
        self.seconds = {
            "lowering": lowered - clock,
            "LLVM": compiled - lowered,
        }
        for what, seconds in self.seconds.items():
            jax.monitoring.record_event_duration_secs(f"{DURATION_PREFIX}/{what}", seconds)

    @property
    def text(self) -> str:
        """The module in LLVM IR; it may be long, so it is generated when needed and not kept."""
        jaxpr = self.program.jaxpr
        return lower(self.program, self.plan.small, *self._how) + handler(len(jaxpr.invars), len(jaxpr.outvars))

    def address(self, function: str) -> int:
        """The address of a function of the code, for XLA's programs, in which a whole run is one call."""
        return self.code.address(function, self._patience)

    def __call__(self, *operands) -> list[np.ndarray]:
        """The results; Python's lock is released meanwhile. With lanes each result has a last axis (lanes,)."""
        last = (self.lanes,) if self.lanes > 1 else ()
        inputs = []
        for i, (x, (shape, dtype, _)) in enumerate(zip(operands, self._given, strict=True)):
            if type(x) is not np.ndarray or x.dtype != dtype or not x.flags.c_contiguous:
                x = np.ascontiguousarray(as_numpy(x), dtype=dtype)
            expected = (*shape, *last) if self._wide and self._wide[i] else shape
            if x.shape != expected and (x.size != 1 or expected != ()):  # ascontiguousarray makes scalars (1,)
                raise ValueError(f"operand {i} must have shape {expected}; got {x.shape}.")
            inputs.append(x)
        outputs = [np.empty((*shape, *last), dtype) for shape, dtype, _ in self._found]
        self.code(_pointers(inputs), _pointers(outputs))
        return [of_numpy(x, dtype) for x, (_, _, dtype) in zip(outputs, self._found, strict=True)]


def _forms(avals: Sequence) -> list[tuple[tuple[int, ...], np.dtype, Any]]:
    """Of each array its shape, its NumPy type and its JAX type."""
    return [(tuple(aval.shape), numpy_type(aval.dtype), aval.dtype) for aval in avals]


def _plan_of(program: ClosedJaxpr) -> Options:
    return plan(program.jaxpr)


def _pointers(arrays: Sequence[np.ndarray]):
    return (ctypes.c_void_p * max(1, len(arrays)))(*map(_address, arrays))


def _address(array: np.ndarray) -> int:
    """The address of the first element; `ctypes` says it faster than NumPy, but only of what may be written."""
    if array.size > 0 and array.flags.writeable:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # pyright: ignore[reportArgumentType]
    return array.__array_interface__["data"][0]


def compile(function: Callable, *example, **options) -> Callable:
    """A function of pytrees of arrays, compiled for arguments like these; `options` are those of `Compiled`."""
    program, shapes = jax.make_jaxpr(function, return_shape=True)(*example)
    compiled, tree = Compiled(program, **options), jax.tree.structure(shapes)

    def call(*args):
        return jax.tree.unflatten(tree, compiled(*jax.tree.leaves(args)))

    call.compiled = compiled  # pyright: ignore[reportFunctionMemberAccess]
    return call
