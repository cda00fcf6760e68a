"""Hybrid systems with exactly known exponents, from piecewise linear structure."""

import math

import jax.numpy as jnp

from ...systems.hybrid import Hybrid, Transition
from ..mappings.maps import entropy
from ..problem import Problem, Real, exact, positive, problem, require, state, traced


def _tent(y, peak):
    return jnp.where(y < peak, y / peak, (1 - y) / (1 - peak))


def _expand(t, x, args):
    return jnp.stack([args["rate"] * x[0], 1 + 0 * x[1]])


def _until_one(t, x, args):
    return 1 - x[1]


def _fold(t, x, args):
    return jnp.stack([x[0] - jnp.floor(x[0]), 0 * x[1]])


def _wait(t, x, args):
    return jnp.stack([0 * x[0], 0 * x[1], 1 + 0 * x[2]])


def _roof(t, x, args):
    return 1 + x[0] - x[2]


def _fold_and_contract(t, x, args):
    y, z = x[0], x[1]
    squeezed = jnp.where(y < args["peak"], 0.25 * z, 0.4 * z + 0.6)
    return jnp.stack([_tent(y, args["peak"]), squeezed, 0 * x[2]])


def _grow(t, x, args):
    return jnp.stack([0 * x[0], args["growth"] * x[1] + x[0], 1 + 0 * x[2]])


def _low_roof(t, x, args):
    return 0.5 + x[0] - x[2]


def _fold_and_reset(t, x, args):
    return jnp.stack([_tent(x[0], args["peak"]), args["q"] * x[1], 0 * x[2]])


def _spiral(side):
    def field(t, x, args):
        sigma, omega = args[f"sigma_{side}"], args[f"omega_{side}"]
        return jnp.stack([sigma * x[0] - omega * x[1], omega * x[0] + sigma * x[1]])

    return field


def _across(t, x, args):
    return x[0]


BETA = Hybrid(_expand, Transition(_until_one, _fold))
SKEW = Hybrid(_wait, Transition(_roof, _fold_and_contract))
GROW = Hybrid(_grow, Transition(_low_roof, _fold_and_reset))
CONEWISE = Hybrid(
    {"right": _spiral("right"), "left": _spiral("left")},
    [
        Transition(_across, source="right", target="left", direction=-1),
        Transition(_across, source="left", target="right", direction=+1),
    ],
)


@problem
def conewise_linear(
    *,
    sigma_right: Real = 0.1,
    omega_right: Real = 1.0,
    sigma_left: Real = -0.05,
    omega_left: Real = 2.0,
) -> Problem:
    """A spiral in each half plane: x' = [[σ, −ω], [ω, σ]] x, σ and ω differing between x₁ > 0 and x₁ < 0.

    Nothing is reset; the field jumps, so that S = I + (f⁺ − f⁻) e₁ᵀ / f⁻₁ is not the identity. In polar
    coordinates the angle turns at the rate ω whatever the radius, half a turn in π/ω, while the radius grows
    at the rate σ. A turn takes T = π/ω_r + π/ω_l and multiplies the radius by e^μ, μ = πσ_r/ω_r + πσ_l/ω_l.
    The field is homogeneous, F(cx) = c F(x), so x(t) itself solves the variational equation, as
    F(x(t)) does: both return to their direction after a turn, multiplied by e^μ. So the
    fundamental matrix over a turn is e^μ times the identity, and both exponents are μ/T, at every whole
    turn without transient.

    Args:
        sigma_right: growth rate where x₁ > 0, per time.
        omega_right: angular velocity where x₁ > 0, positive, radians per time.
        sigma_left: growth rate where x₁ < 0.
        omega_left: angular velocity where x₁ < 0.

    Returns:
        A `Problem` in mode "right", 40 turns long, with its exact reference: 0.05 twice at the default
        parameters.

    Source:
        P. C. Müller, Calculation of Lyapunov exponents for dynamic systems with discontinuities, Chaos,
        Solitons & Fractals 5 (1995) 1671, doi:10.1016/0960-0779(94)00170-U; the exponents: above.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.conewise_linear().reference)
        0.05, 0.05 per unit time (growth over a turn)
    """
    positive(omega_right=omega_right, omega_left=omega_left)
    turn = math.pi / omega_right + math.pi / omega_left
    growth = math.pi * sigma_right / omega_right + math.pi * sigma_left / omega_left
    return Problem(
        system=CONEWISE,
        x0=state(1.0, 0.0),
        args={
            "sigma_right": sigma_right,
            "omega_right": omega_right,
            "sigma_left": sigma_left,
            "omega_left": omega_left,
        },
        mode="right",
        t1=40 * turn,
        reference=None if traced(turn, growth) else exact(growth / turn, growth / turn, source="growth over a turn"),
        source="P. C. Müller, Chaos, Solitons & Fractals 5 (1995) 1671, doi:10.1016/0960-0779(94)00170-U",
    )


