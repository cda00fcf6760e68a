"""Rules for linear algebra by LAPACK and BLAS; JAX calls the same functions on a CPU, so the results are the same.

LAPACK's matrices are in column-major order, ours in row-major order. Unique results (a Cholesky factor, the solution of
a triangular system, a product) are computed for the transposed matrices, as LAPACK reads our memory. For the others,
whose signs must be those of JAX, LAPACK overwrites a transposed copy, and the result is transposed back.
"""

import math
from collections.abc import Callable, Sequence

import jax
import numpy as np

from ..elementary import arithmetic as a
from ..lowering.emitter import Entry
from ..lowering.jax_versions import linear_solve
from ..lowering.lowering import KEEPS_ROWS, Lowering, rule
from ..lowering.types import INDEX, llvm_type
from ..lowering.unsupported import UnsupportedError
from ..lowering.values import Buffer, Value, memory_of, size
from ..machine.scipy import symbol
from .moving import moved, permuted
from .reductions import dot as written_out

INTEGER = np.dtype(np.int32)
_BLOCK = 32  # block size of LAPACK, for the size of its workspace

# --- calls -----------------------------------------------------------------------------------------------------------


def blas(b: Lowering, dtype, function: str, *arguments: str | int | float | bytes) -> None:
    """Call a BLAS or LAPACK function, named without its type letter; numbers and letters become constants in memory."""
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise UnsupportedError(f"{function} of {dtype}")
    if b.lanes > 1:
        raise UnsupportedError(f"{function} in lanes")
    name, pointers = symbol("sd"[np.dtype(dtype) == np.float64] + function), []
    for argument in arguments:
        if isinstance(argument, bytes):
            argument = b.constant([argument[0]], "i8")
        elif isinstance(argument, int):
            argument = b.constant([argument], "i32")
        elif isinstance(argument, float):
            argument = b.constant([argument], llvm_type(dtype))
        pointers.append(f"ptr {argument}")
    b.declarations.add(f"declare void @{name}({', '.join(['ptr'] * len(pointers))}) nounwind")
    b.line(f"call void @{name}({', '.join(pointers)})")


def _for_each_matrix(b: Lowering, batch: Sequence[int], body: Callable[[Callable], None]) -> None:
    """Calls body(part) for each matrix of a batch; part(buffer) is the address of the matrix in a buffer."""
    n = size(batch)
    if n == 0:
        return

    def one(i, _):
        def part(buffer: Buffer) -> str:
            return b.address(
                buffer.memory.pointer, llvm_type(buffer.dtype), b.index_times(i, size(buffer.shape[len(batch) :]))
            )

        body(part)

    b.count_up(n, one)


def _nan_unless(b: Lowering, fine: Entry, pointers: Sequence[tuple[str, int]], dtype) -> None:
    """Fill memory, given by (pointer, number of elements), with nan unless a condition holds."""
    bad, after, scope = b.block_name(), b.block_name(), b.scope()
    b.line(f"br i1 {b.text(fine, 'i1')}, label %{after}, label %{bad}")
    b.begin_block(bad)
    for pointer, n in pointers:
        b.count_up(n, lambda i, _, pointer=pointer: b.store(pointer, llvm_type(dtype), i, math.nan))
    b.line(f"br label %{after}")
    b.end_scope(scope)
    b.begin_block(after)


def _succeeded(b: Lowering, info: Buffer) -> Entry:
    return a.equal(b, INTEGER, b.load_element(info, [0]), 0)


def _columns(b: Lowering, value: Value, dtype, n: int | None = None) -> Buffer:
    """A column-major copy of matrices (…, m, k), with memory for at least n columns."""
    *batch, m, k = value.shape
    found = b.new_buffer((*batch, max(k, n or 0), m), dtype)
    turned = value.swapaxes(-1, -2) if isinstance(value, np.ndarray) else _turned(b, value, dtype)
    b.write(found, turned, [0] * len(value.shape))
    return found


def _turned(b: Lowering, value: Value, dtype, n: int | None = None) -> Value:
    """The transposed matrices (…, m, k) of (…, k, m); only the first n columns if n is given."""
    *batch, k, m = value.shape
    shape = (*batch, m, k if n is None else n)
    return moved(b, jax.ShapeDtypeStruct(shape, dtype), value, lambda i: [*i[:-2], i[-1], i[-2]])


# --- triangles -------------------------------------------------------------------------------------------------------


@rule("cholesky")
def cholesky(b, eqn, value):
    """The lower triangular factor; the entries above the diagonal are undefined."""
    (*batch, n, _), dtype = value.shape, eqn.invars[0].aval.dtype
    found, info = b.to_write(value, dtype), b.new_buffer((1,), INTEGER)

    def one(part):
        blas(b, dtype, "potrf", b"U", n, part(found), n, info.memory.pointer)
        _nan_unless(b, _succeeded(b, info), [(part(found), n * n)], dtype)

    if n:
        _for_each_matrix(b, batch, one)
    return b.held(found)


