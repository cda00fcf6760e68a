"""Gram–Schmidt in blocks, by BLAS and LAPACK: half the columns, then the other half less what they share, and so on.

A panel Y of a few columns is orthonormalised by its Gram matrix: YᵀY = L Lᵀ, Q = Y L⁻ᵀ. It is done in place: LAPACK,
whose matrices lie column after column, sees the transposed frame, in which our columns are rows.
"""

import functools
import math

from ..elementary import arithmetic as a
from ..lowering.lowering import Lowering
from ..lowering.types import llvm_type
from ..lowering.values import scalar
from .calls import program
from .linear_algebra import INTEGER, blas

_PANEL = 32  # columns of a panel, at most


@program("orthonormal_by_blocks")
def orthonormal_by_blocks(b: Lowering, eqn, *frames):
    """Of a frame (n, k): orthonormal columns, their lengths (k,), and the largest ratio of lengths in one panel.

    That ratio is no finite number where a panel is singular.
    """
    dtype, shape = eqn.invars[0].aval.dtype, eqn.invars[0].aval.shape
    if len(frames) != 1 or len(eqn.outvars) != 3 or len(shape) != 2 or b.is_small(shape) or b.lanes > 1:
        return None  # a derivative of it, say
    n, k = shape
    columns, lengths = b.to_write(frames[0], dtype), b.new_buffer((k,), dtype)
    work, info = b.new_buffer((max(k // 2, _PANEL) ** 2,), dtype), b.new_buffer((1,), INTEGER)
    type_, uneven = llvm_type(dtype), []

    def rows(first: int) -> str:
        return b.address(columns.memory.pointer, type_, first)

    def panel(first: int, last: int) -> None:
        m, gram = last - first, work.memory.pointer
        blas(b, dtype, "syrk", b"L", b"N", m, n, 1.0, rows(first), k, 0.0, gram, m)
        blas(b, dtype, "potrf", b"L", m, gram, m, info.memory.pointer)
        blas(b, dtype, "trsm", b"L", b"L", b"N", b"N", m, n, 1.0, gram, m, rows(first), k)
        uneven.append(panel_ratio(first, m))

    def panel_ratio(first: int, m: int):
        def length(i, extremes):
            found = b.load_element(work, [b.index_times(i, m + 1)])
            b.store_element(lengths, [b.index_sum(i, first)], found)
            return [a.minimum(b, dtype, extremes[0], found), a.maximum(b, dtype, extremes[1], found)]

        least, greatest = b.count_up(m, length, [(math.inf, type_), (0.0, type_)])
        succeeded = a.equal(b, INTEGER, b.load_element(info, [0]), 0)
        return b.select(succeeded, type_, a.divide(b, dtype, greatest, least), math.inf)

    def orthonormalise(first: int, last: int) -> None:
        if last - first <= _PANEL:
            panel(first, last)
            return
        middle = (first + last) // 2
        few, many, shares = middle - first, last - middle, work.memory.pointer
        orthonormalise(first, middle)
        blas(b, dtype, "gemm", b"N", b"T", few, many, n, 1.0, rows(first), k, rows(middle), k, 0.0, shares, few)
        blas(b, dtype, "gemm", b"T", b"N", many, n, few, -1.0, shares, few, rows(first), k, 1.0, rows(middle), k)
        orthonormalise(middle, last)

    orthonormalise(0, k)
    largest = functools.reduce(functools.partial(a.maximum, b, dtype), uneven)
    return [columns, b.held(lengths), scalar(largest)]
