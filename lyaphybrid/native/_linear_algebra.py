"""Rules for factorisations, solves and large products, by the LAPACK and BLAS that SciPy brings along.

Fortran's matrices lie column by column, and all arguments are addresses. Arrays of matrices are done one by one.
"""

from collections.abc import Callable, Sequence

import numpy as np

from . import _arithmetic as a
from ._emitter import Entry
from ._jax_versions import linear_solve
from ._lowering import KEEPS_ROWS, Lowering, rule
from ._types import INDEX, is_float, llvm_type
from ._unsupported import Unsupported
from ._values import Buffer, Value, size

WORK = 32  # columns of a block, for which LAPACK wants room
MANY = 32**3  # products: from so many on BLAS is asked


class Matrix:
    """A matrix in memory, column by column, that Fortran may write."""

    def __init__(self, b: Lowering, rows: int, columns: int, dtype):
        self.b, self.rows, self.columns = b, rows, columns
        self.buffer = b.new_buffer((columns, rows), dtype)

    @property
    def pointer(self) -> str:
        return self.buffer.memory.pointer

    def fill(self, entry: Callable[[Entry, Entry], Entry]) -> None:
        """Put entry(i, j) at row i, column j."""
        self.b.for_each_index(
            (self.columns, self.rows), lambda at: self.b.store_element(self.buffer, at, entry(at[1], at[0]))
        )

    def entry(self, i: Entry, j: Entry) -> Entry:
        """What stands at row i, column j."""
        return self.b.load_element(self.buffer, [j, i])


class _Fortran:
    """Calls of one precision's routines."""

    def __init__(self, b: Lowering, dtype):
        if not is_float(dtype):
            raise Unsupported(f"linear algebra of {np.dtype(dtype).name}")
        self.b, self.dtype, self.type = b, dtype, llvm_type(dtype)
        self.info = b.allocate("i32", 1)

    def __call__(self, routine: str, *arguments: "str | int | float | Matrix | Buffer") -> None:
        """A call; text is a name of memory if it begins with % or @, else a letter."""
        pointers = ", ".join(f"ptr {self._address(argument)}" for argument in arguments)
        name = f"scipy_{'d' if self.type == 'double' else 's'}{routine}"
        self.b.declarations.add(f"declare void @{name}({', '.join(['ptr'] * len(arguments))})")
        self.b.line(f"call void @{name}({pointers})")

    def _address(self, argument) -> str:
        if isinstance(argument, Matrix):
            return argument.pointer
        if isinstance(argument, Buffer):
            return argument.memory.pointer
        if isinstance(argument, str):
            return argument if argument[0] in "%@" else self.b.constant([ord(argument)], "i8")
        return self.b.constant([argument], "i32" if isinstance(argument, int) else self.type)

    def work(self, length: int) -> Buffer:
        """Room for a routine."""
        return self.b.new_buffer((length,), self.dtype)

    def failed(self, relation: str = "ne") -> Entry:
        """Whether the last routine's info is not 0 (or is less, or greater)."""
        return a.compare(self.b, np.int32, relation, self.b.load(self.info, "i32", 0), 0)


def _each(b: Lowering, value: Value, dtype, one: Callable) -> None:
    """one(indices, read) for all matrices of an array; read(i, j) gives an entry."""
    value = b.in_memory(value, dtype)
    b.for_each_index(value.shape[:-2], lambda at: one(at, lambda i, j: b.load_element(value, [*at, i, j])))


def _results(b: Lowering, eqn) -> list[Buffer]:
    return [b.new_buffer(variable.aval.shape, variable.aval.dtype) for variable in eqn.outvars]


def _store(b: Lowering, result: Buffer, at: Sequence[Entry], entry: Callable[[Entry, Entry], Entry]) -> None:
    b.for_each_index(result.shape[-2:], lambda ij: b.store_element(result, [*at, *ij], entry(*ij)))


def _triangle(b: Lowering, dtype, i: Entry, j: Entry, entry: Entry, lower: bool, nan_if: Entry = False) -> Entry:
    """An entry of a triangular matrix: zero beyond the diagonal; nan where a condition holds."""
    inside = a.compare(b, INDEX, "ge" if lower else "le", i, j)
    good = b.select(inside, llvm_type(dtype), entry, a.zero(dtype))
    return b.select(nan_if, llvm_type(dtype), np.nan, good)