@rule("triangular_solve")
def triangular_solve(b, eqn, matrix, right):
    p, (*batch, m, n), dtype = eqn.params, right.shape, eqn.invars[1].aval.dtype
    triangle = b.in_memory(matrix, dtype)
    found = b.to_write(right, dtype, [triangle])
    # A X = B is solved as its transpose X' A' = B': side and triangle change, the transposition flag does not.
    side, triangle_side = b"R" if p["left_side"] else b"L", b"U" if p["lower"] else b"L"
    turned, diagonal = b"T" if p["transpose_a"] else b"N", b"U" if p["unit_diagonal"] else b"N"
    k = m if p["left_side"] else n

    def one(part):
        blas(b, dtype, "trsm", side, triangle_side, turned, diagonal, n, m, 1.0, part(triangle), k, part(found), n)

    if m and n:
        _for_each_matrix(b, batch, one)
    return b.held(found)


@rule("custom_linear_solve")
def custom_linear_solve(b, eqn, *values):
    """Runs the solving program; the other programs serve derivatives only."""
    program, places = linear_solve(eqn)
    return b.run(program, [values[place] for place in places])


KEEPS_ROWS.add("custom_linear_solve")


# --- LU --------------------------------------------------------------------------------------------------------------


@rule("lu")
def lu(b, eqn, value):
    (*batch, m, n), dtype, k = value.shape, eqn.invars[0].aval.dtype, min(value.shape[-2:])
    found, info = _columns(b, value, dtype), b.new_buffer((1,), INTEGER)
    pivots, order = b.new_buffer((*batch, k), INTEGER), b.new_buffer((*batch, m), INTEGER)

    def one(part):
        if k:
            blas(b, dtype, "getrf", m, n, part(found), m, part(pivots), info.memory.pointer)
            fine = a.compare(b, INTEGER, "ge", b.load_element(info, [0]), 0)  # > 0: singular, which is no error in JAX
            _nan_unless(b, fine, [(part(found), m * n)], dtype)
        where = part(pivots)

        def from_zero(i, _):
            b.store(where, "i32", i, b.binary("sub", "i32", b.load(where, "i32", i), 1))

        if k:
            b.count_up(k, from_zero)
        _permutation(b, where, k, part(order), m)

    _for_each_matrix(b, batch, one)
    return [_turned(b, found, dtype), b.held(pivots), b.held(order)]


@rule("lu_pivots_to_permutation")
def lu_pivots_to_permutation(b, eqn, value):
    *batch, k = value.shape
    pivots, m = b.in_memory(value, INTEGER), eqn.params["permutation_size"]
    order = b.new_buffer((*batch, m), INTEGER)
    _for_each_matrix(b, batch, lambda part: _permutation(b, part(pivots), k, part(order), m))
    return b.held(order)


def _permutation(b: Lowering, pivots: str, k: int, order: str, m: int) -> None:
    """The permutation (m,) of the rows, from the exchanges of pivoting (k,)."""
    if m:
        b.count_up(m, lambda i, _: b.store(order, "i32", i, a.converted(b, INDEX, i, INTEGER)))

    def exchange(i, _):
        j = a.converted(b, INTEGER, b.load(pivots, "i32", i), INDEX)
        x, y = b.load(order, "i32", i), b.load(order, "i32", j)
        b.store(order, "i32", i, y)
        b.store(order, "i32", j, x)

    if k:
        b.count_up(k, exchange)


# --- QR --------------------------------------------------------------------------------------------------------------


def _geqrf(b: Lowering, dtype, batch, m: int, n: int, columns: Buffer, scales: Buffer) -> None:
    work, info = b.new_buffer((_BLOCK * max(n, 1),), dtype), b.new_buffer((1,), INTEGER)

    def one(part):
        room = (work.memory.pointer, _BLOCK * n, info.memory.pointer)
        blas(b, dtype, "geqrf", m, n, part(columns), m, part(scales), *room)

    if m and n:
        _for_each_matrix(b, batch, one)


def _orgqr(b: Lowering, dtype, batch, m: int, n: int, columns: Buffer, scales: Buffer) -> None:
    """Replaces the Householder vectors by the first n columns of Q."""
    work, info = b.new_buffer((_BLOCK * max(n, 1),), dtype), b.new_buffer((1,), INTEGER)

    def one(part):
        room = (work.memory.pointer, _BLOCK * n, info.memory.pointer)
        blas(b, dtype, "orgqr", m, n, scales.shape[-1], part(columns), m, part(scales), *room)

    if m and n:
        _for_each_matrix(b, batch, one)


