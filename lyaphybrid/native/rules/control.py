"""Rules for loops, which become loops of machine code.

The state of a loop is held in registers (small arrays, rows) or in buffers of its own (large arrays), which the body
may overwrite in place. With lanes a loop continues while any lane does; the other lanes keep their values.
"""

import contextlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..elementary import arithmetic as a
from ..lowering.costs import turns_written_out
from ..lowering.emitter import Entry, is_wide, same
from ..lowering.expansion import traced
from ..lowering.jax_versions import ClosedJaxpr, parts, scan_of
from ..lowering.lowering import KEEPS_ROWS, Lowering, rule
from ..lowering.types import INDEX, llvm_type
from ..lowering.values import Buffer, Entries, RowVectors, Value, filled, flat, memory_of, scalar
from .moving import with_axis

KEEPS_ROWS |= {"while", "scan"}

__all__ = ["scan", "while_"]


class _Aval(NamedTuple):
    shape: tuple[int, ...]
    dtype: np.dtype


def registers_of(value: Value) -> Entries | None:
    """The entries or vectors of a value in registers; None for a value in memory."""
    return value if isinstance(value, np.ndarray) else value.vectors if isinstance(value, RowVectors) else None


def held_like(value: Value, registers: Entries) -> Value:
    """A value of the same form with other registers."""
    return RowVectors(registers, value.shape, value.dtype) if isinstance(value, RowVectors) else registers


def in_registers(b: Lowering, value: Value, aval) -> Entries | RowVectors:
    return b.rows(value, aval.dtype) if b.holds_rows(aval.shape, aval.dtype) else b.entries(value)


def _state(b: Lowering, values: Sequence[Value], avals) -> list[Value]:
    """The initial values in the form in which a loop holds its state: registers, or buffers that may be written."""
    found = []
    for place, (value, aval) in enumerate(zip(values, avals, strict=True)):
        if b.is_small(aval.shape):
            found.append(in_registers(b, value, aval))
        else:
            others = [*values[:place], *values[place + 1 :], *found]
            found.append(b.to_write(value, aval.dtype, others))
    return found


def _returned(b: Lowering, state: list[Value], results: Sequence[Value], avals) -> list[Value]:
    """Moves the results of the body to the buffers of the state; returns those that go to its registers."""
    settled, moves = [], []
    places = {memory_of(value) for value in state} - {None}
    for value, result, aval in zip(state, results, avals, strict=True):
        if not isinstance(value, Buffer):
            settled.append(in_registers(b, result, aval))
            continue
        result = b.in_memory(result, aval.dtype)
        if result.memory is value.memory:
            continue
        # Parts of the state may be exchanged: copy such a result before its memory is overwritten.
        moves.append((value, b.copied(result) if result.memory in places else result))
    for value, result in moves:
        b.settle_readers(value.memory)
        b.copy_buffer(value, result)
    return settled


@contextlib.contextmanager
def keeping(values: Sequence[Value]):
    """A context in which these values must not be overwritten."""
    memories = [memory for value in values if (memory := memory_of(value)) is not None]
    for memory in memories:
        memory.holders += 1
    yield
    for memory in memories:
        memory.holders -= 1


def any_lane(b: Lowering, condition: Entry) -> Entry:
    if not is_wide(condition):
        return condition
    bits, found = b.name(), b.name()
    b.line(f"{bits} = bitcast <{b.width} x i1> {condition} to i{b.width}")
    b.line(f"{found} = icmp ne i{b.width} {bits}, 0")
    return found


class _Checkpoint(NamedTuple):
    """The state of the emitter before a loop, to be restored if the loop must be emitted again."""

    lines: int
    allocations: int
    releases: int
    constants: int
    label: str
    counts: tuple[int, int]
    scope: tuple[int, int]

    @classmethod
    def of(cls, b: Lowering):
        counts = b.apart, b.seldom
        return cls(len(b.lines), len(b.allocations), len(b.releases), len(b.constants), b.label, counts, b.scope())

    def restore(self, b: Lowering) -> None:
        del b.lines[self.lines :], b.allocations[self.allocations :]
        del b.releases[self.releases :], b.constants[self.constants :]
        b.label, (b.apart, b.seldom) = self.label, self.counts
        b.end_scope(self.scope)