@rule("cholesky")
def cholesky(b, eqn, value):
    dtype, n = eqn.outvars[0].aval.dtype, value.shape[-1]
    fortran, (result,), matrix = _Fortran(b, dtype), _results(b, eqn), Matrix(b, n, n, dtype)

    def one(at, read):
        matrix.fill(read)
        fortran("potrf", "L", n, matrix, max(n, 1), fortran.info)
        failed = fortran.failed()
        _store(b, result, at, lambda i, j: _triangle(b, dtype, i, j, matrix.entry(i, j), True, failed))

    _each(b, value, dtype, one)
    return b.held(result)


@rule("triangular_solve")
def triangular_solve(b, eqn, matrix, right):
    p, aval = eqn.params, eqn.outvars[0].aval
    dtype, (rows, columns) = aval.dtype, aval.shape[-2:]
    n = rows if p["left_side"] else columns
    fortran, (result,) = _Fortran(b, dtype), _results(b, eqn)
    left, solved = Matrix(b, n, n, dtype), Matrix(b, rows, columns, dtype)
    right = b.in_memory(right, dtype)

    def one(at, read):
        left.fill(read)
        solved.fill(lambda i, j: b.load_element(right, [*at, i, j]))
        how = ("L" if p["left_side"] else "R", "L" if p["lower"] else "U", "T" if p["transpose_a"] else "N")
        unit = "U" if p["unit_diagonal"] else "N"
        fortran("trsm", *how, unit, rows, columns, 1.0, left, max(n, 1), solved, max(rows, 1))
        _store(b, result, at, solved.entry)

    _each(b, matrix, dtype, one)
    return b.held(result)


@rule("lu")
def lu(b, eqn, value):
    dtype, (m, n) = eqn.outvars[0].aval.dtype, value.shape[-2:]
    fortran, (result, pivots, permutation) = _Fortran(b, dtype), _results(b, eqn)
    matrix, found = Matrix(b, m, n, dtype), b.new_buffer((min(m, n),), np.int32)

    def one(at, read):
        matrix.fill(read)
        fortran("getrf", m, n, matrix, max(m, 1), found, fortran.info)
        _store(b, result, at, matrix.entry)

        def pivot(i):  # Fortran counts from 1
            b.store_element(pivots, [*at, *i], b.binary("sub", "i32", b.load_element(found, i), 1))

        b.for_each_index(found.shape, pivot)
        _exchanged(b, permutation, pivots, at)

    _each(b, value, dtype, one)
    return [b.held(one) for one in (result, pivots, permutation)]


@rule("lu_pivots_to_permutation")
def lu_pivots_to_permutation(b, eqn, pivots):
    pivots, (result,) = b.in_memory(pivots, np.int32), _results(b, eqn)
    b.for_each_index(pivots.shape[:-1], lambda at: _exchanged(b, result, pivots, at))
    return b.held(result)


def _exchanged(b: Lowering, permutation: Buffer, pivots: Buffer, at: Sequence[Entry]) -> None:
    """The permutation that exchanging row i with row pivots[i], one after the other, makes."""
    dtype = permutation.dtype
    b.for_each_index(
        permutation.shape[-1:], lambda i: b.store_element(permutation, [*at, *i], a.converted(b, INDEX, i[0], dtype))
    )

    def exchange(i):
        other = [*at, a.converted(b, pivots.dtype, b.load_element(pivots, [*at, *i]), INDEX)]
        mine = [*at, *i]
        x, y = b.load_element(permutation, mine), b.load_element(permutation, other)
        b.store_element(permutation, mine, y)
        b.store_element(permutation, other, x)

    b.for_each_index(pivots.shape[-1:], exchange)