@problem
def beta_clock(*, rate: Real = 0.6418538861723947) -> Problem:
    """Rényi's β-map in continuous time: x' = a x, τ' = 1; at τ = 1, x → x mod 1 and τ → 0. State (x, τ).

    Every cycle multiplies δx by e^a and the jump leaves it alone: the exponents are a and 0 for every orbit.
    Where e^a is an integer floating-point orbits collapse (see `baker_map`).

    Args:
        rate: a, positive, per time; the default is ln 1.9.

    Returns:
        A `Problem` with its exact reference.

    Source:
        W. Parry, On the β-expansions of real numbers, Acta Math. Acad. Sci. Hung. 11 (1960) 401,
        doi:10.1007/BF02020954.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.beta_clock().reference.exponents
        (0.6418538861723947, 0.0)
    """
    positive(rate=rate)
    return Problem(
        system=BETA,
        x0=state(0.7029, 0.0),
        args={"rate": rate},
        t1=1000.0,
        reference=None if traced(rate) else exact(rate, 0.0, source="growth over a cycle"),
        source="W. Parry, Acta Math. Acad. Sci. Hung. 11 (1960) 401, doi:10.1007/BF02020954",
    )


@problem
def skew_tent_roof(*, peak: Real = 0.3) -> Problem:
    """A flow under a roof: y' = z' = 0, τ' = 1; at τ = 1 + y a baker's map folds (y, z), and τ → 0.

    y → y/c where y < c, else (1 − y)/(1 − c); z → z/4 where y < c, else 0.4 z + 0.6. State (y, z, τ).
    Lebesgue measure is invariant for y, so the mean roof is 3/2, and by Abramov's formula the exponents are
    those of the map over it: h(c)/1.5 with h = −c ln c − (1 − c) ln(1 − c), 0, and (c ln 0.25 + (1 − c) ln
    0.4)/1.5. The guard depends on the state: without saltation the sum is right and the values are not.

    Args:
        peak: c, where the tent has its peak, in (0, 1); 1/2 collapses (see `baker_map`).

    Returns:
        A `Problem` with its exact reference.

    Source:
        L. M. Abramov, On the entropy of a flow, Dokl. Akad. Nauk SSSR 128 (1959) 873.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.skew_tent_roof().reference)
        0.407242868, 0, -0.7048612138 per unit time (Abramov's formula)
    """
    require("peak", peak, lambda c: 0 < c < 1, "between 0 and 1")
    reference = None
    if not traced(peak):
        contraction = peak * math.log(0.25) + (1 - peak) * math.log(0.4)
        reference = exact(entropy(peak) / 1.5, 0.0, contraction / 1.5, source="Abramov's formula")
    return Problem(
        system=SKEW,
        x0=state(0.7029218331588505, 0.5204366199388569, 0.0),
        args={"peak": peak},
        t1=20_000.0,
        transient=50.0,
        reference=reference,
        source="L. M. Abramov, Dokl. Akad. Nauk SSSR 128 (1959) 873",
    )


@problem
def grow_reset(*, q: Real = 0.5, growth: Real = 0.25, peak: Real = 0.3) -> Problem:
    """Growth between resets: y' = 0, z' = g z + y, τ' = 1; at τ = 1/2 + y: y → tent(y), z → q z, τ → 0.

    The tent is that of `skew_tent_roof`; state (y, z, τ). The tangent is block triangular. y drives (its
    exponent is the tent's, h(c) per jump), the direction of the flow is neutral, and δz on top of them obeys
    δz' = g δz, δz → q δz. Lebesgue measure is invariant for y, so the mean roof is 1 and the exponents per
    unit time are h(c), 0 and g + ln q. At q = 0 the reset destroys z: S has rank 2, and the last exponent is
    −inf after the first jump.

    Args:
        q: what a reset leaves of z, 0 ≤ q < e^{−g}, so that z stays bounded.
        growth: g, per time.
        peak: c, in (0, 1); 1/2 collapses (see `baker_map`).

    Returns:
        A `Problem` with its exact reference: 0.6108643020548935, 0, and −0.4431471805599453 or −inf (q = 0).

    Source:
        L. M. Abramov, On the entropy of a flow, Dokl. Akad. Nauk SSSR 128 (1959) 873; the system: this
        library.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.grow_reset(q=0).reference)
        0.6108643021, 0, -inf per unit time (triangular tangent, mean roof 1)
    """
    require("peak", peak, lambda c: 0 < c < 1, "between 0 and 1")
    reference = None
    if not traced(q, growth):
        bound = math.exp(-growth)
        require(
            "q",
            q,
            lambda v: 0 <= v < bound,
            f"at least 0 and below e^−growth = {bound:.4g}, so that z stays bounded",
        )
        if not traced(peak):
            decay = growth + math.log(q) if q else -math.inf
            reference = exact(entropy(peak), 0.0, decay, source="triangular tangent, mean roof 1")
    return Problem(
        system=GROW,
        x0=state(0.7029218331588505, 0.5204366199388569, 0.0),
        args={"q": q, "growth": growth, "peak": peak},
        t1=20_000.0,
        transient=50.0,
        reference=reference,
        source="L. M. Abramov, Dokl. Akad. Nauk SSSR 128 (1959) 873; the system: this library",
    )
