"""Arithmetic of single entries with JAX's semantics: IEEE nan and inf, integers modulo 2^bits.

Each function is `(b, dtype, *entries) -> entry`. Compile-time constants are evaluated here, by NumPy.
"""

import math
from collections.abc import Callable

import numpy as np

from ..lowering.emitter import Emitter, Entry, is_known
from ..lowering.types import BITS, kind, llvm_type

_SIGNED = {"i": "s", "u": "u"}


def folded(dtype, function: Callable, *entries: Entry) -> Entry:
    """A function of constants, evaluated in the arithmetic of their type."""
    with np.errstate(all="ignore"):
        return np.asarray(function(*(np.asarray(entry, dtype)[()] for entry in entries))).astype(dtype).item()


def add(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """The sum x + y; for booleans: or."""
    if is_known(x, y):
        return folded(dtype, np.add, x, y)
    if kind(dtype) == "b":
        return b.logic("or", x, y)
    if kind(dtype) == "f":
        # x + 0.0 is taken as x. For x = -0.0 this differs from IEEE arithmetic, but XLA does the same.
        return y if _is(x, 0) else x if _is(y, 0) else _sum(b, dtype, x, y)
    return y if _is(x, 0) else x if _is(y, 0) else b.binary("add", llvm_type(dtype), x, y, True)


def subtract(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """The difference x − y."""
    if is_known(x, y):
        return folded(dtype, np.subtract, x, y)
    if _is(y, 0):
        return x
    if kind(dtype) != "f":
        return b.binary("sub", llvm_type(dtype), x, y)
    if y in b.products or x in b.products:
        return _sum(b, dtype, x, negate(b, dtype, y))
    return b.binary("fsub", llvm_type(dtype), x, y)


def _sum(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """The sum x + y of floats; a·b + c becomes one fused operation.

    The choice of what to fuse is made here and not left to LLVM, whose choice depends on the surrounding code: a run
    that is continued must give the same bits as an uninterrupted run.
    """
    if y in b.products:
        return b.intrinsic("llvm.fmuladd", llvm_type(dtype), [*b.products[y], x])
    if x in b.products:
        return b.intrinsic("llvm.fmuladd", llvm_type(dtype), [*b.products[x], y])
    return b.binary("fadd", llvm_type(dtype), x, y, True)


def multiply(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """The product x y; for booleans: and."""
    if is_known(x, y):
        return folded(dtype, np.multiply, x, y)
    if kind(dtype) == "b":
        return b.logic("and", x, y)
    if _is(x, 1) or _is(y, 1):
        return y if _is(x, 1) else x
    if kind(dtype) != "f":
        return b.binary("mul", llvm_type(dtype), x, y, True)
    if (shorter := _by_one_factor(b, dtype, x, y)) is not None:
        return shorter
    product = b.binary("fmul", llvm_type(dtype), x, y, True)
    b.products[product] = x, y
    return product


def _by_one_factor(b: Emitter, dtype, x: Entry, y: Entry) -> Entry | None:
    """(z·c)·d as z·(c·d) for constants c and d, which are frequent in derivatives of powers.

    None if x·y is not of this form, or if c·d is subnormal or infinite.
    """
    for known, other in ((x, y), (y, x)):
        for factor, rest in (b.products[other], b.products[other][::-1]) if other in b.products else ():
            if is_known(known, factor) and not is_known(rest):
                both = folded(dtype, np.multiply, known, factor)
                if np.finfo(dtype).tiny <= abs(both) <= np.finfo(dtype).max:
                    return multiply(b, dtype, rest, both)
    return None


def divide(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """The quotient x / y. Integers are rounded towards zero; x / 0 = −1 and min / −1 = min, as in XLA."""
    type_ = llvm_type(dtype)
    if kind(dtype) == "f":
        if is_known(x, y):
            return folded(dtype, np.divide, x, y)
        limits = np.finfo(dtype)
        if is_known(y) and abs(math.frexp(y)[0]) == 0.5 and limits.tiny <= abs(y) <= 1 / limits.tiny:
            return multiply(b, dtype, x, 1 / y)  # by a power of two: exact
        return b.binary("fdiv", type_, x, y)
    return _integer_division(b, dtype, x, y, "div", lambda x: x)


def remainder(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """The remainder of x / y, with the sign of x. For integers the remainder of x / 0 is x."""
    if kind(dtype) == "f":
        if is_known(x, y):
            return folded(dtype, np.fmod, x, y)
        return b.call("fmod" if llvm_type(dtype) == "double" else "fmodf", llvm_type(dtype), [x, y])
    return _integer_division(b, dtype, x, y, "rem", lambda x: 0)


def _integer_division(b: Emitter, dtype, x: Entry, y: Entry, operation: str, by_minus_one: Callable) -> Entry:
    type_, signed = llvm_type(dtype), kind(dtype) == "i"
    least = -(2 ** (BITS[type_] - 1))
    zero = equal(b, dtype, y, 0)
    overflows = b.logic("and", equal(b, dtype, x, least), equal(b, dtype, y, -1)) if signed else False
    safe = b.select(b.logic("or", zero, overflows), type_, 1, y)
    if is_known(x, safe):
        quotient = abs(x) // abs(safe) * (1 if (x < 0) == (safe < 0) else -1)
        found = quotient if operation == "div" else x - quotient * safe
    else:
        found = b.binary(f"{'s' if signed else 'u'}{operation}", type_, x, safe)
    by_zero = (-1 if signed else 2 ** BITS[type_] - 1) if operation == "div" else x
    return b.select(zero, type_, by_zero, b.select(overflows, type_, by_minus_one(x), found))


def negate(b: Emitter, dtype, x: Entry) -> Entry:
    """The negative −x."""
    if is_known(x):
        return folded(dtype, np.negative, x)
    if kind(dtype) != "f":
        return b.binary("sub", llvm_type(dtype), 0, x)
    negative = b.unary("fneg", llvm_type(dtype), x)
    if x in b.products:
        left, right = b.products[x]
        b.products[negative] = (right, negate(b, dtype, left)) if is_known(right) else (left, negate(b, dtype, right))
    return negative


def absolute(b: Emitter, dtype, x: Entry) -> Entry:
    """The absolute value |x|."""
    if is_known(x):
        return folded(dtype, np.abs, x)
    if kind(dtype) == "f":
        return b.intrinsic("llvm.fabs", llvm_type(dtype), [x])
    return (
        b.select(compare(b, dtype, "lt", x, 0), llvm_type(dtype), negate(b, dtype, x), x) if kind(dtype) == "i" else x
    )


def maximum(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """The larger one; nan if either is."""
    return _extremum(b, dtype, x, y, "gt", np.maximum, "or")


def minimum(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """The smaller one; nan if either is."""
    return _extremum(b, dtype, x, y, "lt", np.minimum, "and")


def _extremum(b: Emitter, dtype, x: Entry, y: Entry, relation: str, fold: Callable, of_conditions: str) -> Entry:
    if is_known(x, y):
        return folded(dtype, fold, x, y)
    if kind(dtype) == "b":
        return b.logic(of_conditions, x, y)
    if is_known(x):
        x, y = y, x
    if kind(dtype) == "f" and is_known(y) and not math.isnan(y):  # if x is nan the comparison fails: the result is x
        return b.select(compare(b, dtype, relation, y, x), llvm_type(dtype), y, x)
    found = compare(b, dtype, relation, x, y)
    if kind(dtype) == "f":
        found = b.logic("or", found, is_nan(b, dtype, x))
    return b.select(found, llvm_type(dtype), x, y)


def is_nan(b: Emitter, dtype, x: Entry) -> Entry:
    """Whether x is not a number."""
    return math.isnan(x) if is_known(x) else b.binary("fcmp uno", llvm_type(dtype), x, x)


_RELATIONS = {
    "lt": ("olt", "lt", np.less),
    "le": ("ole", "le", np.less_equal),
    "gt": ("ogt", "gt", np.greater),
    "ge": ("oge", "ge", np.greater_equal),
    "eq": ("oeq", "eq", np.equal),
    "ne": ("une", "ne", np.not_equal),
}


def compare(b: Emitter, dtype, relation: str, x: Entry, y: Entry) -> Entry:
    """Whether lt, le, gt, ge, eq or ne holds; with nan only ne does."""
    of_floats, of_integers, fold = _RELATIONS[relation]
    if is_known(x, y):
        return bool(folded(dtype, fold, x, y))
    letter, type_ = kind(dtype), llvm_type(dtype)
    if letter == "f":
        return b.binary(f"fcmp {of_floats}", type_, x, y)
    if letter == "b" and relation in ("eq", "ne"):
        return b.logic("xor", x, b.negation(y) if relation == "eq" else y)
    sign = "" if relation in ("eq", "ne") else _SIGNED.get(letter, "u")
    return b.binary(f"icmp {sign}{of_integers}", type_, x, y)


def equal(b: Emitter, dtype, x: Entry, y: Entry) -> Entry:
    """Whether x = y."""
    return compare(b, dtype, "eq", x, y)


def power_of_integer(b: Emitter, dtype, x: Entry, exponent: int) -> Entry:
    """The power x^n, by repeated squaring."""
    if exponent < 0:
        return divide(b, dtype, 1, power_of_integer(b, dtype, x, -exponent))
    found: Entry = folded(dtype, lambda one: one, 1)
    while exponent:
        if exponent & 1:
            found = multiply(b, dtype, found, x)
        exponent >>= 1
        if exponent:
            x = multiply(b, dtype, x, x)
    return found


def converted(b: Emitter, dtype, x: Entry, to) -> Entry:
    """An entry converted to another type. Floats to integers: rounded towards zero, saturating, nan to 0."""
    dtype, to = np.dtype(dtype), np.dtype(to)
    source, target = llvm_type(dtype), llvm_type(to)
    if dtype == to:
        return x
    if is_known(x):
        return _converted_number(x, dtype, to)
    if to.kind == "b":
        return compare(b, dtype, "ne", x, 0)
    if dtype.kind == "f":
        if to.kind == "f":
            return b.unary("fpext" if to.itemsize > dtype.itemsize else "fptrunc", source, x, target)
        return b.intrinsic("llvm.fptosi.sat" if to.kind == "i" else "llvm.fptoui.sat", source, [x], target)
    if to.kind == "f":
        return b.unary("sitofp" if dtype.kind == "i" else "uitofp", source, x, target)
    if BITS[source] == BITS[target]:
        return x
    if BITS[source] > BITS[target]:
        return b.unary("trunc", source, x, target)
    return b.unary("sext" if dtype.kind == "i" else "zext", source, x, target)


def _converted_number(x, dtype: np.dtype, to: np.dtype):
    if dtype.kind == "f" and to.kind in "iu":
        if math.isnan(x):
            return 0
        limits = np.iinfo(to)
        return int(limits.min) if x <= limits.min else int(limits.max) if x >= limits.max else int(x)
    with np.errstate(all="ignore"):
        return np.asarray(x, dtype).astype(to).item()


def least(dtype) -> Entry:
    """The smallest number of a type."""
    return -math.inf if kind(dtype) == "f" else False if kind(dtype) == "b" else int(np.iinfo(dtype).min)


def greatest(dtype) -> Entry:
    """The largest number of a type."""
    return math.inf if kind(dtype) == "f" else True if kind(dtype) == "b" else int(np.iinfo(dtype).max)


def zero(dtype) -> Entry:
    """The zero of a type; also of float0, JAX's type of the derivatives of integers."""
    return np.zeros((), dtype).item()


def _is(x: Entry, number) -> bool:
    return not isinstance(x, str) and x == number
