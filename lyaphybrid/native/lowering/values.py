"""The four forms of an array while it is compiled.

- Entries: few elements, each an entry (a constant, or an SSA value); moving them costs nothing at run time.
- Rows: few elements, each row of the last axis in a vector register: the columns of a frame.
- Lazy: many elements that are not computed yet: a function of the index, evaluated where it is used.
- Buffer: many elements in memory, overwritten in place if the old values are not needed any more.
"""

import math
import weakref
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from .emitter import Emitter, Entry, is_known, is_wide
from .seams import Seams
from .types import BYTES, is_float, llvm_type, numpy_type

Entries = np.ndarray  # of type object


class Source:
    """A value with counted uses: memory, or a lazy array, which may be computed into memory later."""

    def __init__(self):
        self.holders = 0  # number of variables of the program that still need the value
        # Lazy arrays that will read it; ordered, so that the text of a program is reproducible.
        self.readers: weakref.WeakKeyDictionary[Lazy, None] = weakref.WeakKeyDictionary()


class MemoryBlock(Source):
    """A block of memory that holds the elements of buffers."""

    def __init__(self, pointer: str, size: int, writable: bool, wide: bool = False, mask: Entry | None = None):
        super().__init__()
        self.pointer, self.size = pointer, size
        self.writable = writable  # False for inputs and constants
        self.wide = wide  # whether each element is a vector, a number for each lane
        self.mask = mask  # the lanes that were active when it was allocated: the others have no values there

    def is_free(self) -> bool:
        """Whether it may be overwritten: no variable needs its values."""
        return self.writable and self.holders == 0


class Buffer:
    """An array in memory, in row-major order."""

    def __init__(self, memory: MemoryBlock, shape: Sequence[int], dtype):
        self.memory, self.shape, self.dtype = memory, tuple(shape), numpy_type(dtype)


class Lazy(Source):
    """An array as a function of the index."""

    def __init__(
        self,
        shape: Sequence[int],
        dtype,
        at: Callable[[list[Entry]], Entry],
        sources: Sequence[Source] = (),
        cheap: bool = False,
    ):
        super().__init__()
        self.shape, self.dtype, self.at = tuple(shape), numpy_type(dtype), at
        self.sources = sources  # all that it reads, directly or through other lazy arrays
        self.depth = 1 + max((source.depth for source in sources if isinstance(source, Lazy)), default=0)
        self.cheap = cheap  # whether it may be evaluated again for each use, because it only reads elements
        self.has_rare_cases = False  # whether elements are computed in another way in rare cases, by a branch
        self.seams: Seams = ()  # where it is best cut in a loop
        self.buffer: Buffer | None = None  # its memory, once it has been computed


class RowVectors:
    """A small array whose last axis is held in vectors; the array `vectors` has one axis less."""

    def __init__(self, vectors: np.ndarray, shape: Sequence[int], dtype):
        self.vectors, self.shape, self.dtype = vectors, tuple(shape), numpy_type(dtype)


_TOGETHER = 16  # most arrays that are computed in one loop
_DEEP = 40  # largest depth of lazy arrays that read lazy arrays: their evaluation is recursive

Value = Entries | RowVectors | Lazy | Buffer


def memory_of(value: Value) -> MemoryBlock | None:
    """The memory of a value, or None if it is not in memory."""
    buffer = value.buffer if isinstance(value, Lazy) else value
    return buffer.memory if isinstance(buffer, Buffer) else None


def source_of(value: Value) -> Source | None:
    """The object that counts the uses of a value; None for entries and rows, which are never overwritten."""
    return value if isinstance(value, Lazy) and value.buffer is None else memory_of(value)


def seams_of(value: Value) -> Seams:
    """The seams of a value; only a lazy array that has not been computed yet has some."""
    return value.seams if isinstance(value, Lazy) and value.buffer is None else ()


def scalar(entry: Entry) -> Entries:
    """An array of shape () with this entry."""
    array = np.empty((), object)
    array[()] = entry
    return array


def filled(shape: Sequence[int], entries: Sequence[Entry]) -> Entries:
    """An array of entries, in row-major order."""
    array = np.empty(len(entries), object)
    for i, entry in enumerate(entries):  # not array[:] = entries, which would treat strings as sequences
        array[i] = entry
    return array.reshape(shape)


def flat(array: Entries) -> list[Entry]:
    """The list of entries, in row-major order."""
    return array.ravel().tolist()


def size(shape: Sequence[int]) -> int:
    """The number of elements."""
    return math.prod(shape)


