"""Sine and cosine without library calls, so that several can run in parallel, in vectors and in the CPU's pipelines.

x = k π/2 + r + c, k the nearest integer, |r| ≤ π/4 and c the rounding error of r (W. J. Cody and W. Waite, Software
Manual for the Elementary Functions, Prentice-Hall 1980, with fused products and π/2 in three parts). Then Taylor's
series, up to terms below 1e-18. For |x| ≥ 2^50, where the spacing of doubles is 1/4 or more, the C library is called:
by a branch, or after a loop over memory, which without branches is done in vectors.
Errors are below 0.8 units in the last place.
"""

import math

from ..lowering.emitter import Emitter, Entry, is_wide
from .series import NEAREST, bits_of, fused, number_of, plain, polynomial

# π/2 to 159 bits: each part is the double nearest to the remainder of the parts before.
_PARTS = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591698e-33)
LARGE = 2.0**50
_SINE = [-((-1) ** i) / math.factorial(2 * i + 1) for i in range(1, 9)]  # of −r³, −r⁵, …
_COSINE = [(-1) ** i / math.factorial(2 * i) for i in range(2, 9)]  # of r⁴, r⁶, …


def sine(b: Emitter, x: Entry) -> Entry:
    """The sine of a double that is not a constant."""
    return _once(b, "sin", x, 0)


def cosine(b: Emitter, x: Entry) -> Entry:
    """The cosine of a double that is not a constant."""
    return _once(b, "cos", x, 1)


def _once(b: Emitter, function: str, x: Entry, quadrants: int) -> Entry:
    key = (function, x)
    if (found := b.recall(key)) is None:
        found = b.remember(key, _otherwise(b, function, x, _in_quadrant(b, x, quadrants)))
    return found


def _in_quadrant(b: Emitter, x: Entry, quadrants: int) -> Entry:
    """The value sin(x + quadrants π/2) = ± sin(r + c) or ± cos(r + c)."""
    turns, r, c = _reduced(b, x)
    z = plain(b, "fmul", r, r)
    place = b.binary("add", "i64", turns, quadrants) if quadrants else turns
    odd = b.binary("icmp ne", "i64", b.binary("and", "i64", place, 1), 0)
    size = b.select(odd, "double", _cosine_of_rest(b, r, c, z), _sine_of_rest(b, r, c, z))
    sign = b.binary("shl", "i64", b.binary("and", "i64", place, 2), 62)
    return number_of(b, b.binary("xor", "i64", bits_of(b, size), sign))


def _reduced(b: Emitter, x: Entry) -> tuple[Entry, Entry, Entry]:
    """The integer k (in the last bits of an i64), r and c."""
    shifted = fused(b, x, 2 / math.pi, NEAREST)
    k, turns = plain(b, "fsub", shifted, NEAREST), bits_of(b, shifted)
    first, second, third = _PARTS
    rest = fused(b, k, -first, x)  # exact: a multiple of 2^-52 below 1
    share = plain(b, "fmul", k, second)
    r = plain(b, "fsub", rest, share)
    lost = plain(b, "fsub", plain(b, "fsub", rest, r), share)
    lost = plain(b, "fsub", lost, fused(b, k, second, b.unary("fneg", "double", share)))
    return turns, r, fused(b, k, -third, lost)


def _sine_of_rest(b: Emitter, r: Entry, c: Entry, z: Entry) -> Entry:
    """sin(r + c) = r − (r³ P(r²) − c (1 − r²/2)); this form keeps −0.0."""
    of_rest = fused(b, plain(b, "fmul", z, 0.5), c, b.unary("fneg", "double", c))
    return plain(b, "fsub", r, fused(b, plain(b, "fmul", z, r), polynomial(b, z, _SINE), of_rest))


def _cosine_of_rest(b: Emitter, r: Entry, c: Entry, z: Entry) -> Entry:
    """cos(r + c) = 1 − r²/2 + (r⁴ Q(r²) − r c), with the rounding error of 1 − r²/2 added."""
    half = plain(b, "fmul", z, 0.5)
    most = plain(b, "fsub", 1.0, half)
    lost = plain(b, "fsub", plain(b, "fsub", 1.0, most), half)
    small = fused(b, b.unary("fneg", "double", r), c, lost)
    return plain(b, "fadd", most, fused(b, plain(b, "fmul", z, z), polynomial(b, z, _COSINE), small))


def _otherwise(b: Emitter, function: str, x: Entry, found: Entry) -> Entry:
    """The value `found`, or the C library's if |x| is large: that call stands in a block that is rarely executed."""
    large = b.binary("fcmp oge", "double", b.intrinsic("llvm.fabs", "double", [x]), LARGE)
    if b.rare is not None:
        b.rare.append(large)
        return found
    before, cold, after = b.label, b.block_name(), b.block_name()
    b.line(f"br i1 {_seldom(b, large)}, label %{cold}, label %{after}")
    b.begin_block(cold)
    scope = b.scope()
    other = b.select(large, "double", b.call(function, "double", [x]), found)
    end = b.label
    b.line(f"br label %{after}")
    b.end_scope(scope)
    b.begin_block(after)
    result, type_ = b.name(is_wide(x)), b.type_text("double", is_wide(x))
    b.line(f"{result} = phi {type_} [ {found}, %{before} ], [ {other}, %{end} ]")
    return result


def _seldom(b: Emitter, condition: Entry) -> Entry:
    """The condition (in any lane), marked for LLVM as rarely true."""
    if is_wide(condition):
        bits, any_ = b.name(), b.name()
        b.line(f"{bits} = bitcast <{b.width} x i1> {condition} to i{b.width}")
        b.line(f"{any_} = icmp ne i{b.width} {bits}, 0")
        condition = any_
    b.declarations.add("declare i1 @llvm.expect.i1(i1, i1)")
    expected = b.name()
    b.line(f"{expected} = call i1 @llvm.expect.i1(i1 {condition}, i1 false)")
    return expected
