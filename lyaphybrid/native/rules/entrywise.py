"""Rules for single entries: arithmetic, comparisons, elementary functions."""

import math
from collections.abc import Callable

import numpy as np

from ..elementary import arithmetic as a
from ..elementary.circular import cosine, sine
from ..elementary.exponential import exponential, logarithm
from ..lowering.emitter import Emitter, Entry, is_known, is_wide
from ..lowering.lowering import ENTRYWISE, entrywise
from ..lowering.types import BITS, kind, llvm_type
from ..lowering.unsupported import UnsupportedError
from ..machine.code import has_fused_products


def _simple(function: Callable) -> Callable:
    """A rule from an arithmetic function whose operands all have the same type."""
    return lambda b, eqn, dtypes, *entries: function(b, dtypes[0], *entries)


for _names, _function in {
    ("add", "add_any"): a.add,
    ("sub",): a.subtract,
    ("mul",): a.multiply,
    ("div",): a.divide,
    ("rem",): a.remainder,
    ("max",): a.maximum,
    ("min",): a.minimum,
    ("neg",): a.negate,
    ("abs",): a.absolute,
}.items():
    entrywise(*_names)(_simple(_function))


def _comparison(relation: str) -> Callable:
    return lambda b, eqn, dtypes, x, y: a.compare(b, dtypes[0], relation, x, y)


for _relation in ("lt", "le", "gt", "ge", "eq", "ne"):
    entrywise(_relation)(_comparison(_relation))


def _bitwise(operation: str, fold: Callable) -> Callable:
    def function(b, eqn, dtypes, x, y):
        if is_known(x, y):
            return a.folded(dtypes[0], fold, x, y)
        if kind(dtypes[0]) == "b":
            return b.logic(operation, x, y)
        return b.binary(operation, llvm_type(dtypes[0]), x, y, commutes=True)

    return function