def rows_available(shape: Sequence[int], dtype, columns: int) -> bool:
    """Whether an array has the form of a frame: (n, columns) floating-point numbers."""
    return columns > 1 and len(shape) == 2 and shape[-1] == columns and is_float(dtype)


class Values(Emitter):
    """The emitter with operations on arrays."""

    def __init__(self, small: int = 16, columns: int = 0, lanes: int = 1, checked: bool = False):
        """Up to `small` elements are entries; frames of `columns` columns are rows; `lanes` runs are in parallel."""
        if columns and lanes > 1:
            raise ValueError("vectors hold either the columns of frames or lanes")
        super().__init__(2 ** math.ceil(math.log2(columns)) if columns else lanes, checked)
        self.small, self.columns, self.lanes = small, columns, lanes
        self.carries_vectors = lanes > 1
        self.mask: Entry | None = None  # the active lanes, where lanes diverge; None: all
        self.apart = 0  # number of lines in branches that lanes do not share, without …
        self.seldom = 0  # … the number of lines that are declared as rarely executed
        self._lazies: list[weakref.ref[Lazy]] = []  # in the order of creation

    def scope(self) -> tuple[int, int]:
        """Open a scope. Lazy arrays created in it cannot be evaluated after its end: they may use its indices."""
        return super().scope(), len(self._lazies)

    def end_scope(self, scope: tuple[int, int]) -> None:
        """Close a scope."""
        expressions, lazies = scope
        super().end_scope(expressions)
        for reference in self._lazies[lazies:]:
            if (lazy := reference()) is not None:
                self._forget(lazy)
        del self._lazies[lazies:]

    def _forget(self, lazy: Lazy) -> None:
        for source in lazy.sources:
            source.readers.pop(lazy, None)

    def is_small(self, shape: Sequence[int]) -> bool:
        """Whether an array of this shape is held as entries."""
        return size(shape) <= self.small

    def holds_rows(self, shape: Sequence[int], dtype) -> bool:
        """Whether an array of this shape and type is held in rows."""
        return rows_available(shape, dtype, self.columns) and self.is_small(shape)

    # --- elements --------------------------------------------------------------------------------------------

    def entry_of(self, value: Value) -> Entry:
        """The only element of an array of size one."""
        return flat(self.entries(value))[0]

    def element_at(self, value: Value, indices: Sequence[Entry], dtype=None) -> Entry:
        """One element; the indices are constants or SSA values, within bounds. `dtype` is needed for entries only."""
        known = is_known(*indices)
        if isinstance(value, RowVectors):
            if known:
                return self.element(value.vectors[tuple(indices[:-1])], int(indices[-1]), llvm_type(value.dtype))
            value, dtype = self.entries(value), value.dtype
        if isinstance(value, np.ndarray):
            return value[tuple(indices)] if known else self._chosen(value, list(indices), llvm_type(dtype))
        if isinstance(value, Lazy):
            if value.buffer is None:
                key = ("element", value, *indices)
                found = self.recall(key)
                return self.remember(key, value.at(list(indices))) if found is None else found
            value = value.buffer
        return self.load_element(value, indices)

    def _chosen(self, array: Entries, indices: list[Entry], type_: str) -> Entry:
        """An element of entries at indices that are known only at run time: by comparisons and selections."""
        index, *rest = indices
        if not isinstance(index, str):
            return self._chosen(array[index], rest, type_) if rest else array[index]
        parts = [self._chosen(array[i], rest, type_) if rest else array[i] for i in range(array.shape[0])]
        found = parts[-1]
        for i in range(len(parts) - 2, -1, -1):
            found = self.select(self.binary("icmp eq", "i64", index, i), type_, parts[i], found)
        return found

    def load_element(self, buffer: Buffer, indices: Sequence[Entry]) -> Entry:
        """Load an element of a buffer."""
        memory, type_, place = buffer.memory, llvm_type(buffer.dtype), self.linear_index(indices, buffer.shape)
        if is_wide(place):  # each lane has its own index
            return self.vector(
                [self.load(memory.pointer, type_, at) for at in self._linear_indices(memory, place)], type_
            )
        self.check_index(place, memory.size)
        return self.load(memory.pointer, type_, self._linear_index(memory, place), memory.wide)

    def store_element(self, buffer: Buffer, indices: Sequence[Entry], entry: Entry) -> None:
        """Store an element of a buffer; inactive lanes keep their old values."""
        memory, type_, place = buffer.memory, llvm_type(buffer.dtype), self.linear_index(indices, buffer.shape)
        if memory.wide and self.mask is not None and self.mask != memory.mask:
            entry = self.select(self.mask, type_, entry, self.load_element(buffer, indices))
        if is_wide(place):
            for lane, at in enumerate(self._linear_indices(memory, place)):
                self.store(memory.pointer, type_, at, self.element(entry, lane, type_))
            return
        self.check_index(place, memory.size)
        self.store(memory.pointer, type_, self._linear_index(memory, place), entry, memory.wide)

    def _linear_index(self, memory: MemoryBlock, place: Entry) -> Entry:
        return self.index_times(place, self.lanes) if memory.wide else place

    def _linear_indices(self, memory: MemoryBlock, place: Entry) -> list[Entry]:
        """For each lane the linear index of its element."""
        found = []
        for lane in range(self.lanes):
            index = self.element(place, lane, "i64")
            self.check_index(index, memory.size)
            found.append(self.index_sum(self.index_times(index, self.lanes), lane) if memory.wide else index)
        return found

    # --- from one form to another ----------------------------------------------------------------------------

    def entries(self, value: Value) -> Entries:
        """A small value as entries."""
        if isinstance(value, np.ndarray):
            return value
        if isinstance(value, RowVectors):
            type_ = llvm_type(value.dtype)
            return filled(
                value.shape,
                [self.element(value.vectors[i[:-1]], i[-1], type_) for i in np.ndindex(value.shape)],
            )
        if isinstance(value, Lazy) and value.buffer is None:
            return filled(value.shape, [value.at(list(i)) for i in np.ndindex(value.shape)])
        return filled(value.shape, [self.element_at(value, i) for i in np.ndindex(value.shape)])

    def rows(self, value: Value, dtype) -> RowVectors:
        """A frame as rows."""
        if isinstance(value, RowVectors):
            return value
        array, type_ = self.entries(value), llvm_type(dtype)
        lead = array.shape[:-1]
        return RowVectors(
            filled(lead, [self.vector(array[i].tolist(), type_) for i in np.ndindex(lead)]), array.shape, dtype
        )

    def new_buffer(self, shape: Sequence[int], dtype) -> Buffer:
        """A new, uninitialised buffer; with lanes it holds one value per lane for each element."""
        n = size(shape)
        pointer = self.allocate(llvm_type(dtype), n * self.lanes)
        return Buffer(MemoryBlock(pointer, n, True, self.lanes > 1, self.mask), shape, dtype)

    def in_memory(self, value: Value, dtype=None) -> Buffer:
        """A value as a buffer. `dtype` is needed for entries only."""
        if isinstance(value, Buffer):
            return value
        if isinstance(value, Lazy):
            self.work_out([value])
            assert value.buffer is not None
            return value.buffer
        if isinstance(value, RowVectors):
            value, dtype = self.entries(value), value.dtype
        numbers = flat(value)
        if numbers and is_known(*numbers):
            return self.constant_buffer(value, dtype)
        buffer = self.new_buffer(value.shape, dtype)
        for i in np.ndindex(value.shape):
            self.store_element(buffer, i, value[i])
        return buffer

    def work_out(self, values: Sequence[Value]) -> None:
        """Compute lazy arrays into memory. Arrays of one shape share a loop, so that common terms are computed once."""
        waiting = dict.fromkeys(value for value in values if isinstance(value, Lazy) and value.buffer is None)
        for lazies in _alike(waiting, lambda lazy: (lazy.shape, lazy.seams)):
            buffers = [self.new_buffer(lazy.shape, lazy.dtype) for lazy in lazies]
            self._store_elements(lazies, buffers)
            for lazy, buffer in zip(lazies, buffers, strict=True):
                lazy.buffer = buffer
                buffer.memory.holders, buffer.memory.readers = lazy.holders, lazy.readers

    def _store_elements(self, lazies: Sequence[Lazy], buffers: Sequence[Buffer]) -> None:
        """Compute lazy arrays of one shape in one loop, in vectors also where they have rare cases.

        If such a case was met, a second loop, with branches, computes all of them again.
        """
        shape, seams = lazies[0].shape, lazies[0].seams

        def store(i):
            for buffer, entry in zip(buffers, [lazy.at(i) for lazy in lazies], strict=True):
                self.store_element(buffer, i, entry)

        def regular(i, carried):
            (met,) = carried
            self.rare = []
            store(i)
            for case in dict.fromkeys(self.rare):
                met = self.binary("or", "i1", met, case)
            self.rare = None
            return [met]

        if self.lanes > 1 or 0 in shape or not any(lazy.has_rare_cases for lazy in lazies):
            self.for_each_index(shape, store, seams)
            return
        (met,) = self.fold_indices(shape, regular, [("false", "i1")], seams)
        again, done = self.block_name(), self.block_name()
        self.line(f"br i1 {met}, label %{again}, label %{done}")
        self.begin_block(again)
        scope = self.scope()
        self.for_each_index(shape, store, seams)
        self.end_scope(scope)
        self.line(f"br label %{done}")
        self.begin_block(done)

    def constant_buffer(self, array: np.ndarray, dtype) -> Buffer:
        """A constant array in memory."""
        pointer = self.constant(array.ravel().tolist(), llvm_type(dtype))
        return Buffer(MemoryBlock(pointer, array.size, False), array.shape, dtype)

    def held(self, buffer: Buffer) -> Value:
        """A result that was computed in memory: loaded as entries if it is small, otherwise the buffer."""
        return self.entries(buffer) if self.is_small(buffer.shape) else buffer

    def lazy(self, shape: Sequence[int], dtype, at: Callable, operands: Sequence[Value], cheap: bool = False) -> Lazy:
        """A lazy array, evaluated where it is used; `operands`: the values that it reads."""
        sources: dict[Source, None] = {}
        for value in operands:
            if (source := source_of(value)) is not None:
                sources[source] = None
            if isinstance(source, Lazy):
                sources |= dict.fromkeys(source.sources)
        found = Lazy(shape, dtype, at, tuple(sources), cheap)
        for source in sources:
            source.readers[found] = None
        self._lazies.append(weakref.ref(found))
        if found.depth > _DEEP:
            self.in_memory(found)
        return found

    def settle_readers(self, memory: MemoryBlock) -> None:
        """Compute the lazy arrays that read from memory which is about to be overwritten."""
        for reader in list(memory.readers):
            self.in_memory(reader)

    def copied(self, buffer: Buffer) -> Buffer:
        """A copy of a buffer in new memory."""
        new = self.new_buffer(buffer.shape, buffer.dtype)
        self.copy_buffer(new, buffer)
        return new

    def copy_buffer(self, to: Buffer, source: Buffer) -> None:
        """Copy all elements from `source` to `to`."""
        blended = self.mask is not None and self.mask != to.memory.mask
        if to.memory.wide == source.memory.wide and not blended:
            bytes_ = BYTES[llvm_type(source.dtype)] * (self.lanes if to.memory.wide else 1)
            self.copy(to.memory.pointer, source.memory.pointer, size(source.shape) * bytes_)
        else:
            self.for_each_index(source.shape, lambda i: self.store_element(to, i, self.load_element(source, i)))

    def to_write(self, value: Value, dtype, others: Sequence[Value] = ()) -> Buffer:
        """A buffer with this value that may be overwritten: its own memory if the old value is not needed, else a copy.

        `others` are values that are read while it is written.
        """
        private = isinstance(value, np.ndarray | RowVectors)
        buffer = self.in_memory(value, dtype)
        memory = buffer.memory
        if (private and memory.writable or memory.is_free()) and memory not in map(memory_of, others):
            self.settle_readers(memory)
            return buffer
        return self.copied(buffer)

    def write(self, buffer: Buffer, value: Value, corner: Sequence[Entry]) -> None:
        """Write an array into a larger one, with its first element at the indices `corner`."""
        self.write_parts(buffer, [(value, corner)])

    def write_parts(self, buffer: Buffer, parts: Sequence[tuple[Value, Sequence[Entry]]]) -> None:
        """Write arrays into a larger one, each at its corner; large arrays of one shape share a loop.

        The parts do not overlap, and read nothing of the larger one.
        """

        def put(value: Value, corner: Sequence[Entry], i: Sequence[Entry]) -> None:
            entry = value[tuple(i)] if isinstance(value, np.ndarray) else self.element_at(value, i)
            self.store_element(buffer, [self.index_sum(x, start) for x, start in zip(i, corner, strict=True)], entry)

        large = []
        for value, corner in parts:
            if isinstance(value, np.ndarray | RowVectors):
                value = self.entries(value)
                for i in np.ndindex(value.shape):
                    put(value, corner, i)
            else:
                large.append((value, corner))
        for alike in _alike(large, lambda part: (part[0].shape, seams_of(part[0]))):

            def body(i, alike=alike):
                for value, corner in alike:
                    put(value, corner, i)

            self.for_each_index(alike[0][0].shape, body, seams_of(alike[0][0]))


def _alike(items: Iterable, of: Callable) -> list[list]:
    """Items grouped by the value of `of`, at most `_TOGETHER` in a group."""
    found: dict[Any, list[list]] = {}
    for item in items:
        groups = found.setdefault(of(item), [[]])
        if len(groups[-1]) == _TOGETHER:
            groups.append([])
        groups[-1].append(item)
    return [group for groups in found.values() for group in groups]
