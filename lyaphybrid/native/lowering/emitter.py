"""The text of one LLVM function: instructions with common subexpressions written once, blocks, loops, memory.

An *entry* is one element of an array: a Python bool, int or float if it is a compile-time constant ("known"), otherwise
the name of an SSA value. Names that begin with "%w" are vectors of `width` elements, all others are scalars. A
constant or a scalar stands for a vector of equal elements where it is combined with a vector.
"""

from collections.abc import Callable, Sequence
from typing import Any

from .seams import Seams, Spans, cut
from .types import BYTES, in_memory, literal
from .unsupported import UnsupportedError

_LINE = 64  # bytes of a cache line
_STACK = 2**18  # bytes on the stack, at most: stacks of threads can be as small as half a megabyte

Entry = Any  # bool, int or float if it is a constant, else str


def is_known(*entries: Entry) -> bool:
    """Whether all entries are compile-time constants."""
    for entry in entries:  # noqa: SIM110  called for each instruction, and a plain loop has less overhead
        if isinstance(entry, str):
            return False
    return True


def is_wide(entry: Entry) -> bool:
    """Whether an entry is a vector."""
    return isinstance(entry, str) and entry[1] == "w"


def same(a: Entry, b: Entry) -> bool:
    """Whether two entries are the same value; 0.0 and -0.0, or 1 and True, are different."""
    return a is b or (type(a) is type(b) and a == b and (isinstance(a, str) or repr(a) == repr(b)))


def _key(*parts) -> tuple:
    """A key for common subexpressions; numbers by type and digits, because 1 == True and 0.0 == -0.0."""
    return tuple(part if part is None or isinstance(part, str) else (type(part), repr(part)) for part in parts)


