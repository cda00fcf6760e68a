"""Branches: jumps if all lanes take the same branch, selections if lanes take different ones."""

import collections
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..elementary import arithmetic as a
from ..lowering.costs import worth_a_jump
from ..lowering.emitter import Entry, is_known, is_wide, same
from ..lowering.jax_versions import parts
from ..lowering.lowering import KEEPS_ROWS, Lowering, rule
from ..lowering.types import llvm_type
from ..lowering.values import MemoryBlock, Value, filled, flat, memory_of
from .control import any_lane, held_like, in_registers, keeping, registers_of

__all__ = ["cond"]

KEEPS_ROWS |= {"cond"}


@rule("cond")
def cond(b, eqn, which, *values):
    branches, avals = eqn.params["branches"], [variable.aval for variable in eqn.outvars]
    dtype, index = eqn.invars[0].aval.dtype, b.entry_of(which)
    if not isinstance(index, str):
        return b.run(branches[min(max(int(index), 0), len(branches) - 1)], values)
    values = [b.at_hand(value) for value in values]
    if is_wide(index):
        return _by_lanes(b, branches, index, dtype, values, avals)
    free = {memory: None for value in values if (memory := memory_of(value)) is not None and memory.is_free()}
    for memory in free:
        b.settle_readers(memory)  # before the jump, so that no branch has to do it before it overwrites the memory
    labels, after = [b.block_name() for _ in branches], b.block_name()
    _jump(b, index, dtype, labels)
    ends = [_branch(b, label, after, branch, values, avals) for label, branch in zip(labels, branches, strict=True)]
    results, phis = [], []
    in_use = collections.Counter(
        memory for each in zip(*(end.values for end in ends), strict=True) for memory in _memories(each)
    )
    before = _memories(values)
    new = [memory for end in ends for memory in _memories(end.values) if memory.writable and memory not in before]
    alone = [memory for memory in (*free, *new) if in_use[memory] == 1]  # needed by one result only
    for place, aval in enumerate(avals):
        results.append(_merged(b, [_Arm(end.values[place], end) for end in ends], aval, alone, phis))
    b.begin_block(after)
    b.lines += phis
    return results


class _End(NamedTuple):
    """The end of a branch."""

    values: list[Value]
    label: str
    late: int  # index of a placeholder line before the branch's final jump, for instructions that are added later


class _Arm(NamedTuple):
    value: Value
    end: _End


def _jump(b: Lowering, index: Entry, dtype, labels: list[str]) -> None:
    if np.dtype(dtype).kind == "b":
        b.line(f"br i1 {index}, label %{labels[1]}, label %{labels[0]}")
        return
    type_ = llvm_type(dtype)
    inside = b.select(a.compare(b, dtype, "lt", index, 0), type_, 0, index)
    cases = " ".join(f"{type_} {i}, label %{label}" for i, label in enumerate(labels[:-1]))
    b.line(f"switch {type_} {inside}, label %{labels[-1]} [ {cases} ]")


def _branch(b: Lowering, label: str, after: str, branch, values, avals) -> _End:
    b.begin_block(label)
    scope = b.scope()
    found, results = [], b.run(branch, values)
    b.work_out([result for result, aval in zip(results, avals, strict=True) if not b.is_small(aval.shape)])
    for result, aval in zip(results, avals, strict=True):
        if b.is_small(aval.shape):
            found.append(in_registers(b, result, aval))
        else:
            buffer = b.in_memory(result, aval.dtype)
            # All branches must have the same memory layout, with or without lanes, for a plain copy.
            found.append(buffer if buffer.memory.wide == (b.lanes > 1) else b.copied(buffer))
    late = len(b.lines)
    b.lines.append("")
    end = _End(found, b.label, late)
    b.line(f"br label %{after}")
    b.end_scope(scope)
    return end


def _memories(values: Sequence[Value]) -> set[MemoryBlock]:
    return {memory for value in values if (memory := memory_of(value)) is not None}


