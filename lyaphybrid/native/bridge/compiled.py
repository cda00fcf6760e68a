"""A compiled program, called with NumPy's arrays."""

import ctypes
import time
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr

from .. import rules  # noqa: F401  registers how each primitive is lowered
from ..lowering.costs import Plan, plan, runs_long
from ..lowering.lowering import lower
from ..lowering.types import as_numpy, numpy_type, of_numpy
from ..machine.collector import no_collector
from ..machine.tiers import PATIENCE, Tiers, cost
from .handler import handler

EVENTS = "/lyaphybrid/native"  # what `jax.monitoring` is told of each program: …/lowering, …/LLVM


class Compiled:
    """A program as machine code: a function of a flat list of arrays.

    Attributes:
        program: the closed jaxpr.
        plan: how it was compiled.
        seconds: what lowering and LLVM took, with linking.
        code: its machine code, which becomes better where it runs for long.
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
        plan: Plan | None = None,
        in_pieces: bool = False,
    ):
        """`in_pieces`: a long run is many calls, so that better code can follow between two of them."""
        self.program, self.lanes, self._wide = program, lanes, tuple(wide)
        self.plan = _plan_of(program) if plan is None else plan
        self._how = columns, lanes, self._wide, checked, most_apart
        clock = time.perf_counter()
        with no_collector():
            text = self.text
        lowered = time.perf_counter()
        # A long module is numbers written out one by one: optimised, it runs twice as fast at most.
        long = runs_long(program.jaxpr)
        self._patience = PATIENCE if long else PATIENCE / 10
        at_once = plan is None and (in_pieces or not long or cost(text) > PATIENCE)
        self.code = Tiers(text, self.plan.level, self.plan.scattered, at_once)
        compiled = time.perf_counter()
        self.seconds = {
            "lowering": lowered - clock,
            "LLVM": compiled - lowered,
        }
        for what, seconds in self.seconds.items():
            jax.monitoring.record_event_duration_secs(f"{EVENTS}/{what}", seconds)

    @property
    def text(self) -> str:
        """The module, in LLVM's language: written anew each time, for it may be long."""
        jaxpr = self.program.jaxpr
        return lower(self.program, self.plan.small, *self._how) + handler(len(jaxpr.invars), len(jaxpr.outvars))

    def address(self, function: str) -> int:
        """Where a function of the code begins, for XLA's programs, which make a whole run in one call."""
        return self.code.address(function, self._patience)

    def __call__(self, *operands) -> list[np.ndarray]:
        """The results; other threads of Python run meanwhile. With lanes each result has a last axis for them."""
        jaxpr = self.program.jaxpr
        inputs = [
            np.ascontiguousarray(as_numpy(x), dtype=numpy_type(variable.aval.dtype))
            for x, variable in zip(operands, jaxpr.invars, strict=True)
        ]
        last = (self.lanes,) if self.lanes > 1 else ()
        for i, (x, variable) in enumerate(zip(inputs, jaxpr.invars, strict=True)):
            expected = (*variable.aval.shape, *(last if self._wide and self._wide[i] else ()))
            if x.shape != expected and (x.size != 1 or expected != ()):  # ascontiguousarray makes scalars (1,)
                raise ValueError(f"operand {i} must have shape {expected}; got {x.shape}.")
        outputs = [np.empty((*atom.aval.shape, *last), numpy_type(atom.aval.dtype)) for atom in jaxpr.outvars]
        self.code(_pointers(inputs), _pointers(outputs))
        return [of_numpy(x, atom.aval.dtype) for x, atom in zip(outputs, jaxpr.outvars, strict=True)]


def _plan_of(program: ClosedJaxpr) -> Plan:
    return plan(program.jaxpr)


def _pointers(arrays: Sequence[np.ndarray]):
    return (ctypes.c_void_p * max(1, len(arrays)))(*(array.ctypes.data for array in arrays))


def compile(function: Callable, *example, **options) -> Callable:
    """A function of pytrees of arrays, compiled for arguments like these; `options` are those of `Compiled`."""
    program, shapes = jax.make_jaxpr(function, return_shape=True)(*example)
    compiled, tree = Compiled(program, **options), jax.tree.structure(shapes)

    def call(*args):
        return jax.tree.unflatten(tree, compiled(*jax.tree.leaves(args)))

    call.compiled = compiled  # pyright: ignore[reportFunctionMemberAccess]
    return call