def _loop(
    b: Lowering, state: list[Value], avals, goes_on: Callable, body: Callable, unchanged: Sequence[bool]
) -> list[Value]:
    """A loop: while goes_on(state): state = body(state). `unchanged`: which parts the body returns as they are."""
    registers = [registers_of(value) for value in state]
    start = [entry for r in registers if r is not None for entry in flat(r)]
    types = [llvm_type(v.dtype) for r, v in zip(registers, avals, strict=True) if r is not None for _ in flat(r)]
    fixed = [f for r, f in zip(registers, unchanged, strict=True) if r is not None for _ in flat(r)]
    wide = [is_wide(entry) for entry in start]
    checkpoint, outer = _Checkpoint.of(b), b.mask
    while True:  # with lanes repeated until it is known which values differ between them
        before = b.label
        head, inside, done = b.block_name(), b.block_name(), b.block_name()
        firsts = [e if f else b.text(e, t, w) for e, t, w, f in zip(start, types, wide, fixed, strict=True)]
        b.line(f"br label %{head}")
        b.begin_block(head)
        place = len(b.lines)
        b.lines.append("")  # placeholder for the phi instructions
        phis = [e if f else b.name(w) for e, w, f in zip(start, wide, fixed, strict=True)]
        scope = b.scope()
        now = _refilled(state, phis)
        condition = goes_on(now)
        if outer is not None and is_wide(condition):  # a scalar condition is the same for all lanes
            condition = b.logic("and", condition, outer)
        b.line(f"br i1 {b.text(any_lane(b, condition), 'i1')}, label %{inside}, label %{done}")
        b.begin_block(inside)
        inner_scope = b.scope()
        b.mask = condition if is_wide(condition) else outer
        results = _returned(b, state, body(now), avals)
        ends = [e for value in results if (r := registers_of(value)) is not None for e in flat(r)]
        if is_wide(condition):  # lanes that have finished keep their values
            ends = [
                end if same(end, phi) else b.select(condition, t, end, phi)
                for end, phi, t in zip(ends, phis, types, strict=True)
            ]
        b.mask = outer
        grown = [w or (is_wide(end) and not f) for w, end, f in zip(wide, ends, fixed, strict=True)]
        if grown != wide:
            wide = grown
            checkpoint.restore(b)
            continue
        lasts = [e if f else b.text(e, t, w) for e, t, w, f in zip(ends, types, wide, fixed, strict=True)]
        b.line(f"br label %{head}")
        lines = [
            f"  {phi} = phi {b.type_text(t, w)} [ {first}, %{before} ], [ {last}, %{b.label} ]"
            for phi, t, w, first, last, f in zip(phis, types, wide, firsts, lasts, fixed, strict=True)
            if not f
        ]
        b.lines[place] = "\n".join(lines)
        b.end_scope(inner_scope)
        b.end_scope(scope)
        b.begin_block(done)
        return _refilled(state, phis)


def _refilled(state: list[Value], entries: Sequence[Entry]) -> list[Value]:
    """The state with these registers."""
    found, rest = [], iter(entries)
    for value in state:
        registers = registers_of(value)
        if registers is None:
            found.append(value)
        else:
            found.append(held_like(value, filled(registers.shape, [next(rest) for _ in range(registers.size)])))
    return found


def _handed_on(body: ClosedJaxpr, carried: int, before: int) -> list[bool]:
    """Which parts of the state a body returns unchanged; `before`: number of operands before the state."""
    inner, _ = parts(body)
    return [out is given for out, given in zip(inner.outvars[:carried], inner.invars[before:], strict=False)]


@rule("while")
def while_(b, eqn, *values):
    p, avals = eqn.params, [variable.aval for variable in eqn.outvars]
    of_condition, of_body = p["cond_nconsts"], p["body_nconsts"]
    consts = [b.at_hand(value) for value in values[: of_condition + of_body]]
    in_condition, in_body = consts[:of_condition], consts[of_condition:]
    (condition,) = p["cond_jaxpr"].out_avals  # a condition with axes comes from vmap: several loops in one
    with keeping(consts):
        state = _state(b, values[of_condition + of_body :], avals)

        def go_on(now):
            with keeping(now):
                return b.run(p["cond_jaxpr"], [*in_condition, *now])[0]

        def goes_on(now):
            return b.entry_of(b.run(traced(jnp.any, [condition]), [go_on(now)])[0] if condition.shape else go_on(now))

        def body(now):
            if not condition.shape:
                return b.run(p["body_jaxpr"], [*in_body, *now])
            with keeping(now):
                which = b.at_hand(go_on(now))
                results = b.run(p["body_jaxpr"], [*in_body, *now])
                return b.run(traced(_for_those_that_go_on, [condition, *avals, *avals]), [which, *results, *now])

        return _loop(b, state, avals, goes_on, body, _handed_on(p["body_jaxpr"], len(avals), of_body))


