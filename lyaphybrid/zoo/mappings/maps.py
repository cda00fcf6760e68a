"""Maps. Exponents are per iteration.

Note: a slope of exactly 2 shifts the 53 binary digits of a floating-point number out one by one; then the orbit
stays at 0. So no default here has a slope that is a power of two.
"""

import math

import jax.numpy as jnp

from ...systems.hybrid import Hybrid, Transition
from ...systems.smooth import Map
from ..problem import Problem, Real, computed, exact, near, one_of, problem, require, state, traced

TURN = 2 * math.pi


def entropy(p) -> float:
    """−p ln p − (1 − p) ln(1 − p): the exponent of a full skew tent or baker's map of branch width p."""
    return -p * math.log(p) - (1 - p) * math.log(1 - p)


def _wrap(x, period=1.0):
    return x - period * jnp.floor(x / period)


def _henon(n, x, args):
    return jnp.stack([1 - args["a"] * x[0] ** 2 + x[1], args["b"] * x[0]])


def _logistic(n, x, args):
    return args["r"] * x * (1 - x)


def _cat(n, x, args):
    return _wrap(jnp.stack([2 * x[0] + x[1], x[0] + x[1]]))


def _standard(n, x, args):
    p = x[1] + args["K"] * jnp.sin(x[0])
    return _wrap(jnp.stack([x[0] + p, p]), TURN)


def _baker(n, x, args):
    p = args["p"]
    left = x[0] < p
    stretched = jnp.where(left, x[0] / p, (x[0] - p) / (1 - p))
    return jnp.stack([stretched, jnp.where(left, p * x[1], p + (1 - p) * x[1])])


def _kaplan_yorke(n, x, args):
    return jnp.stack([_wrap(args["slope"] * x[0]), args["alpha"] * x[1] + jnp.cos(2 * TURN * x[0])])


PLANE = ("x", "y")
HENON, LOGISTIC = Map(_henon, names=PLANE), Map(_logistic, names=("x",))
CAT, STANDARD = Map(_cat, names=PLANE), Map(_standard, names=("θ", "p"))
BAKER, KAPLAN_YORKE = Map(_baker, names=PLANE), Map(_kaplan_yorke, names=PLANE)
CAT_JUMPS = Hybrid(None, Transition(every=1.0, reset=_cat), names=PLANE)


@problem
def henon_map(*, a: Real = 1.4, b: Real = 0.3) -> Problem:
    """Hénon's map: x⁺ = 1 − ax² + y, y⁺ = bx.

    The exponents sum to ln|b| exactly.

    Args:
        a: strength of the fold.
        b: factor by which areas shrink.

    Returns:
        A `Problem`; at the default parameters with the reference 0.419191(37), −1.623163(37).

    Source:
        M. Hénon, A two-dimensional mapping with a strange attractor, Commun. Math. Phys. 50 (1976) 69,
        doi:10.1007/BF01608556.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.henon_map().parameters
        {'a': 1.4, 'b': 0.3}
    """
    known = near((a, b), 1.4, 0.3)
    return Problem(
        system=HENON,
        x0=state(0.1, 0.1),
        args={"a": a, "b": b},
        t1=200_000,
        transient=1000,
        clock="jumps",
        reference=computed((0.41919054, -1.62316334), (3.7e-5, 3.7e-5), source="1e8 iterations in C", clock="jumps")
        if known
        else None,
        source="M. Hénon, Commun. Math. Phys. 50 (1976) 69, doi:10.1007/BF01608556",
    )


@problem
def logistic_map(*, r: Real = 4.0) -> Problem:
    """The logistic map: x⁺ = r x (1 − x).

    At r = 4, x = sin²(πθ/2) turns it into the tent map of slope 2: the exponent is ln 2. For 1 < r < 3 the
    fixed point 1 − 1/r attracts, with exponent ln|2 − r|; at r = 2 that is −inf.

    Args:
        r: growth rate, in [0, 4].

    Returns:
        A `Problem`, with its exact reference at r = 4 and for 1 < r < 3.

    Source:
        R. M. May, Simple mathematical models with very complicated dynamics, Nature 261 (1976) 459,
        doi:10.1038/261459a0.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.logistic_map(r=2).reference.exponents
        (-inf,)
    """
    require("r", r, lambda v: 0 <= v <= 4, "in [0, 4], so that x stays in [0, 1]")
    reference = None
    if near(r, 4):
        reference = exact(math.log(2), source="conjugate to the tent map", clock="jumps")
    elif not traced(r) and 1 < r < 3:
        value = math.log(abs(2 - r)) if r != 2 else -math.inf
        reference = exact(value, source="slope 2 − r at the fixed point", clock="jumps")
    return Problem(
        system=LOGISTIC,
        x0=state(0.3),
        args={"r": r},
        t1=200_000,
        transient=1000,
        clock="jumps",
        reference=reference,
        source="R. M. May, Nature 261 (1976) 459, doi:10.1038/261459a0",
    )


