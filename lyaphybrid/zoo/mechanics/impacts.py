"""Balls that bounce and oscillators that hit a wall. State (x, v); the forcing is explicit in time."""

import cmath
import math

import jax.numpy as jnp

from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, Reference, computed, exact, near, positive, problem, require, state, traced


def _fall(t, x, args):
    return jnp.stack([x[1], 0 * x[1] - args["gravity"]])


def _height(t, x, args):
    return x[0]


def _rebound(t, x, args):
    return jnp.stack([x[0], -args["restitution"] * x[1]])


def _height_above_table(t, x, args):
    return x[0] - args["amplitude"] * jnp.sin(args["omega"] * t)


def _rebound_from_table(t, x, args):
    r, omega = args["restitution"], args["omega"]
    table = args["amplitude"] * omega * jnp.cos(omega * t)
    return jnp.stack([x[0], -r * x[1] + (1 + r) * table])


def _fall_in_own_units(t, x, args):
    return jnp.stack([x[1], 0 * x[1] - 2.0])


def _kick(t, x, args):
    return jnp.stack([x[0], -args["restitution"] * x[1] + args["drive"] + args["kick"] * jnp.sin(t)])


def _oscillate(t, x, args):
    force = args["amplitude"] * jnp.cos(args["omega"] * t)
    return jnp.stack([x[1], force - x[0] - 2 * args["zeta"] * x[1]])


def _gap(t, x, args):
    return args["gap"] - x[0]


def _pressing(t, x, args):
    return args["amplitude"] * jnp.cos(args["omega"] * t) - args["gap"]


def _bounces_on(t, x, args):
    return ~_chatter_ends(t, x, args)


def _chatter_ends(t, x, args):
    """Whether the impact is slow and the chatter ends before the acceleration changes much."""
    r, v, press = args["restitution"], x[1], _pressing(t, x, args)
    swing = args["amplitude"] * args["omega"]  # largest rate of the acceleration
    lasts = press**2 * (1 - r) > 8 * r * v * swing  # the further bounces take the time 2rv / ((1 − r) press)
    return (v < CHATTER_ENDS * args["amplitude"]) & (press > 0) & lasts


def _put_on_wall(t, x, args):
    return jnp.stack([0 * x[0] + args["gap"], 0 * x[1]])


def _stand(t, x, args):
    return 0 * x


def _nothing_moves(t, x, args, dx):
    return 0 * dx


def _velocity(t, x, args):
    return x[1]


CHATTER_ENDS = 1e-5  # velocity, in units of the amplitude, below which an impact under pressure ends the chatter

HEIGHT, MOTION = ("height", "velocity"), ("x", "v")
BOUNCING = Hybrid(_fall, Transition(_height, _rebound), names=HEIGHT)
KICKED = Hybrid(_fall, Transition(_height_above_table, _rebound_from_table), names=HEIGHT)
ZASLAVSKY = Hybrid(_fall_in_own_units, Transition(_height, _kick), names=HEIGHT)
IMPACTING = Hybrid(_oscillate, Transition(_gap, _rebound), names=MOTION)
STICKING = Hybrid(
    {"free": _oscillate, "stuck": _stand, "leaving": _oscillate},
    [
        Transition(_gap, _rebound, source="free", when=_bounces_on),
        Transition(_gap, _put_on_wall, source="free", target="stuck", when=_chatter_ends),
        Transition(_pressing, source="stuck", target="leaving"),
        # On leaving, the gap and its first two derivatives are zero: the guard is inactive until the mass turns back.
        Transition(_velocity, source="leaving", target="free", direction=+1),
    ],
    tangent={"stuck": _nothing_moves},
    names=MOTION,
)


@problem
def bouncing_ball(*, restitution: Real = 0.5, gravity: Real = 1.0, velocity: Real = 1.0) -> Problem:
    """A ball that bounces to rest: x'' = −g, and v⁺ = −r v⁻ at x = 0.

    Infinitely many bounces by the time 2 v₀ / (g (1 − r)): exponents per unit time do not exist, a run in
    time ends as `zeno`. Per jump they are 0 and 2 ln r: one cycle maps the field (v, −g) onto (r v, −g), and
    its determinant is r².

    Args:
        restitution: r, in (0, 1).
        gravity: g, length per time².
        velocity: v₀ of the start at x = 0, length per time.

    Returns:
        A `Problem` with its exact reference, per jump.

    Source:
        R. Goebel, R. Sanfelice & A. Teel, Hybrid dynamical systems, IEEE Control Systems 29 (2009) 28,
        doi:10.1109/MCS.2008.931718.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.bouncing_ball().reference)
        0, -1.386294361 per jump (cycle matrix)
    """
    require("restitution", restitution, lambda r: 0 < r < 1, "between 0 and 1")
    positive(gravity=gravity, velocity=velocity)
    # bounces that reduce the velocity to a thousandth; the first ones align the frame with the field
    thousand = 20 if traced(restitution) else math.ceil(math.log(1e-3) / math.log(restitution))
    return Problem(
        system=BOUNCING,
        x0=state(0.0, velocity),
        args={"restitution": restitution, "gravity": gravity},
        t1=thousand,
        transient=thousand,
        clock="jumps",
        reference=None
        if traced(restitution)
        else exact(0.0, 2 * math.log(restitution), source="cycle matrix", clock="jumps"),
        source="R. Goebel, R. Sanfelice & A. Teel, IEEE Control Systems 29 (2009) 28, doi:10.1109/MCS.2008.931718",
        parameters={"restitution": restitution, "gravity": gravity, "velocity": velocity},
    )