def _for_those_that_go_on(which, *states):
    """For loops batched by vmap: the new state of those that continue, the old state of the others."""
    middle = len(states) // 2

    def chosen(new, old):
        return jnp.where(jnp.reshape(which, which.shape + (1,) * (new.ndim - which.ndim)), new, old)

    return [chosen(new, old) for new, old in zip(states[:middle], states[middle:], strict=True)]


@rule("scan")
def scan(b, eqn, *values):
    p, avals = scan_of(eqn), [variable.aval for variable in eqn.outvars]
    consts = [b.at_hand(value) for value in values[: p.consts]]
    start, xs = values[p.consts : p.consts + p.carry], values[p.consts + p.carry :]
    x_avals = [atom.aval for atom in eqn.invars[p.consts + p.carry :]]
    with keeping(consts):
        if p.length == 0:
            return [*start, *(filled(v.shape, []) for v in avals[p.carry :])]
        if p.length <= turns_written_out(b.small, p, [*avals, *x_avals]):
            return _written_out(b, p, avals, consts, start, xs, x_avals)
        xs = [b.in_memory(x, v.dtype) for x, v in zip(xs, x_avals, strict=True)]
        with keeping(xs):
            return _scanned(b, p, avals, consts, start, xs, x_avals)


def _written_out(b, p, avals, consts, start, xs, x_avals):
    """An unrolled scan: all indices are constants."""
    xs = [b.entries(x) if b.is_small(v.shape) else b.in_memory(x) for x, v in zip(xs, x_avals, strict=True)]
    records = [_Record(b, aval) for aval in avals[p.carry :]]
    with keeping(xs):
        carry = list(start)
        for i in reversed(range(p.length)) if p.reverse else range(p.length):
            results = b.run(p.body, [*consts, *carry, *(_part(b, x, v, i) for x, v in zip(xs, x_avals, strict=True))])
            carry = results[: p.carry]
            for record, value in zip(records, results[p.carry :], strict=True):
                record.put(i, value)
    return [*carry, *(record.array for record in records)]


class _Record:
    """A stacked output of an unrolled scan."""

    def __init__(self, b: Lowering, aval):
        self.b, small = b, b.is_small(aval.shape)
        self.array = np.empty(aval.shape, object) if small else b.new_buffer(aval.shape, aval.dtype)

    def put(self, i: int, value: Value) -> None:
        if isinstance(self.array, np.ndarray):
            self.array[i] = self.b.entries(value)[()]  # [()] turns an array of shape () into its entry
        else:
            self.b.write(self.array, with_axis(self.b, value, 0), [i, *[0] * len(value.shape)])


def _scanned(b, p, avals, consts, start, xs, x_avals):
    records = [b.new_buffer(aval.shape, aval.dtype) for aval in avals[p.carry :]]
    state = [scalar(0), *_state(b, start, avals[: p.carry])]

    def goes_on(now):
        return a.compare(b, INDEX, "lt", b.entry_of(now[0]), p.length)

    def body(now):
        turn = b.entry_of(now[0])
        place = b.index_sum(p.length - 1, b.index_times(turn, -1)) if p.reverse else turn
        parts_ = [_part(b, x, aval, place) for x, aval in zip(xs, x_avals, strict=True)]
        results = b.run(p.body, [*consts, *now[1:], *parts_])
        for record, value in zip(records, results[p.carry :], strict=True):
            b.write(record, with_axis(b, value, 0), [place, *[0] * len(value.shape)])
        return [scalar(b.index_sum(turn, 1)), *results[: p.carry]]

    handed_on = [False, *_handed_on(p.body, p.carry, p.consts)]
    state_avals = [_Aval((), INDEX), *avals[: p.carry]]
    carry = _loop(b, state, state_avals, goes_on, body, handed_on)[1:]
    return [*carry, *map(b.held, records)]


def _part(b: Lowering, x: Entries | Buffer, aval, place: Entry) -> Value:
    """The part of x that a scan reads in the iteration `place`."""
    shape = aval.shape[1:]
    if isinstance(x, np.ndarray):
        return x[place] if isinstance(x[place], np.ndarray) else scalar(x[place])
    if b.is_small(shape):
        return filled(shape, [b.load_element(x, [place, *i]) for i in np.ndindex(shape)])
    return b.lazy(shape, aval.dtype, lambda i: b.load_element(x, [place, *i]), [x], cheap=True)