@problem
def cat_map(*, form: str = "map") -> Problem:
    """Arnold's cat map: (x, y)⁺ = (2x + y, x + y) mod 1.

    The matrix has the eigenvalues φ² and φ⁻² with φ = (1 + √5)/2: the exponents are ±2 ln φ for every orbit.

    Args:
        form: "map", an `lh.Map`; or "jumps", the same as a hybrid system that only jumps (empty flow set).

    Returns:
        A `Problem` with the exact reference ±0.9624236501192069.

    Source:
        V. I. Arnold & A. Avez, Ergodic Problems of Classical Mechanics (Benjamin 1968).

    Example:
        >>> from lyaphybrid import zoo
        >>> type(zoo.cat_map(form="jumps").system).__name__
        'Hybrid'
    """
    one_of("form", form, ("map", "jumps"))
    value = 2 * math.log((1 + math.sqrt(5)) / 2)
    return Problem(
        system=CAT if form == "map" else CAT_JUMPS,
        x0=state(0.2137, 0.6481),
        args=None,
        t1=10_000,
        transient=50,
        clock="jumps",
        reference=exact(value, -value, source="eigenvalues of [[2, 1], [1, 1]]", clock="jumps"),
        source="V. I. Arnold & A. Avez, Ergodic Problems of Classical Mechanics (Benjamin 1968)",
    )


@problem
def standard_map(*, K: Real = 6.9115) -> Problem:
    """Chirikov's standard map: p⁺ = p + K sin θ, θ⁺ = θ + p⁺, both mod 2π; x = (θ, p).

    Symplectic: the exponents are ±λ. Sticky islands make convergence slow near some K.

    Args:
        K: strength of the kick.

    Returns:
        A `Problem`, with a reference at K = 6.9115 (1.26354(27)) and K = 6.9 (1.26413(84)).

    Source:
        B. V. Chirikov, A universal instability of many-dimensional oscillator systems, Phys. Rep. 52 (1979)
        263, doi:10.1016/0370-1573(79)90023-1.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.standard_map().reference)
        1.26354(27), -1.26354(27) per jump (1e8 iterations in C)
    """
    reference = None
    for kick, value, stderr in ((6.9115, 1.26354, 2.7e-4), (6.9, 1.26413, 8.4e-4)):
        if near(K, kick):
            reference = computed((value, -value), (stderr, stderr), source="1e8 iterations in C", clock="jumps")
    return Problem(
        system=STANDARD,
        x0=state(1.0, 2.0),
        args={"K": K},
        t1=200_000,
        transient=1000,
        clock="jumps",
        reference=reference,
        source="B. V. Chirikov, Phys. Rep. 52 (1979) 263, doi:10.1016/0370-1573(79)90023-1",
    )


@problem
def baker_map(*, p: Real = 0.3) -> Problem:
    """The generalised baker's map: (x/p, py) where x < p, else ((x − p)/(1 − p), p + (1 − p)y).

    It preserves area and Lebesgue measure is invariant, so the exponents are ±h with
    h = −p ln p − (1 − p) ln(1 − p). At p = 1/2, or another power of two, floating-point orbits collapse onto
    x = 0 within 53 iterations.

    Args:
        p: width of the left strip, in (0, 1).

    Returns:
        A `Problem` with its exact reference.

    Source:
        J. D. Farmer, E. Ott & J. A. Yorke, The dimension of chaotic attractors, Physica D 7 (1983) 153,
        doi:10.1016/0167-2789(83)90125-2.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.baker_map().reference.exponents[0]
        0.6108643020548935
    """
    require("p", p, lambda v: 0 < v < 1, "between 0 and 1")
    return Problem(
        system=BAKER,
        x0=state(0.7029218331588505, 0.5204366199388569),
        args={"p": p},
        t1=200_000,
        transient=100,
        clock="jumps",
        reference=None
        if traced(p)
        else exact(entropy(p), -entropy(p), source="Lebesgue measure is invariant", clock="jumps"),
        source="J. D. Farmer, E. Ott & J. A. Yorke, Physica D 7 (1983) 153, doi:10.1016/0167-2789(83)90125-2",
    )


@problem
def kaplan_yorke_map(*, alpha: Real = 0.2, slope: Real = 1.999999999) -> Problem:
    """Kaplan and Yorke's map: x⁺ = 2x mod 1, y⁺ = αy + cos 4πx, with a slope a little off 2.

    The Jacobian is triangular with constant diagonal: the exponents are ln(slope) and ln|α| for every orbit.
    With slope = 2 the exponents are still right, but x stands at 0 after 53 iterations, and so does
    everything that depends on the orbit.

    Args:
        alpha: contraction of y, |α| < 1.
        slope: of the x-map, above 1.

    Returns:
        A `Problem` with its exact reference.

    Source:
        J. L. Kaplan & J. A. Yorke, Chaotic behavior of multidimensional difference equations, Lecture Notes
        in Mathematics 730 (1979) 204, doi:10.1007/BFb0064319.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.kaplan_yorke_map().reference)
        0.6931471801, -1.609437912 per jump (triangular Jacobian)
    """
    require("alpha", alpha, lambda v: -1 < v < 1, "between −1 and 1")
    require("slope", slope, lambda v: v > 1, "above 1")
    reference = None
    if not traced(alpha, slope):
        contraction = math.log(abs(alpha)) if alpha else -math.inf
        reference = exact(math.log(slope), contraction, source="triangular Jacobian", clock="jumps")
    return Problem(
        system=KAPLAN_YORKE,
        x0=state(0.7029218331588505, 0.1),
        args={"alpha": alpha, "slope": slope},
        t1=10_000,
        transient=100,
        clock="jumps",
        reference=reference,
        source="J. L. Kaplan & J. A. Yorke, LNM 730 (1979) 204, doi:10.1007/BFb0064319",
    )
