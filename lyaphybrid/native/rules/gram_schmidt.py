"""Gram–Schmidt in blocks, in place: half the columns, then the other half less what they share, and so on.

The products of large parts are BLAS's; its matrices lie column after column, so that it sees the transposed frame, in
which our columns are rows. A panel of up to 64 columns is held in the vectors of the CPU: they are copied to where the
rows of one vector, of as many columns as it holds, lie one after the other. Within a vector modified Gram–Schmidt takes
one column out of all later ones at once, and finds the overlaps of the next one on the way; then all its columns
together are taken out of later vectors. This is written in functions of their own, which a module holds once: LLVM
need not optimise them wherever they are called.
"""

import functools
import math
from collections.abc import Callable

from ..elementary import arithmetic as a
from ..lowering.emitter import Emitter, Entry
from ..lowering.lowering import Lowering
from ..lowering.types import llvm_type
from ..lowering.values import Buffer, scalar
from ..machine.code import doubles_in_a_vector
from .calls import program
from .linear_algebra import blas

_FEW_COLUMNS = 8  # columns that are done otherwise
_PANEL = 64  # columns of a panel, at most
_SMALLEST_LENGTH = {"double": 1e-290, "float": 1e-30}  # a length that stands for none
_SUMS = 4  # side by side: less waiting for additions
_COMPARED = 32  # columns whose lengths are compared, at most


@program("modified_gram_schmidt")
@program("orthonormal")
def orthonormal(b: Lowering, eqn, *frames):
    """Of a frame (n, k): orthonormal columns, and their lengths (k,)."""
    return list(_in_place(b, eqn, frames[0])) if _taken(b, eqn, frames, 2) else None


@program("orthonormal_by_blocks")
def orthonormal_by_blocks(b: Lowering, eqn, *frames):
    """The same, and the largest ratio of lengths among a few neighbours, which is no finite number where one is 0."""
    if not _taken(b, eqn, frames, 3):
        return None
    columns, lengths = _in_place(b, eqn, frames[0])
    ratios = [_ratio(b, lengths, first, last) for first, last in _neighbours(0, columns.shape[1])]
    return [columns, lengths, scalar(functools.reduce(functools.partial(a.maximum, b, columns.dtype), ratios))]


def _taken(b: Lowering, eqn, frames, results: int) -> bool:
    """Whether this is no derivative of it, say, and there are columns enough."""
    shape = eqn.invars[0].aval.shape
    alone = len(frames) == 1 and len(eqn.outvars) == results
    return alone and len(shape) == 2 and shape[1] > _FEW_COLUMNS and b.lanes == 1


def _in_place(b: Lowering, eqn, frame) -> tuple[Buffer, Buffer]:
    """The columns, where the frame was, and their lengths."""
    dtype, (n, k) = eqn.invars[0].aval.dtype, eqn.invars[0].aval.shape
    columns, lengths = b.to_write(frame, dtype), b.new_buffer((k,), dtype)
    type_ = llvm_type(dtype)

    def rows(first: int) -> str:
        return b.address(columns.memory.pointer, type_, first)

    def panel(first: int, last: int) -> None:
        name, room = _panel_function(b, type_, n, k, last - first)
        work, here = b.new_buffer((room,), dtype), b.address(lengths.memory.pointer, type_, first)
        b.line(f"call void @{name}(ptr {rows(first)}, ptr {here}, ptr {work.memory.pointer})")

    def orthonormalise(first: int, last: int) -> None:
        if last - first <= _PANEL:
            panel(first, last)
            return
        middle = (first + last) // 2
        few, many = middle - first, last - middle
        shares = b.new_buffer((few * many,), dtype).memory.pointer
        orthonormalise(first, middle)
        blas(b, dtype, "gemm", b"N", b"T", few, many, n, 1.0, rows(first), k, rows(middle), k, 0.0, shares, few)
        blas(b, dtype, "gemm", b"T", b"N", many, n, few, -1.0, shares, few, rows(first), k, 1.0, rows(middle), k)
        orthonormalise(middle, last)

    orthonormalise(0, k)
    return columns, lengths


def _neighbours(first: int, last: int) -> list[tuple[int, int]]:
    """Halves of halves, until they are few."""
    if last - first <= _COMPARED:
        return [(first, last)]
    middle = (first + last) // 2
    return [*_neighbours(first, middle), *_neighbours(middle, last)]


