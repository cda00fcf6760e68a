"""Arrays while they are compiled.

An array is held in one of four ways:

- Entries: few elements: each is an entry (a number, or an SSA value); moving them about costs nothing at run time
- Rows: few elements, of which the last axis lies in a vector: the columns of a frame
- Lazy: many elements that are not in memory yet: a function of the index, written out where it is used
- Buffer: many elements in memory; written in place where nothing reads the old value any more
"""

import math
import weakref
from collections.abc import Callable, Sequence

import numpy as np

from .emitter import Emitter, Entry, is_known, is_wide
from .types import BYTES, is_float, llvm_type, numpy_type

Entries = np.ndarray  # of objects


class Source:
    """What variables hold, and what lazy values read: memory, or a lazy value, which may come to lie in memory."""

    def __init__(self):
        self.holders = 0  # how many variables of the program still need what is there
        # What is yet to be worked out from it; in order, so that a program has one text.
        self.readers: weakref.WeakKeyDictionary[Lazy, None] = weakref.WeakKeyDictionary()


class Memory(Source):
    """Where a buffer's elements lie."""

    def __init__(self, pointer: str, size: int, writable: bool, wide: bool = False, mask: Entry | None = None):
        super().__init__()
        self.pointer, self.size = pointer, size
        self.writable = writable  # inputs and constants are not
        self.wide = wide  # whether each element is a vector: one number for each lane
        self.mask = mask  # of the lanes that were going when it was new: the others have nothing there

    def is_free(self) -> bool:
        """Whether it may be written: no variable needs what is there."""
        return self.writable and self.holders == 0


class Buffer:
    """An array in memory, row by row."""

    def __init__(self, memory: Memory, shape: Sequence[int], dtype):
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
        self.sources = sources  # all that it reads, also by way of other lazy values
        self.depth = 1 + max((source.depth for source in sources if isinstance(source, Lazy)), default=0)
        self.cheap = cheap  # may be worked out for each use: it only reads
        self.buffer: Buffer | None = None  # once it was worked out


class Rows:
    """A small array whose last axis lies in vectors: `vectors` has one axis less."""

    def __init__(self, vectors: np.ndarray, shape: Sequence[int], dtype):
        self.vectors, self.shape, self.dtype = vectors, tuple(shape), numpy_type(dtype)


_DEEP = 40  # lazy values that read lazy values: Python's stack is finite

Value = Entries | Rows | Lazy | Buffer


def memory_of(value: Value) -> Memory | None:
    """Where a value lies, if it lies in memory."""
    buffer = value.buffer if isinstance(value, Lazy) else value
    return buffer.memory if isinstance(buffer, Buffer) else None


def source_of(value: Value) -> Source | None:
    """What counts who needs a value; None for entries and rows, which nothing overwrites."""
    return value if isinstance(value, Lazy) and value.buffer is None else memory_of(value)


def scalar(entry: Entry) -> Entries:
    """An array without axes."""
    array = np.empty((), object)
    array[()] = entry
    return array


def filled(shape: Sequence[int], entries: Sequence[Entry]) -> Entries:
    """An array of entries, row by row."""
    array = np.empty(len(entries), object)
    for i, entry in enumerate(entries):  # not array[:] = entries, which would look into strings
        array[i] = entry
    return array.reshape(shape)


def flat(array: Entries) -> list[Entry]:
    """The entries, row by row."""
    return array.ravel().tolist()


def size(shape: Sequence[int]) -> int:
    """How many elements."""
    return math.prod(shape)


def rows_available(shape: Sequence[int], dtype, columns: int) -> bool:
    """Whether an array has the form of a frame: (n, columns) floating-point numbers."""
    return columns > 1 and len(shape) == 2 and shape[-1] == columns and is_float(dtype)


