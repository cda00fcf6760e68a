"""Passive walkers: legs that walk down a slope by gravity alone. Angles in radians, leg length and gravity 1."""

import math

import jax.numpy as jnp
import numpy as np

from ..._jax.tracing import numpy_for
from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, Reference, computed, exact, near, positive, problem, require, state, traced


def _topple(t, x, args):
    return jnp.stack([x[1], jnp.sin(x[0])])


def _next_spoke(t, x, args):
    return args["slope"] + args["angle"] - x[0]


def _last_spoke(t, x, args):
    return x[0] - (args["slope"] - args["angle"])


def _step(forward):
    def reset(t, x, args):
        angle = args["slope"] - forward * args["angle"]
        return jnp.stack([0 * x[0] + angle, jnp.cos(2 * args["angle"]) * x[1]])

    return reset


def _swing(t, x, args):
    theta, phi, rate = x[0], x[1], x[2]
    fall, side = jnp.sin(theta - args["slope"]), jnp.sin(phi)
    return jnp.stack([rate, x[3], fall, fall + (rate**2 - jnp.cos(theta - args["slope"])) * side])


def _foot(t, x, args):
    return 2 * x[0] - x[1]


def _heel_strike(t, x, args):
    theta, rate = x[0], x[2]
    c = jnp.cos(2 * theta)
    struck = jnp.stack([-theta, -2 * theta, c * rate, c * (1 - c) * rate])
    return jnp.where(theta < 0, struck, x)  # no strike before the legs have passed each other: the foot scuffs


def _upright(t, x, args):
    return jnp.cos(x[0])


RIMLESS = Hybrid(_topple, [Transition(_next_spoke, _step(1)), Transition(_last_spoke, _step(-1))], names=("θ", "θ'"))
WALKER = Hybrid(
    _swing, [Transition(_foot, _heel_strike), Transition(_upright, terminal=True)], names=("θ", "φ", "θ'", "φ'")
)


@problem
def rimless_wheel(*, angle: Real = math.pi / 8, slope: Real = 0.2) -> Problem:
    """A wheel of spokes without a rim rolls down a slope: θ'' = sin θ on one spoke, from θ = γ − α to γ + α.

    There the next spoke strikes: θ⁺ = γ − α, θ'⁺ = cos 2α · θ'⁻, and likewise backwards where the wheel falls back.
    A step gains the energy 2 sin γ sin α, an impact leaves cos²2α of it: the rolling motion leaves an impact with θ'² =
    4 sin γ sin α cot²2α, its multipliers are 1 and cos²2α, and the exponents 0 and ln cos²2α / T, T the time of a step.
    A wheel that does not get over the top, θ = 0, rocks between two spokes to rest: such a run ends as `zeno`.

    Args:
        angle: α, half of the angle between two spokes, in (0, π/4).
        slope: γ, positive.

    Returns:
        A `Problem` that starts on the rolling motion, just after an impact, and is as long as 64 steps; with its exact
        reference where that motion gets over the top: 0, −0.5142260239816939 at the default parameters.

    Source:
        T. McGeer, Passive dynamic walking, Int. J. Robotics Res. 9 (1990) 62, doi:10.1177/027836499000900206.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.rimless_wheel().reference)
        0, -0.514226024 per unit time (multipliers 1 and cos² 2α of a step)
    """
    require("angle", angle, lambda a: 0 < a < math.pi / 4, "between 0 and π/4")
    positive(slope=slope)
    numbers = numpy_for(angle, slope)
    launch = 2 * numbers.sqrt(numbers.sin(slope) * numbers.sin(angle)) / numbers.tan(2 * angle)
    period, reference = (1.4, None) if traced(angle, slope) else _rolling(angle, slope, float(launch))
    return Problem(
        system=RIMLESS,
        x0=state(slope - angle, launch),
        args={"angle": angle, "slope": slope},
        t1=64 * period,
        transient=20.5 * period,  # half a step more, so that blocks end between two impacts
        reference=reference,
        source="T. McGeer, Int. J. Robotics Res. 9 (1990) 62, doi:10.1177/027836499000900206",
    )