@rule("qr")
def qr(b, eqn, value):
    if eqn.params.get("pivoting"):
        raise Unsupported("qr with pivoting")
    dtype, (m, n) = eqn.outvars[0].aval.dtype, value.shape[-2:]
    fortran, (q, r) = _Fortran(b, dtype), _results(b, eqn)
    k, columns = min(m, n), q.shape[-1]  # of Q: k, or all m
    matrix, basis = Matrix(b, m, n, dtype), Matrix(b, m, columns, dtype)
    factors, work = fortran.work(k), fortran.work(max(m, n, 1) * WORK)

    def one(at, read):
        matrix.fill(read)
        fortran("geqrf", m, n, matrix, max(m, 1), factors, work, max(m, n, 1) * WORK, fortran.info)
        _store(b, r, at, lambda i, j: _triangle(b, dtype, i, j, matrix.entry(i, j), False))
        basis.fill(lambda i, j: _within(b, dtype, matrix, i, j, k))
        fortran("orgqr", m, columns, k, basis, max(m, 1), factors, work, max(m, n, 1) * WORK, fortran.info)
        _store(b, q, at, basis.entry)

    _each(b, value, dtype, one)
    return [b.held(q), b.held(r)]


def _within(b: Lowering, dtype, matrix: Matrix, i: Entry, j: Entry, columns: int) -> Entry:
    """An entry of the first columns; zero beyond them."""
    inside = a.compare(b, INDEX, "lt", j, columns)
    return b.select(inside, llvm_type(dtype), matrix.entry(i, b.select(inside, "i64", j, 0)), a.zero(dtype))


@rule("eigh")
def eigh(b, eqn, value):
    if eqn.params.get("subset_by_index") not in (None, (0, value.shape[-1])):
        raise Unsupported("eigh of some eigenvalues only")
    dtype, n = eqn.outvars[0].aval.dtype, value.shape[-1]
    fortran, (vectors, values) = _Fortran(b, dtype), _results(b, eqn)
    matrix, found = Matrix(b, n, n, dtype), fortran.work(n)
    long, whole = 1 + 6 * n + 2 * n * n, 3 + 5 * n
    work, counts = fortran.work(long), b.new_buffer((whole,), np.int32)
    triangle = "L" if eqn.params["lower"] else "U"

    def one(at, read):
        matrix.fill(read)
        fortran("syevd", "V", triangle, n, matrix, max(n, 1), found, work, long, counts, whole, fortran.info)
        failed, type_ = fortran.failed(), llvm_type(dtype)
        _store(b, vectors, at, lambda i, j: b.select(failed, type_, np.nan, matrix.entry(i, j)))
        value_at = lambda i: b.select(failed, type_, np.nan, b.load_element(found, i))  # noqa: E731
        b.for_each_index((n,), lambda i: b.store_element(values, [*at, *i], value_at(i)))

    _each(b, value, dtype, one)
    return [b.held(vectors), b.held(values)]


@rule("custom_linear_solve")
def custom_linear_solve(b, eqn, *values):
    """The program that solves; those of derivatives are not needed any more."""
    program, places = linear_solve(eqn)
    return b.run(program, [values[place] for place in places])


KEEPS_ROWS.add("custom_linear_solve")


def large_product(b: Lowering, eqn, left: Value, right: Value) -> Value | None:
    """A product of two matrices that is worth a call of BLAS; None: it is not."""
    (left_over, right_over), (batch, _) = eqn.params["dimension_numbers"]
    aval = eqn.outvars[0].aval
    types = {aval.dtype, *(atom.aval.dtype for atom in eqn.invars)}
    plain = not batch and len(left.shape) == len(right.shape) == 2 and len(left_over) == 1 and len(types) == 1
    if not plain or not is_float(aval.dtype) or size(aval.shape) * left.shape[left_over[0]] < MANY:
        return None
    fortran, (result,) = _Fortran(b, aval.dtype), _results(b, eqn)
    left, right = b.in_memory(left, aval.dtype), b.in_memory(right, aval.dtype)
    (m, n), k = aval.shape, left.shape[left_over[0]]
    # Row by row the product is, column by column, the transposed one: rightᵀ leftᵀ.
    how = ("N" if right_over[0] == 0 else "T", "N" if left_over[0] == 1 else "T")
    leading = (right.shape[1], left.shape[1])
    fortran("gemm", *how, n, m, k, 1.0, right, leading[0], left, leading[1], 0.0, result, n)
    return result
