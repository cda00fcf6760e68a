"""The exponential function and the natural logarithm without library calls, as sine and cosine in `circular`.

Both split off a power of two: eˣ = 2ᵏ eʳ with |r| ≤ ln 2/2 and Taylor's series of eʳ; ln x = k ln 2 + ln(1 + f) with
1 + f between √½ and √2, and ln(1 + f) = 2 artanh s, s = f/(2 + f), as a series in s. Errors are below 0.9 units in the
last place.
"""

import math
import struct

from ..lowering.emitter import Emitter, Entry
from .series import NEAREST, bits_of, fused, number_of, plain, polynomial

_LN2 = (0.6931471805599453, 2.3190468138462996e-17)  # the double nearest to ln 2, and the remainder
_LN2_SHORT = (0.693147180369123816490, 1.9082149292705877e-10)  # the first part has 32 bits: k times it is exact
_EXPONENTIAL = [1 / math.factorial(i) for i in range(2, 15)]  # of r², r³, …
_LOGARITHM = [2 / (2 * i + 1) for i in range(1, 12)]  # of s², s⁴, …
_LEAST, _GREATEST = -746.0, 710.0  # below and above, eˣ is 0 and inf
_TINY, _TWO_54 = 2.0**-1022, 2.0**54  # the smallest normal number; subnormal ones are scaled by 2^54


def _bits(number: float) -> int:
    return struct.unpack("<q", struct.pack("<d", number))[0]


def exponential(b: Emitter, x: Entry) -> Entry:
    """The exponential of a double that is not a constant."""
    x = b.select(b.binary("fcmp ogt", "double", x, _GREATEST), "double", _GREATEST, x)
    x = b.select(b.binary("fcmp olt", "double", x, _LEAST), "double", _LEAST, x)
    shifted = fused(b, x, 1 / math.log(2), NEAREST)
    k = plain(b, "fsub", shifted, NEAREST)
    r = fused(b, k, -_LN2[1], fused(b, k, -_LN2[0], x))
    series = plain(b, "fadd", 1.0, fused(b, plain(b, "fmul", r, r), polynomial(b, r, _EXPONENTIAL), r))
    # 2ᵏ as a product of two factors: 2ᵏ itself may overflow although the result does not.
    power = b.binary("sub", "i64", bits_of(b, shifted), _bits(NEAREST))
    half = b.binary("lshr", "i64", b.binary("add", "i64", power, 2048), 1)
    other = b.binary("sub", "i64", b.binary("add", "i64", power, 2047), half)
    one = number_of(b, b.binary("shl", "i64", b.binary("sub", "i64", half, 1), 52))
    return plain(b, "fmul", plain(b, "fmul", series, one), number_of(b, b.binary("shl", "i64", other, 52)))


def logarithm(b: Emitter, x: Entry) -> Entry:
    """The natural logarithm of a double that is not a constant."""
    small = b.binary("fcmp olt", "double", x, _TINY)
    normal = b.select(small, "double", plain(b, "fmul", x, _TWO_54), x)
    bits = bits_of(b, normal)
    above = b.binary("sub", "i64", bits, _bits(math.sqrt(0.5)))
    k = b.binary("sub", "i64", b.binary("lshr", "i64", b.binary("xor", "i64", above, -(2**63)), 52), 2048)
    f = plain(b, "fsub", number_of(b, b.binary("sub", "i64", bits, b.binary("shl", "i64", k, 52))), 1.0)
    k = plain(b, "fsub", number_of(b, b.binary("add", "i64", k, _bits(NEAREST))), NEAREST)
    k = b.select(small, "double", plain(b, "fsub", k, 54.0), k)
    s = plain(b, "fdiv", f, plain(b, "fadd", f, 2.0))
    z, half = plain(b, "fmul", s, s), plain(b, "fmul", plain(b, "fmul", f, 0.5), f)
    # ln(1 + f) = f − (f²/2 − s (f²/2 + R)), R = 2/3 s² + 2/5 s⁴ + …: the correction to f is small.
    rest = plain(b, "fadd", half, plain(b, "fmul", z, polynomial(b, z, _LOGARITHM)))
    rest = plain(b, "fsub", half, fused(b, s, rest, plain(b, "fmul", k, _LN2_SHORT[1])))
    found = plain(b, "fsub", plain(b, "fmul", k, _LN2_SHORT[0]), plain(b, "fsub", rest, f))
    found = b.select(b.binary("fcmp olt", "double", x, math.inf), "double", found, x)  # inf and nan
    found = b.select(b.binary("fcmp olt", "double", x, 0.0), "double", math.nan, found)
    return b.select(b.binary("fcmp oeq", "double", x, 0.0), "double", -math.inf, found)