def _ratio(b: Lowering, lengths: Buffer, first: int, last: int):
    """The largest of some lengths over the least."""
    dtype, type_ = lengths.dtype, llvm_type(lengths.dtype)

    def length(i, extremes):
        found = b.load_element(lengths, [b.index_sum(i, first)])
        return [a.minimum(b, dtype, extremes[0], found), a.maximum(b, dtype, extremes[1], found)]

    least, greatest = b.count_up(last - first, length, [(math.inf, type_), (0.0, type_)])
    return a.divide(b, dtype, greatest, least)


def _panel_function(module: Emitter, type_: str, n: int, k: int, m: int) -> tuple[str, int]:
    """Its name, and how many elements it needs to work in: `(columns, lengths, work)`, all of them pointers.

    It makes m columns of a frame (n, k) orthonormal, from where `columns` points to on, and stores their m lengths.
    """
    width = doubles_in_a_vector()
    vectors = -(-m // width)
    in_work = vectors * n * width

    def body(f: Emitter, columns: str, lengths: str, work: str) -> None:
        each = [f.address(work, type_, v * n * width) for v in range(vectors)]
        found = f.address(work, type_, in_work)
        _copied(f, type_, n, k, m, columns, each, pack=True)
        for second in range(1, vectors + 1, 2):  # two at once
            pair = each[second - 1 : second + 1]
            for before in each[: second - 1]:
                _call(f, _without(module, type_, n, len(pair)), before, *pair)
            for v, y in enumerate(pair, second - 1):
                if v == second:
                    _call(f, _without(module, type_, n, 1), pair[0], y)
                alone = _orthonormal_vector(module, type_, n, min(width, m - v * width))
                _call(f, alone, y, f.address(found, type_, v * width))
        _copied(f, type_, n, k, m, columns, each, pack=False)
        f.copy(lengths, found, m * (8 if type_ == "double" else 4))

    return _function(module, f"panel.{type_}.{n}.{k}.{m}", 3, body), in_work + vectors * width


def _function(module: Emitter, name: str, pointers: int, body: Callable[..., None]) -> str:
    """A function of pointers to memory that does not overlap; in the module once."""
    head = f"define internal void @{name}({', '.join(f'ptr noalias %p{i}' for i in range(pointers))}) noinline nounwind"
    if not any(text.startswith(head) for text in module.constants):
        f = Emitter(doubles_in_a_vector())
        f.carries_vectors = True
        body(f, *(f"%p{i}" for i in range(pointers)))
        module.declarations |= f.declarations
        module.constants.append("\n".join([f"{head} {{", "entry:", *f.lines, "  ret void", "}"]))
    return name


def _call(f: Emitter, name: str, *pointers: str) -> None:
    f.line(f"call void @{name}({', '.join(f'ptr {pointer}' for pointer in pointers)})")


def _copied(f: Emitter, type_: str, n: int, k: int, m: int, columns: str, each: list[str], pack: bool) -> None:
    """From the frame's rows to those of each vector, or back; what the last vector has too much is 0."""
    width = f.width

    def row(i, _):
        for v, y in enumerate(each):
            count, at = min(width, m - v * width), f.index_sum(f.index_times(i, k), v * width)
            here = f.index_times(i, width)
            if count == width:
                places = (columns, at), (y, here)
                (source, x), (to, z) = places if pack else places[::-1]
                f.store(to, type_, z, f.load(source, type_, x, wide=True), wide=True)
            elif pack:
                entries = [f.load(columns, type_, f.index_sum(at, c)) for c in range(count)]
                f.store(y, type_, here, f.vector([*entries, *[0.0] * (width - count)], type_), wide=True)
            else:
                found = f.load(y, type_, here, wide=True)
                for c in range(count):
                    f.store(columns, type_, f.index_sum(at, c), f.element(found, c, type_))

    f.count_up(n, row)


def _fused(f: Emitter, type_: str, x: Entry, y: Entry, z: Entry) -> Entry:
    """x·y + z."""
    return f.intrinsic("llvm.fmuladd", type_, [x, y, z])


def _without(module: Emitter, type_: str, n: int, count: int) -> str:
    """The function `(panel, *ys)`: ys -= panel (panelᵀ ys), for orthonormal columns of one vector."""

    def body(f: Emitter, panel: str, *ys: str) -> None:
        def lane(i, c):
            return f.load(panel, type_, f.index_sum(f.index_times(i, f.width), c))

        def row(i):
            return [f.load(y, type_, f.index_times(i, f.width), wide=True) for y in ys]

        def overlaps(i, sums):
            rows, rest = row(i), iter(sums)
            return [_fused(f, type_, lane(i, c), y, next(rest)) for c in range(f.width) for y in rows]

        def remove(i, _):
            for j, left in enumerate(row(i)):
                for c in range(f.width):
                    left = _fused(f, type_, lane(i, c), minus[c * count + j], left)
                f.store(ys[j], type_, f.index_times(i, f.width), left, wide=True)

        minus = [
            f.unary("fneg", type_, overlap) for overlap in f.count_up(n, overlaps, [(0.0, type_)] * (f.width * count))
        ]
        f.count_up(n, remove)

    return _function(module, f"without.{type_}.{n}.{count}", 1 + count, body)


def _orthonormal_vector(module: Emitter, type_: str, n: int, count: int) -> str:
    """The function `(y, lengths)`: orthonormalises the first `count` columns of one vector."""
    # Long: one kernel, whose pointers all steps share.

    def body(f: Emitter, y: str, lengths: str) -> None:
        everywhere = f.type_text(type_, True)

        def lane_of(vector, c):
            name, which = f.name(True), ", ".join([f"i32 {c}"] * f.width)
            f.line(f"{name} = shufflevector {everywhere} {vector}, {everywhere} poison, {_mask(f, which)}")
            return name

        def behind(c, vector):
            """Zero in the columns up to c."""
            name, which = f.name(True), ", ".join(f"i1 {'true' if lane > c else 'false'}" for lane in range(f.width))
            f.line(f"{name} = select {_mask(f, which, 'i1')}, {everywhere} {vector}, {everywhere} zeroinitializer")
            return name

        def pass_over(one: Callable) -> Entry:
            """The sum of one(row) over all rows."""

            def several(i, sums):
                return [one(f.index_sum(f.index_times(i, _SUMS), j), total) for j, total in enumerate(sums)]

            sums: list[Entry] = [0.0] * _SUMS
            if n >= _SUMS:
                sums = f.count_up(n // _SUMS, several, [(0.0, type_)] * _SUMS)
            for j, i in enumerate(range(n - n % _SUMS, n)):
                sums[j] = one(i, sums[j])
            return functools.reduce(lambda p, q: f.binary("fadd", type_, p, q), sums)

        def first(i, total):
            row = f.load(y, type_, f.index_times(i, f.width), wide=True)
            return _fused(f, type_, row, lane_of(row, 0), total)

        def at_least(x, least):
            return f.select(f.binary("fcmp olt", type_, x, least), type_, least, x)  # nan stays

        overlap, squares = pass_over(first), []
        for c in range(count):
            squares.append(f.element(overlap, c, type_))
            if c + 1 == count:
                break
            share = f.binary("fdiv", type_, -1.0, at_least(squares[c], _SMALLEST_LENGTH[type_]))
            minus = behind(c, f.binary("fmul", type_, overlap, share))

            def remove(i, total, c=c, minus=minus):
                place = f.index_times(i, f.width)
                row = f.load(y, type_, place, wide=True)
                left = _fused(f, type_, lane_of(row, c), minus, row)
                f.store(y, type_, place, left, wide=True)
                return _fused(f, type_, left, lane_of(left, c + 1), total)

            overlap = pass_over(remove)
        found = f.intrinsic("llvm.sqrt", type_, [f.vector([*squares, *[1.0] * (f.width - count)], type_)])
        f.store(lengths, type_, 0, found, wide=True)
        scale = f.binary("fdiv", type_, 1.0, at_least(found, _SMALLEST_LENGTH[type_]))

        def scaled(i, _):
            place = f.index_times(i, f.width)
            row = f.load(y, type_, place, wide=True)
            f.store(y, type_, place, f.binary("fmul", type_, row, scale), wide=True)

        f.count_up(n, scaled)

    return _function(module, f"vector.{type_}.{n}.{count}", 2, body)


def _mask(f: Emitter, entries: str, type_: str = "i32") -> str:
    return f"<{f.width} x {type_}> <{entries}>"