@rule("geqrf")
def geqrf(b, eqn, value):
    (*batch, m, n), dtype = value.shape, eqn.invars[0].aval.dtype
    columns, scales = _columns(b, value, dtype), b.new_buffer((*batch, min(m, n)), dtype)
    _geqrf(b, dtype, batch, m, n, columns, scales)
    return [_turned(b, columns, dtype), b.held(scales)]


@rule("householder_product")
def householder_product(b, eqn, value, scales):
    (*batch, m, n), dtype = value.shape, eqn.invars[0].aval.dtype
    columns = _columns(b, value, dtype)
    _orgqr(b, dtype, batch, m, n, columns, b.in_memory(scales, dtype))
    return _turned(b, columns, dtype)


@rule("qr")
def qr(b, eqn, value):
    (*batch, m, n), dtype = value.shape, eqn.invars[0].aval.dtype
    if eqn.params["pivoting"]:
        raise UnsupportedError("qr with pivoting")
    k = eqn.outvars[0].aval.shape[-1]
    columns, scales = _columns(b, value, dtype, k), b.new_buffer((*batch, min(m, n)), dtype)
    _geqrf(b, dtype, batch, m, n, columns, scales)
    upper = b.new_buffer((*batch, k, n), dtype)

    def put(i):
        *which, row, column = i
        below = a.compare(b, INDEX, "gt", row, column)
        found = b.load_element(columns, [*which, column, row])
        b.store_element(upper, i, b.select(below, llvm_type(dtype), 0, found))

    b.for_each_index(upper.shape, put)  # before Q overwrites it
    if not min(m, n):  # an empty matrix: Q is the identity
        b.for_each_index(columns.shape, lambda i: b.store_element(columns, i, _identity(b, dtype, i)))
    _orgqr(b, dtype, batch, m, k if min(m, n) else 0, columns, scales)
    return [_turned(b, columns, dtype, k), b.held(upper)]


def _identity(b: Lowering, dtype, i) -> Entry:
    return a.converted(b, np.bool_, a.equal(b, INDEX, i[-1], i[-2]), dtype)


# --- eigenvalues, singular values ------------------------------------------------------------------------------------


@rule("eigh")
def eigh(b, eqn, value):
    p, (*batch, n, _), dtype = eqn.params, value.shape, eqn.invars[0].aval.dtype
    if p.get("subset_by_index") not in (None, (0, n)):
        raise UnsupportedError("eigh of a part of the spectrum")
    vectors, numbers = _columns(b, value, dtype), b.new_buffer((*batch, n), dtype)
    doubles, integers, info = 1 + 6 * n + 2 * n * n, 3 + 5 * n, b.new_buffer((1,), INTEGER)
    work, places = b.new_buffer((doubles,), dtype), b.new_buffer((integers,), INTEGER)

    def one(part):
        room = (work.memory.pointer, doubles, places.memory.pointer, integers, info.memory.pointer)
        blas(b, dtype, "syevd", b"V", b"L" if p["lower"] else b"U", n, part(vectors), n, part(numbers), *room)
        _nan_unless(b, _succeeded(b, info), [(part(vectors), n * n), (part(numbers), n)], dtype)

    if n:
        _for_each_matrix(b, batch, one)
    return [_turned(b, vectors, dtype), b.held(numbers)]


@rule("svd")
def svd(b, eqn, value):
    p, (*batch, m, n), dtype = eqn.params, value.shape, eqn.invars[0].aval.dtype
    few, many = min(m, n), max(m, n)
    if p.get("subset_by_index") not in (None, (0, few)) or not few:
        raise UnsupportedError("svd of a part, or of an empty matrix")
    mode = b"N" if not p["compute_uv"] else b"A" if p["full_matrices"] else b"S"
    k_left, k_right = (m, n) if mode == b"A" else (few, few)
    matrix, numbers = _columns(b, value, dtype), b.new_buffer((*batch, few), dtype)
    left, right = b.new_buffer((*batch, k_left, m), dtype), b.new_buffer((*batch, n, k_right), dtype)
    doubles, info = 4 * few * few + 7 * few + _BLOCK * (few + many), b.new_buffer((1,), INTEGER)
    work, places = b.new_buffer((doubles,), dtype), b.new_buffer((8 * few,), INTEGER)

    def one(part):
        room = (work.memory.pointer, doubles, places.memory.pointer, info.memory.pointer)
        vectors = (part(left), m, part(right), k_right)
        blas(b, dtype, "gesdd", mode, m, n, part(matrix), m, part(numbers), *vectors, *room)
        results = [(part(numbers), few), (part(left), m * k_left), (part(right), k_right * n)]
        _nan_unless(b, _succeeded(b, info), results, dtype)

    _for_each_matrix(b, batch, one)
    return [b.held(numbers), *(_turned(b, x, dtype) for x in (left, right))][: len(eqn.outvars)]