class Values(Emitter):
    """The emitter, for arrays."""

    def __init__(self, small: int = 16, columns: int = 0, lanes: int = 1, checked: bool = False):
        """Up to `small` elements are entries; frames of so many columns are rows; `lanes` runs go side by side."""
        if columns and lanes > 1:
            raise ValueError("vectors hold either the columns of frames or lanes")
        super().__init__(2 ** math.ceil(math.log2(columns)) if columns else lanes, checked)
        self.small, self.columns, self.lanes = small, columns, lanes
        self.carries_vectors = lanes > 1
        self.mask: Entry | None = None  # of the lanes that are still going, where lanes diverge
        self.apart = 0  # how many lines stand in branches that lanes do not share, less …
        self.seldom = 0  # … those that are said to be run seldom
        self._lazies: list[weakref.ref[Lazy]] = []  # in the order in which they were made

    def scope(self) -> tuple[int, int]:
        """Open a scope: what is lazy in it cannot be worked out after its end, for its indices are known there only."""
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
        """Whether such an array is held in rows."""
        return rows_available(shape, dtype, self.columns) and self.is_small(shape)

    # --- elements --------------------------------------------------------------------------------------------

    def entry_of(self, value: Value) -> Entry:
        """The one element of an array without axes (or with one element)."""
        return flat(self.entries(value))[0]

    def element_at(self, value: Value, indices: Sequence[Entry], dtype=None) -> Entry:
        """One element; the indices are numbers or SSA values, within bounds. `dtype`: of entries, which do not know."""
        known = is_known(*indices)
        if isinstance(value, Rows):
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
        """An element of entries at indices that are known at run time only: by comparisons."""
        index, *rest = indices
        if not isinstance(index, str):
            return self._chosen(array[index], rest, type_) if rest else array[index]
        parts = [self._chosen(array[i], rest, type_) if rest else array[i] for i in range(array.shape[0])]
        found = parts[-1]
        for i in range(len(parts) - 2, -1, -1):
            found = self.select(self.binary("icmp eq", "i64", index, i), type_, parts[i], found)
        return found

    def load_element(self, buffer: Buffer, indices: Sequence[Entry]) -> Entry:
        """An element from memory."""
        memory, type_, place = buffer.memory, llvm_type(buffer.dtype), self.linear_index(indices, buffer.shape)
        if is_wide(place):  # each lane reads elsewhere
            return self.vector([self.load(memory.pointer, type_, at) for at in self._places(memory, place)], type_)
        self.check_index(place, memory.size)
        return self.load(memory.pointer, type_, self._place(memory, place), memory.wide)

    def store_element(self, buffer: Buffer, indices: Sequence[Entry], entry: Entry) -> None:
        """An element into memory; lanes that have stopped keep what they have there."""
        memory, type_, place = buffer.memory, llvm_type(buffer.dtype), self.linear_index(indices, buffer.shape)
        if memory.wide and self.mask is not None and self.mask != memory.mask:
            entry = self.select(self.mask, type_, entry, self.load_element(buffer, indices))
        if is_wide(place):
            for lane, at in enumerate(self._places(memory, place)):
                self.store(memory.pointer, type_, at, self.element(entry, lane, type_))
            return
        self.check_index(place, memory.size)
        self.store(memory.pointer, type_, self._place(memory, place), entry, memory.wide)

    def _place(self, memory: Memory, place: Entry) -> Entry:
        return self.index_times(place, self.lanes) if memory.wide else place

    def _places(self, memory: Memory, place: Entry) -> list[Entry]:
        """For each lane where its element lies."""
        found = []
        for lane in range(self.lanes):
            index = self.element(place, lane, "i64")
            self.check_index(index, memory.size)
            found.append(self.index_sum(self.index_times(index, self.lanes), lane) if memory.wide else index)
        return found

    # --- from one form to another ----------------------------------------------------------------------------

    def entries(self, value: Value) -> Entries:
        """A value of few elements as entries."""
        if isinstance(value, np.ndarray):
            return value
        if isinstance(value, Rows):
            type_ = llvm_type(value.dtype)
            return filled(
                value.shape,
                [self.element(value.vectors[i[:-1]], i[-1], type_) for i in np.ndindex(value.shape)],
            )
        if isinstance(value, Lazy) and value.buffer is None:
            return filled(value.shape, [value.at(list(i)) for i in np.ndindex(value.shape)])
        return filled(value.shape, [self.element_at(value, i) for i in np.ndindex(value.shape)])

    def rows(self, value: Value, dtype) -> Rows:
        """A frame in rows."""
        if isinstance(value, Rows):
            return value
        array, type_ = self.entries(value), llvm_type(dtype)
        lead = array.shape[:-1]
        return Rows(filled(lead, [self.vector(array[i].tolist(), type_) for i in np.ndindex(lead)]), array.shape, dtype)

    def new_buffer(self, shape: Sequence[int], dtype) -> Buffer:
        """An array in memory, not yet filled; with lanes each has its own numbers there."""
        n = size(shape)
        pointer = self.allocate(llvm_type(dtype), n * self.lanes)
        return Buffer(Memory(pointer, n, True, self.lanes > 1, self.mask), shape, dtype)

    def in_memory(self, value: Value, dtype=None) -> Buffer:
        """A value in memory. `dtype`: of entries, which do not know."""
        if isinstance(value, Buffer):
            return value
        if isinstance(value, Lazy):
            if value.buffer is None:
                buffer = self.new_buffer(value.shape, value.dtype)
                self.for_each_index(value.shape, lambda i: self.store_element(buffer, i, value.at(i)))
                value.buffer = buffer
                buffer.memory.holders, buffer.memory.readers = value.holders, value.readers
            return value.buffer
        if isinstance(value, Rows):
            value, dtype = self.entries(value), value.dtype
        numbers = flat(value)
        if numbers and is_known(*numbers):
            return self.constant_buffer(value, dtype)
        buffer = self.new_buffer(value.shape, dtype)
        for i in np.ndindex(value.shape):
            self.store_element(buffer, i, value[i])
        return buffer

    def constant_buffer(self, array: np.ndarray, dtype) -> Buffer:
        """A constant in memory."""
        pointer = self.constant(array.ravel().tolist(), llvm_type(dtype))
        return Buffer(Memory(pointer, array.size, False), array.shape, dtype)

    def held(self, buffer: Buffer) -> Value:
        """A result in memory: as entries if it is small."""
        return self.entries(buffer) if self.is_small(buffer.shape) else buffer

    def lazy(self, shape: Sequence[int], dtype, at: Callable, operands: Sequence[Value], cheap: bool = False) -> Lazy:
        """A value that is worked out where it is used; `operands`: what it reads."""
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

    def settle_readers(self, memory: Memory) -> None:
        """Work out what still reads from memory that is about to be written."""
        for reader in list(memory.readers):
            self.in_memory(reader)

    def copied(self, buffer: Buffer) -> Buffer:
        """The same array in memory of its own."""
        new = self.new_buffer(buffer.shape, buffer.dtype)
        self.copy_buffer(new, buffer)
        return new

    def copy_buffer(self, to: Buffer, source: Buffer) -> None:
        """Copy all elements."""
        blended = self.mask is not None and self.mask != to.memory.mask
        if to.memory.wide == source.memory.wide and not blended:
            bytes_ = BYTES[llvm_type(source.dtype)] * (self.lanes if to.memory.wide else 1)
            self.copy(to.memory.pointer, source.memory.pointer, size(source.shape) * bytes_)
        else:
            self.for_each_index(source.shape, lambda i: self.store_element(to, i, self.load_element(source, i)))

    def to_write(self, value: Value, dtype, others: Sequence[Value] = ()) -> Buffer:
        """A buffer with the value that may be written: the value's own where nobody needs the old one any more.

        `others` are read while it is written.
        """
        private = isinstance(value, np.ndarray | Rows)
        buffer = self.in_memory(value, dtype)
        memory = buffer.memory
        if (private and memory.writable or memory.is_free()) and memory not in map(memory_of, others):
            self.settle_readers(memory)
            return buffer
        return self.copied(buffer)

    def write(self, buffer: Buffer, value: Value, corner: Sequence[Entry]) -> None:
        """Put an array into a larger one, its first element at `corner`."""

        def shifted(indices):
            return [self.index_sum(i, start) for i, start in zip(indices, corner, strict=True)]

        if isinstance(value, Rows):
            value = self.entries(value)
        if isinstance(value, np.ndarray):
            for i in np.ndindex(value.shape):
                self.store_element(buffer, shifted(i), value[i])
        else:
            self.for_each_index(
                value.shape, lambda i: self.store_element(buffer, shifted(i), self.element_at(value, i))
            )