class Emitter:
    """Writes instructions in order; within the scope of its first use an expression is not written twice."""

    def __init__(self, width: int = 1, checked: bool = False):
        """`width`: elements of a vector; `checked`: test each index against the size of its array first."""
        self.width, self.checked = width, checked
        self.lines: list[str] = []
        self.allocations: list[str] = []  # lines of the entry block
        self.releases: list[str] = []  # lines before the function returns
        self.constants: list[str] = []
        self.declarations: set[str] = set()
        self.label = "entry"
        self.carries_vectors = False  # whether the values that `count_up` carries are vectors
        self.in_vector_loop = False  # whether this is the body of a loop over memory, which LLVM may vectorise
        self.rare: list[Entry] | None = None  # where rare cases are noted, to be computed later; None: they are at once
        self.products: dict[Entry, tuple[Entry, Entry]] = {}  # the factors of each product, for fused sums
        self.spans = Spans()
        self._count = self._on_stack = 0
        self._known: dict[tuple, Entry] = {}  # common subexpressions …
        self._order: list[tuple] = []  # … in the order in which they were written

    # --- names, blocks, scopes -------------------------------------------------------------------------------

    def name(self, wide: bool = False) -> str:
        """A fresh name."""
        self._count += 1
        return f"%{'w' if wide else 's'}{self._count}"

    def line(self, text: str) -> None:
        """Write an instruction."""
        self.lines.append("  " + text)

    def block_name(self) -> str:
        """A fresh name for a block."""
        self._count += 1
        return f"b{self._count}"

    def begin_block(self, label: str) -> None:
        """Start a block; the following instructions belong to it."""
        self.lines.append(f"{label}:")
        self.label = label

    def scope(self) -> Any:
        """Open a scope. Its expressions are forgotten at its end, because later code may be reached without them."""
        return len(self._order)

    def end_scope(self, scope: Any) -> None:
        """Close a scope."""
        for key in self._order[scope:]:
            self._known.pop(key, None)
        del self._order[scope:]

    def remember(self, key: tuple, entry: Entry) -> Entry:
        """Record an expression for `recall`."""
        self._known[key] = entry
        self._order.append(key)
        return entry

    def recall(self, key: tuple) -> Entry | None:
        """The value of an expression that was written before in an open scope, or None."""
        return self._known.get(key)

    # --- scalars and vectors ---------------------------------------------------------------------------------

    def type_text(self, type_: str, wide: bool) -> str:
        """The LLVM type, or the vector type of `width` such elements."""
        return f"<{self.width} x {type_}>" if wide else type_

    def text(self, entry: Entry, type_: str, wide: bool = False) -> str:
        """An entry as the text of an operand."""
        if wide:
            return self.spread(entry, type_)
        return entry if isinstance(entry, str) else literal(entry, type_)

    def spread(self, entry: Entry, type_: str) -> str:
        """An entry as a vector of equal elements; a vector stays as it is."""
        if isinstance(entry, str) and is_wide(entry):
            return entry
        if not isinstance(entry, str):
            return "<" + ", ".join([f"{type_} {literal(entry, type_)}"] * self.width) + ">"
        key = ("spread", entry)
        if (found := self.recall(key)) is not None:
            return str(found)
        first, vector, full = self.name(True), self.name(True), self.type_text(type_, True)
        self.line(f"{first} = insertelement {full} poison, {type_} {entry}, i32 0")
        self.line(
            f"{vector} = shufflevector {full} {first}, {full} poison, {self.type_text('i32', True)} zeroinitializer"
        )
        self.remember(key, vector)
        return vector

    def element(self, entry: Entry, place: int, type_: str) -> Entry:
        """One element of a vector."""
        if not is_wide(entry):
            return entry
        key = _key("element", entry, place)
        if (found := self.recall(key)) is not None:
            return found
        name = self.name()
        self.line(f"{name} = extractelement {self.type_text(type_, True)} {entry}, i32 {place}")
        return self.remember(key, name)

    def vector(self, entries: Sequence[Entry], type_: str) -> Entry:
        """A vector of these elements, padded arbitrarily; the entry itself if all are the same."""
        first = entries[0]
        if all(same(entry, first) for entry in entries):
            return first
        key = _key("vector", type_, *entries)
        if (found := self.recall(key)) is not None:
            return found
        full = self.type_text(type_, True)
        padded = [*entries, *[entries[-1] if is_known(entries[-1]) else 0] * (self.width - len(entries))]
        text = "<" + ", ".join(f"{type_} {literal(e, type_) if is_known(e) else 'poison'}" for e in padded) + ">"
        for place, entry in enumerate(entries):
            if isinstance(entry, str):
                name = self.name(True)
                self.line(f"{name} = insertelement {full} {text}, {type_} {entry}, i32 {place}")
                text = name
        if text.startswith("<"):  # all are constants: give the vector a name
            name = self.name(True)
            self.line(f"{name} = select i1 true, {full} {text}, {full} {text}")
            text = name
        return self.remember(key, text)

    # --- instructions ----------------------------------------------------------------------------------------

    def binary(self, operation: str, type_: str, a: Entry, b: Entry, commutes: bool = False) -> Entry:
        """An instruction with two operands of one type: arithmetic or a comparison."""
        if commutes and str(a) > str(b):
            a, b = b, a
        key = _key(operation, type_, a, b)
        if (found := self.recall(key)) is not None:
            return found
        wide = is_wide(a) or is_wide(b)
        left, right = self.text(a, type_, wide), self.text(b, type_, wide)
        name = self.name(wide)
        self.line(f"{name} = {operation} {self.type_text(type_, wide)} {left}, {right}")
        return self.remember(key, name)

    def unary(self, operation: str, type_: str, a: Entry, to: str | None = None) -> Entry:
        """An instruction with one operand: a negation or a conversion."""
        key = _key(operation, type_, a, to)
        if (found := self.recall(key)) is not None:
            return found
        wide = is_wide(a)
        name, operand = self.name(wide), f"{self.type_text(type_, wide)} {self.text(a, type_, wide)}"
        self.line(f"{name} = {operation} {operand}" + (f" to {self.type_text(to, wide)}" if to else ""))
        return self.remember(key, name)

    def select(self, condition: Entry, type_: str, a: Entry, b: Entry) -> Entry:
        """`a` where the condition holds, else `b`."""
        if not isinstance(condition, str):
            return a if condition else b
        if same(a, b):
            return a
        if type_ == "i1" and a is True:
            return self.logic("or", condition, b)
        if type_ == "i1" and b is False:
            return self.logic("and", condition, a)
        key = _key("select", type_, condition, a, b)
        if (found := self.recall(key)) is not None:
            return found
        wide = is_wide(a) or is_wide(b) or is_wide(condition)
        full, left, right = self.type_text(type_, wide), self.text(a, type_, wide), self.text(b, type_, wide)
        name = self.name(wide)
        self.line(
            f"{name} = select {self.type_text('i1', is_wide(condition))} {condition}, {full} {left}, {full} {right}"
        )
        return self.remember(key, name)

    def logic(self, operation: str, a: Entry, b: Entry) -> Entry:
        """`and`, `or`, `xor` of conditions."""
        for known, other in ((a, b), (b, a)):
            if isinstance(known, str):
                continue
            if operation == "and":
                return other if known else False
            if operation == "or":
                return True if known else other
            if not known:
                return other
            if not isinstance(other, str):
                return not other
        if a == b:
            return a if operation != "xor" else False
        return self.binary(operation, "i1", a, b, commutes=True)

    def negation(self, condition: Entry) -> Entry:
        """The negation of a condition."""
        return self.logic("xor", condition, True)

    def intrinsic(self, function: str, type_: str, arguments: Sequence[Entry], to: str | None = None) -> Entry:
        """A call of an LLVM intrinsic, which exists for vectors too."""
        wide = any(map(is_wide, arguments))
        short = {"double": "f64", "float": "f32"}

        def suffix(t: str) -> str:
            return (f"v{self.width}" if wide else "") + short.get(t, t)

        symbol = f"{function}.{suffix(to)}.{suffix(type_)}" if to else f"{function}.{suffix(type_)}"
        return self._call(symbol, type_, arguments, to or type_, wide)

    def call(self, function: str, type_: str, arguments: Sequence[Entry]) -> Entry:
        """A call of a function of the C library without side effects, one for each element of a vector."""
        if not any(map(is_wide, arguments)):
            return self._call(function, type_, arguments, type_, False)
        key = _key("elements", function, type_, *arguments)
        if (found := self.recall(key)) is not None:
            return found
        each = [
            self.call(function, type_, [self.element(a, place, type_) for a in arguments])
            for place in range(self.width)
        ]
        return self.remember(key, self.vector(each, type_))

    def _call(self, symbol: str, type_: str, arguments: Sequence[Entry], to: str, wide: bool) -> Entry:
        key = _key("call", symbol, *arguments)
        if (found := self.recall(key)) is not None:
            return found
        full, result = self.type_text(type_, wide), self.type_text(to, wide)
        texts = ", ".join(f"{full} {self.text(a, type_, wide)}" for a in arguments)
        self.declarations.add(
            f"declare {result} @{symbol}({', '.join([full] * len(arguments))}) memory(none) nounwind willreturn"
        )
        name = self.name(wide)
        self.line(f"{name} = call {result} @{symbol}({texts})")
        return self.remember(key, name)

    # --- arithmetic of indices (i64) -------------------------------------------------------------------------

    def index_sum(self, a: Entry, b: Entry) -> Entry:
        """The sum of two indices."""
        if not isinstance(a, str) and not isinstance(b, str):
            return a + b
        if not isinstance(a, str) and a == 0:
            return b
        if not isinstance(b, str) and b == 0:
            return a
        total = self.binary("add nsw", "i64", a, b, commutes=True)
        self.spans.shift(total, a, b)
        return total

    def index_times(self, a: Entry, factor: int) -> Entry:
        """The product with a constant."""
        if not isinstance(a, str):
            return a * factor
        if factor in (0, 1):
            return a if factor else 0
        return self.binary("mul nsw", "i64", a, factor)

    def linear_index(self, indices: Sequence[Entry], shape: Sequence[int]) -> Entry:
        """The linear index of an element in row-major order."""
        total: Entry = 0
        for index, length in zip(indices, shape, strict=True):
            total = self.index_sum(self.index_times(total, length), index)
        return total

    # --- loops -----------------------------------------------------------------------------------------------

    def count_up(self, length: int, body: Callable, start: Sequence[tuple[Entry, str]] = ()) -> list[Entry]:
        """A loop: for i from 0 to length - 1: carried = body(i, carried); returns the last carried values.

        `start` holds the first carried values, each with its type. The length is at least one.
        """
        if length == 1:
            return list(body(0, [entry for entry, _ in start]) or [])
        head, before = self.block_name(), self.label
        firsts = [self.text(first, type_, self.carries_vectors) for first, type_ in start]
        self.line(f"br label %{head}")
        self.begin_block(head)
        place = len(self.lines)
        self.lines.append("")  # placeholder for the phi instructions
        wide = self.carries_vectors
        i, carried = self.name(), [self.name(wide) for _ in start]
        self.spans.note(i, 0, length)
        scope, rare = self.scope(), self.rare
        self.rare = None
        new = list(body(i, list(carried)) or [])
        self.rare = rare
        lasts = [self.text(last, type_, wide) for last, (_, type_) in zip(new, start, strict=True)]
        self.end_scope(scope)
        after, again, done = self.name(), self.name(), self.block_name()
        self.line(f"{after} = add nuw nsw i64 {i}, 1")
        self.line(f"{again} = icmp ult i64 {after}, {length}")
        self.line(f"br i1 {again}, label %{head}, label %{done}")
        phis = [f"  {i} = phi i64 [ 0, %{before} ], [ {after}, %{self.label} ]"]
        for phi, (_, type_), first, last in zip(carried, start, firsts, lasts, strict=True):
            ends = f"[ {first}, %{before} ], [ {last}, %{self.label} ]"
            phis.append(f"  {phi} = phi {self.type_text(type_, wide)} {ends}")
        self.lines[place] = "\n".join(phis)
        self.begin_block(done)
        return lasts if wide else new

    def for_each_index(self, shape: Sequence[int], body: Callable[[list], None], seams: Seams = ()) -> None:
        """Nested loops: body(indices) for all indices of an array."""
        if 0 not in shape:
            self.fold_indices(shape, lambda i, _: body(i), (), seams)

    def fold_indices(
        self, shape: Sequence[int], body: Callable, start: Sequence[tuple[Entry, str]], seams: Seams = ()
    ) -> list[Entry]:
        """Nested loops: carried = body(indices, carried) for all indices; no length is zero.

        The outermost loop is cut at the seams.
        """
        carried, types = [entry for entry, _ in start], [type_ for _, type_ in start]
        if not shape:
            return list(body([], carried) or [])
        for first, end in cut(shape[0], seams):

            def one(i, carried, first=first):
                outer, now = self.index_sum(i, first), list(zip(carried, types, strict=True))
                return self.fold_indices(shape[1:], lambda inner, carried: body([outer, *inner], carried), now)

            carried = self.count_up(end - first, one, list(zip(carried, types, strict=True)))
        return carried

    # --- memory ----------------------------------------------------------------------------------------------

    def allocate(self, type_: str, size: int) -> str:
        """Memory for an array during the call: small arrays on the stack, where LLVM may keep them in registers."""
        pointer, bytes_ = self.name(), size * BYTES[type_]
        if bytes_ <= 16384 and self._on_stack + bytes_ <= _STACK:
            self._on_stack += bytes_
            self.allocations.append(f"  {pointer} = alloca [{max(size, 1)} x {in_memory(type_)}], align 64")
        else:
            self.declarations |= {
                "declare noalias ptr @malloc(i64) nounwind allocsize(0)",
                "declare void @free(ptr) nounwind",
            }
            # Aligned to a cache line, as on the stack: a vector that lies across two lines is loaded more slowly.
            whole, place, to_go, rest = (self.name() for _ in range(4))
            self.allocations += [
                f"  {whole} = call noalias align 16 ptr @malloc(i64 {bytes_ + _LINE})",
                f"  {place} = ptrtoint ptr {whole} to i64",
                f"  {to_go} = sub i64 0, {place}",
                f"  {rest} = and i64 {to_go}, {_LINE - 1}",
                f"  {pointer} = getelementptr inbounds i8, ptr {whole}, i64 {rest}",
            ]
            self.releases.append(f"  call void @free(ptr {whole})")
        return pointer

    def constant(self, numbers: Sequence, type_: str) -> str:
        """A constant array; programs use the same one at many places."""
        held = in_memory(type_)
        texts = ", ".join(f"{held} {literal(number, held)}" for number in numbers)
        content = f" = private constant [{len(numbers)} x {held}] [{texts}], align 64"
        for known in self.constants:
            if known.endswith(content):
                return known.removesuffix(content)
        name = f"@c{len(self.constants)}"
        self.constants.append(name + content)
        return name

    def address(self, pointer: str, type_: str, index: Entry) -> str:
        """A pointer to an element."""
        if is_wide(index):
            raise UnsupportedError("lanes that index arrays of many elements")
        if not isinstance(index, str) and index == 0:
            return pointer
        name = self.name()
        self.line(f"{name} = getelementptr inbounds {in_memory(type_)}, ptr {pointer}, i64 {index}")
        return name

    def check_index(self, index: Entry, size: int) -> None:
        """If `checked`: code that aborts the process if an index is outside its array."""
        if not self.checked:
            return
        if not isinstance(index, str):
            if not 0 <= index < size:
                raise IndexError(f"index {index} of an array of {size}")
            return
        fine, label, bad = self.name(), self.block_name(), self.block_name()
        self.declarations.add("declare void @abort() noreturn nounwind")
        self.line(f"{fine} = icmp ult i64 {index}, {size}")
        self.line(f"br i1 {fine}, label %{label}, label %{bad}")
        self.lines += [f"{bad}:", "  call void @abort()", "  unreachable"]
        self.begin_block(label)

    def load(self, pointer: str, type_: str, index: Entry, wide: bool = False) -> str:
        """Load an element, or a vector of consecutive elements."""
        address, name, held = self.address(pointer, type_, index), self.name(wide), in_memory(type_)
        if held != type_:
            byte = self.name(wide)
            self.line(f"{byte} = load {self.type_text(held, wide)}, ptr {address}, align 1")
            zero = "zeroinitializer" if wide else "0"
            self.line(f"{name} = icmp ne {self.type_text(held, wide)} {byte}, {zero}")
        else:
            self.line(f"{name} = load {self.type_text(type_, wide)}, ptr {address}, align {BYTES[type_]}")
        return name

    def store(self, pointer: str, type_: str, index: Entry, entry: Entry, wide: bool = False) -> None:
        """Store an element, or a vector of consecutive elements."""
        address, held, text = self.address(pointer, type_, index), in_memory(type_), self.text(entry, type_, wide)
        if held != type_:
            byte = self.name(wide)
            self.line(f"{byte} = zext {self.type_text(type_, wide)} {text} to {self.type_text(held, wide)}")
            text = byte
        self.line(f"store {self.type_text(held, wide)} {text}, ptr {address}, align {BYTES[held]}")

    def copy(self, to: str, source: str, bytes_: int) -> None:
        """Copy memory; source and destination must not overlap."""
        self.declarations.add("declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)")
        self.line(f"call void @llvm.memcpy.p0.p0.i64(ptr align 1 {to}, ptr align 1 {source}, i64 {bytes_}, i1 false)")