@rule("tridiagonal_solve")
def tridiagonal_solve(b, eqn, below, diagonal, above, right):
    (*batch, n, k), dtype = right.shape, eqn.invars[3].aval.dtype
    if eqn.params.get("perturb_singular"):
        raise UnsupportedError("tridiagonal_solve with perturb_singular")
    below, diagonal, above = (_private_copy(b, value, dtype) for value in (below, diagonal, above))
    columns, info = _columns(b, right, dtype), b.new_buffer((1,), INTEGER)

    def one(part):
        first = b.address(part(below), llvm_type(dtype), 1)  # the first element of `below` has no meaning
        where = (first, part(diagonal), part(above), part(columns), n, info.memory.pointer)
        blas(b, dtype, "gtsv", n, k, *where)
        _nan_unless(b, _succeeded(b, info), [(part(columns), n * k)], dtype)

    if n and k:
        _for_each_matrix(b, batch, one)
    return _turned(b, columns, dtype)


def _private_copy(b: Lowering, value: Value, dtype) -> Buffer:
    """A private copy, even if the memory may be overwritten: one array may be passed as several operands."""
    if memory_of(value) is None:
        return b.to_write(value, dtype)
    return b.copied(b.in_memory(value, dtype))


# --- products --------------------------------------------------------------------------------------------------------

# BLAS has an overhead per call and packs its operands; below these sizes, which are estimates, our own loops are used.
_LARGE_PRODUCT = 32**3  # multiplications in a product of two matrices
_LARGE_MATRIX = 64**2  # elements of the matrix in a product of matrix and vector


@rule("dot_general")
def dot_general(b, eqn, left, right):
    (left_over, right_over), (left_batch, right_batch) = eqn.params["dimension_numbers"]
    aval, avals = eqn.outvars[0].aval, [atom.aval for atom in eqn.invars]
    over = size([avals[0].shape[axis] for axis in left_over])
    batch = [avals[0].shape[axis] for axis in left_batch]
    free = [
        [axis for axis in range(len(x.shape)) if axis not in (*contracted, *batched)]
        for x, contracted, batched in zip(avals, (left_over, right_over), (left_batch, right_batch), strict=True)
    ]
    m, n = (size([x.shape[axis] for axis in axes]) for x, axes in zip(avals, free, strict=True))
    large = min(m, n) > 1 and m * n * over >= _LARGE_PRODUCT or min(m, n) == 1 and m * n * over >= _LARGE_MATRIX
    one_type = all(x.dtype == aval.dtype for x in avals) and aval.dtype in (np.float32, np.float64)
    if not large or not one_type or b.lanes > 1:
        return written_out(b, eqn, left, right)
    dtype = aval.dtype
    x, x_first = _matrix(b, left, dtype, left_batch, left_over, free[0])
    y, y_first = _matrix(b, right, dtype, right_batch, right_over, free[1])
    batch_, result = len(batch), b.new_buffer(aval.shape, dtype)
    x, y = (Buffer(v.memory, (*batch, size(v.shape[batch_:])), dtype) for v in (x, y))
    result_ = Buffer(result.memory, (*batch, m * n), dtype)

    def one(part):  # BLAS reads the transposed matrices: C' = Y' X'
        if min(m, n) > 1:
            turned = (b"N" if y_first else b"T", b"T" if x_first else b"N")
            given = (part(y), n if y_first else over, part(x), m if x_first else over)
            blas(b, dtype, "gemm", *turned, n, m, over, 1.0, *given, 0.0, part(result_), n)
            return
        (matrix, first, length), vector = ((y, y_first, n), x) if m == 1 else ((x, x_first, m), y)
        rows, columns = (length, over) if first else (over, length)
        form = (b"N" if first else b"T", rows, columns)
        blas(b, dtype, "gemv", *form, 1.0, part(matrix), rows, part(vector), 1, 0.0, part(result_), 1)

    _for_each_matrix(b, batch, one)
    return b.held(result)


def _matrix(b: Lowering, value: Value, dtype, batch, over, free) -> tuple[Buffer, bool]:
    """An operand in memory, and whether the axes summed over come before the free ones (otherwise after them)."""
    axes = list(range(len(value.shape)))
    for order, first in (((*batch, *free, *over), False), ((*batch, *over, *free), True)):
        if list(order) == axes:
            return b.in_memory(value, dtype), first
    order = (*batch, *free, *over)
    return b.in_memory(permuted(b, value, order, dtype), dtype), False