@problem
def kicked_ball(
    *,
    restitution: Real = 0.8,
    amplitude: Real = 1.0,
    omega: Real = 1.0,
    gravity: Real = 1.0,
) -> Problem:
    """A ball on a vibrating table: x'' = −g, v⁺ = −r v⁻ + (1 + r) Aω cos ωt where x falls to A sin ωt.

    One bounce a period, T = 2π/ω: v₀ = πg/ω leaves the table at the phase cos ωτ = πg (1 − r) / (Aω² (1 +
    r)). Where that orbit exists the start is on it (a little off it where it repels), and where it attracts
    the exponents are ln|μ|/T, μ the eigenvalues of S·[[1, T], [0, 1]], whose product is r²:
    −0.03551439921073647 twice at the default parameters. Aω²/g = 1.75 with r = 0.5 is chaotic, still with one
    bounce a period. Elsewhere chaos sooner or later visits the phases in which the ball comes to rest on the
    table: the run ends as `zeno`.

    Args:
        restitution: r, in (0, 1).
        amplitude: A, length.
        omega: ω, radians per time.
        gravity: g, length per time².

    Returns:
        A `Problem`, with its reference in the two cases above.

    Source:
        P. J. Holmes, The dynamics of repeated impacts with a sinusoidally vibrating table, J. Sound Vib. 84
        (1982) 173, doi:10.1016/S0022-460X(82)80122-3.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.kicked_ball().reference)
        -0.03551439921, -0.03551439921 per unit time (multipliers of the period-1 orbit)
    """
    require("restitution", restitution, lambda r: 0 < r < 1, "between 0 and 1")
    positive(amplitude=amplitude, omega=omega, gravity=gravity)
    x0, reference = (2.0 * amplitude, 0.0 * amplitude), None
    if not traced(restitution, amplitude, omega, gravity):
        x0, reference = _period_1(restitution, amplitude, omega, gravity)
    return Problem(
        system=KICKED,
        x0=state(*x0),
        args={"restitution": restitution, "amplitude": amplitude, "omega": omega, "gravity": gravity},
        t1=20_000 / omega,
        transient=1000 / omega,
        reference=reference,
        source="P. J. Holmes, J. Sound Vib. 84 (1982) 173, doi:10.1016/S0022-460X(82)80122-3",
    )


def _period_1(r, amplitude, omega, g) -> tuple[tuple[float, float], Reference | None]:
    """A start on (or near) the orbit of one bounce a period, in flight at t = 0; and the reference."""
    cosine = math.pi * g * (1 - r) / (amplitude * omega**2 * (1 + r))
    if cosine >= 1:
        return (2 * amplitude, math.pi * g / omega), None
    period, launch, phase = 2 * math.pi / omega, math.pi * g / omega, math.acos(cosine)
    # S of the guard x − A sin ωt at the bounce, columns: c₀, c₁ are the entries of (f⁺ − Dg f⁻ − ∂ₜg)/ḣ.
    rate = -launch - amplitude * omega * cosine
    c0 = 2 * launch / rate
    c1 = ((1 + r) * amplitude * omega**2 * math.sin(phase) - (1 + r) * g) / rate
    trace, determinant = (1 + c0) + c1 * period - r, r * r
    root = cmath.sqrt(trace**2 / 4 - determinant)
    multipliers = sorted((abs(trace / 2 + root), abs(trace / 2 - root)), reverse=True)
    flown = period - phase / omega
    x0 = (amplitude * math.sin(phase) + launch * flown - g * flown**2 / 2, launch - g * flown)
    if multipliers[0] < 1:
        rates = (math.log(m) / period for m in multipliers)
        return x0, exact(*rates, source="multipliers of the period-1 orbit")
    off = (x0[0], x0[1] + 0.05 * launch)
    if near((r, amplitude * omega**2 / g), 0.5, 1.75):
        values, stderr = (0.0587372, -0.2793728), (8e-6, 8e-6)
        return off, computed(
            (v * omega for v in values),
            (e * omega for e in stderr),
            source="event-driven C, two runs of 2e7 bounces",
        )
    return off, None