for _name, _fold in {"and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor}.items():
    entrywise(_name)(_bitwise(_name, _fold))


@entrywise("not")
def _not(b, eqn, dtypes, x):
    if is_known(x):
        return a.folded(dtypes[0], np.invert, x)
    return b.negation(x) if kind(dtypes[0]) == "b" else b.binary("xor", llvm_type(dtypes[0]), x, -1)


def _shift(operation: str, beyond: Callable) -> Callable:
    """`beyond`: the result of a shift by the number of bits or more, which LLVM does not define."""

    def function(b, eqn, dtypes, x, by):
        type_ = llvm_type(dtypes[0])
        bits = BITS[type_]
        unsigned = np.dtype(f"uint{max(bits, 8)}")
        as_unsigned = a.folded(unsigned, lambda y: y, by % 2**bits) if is_known(by) else by
        fits = a.compare(b, unsigned, "lt", as_unsigned, bits)
        shifted = b.binary(operation, type_, x, b.select(fits, type_, by, 0))
        return b.select(fits, type_, shifted, beyond(b, dtypes[0], x))

    return function


entrywise("shift_left")(_shift("shl", lambda b, dtype, x: 0))
entrywise("shift_right_logical")(_shift("lshr", lambda b, dtype, x: 0))
entrywise("shift_right_arithmetic")(
    _shift("ashr", lambda b, dtype, x: b.binary("ashr", llvm_type(dtype), x, BITS[llvm_type(dtype)] - 1))
)


@entrywise("population_count", "clz")
def _count_bits(b, eqn, dtypes, x):
    type_ = llvm_type(dtypes[0])
    if eqn.primitive.name == "population_count":
        return b.intrinsic("llvm.ctpop", type_, [x])
    found, shifted = BITS[type_], x  # llvm.ctlz has operands of two types, which `intrinsic` cannot call: compare
    for bit in range(BITS[type_]):
        top = a.compare(b, dtypes[0], "ne", b.binary("lshr", type_, shifted, bit), 0)
        found = b.select(top, type_, BITS[type_] - 1 - bit, found)
    return found


@entrywise("sign")
def _sign(b, eqn, dtypes, x):
    if is_known(x):
        return a.folded(dtypes[0], np.sign, x)
    type_, dtype = llvm_type(dtypes[0]), dtypes[0]
    positive = b.select(a.compare(b, dtype, "gt", x, 0), type_, 1, x)  # ±0 and nan are returned as they are
    return positive if kind(dtype) == "u" else b.select(a.compare(b, dtype, "lt", x, 0), type_, -1, positive)


@entrywise("convert_element_type")
def _convert(b, eqn, dtypes, x):
    return a.converted(b, dtypes[0], x, eqn.outvars[0].aval.dtype)


@entrywise("bitcast_convert_type")
def _bitcast(b, eqn, dtypes, x):
    source, to = np.dtype(dtypes[0]), np.dtype(eqn.outvars[0].aval.dtype)
    if source.itemsize != to.itemsize or "b" in (source.kind, to.kind):
        raise UnsupportedError("bitcast_convert_type between sizes")
    if is_known(x):
        return np.asarray(x, source).view(to).item()
    return x if llvm_type(source) == llvm_type(to) else b.unary("bitcast", llvm_type(source), x, llvm_type(to))


@entrywise("select_n")
def _select(b, eqn, dtypes, which, *cases):
    type_ = llvm_type(dtypes[1])
    if dtypes[0] == np.bool_:
        return b.select(which, type_, cases[1], cases[0])
    found = cases[-1]
    for i in range(len(cases) - 2, -1, -1):
        found = b.select(a.equal(b, dtypes[0], which, i), type_, cases[i], found)
    return found


@entrywise("clamp")
def _clamp(b, eqn, dtypes, low, x, high):
    return a.minimum(b, dtypes[1], a.maximum(b, dtypes[1], x, low), high)


@entrywise("is_finite")
def _is_finite(b, eqn, dtypes, x):
    if is_known(x):
        return math.isfinite(x)
    return a.compare(b, dtypes[0], "lt", a.absolute(b, dtypes[0], x), math.inf)


@entrywise("integer_pow")
def _integer_pow(b, eqn, dtypes, x):
    return a.power_of_integer(b, dtypes[0], x, eqn.params["y"])


@entrywise("polynomial")
def _polynomial(b, eqn, dtypes, x, *coefficients):
    """A polynomial by Horner's rule; the coefficients are ordered from the lowest degree to the highest."""
    *lower, found = coefficients
    for coefficient in reversed(lower):
        found = a.add(b, dtypes[0], a.multiply(b, dtypes[0], found, x), coefficient)
    return found


@entrywise("one_minus_square")
def _one_minus_square(b, eqn, dtypes, x):
    """1 − x² as (1 − x)(1 + x), without cancellation near |x| = 1, for the derivatives of tanh and asin."""
    return a.multiply(b, dtypes[0], a.subtract(b, dtypes[0], 1.0, x), a.add(b, dtypes[0], 1.0, x))


@entrywise("square")
def _square(b, eqn, dtypes, x):
    return a.multiply(b, dtypes[0], x, x)


@entrywise("copy", "copy_p", "stop_gradient", "real", "reshard", "sharding_constraint", "pvary")
def _same(b, eqn, dtypes, x):
    return x


@entrywise("reduce_precision")
def _reduce_precision(b, eqn, dtypes, x):
    limits = np.finfo(dtypes[0])
    if (eqn.params["exponent_bits"], eqn.params["mantissa_bits"]) != (limits.nexp, limits.nmant):
        raise UnsupportedError("reduce_precision to a type that is no type of LLVM's")
    return x


@entrywise("round")
def _round(b, eqn, dtypes, x):
    to_even = int(eqn.params["rounding_method"]) == 1
    return b.intrinsic("llvm.roundeven" if to_even else "llvm.round", llvm_type(dtypes[0]), [x])


# --- elementary functions --------------------------------------------------------------------------------------------


def _intrinsic(name: str, fold: Callable) -> Callable:
    """A rule from an LLVM intrinsic, which becomes an instruction or a call of the C library."""

    def function(b: Emitter, eqn, dtypes, *entries: Entry) -> Entry:
        _only_floats(eqn, dtypes)
        if is_known(*entries):
            return a.folded(dtypes[0], fold, *entries)
        return b.intrinsic(name, llvm_type(dtypes[0]), entries)

    return function


def _library(name: str, fold: Callable | None = None) -> Callable:
    """A rule from a function of the C library; its name for float32 ends with f."""

    def function(b: Emitter, eqn, dtypes, *entries: Entry) -> Entry:
        _only_floats(eqn, dtypes)
        if fold is not None and is_known(*entries):
            return a.folded(dtypes[0], fold, *entries)
        type_ = llvm_type(dtypes[0])
        return b.call(name if type_ == "double" else name + "f", type_, entries)

    return function


def _only_floats(eqn, dtypes) -> None:
    if any(kind(dtype) != "f" or dtype != dtypes[0] for dtype in dtypes):
        raise UnsupportedError(f"{eqn.primitive.name} of {', '.join(str(dtype) for dtype in dtypes)}")


for _name, _fold in {
    "sqrt": np.sqrt, "exp2": np.exp2, "log2": np.log2,
    "pow": np.power, "floor": np.floor, "ceil": np.ceil,
}.items():  # fmt: skip
    entrywise(_name)(_intrinsic(f"llvm.{_name}", _fold))


def _without_calls(name: str, fold: Callable, written: Callable, vectors_only: bool) -> Callable:
    """A rule from our inline version of a function of doubles; float32 is converted to float64 and back.

    `vectors_only`: call the C library for scalars outside loops over memory, because it is faster there.
    """
    by_library = _intrinsic(f"llvm.{name}", fold)

    def function(b: Emitter, eqn, dtypes, x: Entry) -> Entry:
        single = vectors_only and not (is_wide(x) or b.in_vector_loop)
        if is_known(x) or single or not has_fused_products():
            return by_library(b, eqn, dtypes, x)
        _only_floats(eqn, dtypes)
        return a.converted(b, np.float64, written(b, a.converted(b, dtypes[0], x, np.float64)), dtypes[0])

    return function


entrywise("sin")(_without_calls("sin", np.sin, sine, False))
entrywise("cos")(_without_calls("cos", np.cos, cosine, False))
entrywise("exp")(_without_calls("exp", np.exp, exponential, True))
entrywise("log")(_without_calls("log", np.log, logarithm, True))

for _name, _fold in {
    "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "sinh": np.sinh,
    "cosh": np.cosh, "tanh": np.tanh, "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh,
    "log1p": np.log1p, "expm1": np.expm1, "cbrt": np.cbrt, "nextafter": np.nextafter, "erf": None, "erfc": None,
    "lgamma": None,
}.items():  # fmt: skip
    entrywise(_name)(_library(_name, _fold))


@entrywise("rsqrt")
def _rsqrt(b, eqn, dtypes, x):
    _only_floats(eqn, dtypes)
    root = a.folded(dtypes[0], np.sqrt, x) if is_known(x) else b.intrinsic("llvm.sqrt", llvm_type(dtypes[0]), [x])
    return a.divide(b, dtypes[0], 1.0, root)


@entrywise("logistic")
def _logistic(b, eqn, dtypes, x):
    _only_floats(eqn, dtypes)
    power = ENTRYWISE["exp"](b, eqn, dtypes, a.negate(b, dtypes[0], x))
    return a.divide(b, dtypes[0], 1.0, a.add(b, dtypes[0], 1.0, power))