def _rolling(angle: float, slope: float, launch: float) -> tuple[float, Reference | None]:
    """The time of a step, by quadrature, and the reference; a guess and None where the wheel does not roll."""
    # θ'² = E + 4 sin²(θ/2). With sin(θ/2) = √E/2 sinh u the time is ∫ du / cos(θ/2), smooth even for a slow top.
    energy = launch**2 - 4 * math.sin((slope - angle) / 2) ** 2
    if energy <= 0 or slope + angle >= math.pi / 2:
        return 1.4, None
    ends = np.arcsinh(2 * np.sin(np.array([slope - angle, slope + angle]) / 2) / math.sqrt(energy))
    nodes, weights = np.polynomial.legendre.leggauss(64)
    half = (ends[1] - ends[0]) / 2
    u = ends[0] + half * (1 + nodes)
    period = float(half * np.sum(weights / np.sqrt(1 - energy / 4 * np.sinh(u) ** 2)))
    rate = math.log(math.cos(2 * angle) ** 2) / period
    return period, exact(0.0, rate, source="multipliers 1 and cos² 2α of a step")


# The long gait at slope 0.009: θ and θ' after a heel strike, the second and third exponent.
_GAIT, _GAIT_RATE = 0.20031090054423764, -0.19983247300494023
_GAIT_DECAY = -0.13628896029417775
# Elsewhere θ/γ^(1/3) and θ'/γ^(1/3) in powers of γ^(2/3): fitted to fixed points by SciPy, γ = 0.0005 to 0.02, to 3e-8.
# The basin of the gait is so small that a start by scaling alone would fall.
_GAITS = (0.9709556356626904, -0.18648758864353307, 0.06054561460502856, -0.07170966442733566)
_GAIT_RATES = (-1.01484609463385, 1.2578921342393752, -0.150762477591438, 0.10093265153975915)


@problem
def simplest_walker(*, slope: Real = 0.009) -> Problem:
    """The simplest walking model: two legs, a mass at the hip, feet without mass, down a slope γ without motors.

        θ'' = sin(θ − γ),     φ'' = θ'' + (θ'² − cos(θ − γ)) sin φ

    θ is the angle of the stance leg to the slope's normal, φ that between the legs. At the heel strike, φ = 2θ, the
    legs change roles: with c = cos 2θ, (θ, φ, θ', φ')⁺ = (−θ, −2θ, cθ', c (1 − c) θ'). State (θ, φ, θ', φ'). φ'⁻ is
    forgotten: the saltation matrix has rank 3, and the last exponent is −inf. The foot also passes through the ground
    while the legs pass each other; that scuffing is ignored: the foot strikes where it comes down with θ < 0 only,
    else it goes on as it was. A start on the strike's surface with θ > 0, as here, is that just after a strike. The
    long gait attracts up to γ = 0.0151, then doubles its period, up to chaos and, near 0.019, falls. A walker that
    falls (cos θ = 0) ends the run as `terminated`.

    Args:
        slope: γ, positive, radians.

    Returns:
        A `Problem` that starts on the long gait (to 3e-8 up to γ = 0.02), just after a heel strike. At γ = 0.009 with a
        reference: 0, −0.13628896 twice, −inf (multipliers 1, −0.1901 ± 0.5576i, 0; period 3.882463752851621).

    Source:
        M. Garcia, A. Chatterjee, A. Ruina & M. Coleman, The simplest walking model: stability, complexity, and scaling,
        J. Biomech. Eng. 120 (1998) 281, doi:10.1115/1.2798313.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.simplest_walker().reference)
        0, -0.13628896029(20), -0.13628896029(20), -inf per unit time (multipliers of the long gait)
    """
    positive(slope=slope)
    theta, rate = (_scaled(powers, slope) for powers in (_GAITS, _GAIT_RATES))
    if near(slope, 0.009):
        theta, rate = _GAIT, _GAIT_RATE
    cosine = jnp.cos(2 * theta) if traced(slope) else math.cos(2 * theta)
    reference = None
    if near(slope, 0.009):
        values, stderr = (0.0, _GAIT_DECAY, _GAIT_DECAY, -math.inf), (0.0, 2e-10, 2e-10, 0.0)
        reference = computed(values, stderr, source="multipliers of the long gait")
    return Problem(
        system=WALKER,
        x0=state(theta, 2 * theta, rate, (1 - cosine) * rate),
        args={"slope": slope},
        t1=2000.0,
        transient=200.0,
        reference=reference,
        source="M. Garcia et al., J. Biomech. Eng. 120 (1998) 281, doi:10.1115/1.2798313",
    )


def _scaled(powers, slope):
    """γ^(1/3) times a polynomial in γ^(2/3)."""
    return slope ** (1 / 3) * sum(c * slope ** (2 * i / 3) for i, c in enumerate(powers))
