"""Sines and cosines of several numbers at once, as code of the loop that asks for them.

XLA has them computed by calls of the C library, one number after the other. A call saves the registers, and waits
for the arithmetic before it: in a Runge–Kutta step of an oscillator in the plane the two cosines of its forcing
cost a third of the time. Here they are arithmetic like the rest, four numbers in one vector register.

With x = k π/2 + r, |r| ≤ π/4, the value is ± sin r or ± cos r by k mod 4. π/2 is taken off in three parts, the first
two of 33 bits: for |k| < 2²⁰ their products are exact (W. J. Cody & W. Waite, Software Manual for the Elementary
Functions, 1980). The polynomials, and the parts of π/2, are those of fdlibm 5.3 (k_sin.c, k_cos.c, e_rem_pio2.c; Sun
Microsystems, 1993). What is larger than that, or not finite, is not for these functions.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float64

__all__ = ["LARGEST", "cosine", "sine"]

LARGEST = 1.6e6  # below 2²⁰ π/2
HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
INTEGER = 1.5 * 2.0**52  # added to an integer k, it leaves k in the last bits
SINE = (  # (sin r - r) / r³ in powers of r²
    *(-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04),
    *(2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10),
)
COSINE = (  # (cos r - 1 + r²/2) / r⁴ in powers of r²
    *(4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05),
    *(-2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11),
)


@jax.custom_jvp
def sine(x: Float64[Array, "..."]) -> Float64[Array, "..."]:
    """Sin x, to 2.3e-16, for |x| < LARGEST."""
    return _turned(x, 0)


@jax.custom_jvp
def cosine(x: Float64[Array, "..."]) -> Float64[Array, "..."]:
    """Cos x, to 2.3e-16, for |x| < LARGEST."""
    return _turned(x, 1)


sine.defjvps(lambda dx, _, x: cosine(x) * dx)
cosine.defjvps(lambda dx, _, x: -sine(x) * dx)


def _turned(x, quarters: int):
    """The sine of x + quarters · π/2."""
    # Not (2 x / π + INTEGER) - INTEGER: XLA would simplify that to 2 x / π.
    k = jax.lax.round(x * (2 / jnp.pi), jax.lax.RoundingMethod.TO_NEAREST_EVEN)
    first, second, third = HALF_PI
    r = ((x - k * first) - k * second) - k * third
    square = r * r
    sin = r + r * square * _polynomial(SINE, square)
    cos = (1 - 0.5 * square) + square * square * _polynomial(COSINE, square)
    quadrant = _bits(k + INTEGER) + quarters
    value = jnp.where((quadrant & 1) == 1, cos, sin)
    sign = (quadrant & 2) << 62  # the first bit of a number
    return jax.lax.bitcast_convert_type(_bits(value) ^ sign, x.dtype)


def _polynomial(coefficients, x):
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * x + coefficient
    return value


def _bits(x):
    return jax.lax.bitcast_convert_type(x, jnp.int64)