def _merged(b: Lowering, arms: list[_Arm], aval, free: Sequence[MemoryBlock], phis: list[str]) -> Value:
    """One value from the values of all branches.

    A value in memory gets the memory that one of the branches uses, if that is among the `free` ones, so that this
    branch need not copy it. Memory from before the branches comes first: a branch may leave it unchanged.
    """
    first = arms[0].value
    registers = [r for arm in arms if (r := registers_of(arm.value)) is not None]
    if not registers:
        if len(_memories([arm.value for arm in arms])) == 1:
            return first
        buffers = [b.in_memory(arm.value) for arm in arms]  # no code: all are buffers already
        there = sorted((x for x in buffers if x.memory in free), key=lambda x: free.index(x.memory))
        merged = there[0] if there else b.new_buffer(aval.shape, aval.dtype)
        for buffer, arm in zip(buffers, arms, strict=True):
            if buffer.memory is not merged.memory:
                _late(b, arm.end, lambda buffer=buffer: b.copy_buffer(merged, buffer))
        return merged
    type_, found = llvm_type(aval.dtype), []
    for each in zip(*(flat(r) for r in registers), strict=True):
        if all(same(entry, each[0]) for entry in each):
            found.append(each[0])
            continue
        wide, texts = any(map(is_wide, each)), []
        for entry, arm in zip(each, arms, strict=True):
            if wide and isinstance(entry, str) and not is_wide(entry):
                entry = _late(b, arm.end, lambda e=entry: b.spread(e, type_))
            texts.append(f"[ {b.text(entry, type_, wide)}, %{arm.end.label} ]")
        found.append(b.name(wide))
        phis.append(f"  {found[-1]} = phi {b.type_text(type_, wide)} {', '.join(texts)}")
    return held_like(first, filled(registers[0].shape, found))


def _late(b: Lowering, end: _End, write: Callable):
    """Add instructions at the end of a branch that has been emitted before."""
    kept, b.lines, scope = b.lines, [], b.scope()
    found = write()
    kept[end.late] += "\n".join(["", *b.lines])
    b.lines = kept
    b.end_scope(scope)
    return found


def _by_lanes(b: Lowering, branches, index: Entry, dtype, values, avals) -> list[Value]:
    """Branches that lanes do not share: each one that any lane takes is computed, and each lane selects its result."""
    outer, results, conditions = b.mask, [], []
    for i, branch in enumerate(branches):
        if np.dtype(dtype).kind == "b":
            mine = index if i else b.negation(index)
        elif i == len(branches) - 1:
            mine = a.compare(b, dtype, "ge", index, i)
        else:
            mine = a.compare(b, dtype, "le" if i == 0 else "eq", index, i)
        b.mask = mine if outer is None else b.logic("and", mine, outer)
        with keeping(values):
            results.append(_if_any_takes_it(b, branch, values, avals))
        conditions.append(mine)
    b.mask = outer

    def chosen(each, aval):
        def at(indices):
            found = b.element_at(each[-1], indices, aval.dtype)
            for value, condition in zip(each[-2::-1], conditions[-2::-1], strict=True):
                found = b.select(condition, llvm_type(aval.dtype), b.element_at(value, indices, aval.dtype), found)
            return found

        if b.is_small(aval.shape):
            return filled(aval.shape, [at(i) for i in np.ndindex(aval.shape)])
        return b.lazy(aval.shape, aval.dtype, at, each)

    return [chosen(each, aval) for each, aval in zip(zip(*results, strict=True), avals, strict=True)]


def _if_any_takes_it(b: Lowering, branch, values, avals) -> list[Value]:
    """The results of a branch for the lanes of the mask; a long branch is jumped over if no lane takes it."""
    if not worth_a_jump(parts(branch)[0]):
        return [b.at_hand(value) for value in b.run(branch, values)]
    before, inside, after = b.label, b.block_name(), b.block_name()
    b.line(f"br i1 {b.text(any_lane(b, b.mask), 'i1')}, label %{inside}, label %{after}")
    begun, apart = len(b.lines) - b.seldom, b.apart
    end = _branch(b, inside, after, branch, values, avals)
    b.apart = apart + len(b.lines) - b.seldom - begun
    given = {entry for value in values if (r := registers_of(value)) is not None for entry in flat(r)}
    phis = []

    def merged(value, aval):
        if (registers := registers_of(value)) is None:
            return value  # its memory exists whether or not the branch was executed
        type_, found = llvm_type(aval.dtype), []
        for entry in flat(registers):
            if is_known(entry) or entry in given:
                found.append(entry)
                continue
            found.append(b.name(is_wide(entry)))
            text = b.type_text(type_, is_wide(entry))
            phis.append(f"  {found[-1]} = phi {text} [ {entry}, %{end.label} ], [ poison, %{before} ]")
        return held_like(value, filled(registers.shape, found))

    results = [merged(value, aval) for value, aval in zip(end.values, avals, strict=True)]
    b.begin_block(after)
    b.lines += phis
    return results
