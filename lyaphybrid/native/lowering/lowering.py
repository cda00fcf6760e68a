"""From a jaxpr to the text of one LLVM function: equation by equation, each by the rule of its primitive.

A rule is a function `(b, eqn, *values) -> value`, or a list of values if the primitive has several results. `b` is the
`Lowering`; the values are the operands in one of the four forms of `values`. An `entrywise` rule gets single entries,
`(b, eqn, dtypes, *entries) -> entry`, and serves entries, rows and lazy arrays alike. `in_rows` registers an additional
rule for operands in rows; if there is none, or it returns None, rows are converted to entries first.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from .emitter import is_known
from .expansion import implementation
from .jax_versions import ClosedJaxpr, Jaxpr, Literal, literal_value, parts
from .seams import MOST_SEAMS, united
from .types import as_numpy, llvm_type
from .unsupported import UnsupportedError
from .uses import WITH_RARE_CASES, Uses, uses_of
from .values import (
    Buffer,
    Lazy,
    MemoryBlock,
    RowVectors,
    Value,
    Values,
    filled,
    flat,
    memory_of,
    scalar,
    seams_of,
    size,
    source_of,
)

RULES: dict[str, Callable] = {}
ENTRYWISE: dict[str, Callable] = {}
IN_ROWS: dict[str, Callable] = {}


def rule(*primitives: str) -> Callable:
    """Register a rule for these primitives."""
    return _register(RULES, primitives)


def entrywise(*primitives: str) -> Callable:
    """Register a rule for single entries."""
    return _register(ENTRYWISE, primitives)


def in_rows(*primitives: str) -> Callable:
    """Register a rule of these primitives for operands in rows."""
    return _register(IN_ROWS, primitives)


def _register(registry: dict[str, Callable], primitives: Sequence[str]) -> Callable:
    def decorate(function: Callable) -> Callable:
        for primitive in primitives:
            registry[primitive] = function
        return function

    return decorate


class Lowering(Values):
    """The lowering of one jaxpr to one LLVM function."""

    def __init__(self, *how, **options):
        """Arguments as for `Values`."""
        super().__init__(*how, **options)
        self._uses: dict[Jaxpr, Uses] = {}

    def constant_value(self, number) -> Value:
        """A constant array."""
        array = as_numpy(number)
        if array.dtype == jax.dtypes.float0:  # the cotangent of an integer, which is never read
            array = np.zeros(array.shape, bool)
        llvm_type(array.dtype)
        if self.is_small(array.shape):
            return filled(array.shape, array.ravel().tolist())
        return self.constant_buffer(array, array.dtype)

    def run(self, jaxpr: ClosedJaxpr | Jaxpr, values: Sequence[Value]) -> list[Value]:
        """The results of a jaxpr for these operands."""
        inner, constants = parts(jaxpr)
        uses = uses_of(inner, ENTRYWISE, CALLS, self._uses)
        last, twins, held = uses.last, uses.twins, {}
        waiting: dict[Any, Lazy] = {}  # successive arrays that come to lie in memory, with rare cases

        def hold(variable, value):
            if isinstance(value, np.ndarray):  # entries, which most values are
                held[variable] = value
                return
            if isinstance(value, Lazy) and variable in uses.apart and not value.cheap:
                if value.has_rare_cases:
                    waiting[variable] = value
                else:
                    value = self.in_memory(value)
            held[variable] = value
            if (source := source_of(value)) is not None:
                source.holders += 1

        def release(variable):
            value = held.pop(variable)
            if not isinstance(value, np.ndarray) and (source := source_of(value)) is not None:
                source.holders -= 1

        def read(atom):
            if isinstance(atom, Literal):
                return self.constant_value(literal_value(atom))
            return held[twins.get(atom, atom)]

        for variable, value in zip(
            (*inner.constvars, *inner.invars), (*map(self.constant_value, constants), *values), strict=True
        ):
            if variable in last:
                hold(variable, value)
        del values
        for place, eqn in enumerate(inner.eqns):
            if not any(variable in last for variable in eqn.outvars) and not eqn.effects:
                continue  # the results are not used
            read_here = {twins.get(v, v) for v in eqn.invars if not isinstance(v, Literal)}
            if waiting and (eqn.primitive.name not in WITH_RARE_CASES or not waiting.keys().isdisjoint(read_here)):
                self.work_out(list(waiting.values()))
                waiting.clear()
            operands = [read(atom) for atom in eqn.invars]
            for variable in [v for v in read_here if last[v] == place]:
                release(variable)
            results = self.equation(eqn, operands)
            del operands
            for variable, value in zip(eqn.outvars, results, strict=True):
                if variable in last:
                    hold(variable, value)
            del results
        self.work_out(list(waiting.values()))
        results = [read(atom) for atom in inner.outvars]
        for variable in list(held):
            release(variable)
        return results

    def equation(self, eqn, operands: list[Value]) -> list[Value]:
        """The results of one equation."""
        name = eqn.primitive.name
        if name in ENTRYWISE:
            return [self._entry_by_entry(ENTRYWISE[name], eqn, operands)]
        if name not in RULES:
            return self.run(implementation(eqn), operands)
        if name not in KEEPS_SEAMS and name not in CALLS:  # its loops are not cut
            operands = [self.in_memory(value) if seams_of(value) else value for value in operands]
        found = None
        if any(isinstance(value, RowVectors) for value in operands):
            if name in IN_ROWS:
                found = IN_ROWS[name](self, eqn, *operands)
            if found is None and name not in KEEPS_ROWS:
                operands = [self.entries(value) if isinstance(value, RowVectors) else value for value in operands]
        if found is None:
            found = RULES[name](self, eqn, *operands)
        return found if isinstance(found, list) else [found]

    def _entry_by_entry(self, function: Callable, eqn, operands: list[Value]) -> Value:
        result, dtypes = eqn.outvars[0].aval, [atom.aval.dtype for atom in eqn.invars]
        llvm_type(result.dtype)
        if not result.shape:  # most often
            numbers = [value.item() for value in operands if isinstance(value, np.ndarray) and not value.shape]
            if len(numbers) == len(operands):
                return scalar(function(self, eqn, dtypes, *numbers))
        if any(len(value.shape) not in (0, len(result.shape)) for value in operands):  # numbers as the bits of others
            raise UnsupportedError(f"{eqn.primitive.name} that changes the number of axes")
        if any(isinstance(value, RowVectors) for value in operands):
            lead = result.shape[:-1]
            columns = [
                np.broadcast_to(v if v.ndim == 0 else self.rows(v, d).vectors, lead).ravel()
                if isinstance(v, np.ndarray)
                else np.broadcast_to(self.rows(v, d).vectors, lead).ravel()
                for v, d in zip(operands, dtypes, strict=True)
            ]
            vectors = filled(lead, [function(self, eqn, dtypes, *each) for each in zip(*columns, strict=True)])
            return RowVectors(vectors, result.shape, result.dtype)
        if self.is_small(result.shape):
            arrays = [self.entries(v) for v in operands]
            n = size(result.shape)
            columns = [
                flat(a) if a.shape == result.shape
                else [a.item()] * n if not a.shape
                else flat(np.broadcast_to(a, result.shape))
                for a in arrays
            ]  # fmt: skip
            return filled(result.shape, [function(self, eqn, dtypes, *each) for each in zip(*columns, strict=True)])
        seams = united(seams_of(v) for v in operands if v.shape[:1] == result.shape[:1])
        cut = len(seams) <= MOST_SEAMS
        readable = [
            self.readable(v, d, size(v.shape) < size(result.shape), cut and v.shape[:1] == result.shape[:1])
            for v, d in zip(operands, dtypes, strict=True)
        ]

        def at(indices):
            each = [self.element_at(v, spread(indices, v.shape), d) for v, d in zip(readable, dtypes, strict=True)]
            outer, self.in_vector_loop = self.in_vector_loop, not is_known(*indices)
            found = function(self, eqn, dtypes, *each)
            self.in_vector_loop = outer
            return found

        lazy = self.lazy(result.shape, result.dtype, at, readable)
        lazy.has_rare_cases = eqn.primitive.name in WITH_RARE_CASES
        lazy.seams = united(map(seams_of, readable))
        return lazy

    def readable(self, value: Value, dtype, often: bool = False, cut: bool = False) -> Value:
        """The value in a form whose elements can be read cheaply at indices that are known only at run time.

        `often`: whether elements are read more than once, so that a lazy array is computed into memory first; `cut`:
        whether the loop that reads it is cut at its seams, for otherwise it is computed into memory too.
        """
        if isinstance(value, Lazy) and (often and not value.cheap or seams_of(value) and not cut):
            return self.in_memory(value)
        if isinstance(value, np.ndarray) and value.ndim and value.size > 1:
            return self.in_memory(value, dtype)
        return value

    def at_hand(self, value: Value) -> Value:
        """The value in a form that may be used within loops and branches: a lazy array is computed into memory."""
        return self.held(self.in_memory(value)) if isinstance(value, Lazy) else value


def spread(indices: Sequence, shape: Sequence[int]) -> list:
    """The indices of an operand for an element of the result it is broadcast to (axes missing, or of length 1)."""
    return [0 if n == 1 else i for i, n in zip(indices[len(indices) - len(shape) :], shape, strict=True)]


NO_CALLS = '"no-builtin-memcpy" "no-builtin-memmove" "no-builtin-memset"'
KEEPS_ROWS: set[str] = set()  # primitives whose rules accept operands in rows
KEEPS_SEAMS: set[str] = set()  # primitives whose rules tell the seams of their results from those of their operands
CALLS: set[str] = set()  # primitives that call a program, whose equations are inlined


def lower(
    closed: ClosedJaxpr,
    small: int,
    columns: int = 0,
    lanes: int = 1,
    wide: Sequence[bool] = (),
    checked: bool = False,
    most_apart: float = 1.0,
) -> str:
    """The module's text; its function is `void @call(ptr inputs, ptr outputs)`, each an array of pointers to arrays.

    Args:
        closed: the program.
        small: arrays of up to so many elements are held as entries.
        columns: number of columns of the frames whose rows are held in vectors; 0: none.
        lanes: number of runs in parallel; `wide` inputs, and all outputs, have a last axis (lanes,).
        wide: for each input, whether the lanes differ in it.
        checked: whether to test each index against the size of its array.
        most_apart: largest part of the code, 0 to 1, that may be in branches which lanes do not share.

    Raises:
        UnsupportedError: if a primitive has no rule, or more of the code than `most_apart` is in such branches.
    """
    b = Lowering(small, columns, lanes, checked)
    jaxpr = closed.jaxpr
    inputs = [
        _input(b, place, variable.aval, lanes > 1 and bool(wide[place])) for place, variable in enumerate(jaxpr.invars)
    ]
    results = b.run(closed, inputs)
    for place, (atom, value) in enumerate(zip(jaxpr.outvars, results, strict=True)):
        _output(b, place, atom.aval, value)
    if b.apart > most_apart * (len(b.lines) - b.seldom):
        raise UnsupportedError(f"lanes that part in {b.apart} of {len(b.lines) - b.seldom} lines")
    body = [*b.allocations, *b.lines, *b.releases, "  ret void"]
    # Short loops that copy stay loops: a call of the C library for each row of a frame is slower.
    head = f"define void @call(ptr noalias readonly %inputs, ptr noalias readonly %outputs) nounwind {NO_CALLS} {{"
    return "\n".join([*b.constants, *sorted(b.declarations), head, "entry:", *body, "}", "!0 = !{}", ""])


def _pointer(b: Lowering, array: str, place: int) -> str:
    address, pointer = b.name(), b.name()
    b.line(f"{address} = getelementptr inbounds ptr, ptr %{array}, i64 {place}")
    b.line(f"{pointer} = load ptr, ptr {address}, align 8, !invariant.load !0")
    return pointer


def _input(b: Lowering, place: int, aval, wide: bool) -> Value:
    pointer, n = _pointer(b, "inputs", place), size(aval.shape)
    return b.held(Buffer(MemoryBlock(pointer, n, False, wide), aval.shape, aval.dtype))


def _output(b: Lowering, place: int, aval, value: Value) -> None:
    pointer, n = _pointer(b, "outputs", place), size(aval.shape)
    result = Buffer(MemoryBlock(pointer, n, True, b.lanes > 1), aval.shape, aval.dtype)
    if memory_of(value) is None:
        b.write(result, value, [0] * len(aval.shape))
    else:
        b.copy_buffer(result, b.in_memory(value))
