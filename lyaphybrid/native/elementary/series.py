"""Building blocks of elementary functions: fused products, polynomials, the bits of a number."""

from collections.abc import Sequence

from ..lowering.emitter import Emitter, Entry

NEAREST = 1.5 * 2.0**52  # x + NEAREST has the integer nearest to x in its last bits (|x| < 2^51)


def fused(b: Emitter, x: Entry, y: Entry, z: Entry) -> Entry:
    """The double x·y + z, rounded once."""
    return b.intrinsic("llvm.fma", "double", [x, y, z])


def plain(b: Emitter, operation: str, x: Entry, y: Entry) -> Entry:
    """An operation on doubles that is never fused: compensated arithmetic relies on its rounding."""
    return b.binary(operation, "double", x, y, operation in ("fadd", "fmul"))


def polynomial(b: Emitter, z: Entry, coefficients: Sequence[float]) -> Entry:
    """The polynomial Σ cᵢ zⁱ by Estrin's scheme (pairs of terms, pairs of pairs, …): more parallel than Horner's."""
    terms: list[Entry] = list(coefficients)
    while len(terms) > 1:
        pairs = [fused(b, z, high, low) for low, high in zip(terms[::2], terms[1::2], strict=False)]
        terms = [*pairs, terms[-1]] if len(terms) % 2 else pairs
        z = plain(b, "fmul", z, z)
    return terms[0]


def bits_of(b: Emitter, x: Entry) -> Entry:
    """The bits of a double, as an integer."""
    return b.unary("bitcast", "double", x, "i64")


def number_of(b: Emitter, bits: Entry) -> Entry:
    """The double that has these bits."""
    return b.unary("bitcast", "i64", bits, "double")