@problem
def zaslavsky(*, restitution: Real = 0.3, drive: Real = 10.0, kick: Real = 8.0) -> Problem:
    """Zaslavsky's kicked rotator as a ball: x'' = −2, and v⁺ = −r v⁻ + a + b sin t at x = 0.

    With gravity 2 a flight lasts as long as its launch velocity, so that velocity and phase at the bounces
    follow v⁺ = r v + a + b sin φ⁺, φ⁺ = φ + v: the table moves, but its displacement is neglected. Unlike the
    exact table (`kicked_ball`) the ball never comes to rest where a > |b|. The exponents sum to ln r per
    bounce.

    Args:
        restitution: r, in (0, 1).
        drive: a, constant gain of velocity.
        kick: b, amplitude of the gain that depends on the phase, |b| < a.

    Returns:
        A `Problem`; at the default parameters with the reference 0.1014444(89), −0.186716(13).

    Source:
        G. M. Zaslavsky, The simplest case of a strange attractor, Phys. Lett. A 69 (1978) 145,
        doi:10.1016/0375-9601(78)90195-0.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.zaslavsky().reference)
        0.1014444(89), -0.186716(13) per unit time (event-driven C, 2.4e8 bounces)
    """
    require("restitution", restitution, lambda r: 0 < r < 1, "between 0 and 1")
    if not traced(drive, kick):
        require("drive", drive, lambda a: a > abs(kick), f"above |kick| = {abs(kick):g}")
    known = near((restitution, drive, kick), 0.3, 10, 8)
    return Problem(
        system=ZASLAVSKY,
        x0=state(1.0, 10.0),
        args={"restitution": restitution, "drive": drive, "kick": kick},
        t1=100_000.0,
        transient=1000.0,
        reference=computed(
            (0.101444421225, -0.186716416475),
            (8.913825463645552e-06, 1.3405720358912802e-05),
            source="event-driven C, 2.4e8 bounces",
        )
        if known
        else None,
        source="G. M. Zaslavsky, Phys. Lett. A 69 (1978) 145, doi:10.1016/0375-9601(78)90195-0",
    )


# (omega, zeta, restitution) at gap 0, where the amplitude is only the unit of length; exponents; stderr; how
_IMPACT_VALUES = (
    (
        (2.8, 0.05, 0.8),
        (0.15783934932608695, -0.4761594737478261),
        (2.0e-4, 1.9e-4),
        "event-driven C, 2.3e6 impacts",
    ),
    ((2.0, 0.05, 0.8), (-0.118029, -0.124028), (1e-6, 1e-6), "event-driven C, 1e6 impacts"),
)


@problem
def impact_oscillator(
    *,
    omega: Real = 2.8,
    zeta: Real = 0.05,
    restitution: Real = 0.8,
    gap: Real = 0.0,
    amplitude: Real = 1.0,
    sticking: bool = False,
) -> Problem:
    """A forced oscillator at a rigid wall: x'' + 2ζx' + x = A cos ωt for x ≤ gap, v⁺ = −r v⁻ at x = gap.

    The exponents sum to −2ζ + 2 ln r · (impacts per unit time) exactly. Time is explicit: two exponents, and
    a third one, 0, if the phase counts as a variable.

    Where the force presses the mass against the wall, impacts may follow each other faster and faster: a complete
    chatter, infinitely many in a finite time. Such a run ends as `zeno`. With `sticking` it goes on: an impact that
    presses and is slower than 10⁻⁵ A puts the mass to rest on the wall, mode "stuck", until A cos ωt − gap, its
    acceleration there, falls through 0; then it goes off, "leaving" until it turns back, "free" after that. At rest
    the state does not depend on the past: both exponents are −inf, and the mass always leaves at the same phase. So
    leaving out the last bounces, about 10⁻⁵ of time, changes nothing later.

    Args:
        omega: ω, frequency of the forcing over the oscillator's own.
        zeta: ζ, damping over critical damping.
        restitution: r, in (0, 1].
        gap: position of the wall, length.
        amplitude: A, length.
        sticking: complete a chatter into a rest on the wall.

    Returns:
        A `Problem`, with the reference 0.15784(20), −0.47616(19) at the default parameters (chaos), and one
        at ω = 2 (periodic); none with sticking.

    Source:
        A. B. Nordmark, Non-periodic motion caused by grazing incidence in an impact oscillator, J. Sound Vib.
        145 (1991) 279, doi:10.1016/0022-460X(91)90592-8; chatter: A. B. Nordmark & P. T. Piiroinen, Simulation and
        stability analysis of impacting systems with complete chattering, Nonlinear Dynamics 58 (2009) 85,
        doi:10.1007/s11071-008-9463-y.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.impact_oscillator().reference)
        0.15784(20), -0.47616(19) per unit time (event-driven C, 2.3e6 impacts)
    """
    positive(omega=omega, amplitude=amplitude)
    require("restitution", restitution, lambda r: 0 < r <= 1, "in (0, 1]")
    reference = None
    for parameters, exponents, stderr, how in _IMPACT_VALUES:
        if near((omega, zeta, restitution), *parameters) and near(gap, 0.0) and not sticking:
            reference = computed(exponents, stderr, source=how)
    return Problem(
        system=STICKING if sticking else IMPACTING,
        mode="free" if sticking else None,
        x0=state(gap, -0.5 * amplitude),
        args={"omega": omega, "zeta": zeta, "restitution": restitution, "gap": gap, "amplitude": amplitude},
        t1=20_000.0,
        transient=500.0,
        reference=reference,
        source="A. B. Nordmark, J. Sound Vib. 145 (1991) 279, doi:10.1016/0022-460X(91)90592-8",
    )
